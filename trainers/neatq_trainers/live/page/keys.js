/** The keyboard. */

const TYPING = "input[type=text], select, textarea, dialog[open], dialog[open] *";
const PRESSED = "button, summary, a, input[type=checkbox]";
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

/** Call `actions` by key; see the dialog of keys in index.html for what each is. */
export function wireKeys(actions) {
  window.addEventListener("keydown", (event) => {
    if (event.target.matches(TYPING)) return;
    if ((event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "z") {
      event.preventDefault();
      actions.undo();
    } else if (!(event.ctrlKey || event.metaKey || event.altKey) && press(event, actions)) {
      event.preventDefault();
    }
  });
  // A button that was clicked by mouse gives the keyboard back to the page.
  document.addEventListener("click", (event) => {
    if (event.detail && event.target.closest("button")) document.activeElement?.blur();
  });
}

/** Returns whether the key was one of ours. */
function press({ key, target, shiftKey }, actions) {
  if (target.matches(PRESSED) && (key === " " || key === "Enter")) return false;
  if (key in ARROWS) {
    const free = target === document.body || target.matches("canvas");
    return free && actions.arrow(...ARROWS[key], shiftKey);
  }
  const action = {
    " ": actions.pause, ".": actions.step, "[": actions.previous, "]": actions.next,
    Escape: actions.leave, "+": actions.zoomIn, "=": actions.zoomIn, "-": actions.zoomOut,
    0: actions.fit, Delete: actions.remove, Backspace: actions.remove, "?": actions.help,
    e: actions.edit,
  }[key];
  action?.();
  return Boolean(action);
}
