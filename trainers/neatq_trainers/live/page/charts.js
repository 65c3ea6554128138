/** Curves of the run and species over time, on small canvases. */
import { kindColour, theme } from "./colour.js";
import { FONT, openCanvas, short, words } from "./dom.js";

const LEFT = 46;
const RIGHT = 52;
const TOP = 10;
const BOTTOM = 22;

/** What counts as time in rows. */
function timeOf(row) {
  return ["tick", "steps", "generation"].find((key) => row?.[key] !== undefined) ?? "tick";
}

/** Add rows to a list; a run that was taken back to an earlier time begins again from there. */
export function withRows(list, rows) {
  if (!rows.length) return list;
  const time = timeOf(rows[0]);
  const kept = list.length && list.at(-1)[time] >= rows[0][time]
    ? list.filter((row) => row[time] < rows[0][time]) : list;
  kept.push(...rows);
  return kept;
}

/** About `count` round numbers within low..high. */
function ticksWithin(low, high, count) {
  const wide = high - low;
  if (!(wide > 0)) return [low];
  const power = 10 ** Math.floor(Math.log10(wide / count));
  const step = [1, 2, 5, 10].map((one) => one * power).find((one) => wide / one <= count);
  const first = Math.ceil(low / step - 1e-9);
  const length = Math.floor(high / step + 1e-9) - first + 1;
  return Array.from({ length }, (_, i) => (first + i) * step);
}

/** The box of a chart with its axes; returns how numbers become places. */
function drawAxes(pen, width, height, [low, high], [bottom, top], unit) {
  const [wide, tall] = [Math.max(width - LEFT - RIGHT, 10), Math.max(height - TOP - BOTTOM, 10)];
  const column = (x) => LEFT + ((x - low) / (high - low || 1)) * wide;
  const row = (y) => TOP + tall - ((y - bottom) / (top - bottom || 1)) * tall;
  pen.font = FONT;
  pen.lineWidth = 1;
  pen.strokeStyle = theme().line;
  pen.fillStyle = theme().muted;
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  for (const y of ticksWithin(bottom, top, Math.max(2, tall / 32))) {
    rule(pen, [LEFT, row(y)], [LEFT + wide, row(y)]);
    pen.fillText(short(y), LEFT - 6, row(y));
  }
  pen.textAlign = "center";
  pen.textBaseline = "top";
  for (const x of ticksWithin(low, high, Math.max(2, wide / 110))) {
    rule(pen, [column(x), TOP + tall], [column(x), TOP + tall + 4]);
    pen.fillText(short(x), column(x), TOP + tall + 7);
  }
  pen.textAlign = "right";
  pen.fillText(unit, LEFT - 10, TOP + tall + 7);
  return { column, row, wide, tall };
}

function rule(pen, from, to) {
  pen.beginPath();
  pen.moveTo(...from);
  pen.lineTo(...to);
  pen.stroke();
}

function sayNothing(pen, width, height, text) {
  pen.font = FONT;
  pen.fillStyle = theme().muted;
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.fillText(text, width / 2, height / 2);
}

/** Every so many of a long list, and its last, so that no more than `most` are left. */
function thinned(list, most) {
  const step = Math.ceil(list.length / most);
  return list.filter((_, i) => i % step === 0 || i === list.length - 1);
}

/** One number of the rows as a curve; the pointer reads values off it. */
export class CurveChart {
  constructor(canvas) {
    this.canvas = canvas;
    this.rows = [];
    this.name = "";
    this.pointer = null;
    canvas.addEventListener("pointermove", (event) => this.point(event.offsetX));
    canvas.addEventListener("pointerleave", () => this.point(null));
  }

  point(column) {
    this.pointer = column;
    this.draw();
  }

  draw() {
    const { pen, width, height } = openCanvas(this.canvas);
    const time = timeOf(this.rows[0]);
    const points = thinned(this.rows.flatMap((row) =>
      (Number.isFinite(row[this.name]) ? [[row[time], row[this.name]]] : [])), 1000);
    if (!points.length) {
      sayNothing(pen, width, height, "The first numbers come soon.");
      return;
    }
    const last = points.at(-1);
    const name = words(this.name);
    this.canvas.setAttribute("aria-label", `${name}: ${short(last[1])} at ${time} ${last[0]}`);
    const axes = drawAxes(pen, width, height, spanOf(points, 0, 0), spanOf(points, 1, 0.06), time);
    this.drawCurve(pen, points, axes);
    const near = this.pointer === null ? last : nearest(points, axes, this.pointer);
    drawPoint(pen, near, axes, this.pointer === null ? "" : `${time} ${short(near[0])}: `);
  }

  drawCurve(pen, points, { column, row }) {
    pen.strokeStyle = theme().positive;
    pen.lineWidth = 2;
    pen.lineJoin = "round";
    pen.beginPath();
    for (const [x, y] of points) pen.lineTo(column(x), row(y));
    pen.stroke();
  }
}

function nearest(points, { column }, at) {
  return points.reduce((best, one) =>
    (Math.abs(column(one[0]) - at) < Math.abs(column(best[0]) - at) ? one : best));
}

function drawPoint(pen, [x, y], { column, row, wide }, before) {
  pen.fillStyle = theme().positive;
  pen.beginPath();
  pen.arc(column(x), row(y), 3.5, 0, 2 * Math.PI);
  pen.fill();
  pen.font = `600 ${FONT}`;
  pen.fillStyle = theme().ink;
  pen.strokeStyle = theme().paper;
  pen.lineWidth = 4;
  const text = before + short(y);
  const turned = before && column(x) > LEFT + wide * 0.6;
  pen.textAlign = turned ? "right" : "left";
  pen.textBaseline = "middle";
  const at = column(x) + (turned ? -8 : 8);
  pen.strokeText(text, at, row(y));
  pen.fillText(text, at, row(y));
}

/** Least and greatest of an axis, with a share of room; never of no width. */
function spanOf(points, axis, share) {
  const values = points.map((point) => point[axis]);
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const room = (high - low) * share || (high === low ? Math.abs(high) * 0.1 || 1 : 0);
  return [axis ? low - room : low, high + room];
}

/** Sizes of species over time, one on top of the other. */
export class SpeciesChart {
  constructor(canvas) {
    this.canvas = canvas;
    this.rows = [];
  }

  draw() {
    const { pen, width, height } = openCanvas(this.canvas);
    const rows = thinned(this.rows, 400);
    if (!rows.length) {
      sayNothing(pen, width, height, "No species yet.");
      return;
    }
    const time = timeOf(rows[0]);
    const names = [...new Set(rows.flatMap((row) => Object.keys(row.sizes)))]
      .sort((a, b) => a - b);
    const totals = rows.map(({ sizes }) => Object.values(sizes).reduce((sum, one) => sum + one, 0));
    const times = rows.map((row) => [row[time]]);
    const axes = drawAxes(pen, width, height, spanOf(times, 0, 0), [0, Math.max(...totals, 1)],
      time);
    const living = Object.keys(rows.at(-1).sizes).length;
    this.canvas.setAttribute("aria-label", `${living} species at ${time} ${rows.at(-1)[time]}`);
    this.drawLayers(pen, rows, names, axes, time);
  }

  drawLayers(pen, rows, names, { column, row, wide }, time) {
    let below = rows.map(() => 0);
    for (const name of names) {
      const above = rows.map(({ sizes }, i) => below[i] + (sizes[name] ?? 0));
      pen.fillStyle = kindColour(Number(name));
      pen.strokeStyle = theme().paper;
      pen.lineWidth = 0.7;
      pen.beginPath();
      rows.forEach((one, i) => pen.lineTo(column(one[time]), row(above[i])));
      rows.map((one, i) => [column(one[time]), row(below[i])]).reverse()
        .forEach((place) => pen.lineTo(...place));
      pen.closePath();
      pen.fill();
      pen.stroke();
      const [from, to] = [row(below.at(-1)), row(above.at(-1))];
      if (from - to >= 11) this.drawName(pen, name, LEFT + wide + 6, (from + to) / 2);
      below = above;
    }
  }

  drawName(pen, name, column, row) {
    pen.font = FONT;
    pen.fillStyle = theme().ink;
    pen.textAlign = "left";
    pen.textBaseline = "middle";
    pen.fillText(`no. ${name}`, column, row);
  }
}
