/** Small helpers: elements, numbers as text, canvases as sharp as the screen. */

export function byId(id) {
  return document.getElementById(id);
}

/** Make an element; `text` sets its text, `true` an empty attribute, null and false none. */
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "text") element.textContent = value;
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null) element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

export function show(element, on) {
  element.hidden = !on;
}

/** Replace the choices of a select and keep what was chosen, if it is still there. */
export function fillSelect(select, choices) {
  const before = select.value;
  select.replaceChildren(...choices.map(([value, text]) => make("option", { value, text })));
  if (choices.some(([value]) => String(value) === before)) select.value = before;
}

const shortNumber = new Intl.NumberFormat("en", { maximumSignificantDigits: 3 });
const wholeNumber = new Intl.NumberFormat("en", { maximumFractionDigits: 0 });

export const FONT = "11px system-ui, sans-serif";

/** A number of few characters; "–" for what is not known. */
export function short(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  const size = Math.abs(value);
  if (size >= 1e7 || (size < 1e-3 && size > 0)) return value.toExponential(1);
  return size >= 1000 ? wholeNumber.format(value) : shortNumber.format(value);
}

/** A name of the data as people read it. */
export function words(name) {
  return String(name).replaceAll("_", " ");
}

/** Call `action` with the last arguments once nothing has come for `wait` milliseconds. */
export function debounce(action, wait) {
  let timer = 0;
  return (...values) => {
    clearTimeout(timer);
    timer = setTimeout(() => action(...values), wait);
  };
}

/** Fit a canvas to its box; returns an empty pen in CSS pixels, and width and height in those. */
export function openCanvas(canvas) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const width = canvas.clientWidth;
  const height = canvas.clientHeight;
  const [columns, rows] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== columns || canvas.height !== rows) {
    canvas.width = columns;
    canvas.height = rows;
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  return { pen, width, height };
}

/** Let the browser save a blob as a file. */
export function download(blob, name) {
  const link = make("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

export function clamp(value, low, high) {
  return Math.min(high, Math.max(low, value));
}
