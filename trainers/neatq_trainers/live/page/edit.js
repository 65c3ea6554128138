/** Changing the field by hand: walls, flags, spawns and turrets. */
import { theme } from "./colour.js";
import { clamp } from "./dom.js";
import { flagPlaces, wallCorners } from "./field.js";

const HANDLE_PIXELS = 5;
const REACH_PIXELS = 12;
const TURN_PIXELS = 40;
const LEAST_WALL = 2;
const SIDES = { east: [1, 0], west: [-1, 0], north: [0, 1], south: [0, -1] };

/** Which kinds of things a scenario allows to add. */
export function addable(scenario) {
  const { flag } = scenario;
  const arena = flag && !Array.isArray(flag) && !flag.ring && !flag.switch_ticks;
  const flags = "turrets" in scenario ? !flag : arena && flag.interval_ticks > 0;
  return { wall: true, turret: "turrets" in scenario, flag: Boolean(flags) };
}

/** The things of a scenario that can be chosen: [{kind, index}, ...]. */
export function thingsOf(scenario) {
  const counts = [
    ["wall", scenario.walls ?? []], ["turret", scenario.turrets ?? []],
    ["flag", flagPlaces(scenario)], ["spawn", scenario.spawns ?? []],
  ];
  return counts.flatMap(([kind, list]) => list.map((_, index) => ({ kind, index })));
}

function removable(scenario, { kind }) {
  if (kind === "wall" || kind === "turret") return true;
  if (kind !== "flag") return false;
  if (Array.isArray(scenario.flag)) return true;
  return !scenario.flag.switch_ticks && scenario.flag.positions.length > 1;
}

function placeOf(scenario, { kind, index }) {
  if (kind === "turret") return scenario.turrets[index];
  if (kind === "flag") return flagPlaces(scenario)[index];
  const thing = kind === "wall" ? scenario.walls[index] : scenario.spawns[index];
  return [thing.x, thing.y];
}

/** What of a thing follows the pointer: its middle or that of a wall's side; null: an angle. */
function heldPoint(scenario, { thing, handle }) {
  if (handle === "move") return placeOf(scenario, thing);
  if (handle === "turn") return null;
  const wall = scenario.walls[thing.index];
  return handlesOf(wall, Infinity).find(([name]) => name === handle)[1];
}

function moveTo(scenario, { kind, index }, x, y) {
  const to = [clamp(x, 0, scenario.width), clamp(y, 0, scenario.height)].map(rounded);
  if (kind === "turret") scenario.turrets[index] = to;
  else if (kind === "flag" && Array.isArray(scenario.flag)) scenario.flag = to;
  else if (kind === "flag") scenario.flag.positions[index] = to;
  else {
    const thing = kind === "wall" ? scenario.walls[index] : scenario.spawns[index];
    [thing.x, thing.y] = to;
  }
}

function rounded(value) {
  return Math.round(value * 100) / 100;
}

/** A wall's handles in field points: one for each side and one to turn it. */
function handlesOf(wall, scale) {
  const [cosine, sine] = [Math.cos(wall.angle_rad ?? 0), Math.sin(wall.angle_rad ?? 0)];
  const at = (a, b) => [wall.x + a * cosine - b * sine, wall.y + a * sine + b * cosine];
  const spare = 16 / scale; // so that a thin wall can be held between its handles
  const sides = Object.entries(SIDES).map(([name, [a, b]]) =>
    [name, at(a * (wall.width / 2 + spare), b * (wall.height / 2 + spare))]);
  return [...sides, ["turn", at(0, wall.height / 2 + TURN_PIXELS / scale)]];
}

/**
 * The field being edited. `draft` is what the user sees until the server has answered.
 *
 * `onChange(scenario)` is called at the end of each change, `onChoose()` when another thing is
 * chosen.
 */
export class Editor {
  constructor(view, onChange, onChoose) {
    Object.assign(this, { view, onChange, onChoose, on: false, draft: null, held: null });
    this.chosen = null;
  }

  /** The server's word: what it says holds, unless something is being dragged. */
  settle(scenario) {
    this.scenario = scenario;
    if (this.held) return;
    this.draft = null;
    if (this.chosen && !exists(scenario, this.chosen)) this.choose(null);
  }

  /** The scenario to draw. */
  seen() {
    return this.draft ?? this.scenario;
  }

  toggle(on) {
    this.on = on;
    this.choose(null);
  }

  choose(thing) {
    this.chosen = thing;
    this.onChoose();
  }

  /** Take hold of what is at a place of the canvas; false if there is nothing. */
  press(at) {
    const hit = this.hit(at);
    if (!hit) {
      this.choose(null);
      return false;
    }
    this.choose(hit.thing);
    const pointer = this.view.toField(...at);
    const own = heldPoint(this.seen(), hit) ?? pointer;
    this.held = { ...hit, offset: own.map((one, i) => one - pointer[i]) };
    return true;
  }

  hit(at) {
    const scenario = this.seen();
    const near = (place) => {
      const [column, row] = this.view.toScreen(...place);
      return Math.hypot(column - at[0], row - at[1]) <= REACH_PIXELS;
    };
    if (this.chosen?.kind === "wall") {
      const handles = handlesOf(scenario.walls[this.chosen.index], this.view.scale);
      const handle = handles.find(([, place]) => near(place));
      if (handle) return { thing: this.chosen, handle: handle[0] };
    }
    const things = thingsOf(scenario);
    const small = ["turret", "flag"];
    const thing = things.find((one) => small.includes(one.kind) && near(placeOf(scenario, one)))
      ?? things.find((one) => one.kind === "wall" && this.onWall(scenario.walls[one.index], at))
      ?? things.find((one) => one.kind === "spawn" && this.onSpawn(scenario.spawns[one.index], at));
    return thing ? { thing, handle: "move" } : null;
  }

  onWall(wall, at) {
    const [x, y] = this.view.toField(...at);
    const [along, across] = inWall(wall, x, y);
    const spare = 6 / this.view.scale;
    return Math.abs(along) <= wall.width / 2 + spare
      && Math.abs(across) <= wall.height / 2 + spare;
  }

  onSpawn(spawn, at) {
    const [x, y] = this.view.toField(...at);
    const reach = Math.max(spawn.jitter ?? 20, 8 / this.view.scale);
    return Math.max(Math.abs(x - spawn.x), Math.abs(y - spawn.y)) <= reach;
  }

  drag(at, event) {
    const { thing, handle, offset } = this.held;
    const scenario = this.open();
    const [x, y] = this.view.toField(...at).map((one, i) => one + offset[i]);
    if (handle === "move") moveTo(scenario, thing, x, y);
    else if (handle === "turn") turnWall(scenario.walls[thing.index], x, y, event.shiftKey);
    else scaleWall(scenario.walls[thing.index], SIDES[handle], x, y);
  }

  drop() {
    this.held = null;
    if (this.draft) this.onChange(this.draft);
  }

  /** A draft that may be written to. */
  open() {
    this.draft ??= structuredClone(this.scenario);
    return this.draft;
  }

  /** The place nearest to the middle of the view where a new thing is not in the way. */
  freePlace() {
    const { walls = [], spawns = [], width, height } = this.seen();
    const free = ([x, y]) => x > 20 && y > 20 && x < width - 20 && y < height - 20
      && walls.every((wall) => {
        const [along, across] = inWall(wall, x, y).map(Math.abs);
        return along > wall.width / 2 + 15 || across > wall.height / 2 + 15;
      })
      && spawns.every((one) => Math.hypot(one.x - x, one.y - y) > 1.5 * (one.jitter ?? 20) + 60);
    const middle = [this.view.x, this.view.y].map(Math.round);
    const around = Array.from({ length: 240 }, (_, i) => {
      const [angle, radius] = [(i % 12) * (Math.PI / 6), 20 * Math.floor(1 + i / 12)];
      return [middle[0] + radius * Math.cos(angle), middle[1] + radius * Math.sin(angle)]
        .map(Math.round);
    });
    return [middle, ...around].find(free) ?? middle;
  }

  add(kind) {
    const at = this.freePlace();
    const scenario = this.open();
    if (kind === "wall") {
      scenario.walls = [...(scenario.walls ?? []),
        { x: at[0], y: at[1], width: scenario.width / 8, height: 4, angle_rad: 0 }];
    } else if (kind === "turret") scenario.turrets.push(at);
    else if (Array.isArray(scenario.flag) || !scenario.flag) scenario.flag = at;
    else scenario.flag.positions.push(at);
    const last = thingsOf(scenario).filter((one) => one.kind === kind).at(-1);
    this.choose(last);
    this.onChange(scenario);
  }

  canRemove() {
    return Boolean(this.chosen) && removable(this.seen(), this.chosen);
  }

  remove() {
    if (!this.canRemove()) return;
    const { kind, index } = this.chosen;
    const scenario = this.open();
    if (kind === "wall") scenario.walls.splice(index, 1);
    else if (kind === "turret") scenario.turrets.splice(index, 1);
    else if (Array.isArray(scenario.flag)) scenario.flag = null;
    else scenario.flag.positions.splice(index, 1);
    this.choose(null);
    this.onChange(scenario);
  }

  /** Move the chosen thing by units; returns whether there is one. */
  nudge(dx, dy) {
    if (!this.chosen) return false;
    const scenario = this.open();
    const [x, y] = placeOf(scenario, this.chosen);
    moveTo(scenario, this.chosen, x + dx, y + dy);
    this.onChange(scenario);
    return true;
  }

  draw(pen) {
    const scenario = this.seen();
    pen.strokeStyle = theme().accent;
    pen.lineWidth = 1.5;
    for (const thing of thingsOf(scenario)) this.outline(pen, scenario, thing);
    if (this.chosen?.kind === "wall") this.drawHandles(pen, scenario.walls[this.chosen.index]);
  }

  outline(pen, scenario, thing) {
    const mine = this.chosen?.kind === thing.kind && this.chosen.index === thing.index;
    pen.globalAlpha = mine ? 1 : 0.45;
    pen.setLineDash(mine ? [] : [4, 3]);
    pen.beginPath();
    if (thing.kind === "wall") {
      for (const corner of wallCorners(scenario.walls[thing.index])) {
        pen.lineTo(...this.view.toScreen(...corner));
      }
      pen.closePath();
    } else pen.arc(...this.view.toScreen(...placeOf(scenario, thing)), 13, 0, 2 * Math.PI);
    pen.stroke();
    pen.setLineDash([]);
    pen.globalAlpha = 1;
  }

  drawHandles(pen, wall) {
    const handles = handlesOf(wall, this.view.scale);
    pen.beginPath();
    pen.moveTo(...this.view.toScreen(...handles.find(([name]) => name === "north")[1]));
    pen.lineTo(...this.view.toScreen(...handles.at(-1)[1]));
    pen.stroke();
    for (const [name, place] of handles) {
      const [column, row] = this.view.toScreen(...place);
      pen.fillStyle = name === "turn" ? theme().accent : theme().ground;
      pen.beginPath();
      if (name === "turn") pen.arc(column, row, HANDLE_PIXELS + 1, 0, 2 * Math.PI);
      else pen.rect(column - HANDLE_PIXELS, row - HANDLE_PIXELS, 2 * HANDLE_PIXELS,
        2 * HANDLE_PIXELS);
      pen.fill();
      pen.stroke();
    }
  }
}

function exists(scenario, thing) {
  return thingsOf(scenario).some((one) => one.kind === thing.kind && one.index === thing.index);
}

/** A field point along and across a wall, from its middle. */
function inWall(wall, x, y) {
  const [cosine, sine] = [Math.cos(wall.angle_rad ?? 0), Math.sin(wall.angle_rad ?? 0)];
  const [dx, dy] = [x - wall.x, y - wall.y];
  return [cosine * dx + sine * dy, cosine * dy - sine * dx];
}

function turnWall(wall, x, y, steps) {
  const angle = Math.atan2(y - wall.y, x - wall.x) - Math.PI / 2;
  const step = Math.PI / 12;
  wall.angle_rad = steps ? Math.round(angle / step) * step : Math.round(angle * 1e4) / 1e4;
}

/** Move one side of a wall to a point; the opposite side stays. */
function scaleWall(wall, [a, b], x, y) {
  const key = a ? "width" : "height";
  const reach = inWall(wall, x, y)[a ? 0 : 1] * (a || b);
  const size = rounded(Math.max(wall[key] / 2 + reach, LEAST_WALL));
  const shift = ((size - wall[key]) / 2) * (a || b);
  const angle = (wall.angle_rad ?? 0) + (a ? 0 : Math.PI / 2);
  wall[key] = size;
  wall.x = rounded(wall.x + shift * Math.cos(angle));
  wall.y = rounded(wall.y + shift * Math.sin(angle));
}
