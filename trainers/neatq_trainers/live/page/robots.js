/** What moves on the field: robots, trails, shots, what the chosen one senses and weighs. */
import { kindColour, scaleColour, teamColour, theme } from "./colour.js";
import { FONT, short } from "./dom.js";
import { rayReach } from "./field.js";

const TRAIL_FRAMES = 40;
const SHOT_MS = 350;
const MOST_SHOTS = 400;
const LEAST_RADIUS = 4.5;
const DART = [[1.45, 0], [-0.95, 0.95], [-0.45, 0], [-0.95, -0.95]];

/** The value of a channel of a robot at the end of a clip; NaN if there is none. */
export function channelOf(clip, channel, robot) {
  const width = clip.channels - 3;
  return channel >= 3 && channel < clip.channels ? clip.others[robot * width + channel - 3] : NaN;
}

/** Robots on the canvas: colour, hit points, trails, shots. */
export class Robots {
  constructor() {
    this.trails = true;
    this.clear();
  }

  clear() {
    this.past = [];
    this.shots = [];
    this.range = null;
  }

  /** Remember a frame that has passed, for trails and shots. */
  pass(clip, frame) {
    const size = clip.robots * 3;
    if (this.past.length && this.past[0].length !== size) this.past = [];
    this.past.push(clip.poses.subarray(frame * size, (frame + 1) * size));
    if (this.past.length > TRAIL_FRAMES) this.past.shift();
    const now = performance.now();
    for (let i = 0; i < clip.shots.length; i += 6) {
      if (Math.round(clip.shots[i]) !== frame) continue;
      const [fromX, fromY, toX, toY, team] = clip.shots.subarray(i + 1, i + 6);
      this.shots.push({ fromX, fromY, toX, toY, team, born: now });
    }
    if (this.shots.length > MOST_SHOTS) this.shots.splice(0, this.shots.length - MOST_SHOTS);
  }

  /** Draw all; `scene` has view, scenario, clip, poses, channels, colour, chosen and hovered. */
  draw(pen, scene) {
    const radius = Math.max((scene.scenario.robot_radius ?? 6.53) * scene.view.scale, LEAST_RADIUS);
    const colours = this.colours(scene);
    if (this.trails) this.drawTrails(pen, scene);
    this.drawShots(pen, scene.view);
    for (let robot = 0; robot < scene.clip.robots; robot += 1) {
      if (onField(scene, robot)) drawDart(pen, scene, robot, radius, colours[robot]);
    }
    this.drawBars(pen, scene, radius);
    drawMarks(pen, scene, radius);
  }

  drawTrails(pen, { view, clip, step, chosen }) {
    const farthest = step * clip.ticksPerFrame;
    pen.strokeStyle = theme().muted;
    pen.lineWidth = 1;
    const parts = 4;
    for (let part = 0; part < parts; part += 1) {
      const from = Math.floor((part * this.past.length) / parts);
      const to = Math.floor(((part + 1) * this.past.length) / parts);
      pen.globalAlpha = 0.08 + 0.1 * part;
      pen.beginPath();
      for (let k = Math.max(from, 1); k < to; k += 1) {
        trace(pen, view, this.past[k - 1], this.past[k], farthest);
      }
      pen.stroke();
    }
    pen.globalAlpha = 1;
    if (chosen !== null) this.drawOwnTrail(pen, view, chosen, farthest);
  }

  /** The way of the chosen robot, stronger than the others. */
  drawOwnTrail(pen, view, chosen, farthest) {
    pen.strokeStyle = theme().accent;
    pen.lineWidth = 2;
    pen.beginPath();
    const own = (frame) => frame.subarray(3 * chosen, 3 * chosen + 3);
    for (let k = 1; k < this.past.length; k += 1) {
      trace(pen, view, own(this.past[k - 1]), own(this.past[k]), farthest);
    }
    pen.stroke();
  }

  drawShots(pen, view) {
    const now = performance.now();
    this.shots = this.shots.filter((shot) => now - shot.born < SHOT_MS);
    pen.lineWidth = 1.5;
    for (const shot of this.shots) {
      pen.globalAlpha = 0.9 * (1 - (now - shot.born) / SHOT_MS);
      pen.strokeStyle = teamColour(shot.team);
      pen.beginPath();
      pen.moveTo(...view.toScreen(shot.fromX, shot.fromY));
      pen.lineTo(...view.toScreen(shot.toX, shot.toY));
      pen.stroke();
    }
    pen.globalAlpha = 1;
  }

  /** Colours of all robots; the range of numbers follows slowly, so that colours do not flicker. */
  colours(scene) {
    const { clip, colour } = scene;
    const values = Array.from({ length: clip.robots }, (_, robot) =>
      channelOf(clip, colour.channel, robot));
    if (colour.team) return values.map(teamColour);
    if (colour.categorical) {
      return values.map((one) => (Number.isNaN(one) ? theme().unknown : kindColour(one)));
    }
    const [low, high] = this.follow(values.filter(Number.isFinite), colour.name);
    const wide = high - low || 1;
    return values.map((one) =>
      (Number.isFinite(one) ? scaleColour((one - low) / wide) : theme().unknown));
  }

  follow(known, name) {
    if (!known.length) return [0, 1];
    const [low, high] = [Math.min(...known), Math.max(...known)];
    const before = this.range?.name === name ? this.range : { low, high };
    const [newLow, newHigh] = [before.low + 0.05 * (low - before.low),
      before.high + 0.05 * (high - before.high)];
    this.range = { name, low: newLow, high: newHigh };
    return [newLow, newHigh];
  }

  /** Bars of the hit points that are left, of those that were hit. */
  drawBars(pen, scene, radius) {
    const channel = scene.channels.indexOf("hit_points");
    const most = scene.scenario.hit_points;
    if (channel < 0 || !most) return;
    const wide = 2.2 * radius;
    for (let robot = 0; robot < scene.clip.robots; robot += 1) {
      const left = channelOf(scene.clip, channel, robot) / most;
      if (!(left >= 0 && left < 1) || !onField(scene, robot)) continue;
      const [column, row] = place(scene, robot);
      pen.fillStyle = theme().line;
      pen.fillRect(column - wide / 2, row - 1.7 * radius - 1, wide, 2);
      pen.fillStyle = theme().muted;
      pen.fillRect(column - wide / 2, row - 1.7 * radius - 1, wide * left, 2);
    }
  }

  /** The robot at a place of the canvas, or null. */
  find(scene, [column, row]) {
    const near = Math.max((scene.scenario.robot_radius ?? 6.53) * scene.view.scale, LEAST_RADIUS);
    let [best, least] = [null, 1.6 * near + 6];
    for (let robot = 0; robot < scene.clip.robots; robot += 1) {
      const [x, y] = place(scene, robot);
      const distance = Math.hypot(x - column, y - row);
      if (onField(scene, robot) && distance < least) [best, least] = [robot, distance];
    }
    return best;
  }
}

function place({ view, poses }, robot) {
  return view.toScreen(poses[3 * robot], poses[3 * robot + 1]);
}

/** Whether a robot of a scene lives and is seen. */
export function onField({ clip, poses, channels }, robot) {
  const alive = channelOf(clip, channels.indexOf("alive"), robot);
  return alive !== 0 && !Number.isNaN(poses[3 * robot]);
}

/** A line for each robot from one frame to the next; thousands, so without small arrays. */
function trace(pen, view, before, after, farthest) {
  const { scale } = view;
  const [left, top] = view.toScreen(0, 0);
  for (let i = 0; i < after.length; i += 3) {
    const [x, y] = [after[i] - before[i], after[i + 1] - before[i + 1]];
    if (!(x * x + y * y <= farthest * farthest)) continue; // nor where one is not known
    pen.moveTo(left + before[i] * scale, top - before[i + 1] * scale);
    pen.lineTo(left + after[i] * scale, top - after[i + 1] * scale);
  }
}

function drawDart(pen, scene, robot, radius, colour) {
  const [column, row] = place(scene, robot);
  const heading = scene.poses[3 * robot + 2];
  const [cosine, sine] = [Math.cos(heading) * radius, Math.sin(heading) * radius];
  pen.beginPath();
  for (const [a, b] of DART) {
    pen.lineTo(column + a * cosine - b * sine, row - a * sine - b * cosine);
  }
  pen.closePath();
  pen.fillStyle = colour;
  pen.fill();
  pen.strokeStyle = theme().edge;
  pen.lineWidth = 0.8;
  pen.stroke();
}

/** Rings round robots: the chosen one, the one under the pointer, the preferred, the protected. */
function drawMarks(pen, scene, radius) {
  const ring = (robot, colour, size, dash) => {
    if (robot === null || robot >= scene.clip.robots || !onField(scene, robot)) return;
    pen.strokeStyle = colour;
    pen.setLineDash(dash);
    pen.beginPath();
    pen.arc(...place(scene, robot), size, 0, 2 * Math.PI);
    pen.stroke();
  };
  pen.lineWidth = 1.5;
  for (const robot of scene.protected) ring(robot, theme().muted, 1.9 * radius, [2, 2]);
  for (const robot of scene.preferred) ring(robot, theme().learned, 2.2 * radius, []);
  pen.lineWidth = 2;
  ring(scene.hovered, theme().muted, 2.1 * radius + 1, []);
  pen.lineWidth = 3;
  ring(scene.chosen, theme().accent, 2.1 * radius + 2, []);
  pen.setLineDash([]);
}

/** Draw what the chosen robot senses: sectors and rays, the stronger the more it reads. */
export function drawSenses(pen, scene, sensors, robot, names) {
  const { view, poses, chosen } = scene;
  const [x, y, heading] = poses.subarray(3 * chosen, 3 * chosen + 3);
  const reading = (prefix) => names.flatMap((name, i) =>
    (name.startsWith(prefix) ? [robot.observation?.[i] ?? 0] : []));
  const [column, row] = view.toScreen(x, y);
  const [flags, enemies] = [reading("flag_"), reading("enemy_")];
  pen.lineWidth = 1;
  pen.strokeStyle = theme().muted;
  (flags.length ? sensors.flag_sectors_deg ?? [] : []).forEach(([from, to], i) => {
    const angles = [from, to].map((degrees) => -heading - (degrees * Math.PI) / 180);
    pen.beginPath();
    pen.moveTo(column, row);
    pen.arc(column, row, sensors.flag_radius * view.scale, angles[0], angles[1], true);
    pen.closePath();
    pen.globalAlpha = 0.25;
    pen.stroke();
    for (const [value, colour] of [[flags[i], theme().flag], [enemies[i], theme().enemy]]) {
      pen.globalAlpha = value > 0 ? 0.04 + 0.22 * Math.min(value, 1) : 0;
      pen.fillStyle = colour;
      pen.fill();
    }
  });
  drawRays(pen, scene, sensors, reading("wall_"));
  pen.globalAlpha = 1;
}

function drawRays(pen, scene, sensors, values) {
  const { view, poses, chosen, scenario } = scene;
  const [x, y, heading] = poses.subarray(3 * chosen, 3 * chosen + 3);
  pen.strokeStyle = theme().accent;
  pen.fillStyle = theme().accent;
  (sensors.wall_rays_deg ?? []).forEach((degrees, i) => {
    const angle = heading + (degrees * Math.PI) / 180;
    const reach = rayReach(scenario, x, y, angle, sensors.wall_ray_length);
    const end = view.toScreen(x + reach * Math.cos(angle), y + reach * Math.sin(angle));
    const hit = reach < sensors.wall_ray_length;
    pen.globalAlpha = hit ? 0.9 : 0.4;
    pen.lineWidth = 1 + 2 * Math.min(values[i] ?? 0, 1) * hit;
    pen.beginPath();
    pen.moveTo(...view.toScreen(x, y));
    pen.lineTo(...end);
    pen.stroke();
    if (!hit) return;
    pen.beginPath();
    pen.arc(...end, 3, 0, 2 * Math.PI);
    pen.fill();
  });
}

/** Draw the actions that the chosen robot weighs, as arrows; turns are shown four times as far. */
export function drawCandidates(pen, scene, robot, actions, high) {
  const [speedAt, turnAt] = [actions.indexOf("speed"), actions.indexOf("turn")];
  if (speedAt < 0 || turnAt < 0) return;
  const heading = scene.poses[3 * scene.chosen + 2];
  const [column, row] = place(scene, scene.chosen);
  const known = robot.candidates.map((one) => one.value).filter(Number.isFinite);
  const [low, most] = [Math.min(...known), Math.max(...known)];
  const ends = [];
  robot.candidates.forEach(({ action, value }, i) => {
    const angle = heading + 4 * action[turnAt];
    const length = 16 + 44 * Math.abs(action[speedAt] / (high[speedAt] || 1));
    const sign = action[speedAt] < 0 ? -1 : 1;
    const end = [column + sign * length * Math.cos(angle), row - sign * length * Math.sin(angle)];
    const share = Number.isFinite(value) ? (value - low) / (most - low || 1) : 0.5;
    ends.push({ end, colour: i ? scaleColour(share) : theme().accent, text: short(value) });
  });
  for (const { end, colour } of [...ends].reverse()) {
    drawArrow(pen, [column, row], end, colour, end === ends[0].end);
  }
  labelApart(pen, ends.filter((_, i) => Number.isFinite(robot.candidates[i].value)));
}

/** Label the ends of arrows, the first ones first; none on top of another. */
function labelApart(pen, ends) {
  const placed = [];
  for (const { end, text } of ends) {
    const free = placed.every(([column, row]) =>
      Math.abs(column - end[0]) > 38 || Math.abs(row - end[1]) > 13);
    if (!free) continue;
    label(pen, text, end, !placed.length);
    placed.push(end);
  }
}

function drawArrow(pen, from, to, colour, taken) {
  const angle = Math.atan2(to[1] - from[1], to[0] - from[0]);
  pen.strokeStyle = colour;
  pen.fillStyle = colour;
  pen.lineWidth = taken ? 3 : 1.5;
  pen.beginPath();
  pen.moveTo(...from);
  pen.lineTo(...to);
  pen.stroke();
  pen.beginPath();
  const size = taken ? 9 : 6;
  for (const turn of [0, 2.6, -2.6]) {
    pen.lineTo(to[0] + size * Math.cos(angle + turn), to[1] + size * Math.sin(angle + turn));
  }
  pen.fill();
}

/** A word on the canvas that can be read on any ground. */
export function label(pen, text, [column, row], strong) {
  pen.font = `${strong ? 600 : 400} ${FONT}`;
  pen.lineWidth = 3;
  pen.lineJoin = "round";
  pen.strokeStyle = theme().ground;
  pen.fillStyle = theme().ink;
  pen.strokeText(text, column + 7, row + 4);
  pen.fillText(text, column + 7, row + 4);
}
