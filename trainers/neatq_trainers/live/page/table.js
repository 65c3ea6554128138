/** The table of robots, which is also the way to choose one without seeing the field. */
import { byId, make, short } from "./dom.js";
import { channelOf } from "./robots.js";

const COLUMNS = [
  ["slot", "Robot"], ["fitness", "Fitness"], ["age_ticks", "Age"], ["species", "Species"],
  ["links", "Links"], ["teacher", "Teacher"], ["marks", "Marks"],
];

/** A sortable table; `onChoose(slot)` is called for a row that is clicked. */
export class RobotsTable {
  constructor(onChoose) {
    Object.assign(this, { onChoose, robots: [], chosen: null, key: "slot", down: false });
    this.body = byId("robots-table").tBodies[0];
    this.heads = COLUMNS.map(([key, text]) => {
      const button = make("button", { type: "button", text });
      button.addEventListener("click", () => this.sort(key));
      return make("th", { scope: "col", "aria-sort": "none", "data-key": key }, button);
    });
    byId("robots-table").tHead.rows[0].replaceChildren(...this.heads);
    this.body.addEventListener("click", ({ target }) => {
      const row = target.closest("tr");
      if (row) this.onChoose(Number(row.dataset.slot));
    });
  }

  sort(key) {
    this.down = this.key === key ? !this.down : key === "fitness";
    this.key = key;
    this.draw();
  }

  set(robots) {
    this.robots = robots.map((one) => ({ ...one, marks: marksOf(one) }));
    this.draw();
  }

  choose(slot) {
    this.chosen = slot;
    for (const row of this.body.rows) this.mark(row);
  }

  mark(row) {
    const chosen = Number(row.dataset.slot) === this.chosen;
    row.classList.toggle("chosen", chosen);
    row.setAttribute("aria-current", String(chosen));
  }

  draw() {
    for (const head of this.heads) {
      const way = this.down ? "descending" : "ascending";
      head.setAttribute("aria-sort", head.dataset.key === this.key ? way : "none");
    }
    const sign = this.down ? -1 : 1;
    const sorted = [...this.robots].sort((a, b) => compare(a[this.key], b[this.key], sign));
    while (this.body.rows.length > sorted.length) this.body.lastChild.remove();
    sorted.forEach((robot, i) => this.fill(this.body.rows[i] ?? this.newRow(), robot));
  }

  newRow() {
    const row = this.body.insertRow();
    row.insertCell().append(make("button", { type: "button" }));
    COLUMNS.slice(1).forEach(() => row.insertCell());
    return row;
  }

  fill(row, robot) {
    row.dataset.slot = robot.slot;
    COLUMNS.forEach(([key], i) => {
      const value = robot[key];
      const text = typeof value === "string" ? value : short(value);
      const cell = i ? row.cells[i] : row.cells[0].firstChild;
      if (cell.textContent !== text) cell.textContent = text;
    });
    row.cells[0].firstChild.setAttribute("aria-label", `choose robot ${robot.slot}`);
    this.mark(row);
  }
}

function marksOf(robot) {
    const marks = [robot.preferred && "good", robot.protected && "safe", robot.told && "network"];
  return marks.filter(Boolean).join(", ");
}

/** Unknown values come last, whichever way the others are sorted. */
function compare(a, b, sign) {
  const unknown = (one) => one === null || one === undefined || Number.isNaN(one);
  if (unknown(a) || unknown(b)) return unknown(a) - unknown(b);
  return sign * (typeof a === "string" ? a.localeCompare(b) : a - b);
}

/** What the table shows of a recording, where only clips tell about robots, and `told` of some. */
export function robotsOfClip(clip, channels, most, told) {
  const read = (name, slot) => channelOf(clip, channels.indexOf(name), slot);
  return Array.from({ length: Math.min(clip.robots, most) }, (_, slot) => ({
    slot, fitness: read("fitness", slot), age_ticks: read("age_ticks", slot),
    species: read("species", slot), links: told?.[slot]?.network?.links.length,
    teacher: told?.[slot]?.teacher, told: Boolean(told?.[slot]),
  }));
}
