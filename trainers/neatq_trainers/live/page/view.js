/** The camera over the field, and what fingers, mouse and wheel do to it. */
import { clamp } from "./dom.js";

const MOST_SCALE = 40;
const MARGIN = 14;
const LEGEND_PIXELS = 24; // room for the legend below a field that is seen whole
const TAP_PIXELS = 5;

/** Where field points lie on the canvas; y points up in the field and down on the canvas. */
export class View {
  constructor() {
    this.scale = 1;
    this.x = 400;
    this.y = 400;
    this.width = 1;
    this.height = 1;
    this.fitted = true;
  }

  /** Tell the canvas's size and the field's; a view that was fitted stays so. */
  resize(width, height, field) {
    const changed = width !== this.width || height !== this.height || field !== this.field;
    this.width = width;
    this.height = height;
    this.field = field;
    if (changed && this.fitted) this.fit();
  }

  fitScale() {
    const wide = (this.width - 2 * MARGIN) / this.field.width;
    const high = (this.height - 2 * MARGIN - LEGEND_PIXELS) / this.field.height;
    return Math.max(Math.min(wide, high), 0.01);
  }

  fit() {
    this.scale = this.fitScale();
    this.x = this.field.width / 2;
    this.y = this.field.height / 2 - LEGEND_PIXELS / 2 / this.scale;
    this.fitted = true;
  }

  toScreen(x, y) {
    return [
      this.width / 2 + (x - this.x) * this.scale,
      this.height / 2 - (y - this.y) * this.scale,
    ];
  }

  toField(column, row) {
    return [
      this.x + (column - this.width / 2) / this.scale,
      this.y - (row - this.height / 2) / this.scale,
    ];
  }

  zoom(factor, column = this.width / 2, row = this.height / 2) {
    const [x, y] = this.toField(column, row);
    this.scale = clamp(this.scale * factor, this.fitScale() / 3, MOST_SCALE);
    const [nowX, nowY] = this.toField(column, row);
    this.x += x - nowX;
    this.y += y - nowY;
    this.hold();
  }

  pan(columns, rows) {
    this.x -= columns / this.scale;
    this.y += rows / this.scale;
    this.hold();
  }

  /** Keep the field in sight. */
  hold() {
    this.x = clamp(this.x, 0, this.field.width);
    this.y = clamp(this.y, 0, this.field.height);
    this.fitted = false;
  }
}

/**
 * Pointers on a canvas as gestures: two fingers zoom, one drags or taps.
 *
 * `on` has touched(event) for each event, press(at) that returns whether something is dragged
 * (otherwise the view is), drag(at, event), drop(), tap(at) and hover(at or null); `at` is
 * [column, row] in CSS pixels of the canvas.
 */
export class Gestures {
  constructor(canvas, view, on) {
    Object.assign(this, { canvas, view, on, pointers: new Map(), moved: false, held: false });
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    canvas.addEventListener("pointercancel", (event) => this.up(event));
    canvas.addEventListener("pointerleave", () => on.hover(null));
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
  }

  place(event) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  down(event) {
    if (event.button > 0) return;
    this.on.touched(event);
    this.canvas.setPointerCapture(event.pointerId);
    const at = this.place(event);
    this.pointers.set(event.pointerId, at);
    if (this.pointers.size > 1) {
      if (this.held) this.on.drop();
      this.held = false;
      this.moved = true;
      return;
    }
    this.start = at;
    this.moved = false;
    this.held = this.on.press(at);
  }

  move(event) {
    this.on.touched(event);
    const at = this.place(event);
    const before = this.pointers.get(event.pointerId);
    if (!before) {
      this.on.hover(at);
      return;
    }
    if (this.pointers.size === 2) this.pinch(event.pointerId, before, at);
    else this.one(before, at, event);
    this.pointers.set(event.pointerId, at);
  }

  one(before, at, event) {
    const far = Math.hypot(at[0] - this.start[0], at[1] - this.start[1]) > TAP_PIXELS;
    if (!this.moved && !far) return;
    const from = this.moved ? before : this.start;
    this.moved = true;
    if (this.held) this.on.drag(at, event);
    else this.view.pan(at[0] - from[0], at[1] - from[1]);
  }

  pinch(id, before, at) {
    const [other] = [...this.pointers].filter(([one]) => one !== id).map(([, place]) => place);
    const distance = (one) => Math.hypot(one[0] - other[0], one[1] - other[1]) || 1;
    this.view.zoom(distance(at) / distance(before), other[0], other[1]);
  }

  up(event) {
    if (!this.pointers.delete(event.pointerId)) return;
    this.on.touched(event);
    if (this.pointers.size) return;
    const cancelled = event.type === "pointercancel";
    if (this.held && (this.moved || cancelled)) this.on.drop();
    else if (!this.moved && !cancelled) this.on.tap(this.place(event));
    this.held = false;
  }

  wheel(event) {
    event.preventDefault();
    this.on.touched(event);
    const lines = event.deltaMode === 1 ? 16 : 1;
    const amount = clamp(event.deltaY * lines, -240, 240);
    this.view.zoom(Math.exp(-amount / 500), ...this.place(event));
  }
}
