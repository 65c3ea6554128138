/** The buttons of the editor, and the list by which its things are chosen without a pointer. */
import { addable, thingsOf } from "./edit.js";
import { byId, fillSelect, show } from "./dom.js";

const KINDS_TO_ADD = ["wall", "turret", "flag"];

export class EditBar {
  constructor(editor) {
    this.editor = editor;
    for (const kind of KINDS_TO_ADD) {
      byId(`add-${kind}`).addEventListener("click", () => editor.add(kind));
    }
    byId("remove").addEventListener("click", () => editor.remove());
    byId("thing").addEventListener("change", () => {
      const [kind, index] = byId("thing").value.split(" ");
      editor.choose(index === undefined ? null : { kind, index: Number(index) });
    });
    byId("edit").addEventListener("click", () => this.toggle(!editor.on));
  }

  toggle(on) {
    this.editor.toggle(on);
    byId("edit").setAttribute("aria-pressed", String(on));
    show(byId("edit-bar"), on);
    this.draw();
  }

  /** Called when something is chosen or the scenario has changed. */
  draw() {
    const { editor } = this;
    if (!editor.on || !editor.seen()) return;
    const scenario = editor.seen();
    const may = addable(scenario);
    for (const kind of KINDS_TO_ADD) show(byId(`add-${kind}`), may[kind]);
    const choices = thingsOf(scenario).map(({ kind, index }) =>
      [`${kind} ${index}`, `${kind} ${index + 1}`]);
    fillSelect(byId("thing"), [["", "nothing chosen"], ...choices]);
    byId("thing").value = editor.chosen ? `${editor.chosen.kind} ${editor.chosen.index}` : "";
    byId("remove").disabled = !editor.canRemove();
  }
}
