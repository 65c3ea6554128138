/** The field that stays: ground, border, walls, spawns, flags, turrets. */
import { theme } from "./colour.js";

const BORDER = 2; // units from the edge of the field to the inner face of its border wall

/** The places of a scenario's flags: of the arena several, of NERO one or none. */
export function flagPlaces(scenario) {
  const { flag } = scenario;
  if (Array.isArray(flag)) return [flag];
  return flag?.positions ?? [];
}

/** The corners of a wall in field points. */
export function wallCorners(wall) {
  const [cosine, sine] = [Math.cos(wall.angle_rad ?? 0), Math.sin(wall.angle_rad ?? 0)];
  const [along, across] = [wall.width / 2, wall.height / 2];
  return [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) => [
    wall.x + a * along * cosine - b * across * sine,
    wall.y + a * along * sine + b * across * cosine,
  ]);
}

export function drawField(pen, view, scenario) {
  const colours = theme();
  const [left, top] = view.toScreen(0, scenario.height);
  const [wide, high] = [scenario.width * view.scale, scenario.height * view.scale];
  pen.fillStyle = colours.wall;
  pen.fillRect(left, top, wide, high);
  const edge = Math.max(BORDER * view.scale, 1.5);
  pen.fillStyle = colours.ground;
  pen.fillRect(left + edge, top + edge, wide - 2 * edge, high - 2 * edge);
  drawGrid(pen, view, scenario);
  drawSpawns(pen, view, scenario);
  pen.fillStyle = colours.wall;
  for (const wall of scenario.walls ?? []) {
    outline(pen, view, wallCorners(wall));
    pen.fill();
  }
}

function drawGrid(pen, view, scenario) {
  pen.strokeStyle = theme().line;
  pen.lineWidth = 0.5;
  pen.globalAlpha = 0.6;
  pen.beginPath();
  const step = 100;
  for (let x = step; x < scenario.width; x += step) {
    pen.moveTo(...view.toScreen(x, 0));
    pen.lineTo(...view.toScreen(x, scenario.height));
  }
  for (let y = step; y < scenario.height; y += step) {
    pen.moveTo(...view.toScreen(0, y));
    pen.lineTo(...view.toScreen(scenario.width, y));
  }
  pen.stroke();
  pen.globalAlpha = 1;
}

function outline(pen, view, corners) {
  pen.beginPath();
  for (const corner of corners) pen.lineTo(...view.toScreen(...corner));
  pen.closePath();
}

function drawSpawns(pen, view, scenario) {
  pen.strokeStyle = theme().spawn;
  pen.fillStyle = theme().spawn;
  pen.lineWidth = 1.5;
  pen.setLineDash([2, 4]);
  for (const spawn of scenario.spawns ?? []) {
    const reach = Math.max((spawn.jitter ?? 20) * view.scale, 5);
    const [column, row] = view.toScreen(spawn.x, spawn.y);
    pen.globalAlpha = 0.12;
    pen.fillRect(column - reach, row - reach, 2 * reach, 2 * reach);
    pen.globalAlpha = 1;
    pen.strokeRect(column - reach, row - reach, 2 * reach, 2 * reach);
  }
  drawRing(pen, view, scenario);
  pen.setLineDash([]);
}

/** Where a flag whose place is drawn by chance may stand. */
function drawRing(pen, view, scenario) {
  const ring = scenario.flag?.ring;
  const spawn = scenario.spawns?.[0];
  if (!ring || !spawn) return;
  pen.strokeStyle = theme().flag;
  pen.globalAlpha = 0.5;
  for (const radius of ring) {
    pen.beginPath();
    pen.arc(...view.toScreen(spawn.x, spawn.y), radius * view.scale, 0, 2 * Math.PI);
    pen.stroke();
  }
  pen.globalAlpha = 1;
}

/** Draw flags [[x, y, counts], ...]: the one that counts is filled. */
export function drawFlags(pen, view, flags) {
  const colours = theme();
  const size = Math.max(9, Math.min(7 * view.scale, 18));
  pen.lineWidth = 2;
  pen.lineJoin = "round";
  for (const [x, y, counts] of flags) {
    const [column, row] = view.toScreen(x, y);
    pen.strokeStyle = colours.flag;
    pen.fillStyle = counts ? colours.flag : colours.ground;
    pen.beginPath();
    pen.moveTo(column, row);
    pen.lineTo(column, row - 2 * size);
    pen.lineTo(column + 1.3 * size, row - 1.5 * size);
    pen.lineTo(column, row - size);
    pen.fill();
    pen.stroke();
    pen.fillStyle = colours.flag;
    pen.beginPath();
    pen.arc(column, row, 3, 0, 2 * Math.PI);
    pen.fill();
  }
}

export function drawTurrets(pen, view, scenario) {
  const colours = theme();
  const radius = Math.max((scenario.robot_radius ?? 6.53) * view.scale, 5.5);
  for (const [x, y] of scenario.turrets ?? []) {
    const [column, row] = view.toScreen(x, y);
    pen.fillStyle = colours.enemy;
    pen.strokeStyle = colours.edge;
    pen.lineWidth = 1.5;
    pen.beginPath();
    for (let i = 0; i < 8; i += 1) {
      const angle = (Math.PI / 4) * (i + 0.5);
      pen.lineTo(column + 1.3 * radius * Math.cos(angle), row + 1.3 * radius * Math.sin(angle));
    }
    pen.closePath();
    pen.fill();
    pen.stroke();
    pen.fillStyle = colours.edge;
    pen.beginPath();
    pen.arc(column, row, 0.45 * radius, 0, 2 * Math.PI);
    pen.fill();
  }
}

/** How far a ray from a point goes until a wall or the border, at most `length`. */
export function rayReach(scenario, x, y, angle, length) {
  const [dx, dy] = [Math.cos(angle), Math.sin(angle)];
  const inside = { width: scenario.width - 2 * BORDER, height: scenario.height - 2 * BORDER };
  const border = { x: scenario.width / 2, y: scenario.height / 2, ...inside };
  let reach = Math.min(length, boxSpan(border, x, y, dx, dy)[1]);
  for (const wall of scenario.walls ?? []) {
    const [enters, leaves] = boxSpan(wall, x, y, dx, dy);
    if (enters <= leaves && leaves > 0) reach = Math.min(reach, Math.max(enters, 0));
  }
  return Math.max(reach, 0);
}

/** Between which distances a ray is inside a box; the first is greater where it misses. */
function boxSpan(box, x, y, dx, dy) {
  const [cosine, sine] = [Math.cos(box.angle_rad ?? 0), Math.sin(box.angle_rad ?? 0)];
  const turned = (a, b) => [cosine * a + sine * b, cosine * b - sine * a];
  const [from, along] = [turned(x - box.x, y - box.y), turned(dx, dy)];
  let [enters, leaves] = [-Infinity, Infinity];
  [box.width / 2, box.height / 2].forEach((half, axis) => {
    const speed = along[axis] || 1e-9;
    const [one, other] = [(-half - from[axis]) / speed, (half - from[axis]) / speed];
    enters = Math.max(enters, Math.min(one, other));
    leaves = Math.min(leaves, Math.max(one, other));
  });
  return [enters, leaves];
}
