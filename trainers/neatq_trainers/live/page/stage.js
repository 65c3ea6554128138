/** The canvas of the field: each frame it shows the live run or a recording. */
import { kindColour, scaleGradient, teamColour, theme } from "./colour.js";
import { byId, make, openCanvas, short } from "./dom.js";
import { Editor } from "./edit.js";
import { drawField, drawFlags, drawTurrets, flagPlaces } from "./field.js";
import { LivePlayer, posesAt } from "./player.js";
import { channelOf, drawCandidates, drawSenses, label, onField, Robots } from "./robots.js";
import { Gestures, View } from "./view.js";

const GREATEST_STEP = 3; // units per tick; who moves farther has jumped
const LEGEND_MS = 250;
const STATS_MS = 2000;
const MOST_KINDS = 8;

/**
 * Draws, and turns pointers into choices and changes.
 *
 * `on` has choose(robot or null), change(scenario), edited() when another thing is chosen in the
 * editor, and drawn(tick) after each frame.
 */
export class Stage {
  constructor(canvas, on) {
    Object.assign(this, { canvas, on, reel: null, hello: null, robot: null });
    Object.assign(this, { chosen: null, hovered: null, protected: [], preferred: [] });
    this.senses = true;
    this.view = new View();
    this.robots = new Robots();
    this.live = new LivePlayer((clip, frame) => {
      if (!this.reel) this.robots.pass(clip, frame);
    });
    this.editor = new Editor(this.view, on.change, on.edited);
    this.gestures = new Gestures(canvas, this.view, this.pointerActions());
    this.stats = { fps: 0, latency_ms: null, clips_received: 0, clips_dropped: 0 };
    this.times = [];
    this.legendAt = 0;
    requestAnimationFrame((now) => this.step(now));
  }

  pointerActions() {
    return {
      touched: (event) => { this.touchedAt ??= event.timeStamp; },
      press: (at) => this.editor.on && !this.reel && this.editor.press(at),
      drag: (at, event) => this.editor.drag(at, event),
      drop: () => this.editor.drop(),
      hover: (at) => { this.hovered = at && !this.editor.on ? this.robotAt(at) : null; },
      tap: (at) => {
        if (this.editor.on && !this.reel) this.editor.held = null;
        else if (!this.reel || this.reel.offline) this.on.choose(this.robotAt(at));
      },
    };
  }

  robotAt(at) {
    return this.scene ? this.robots.find(this.scene, at) : null;
  }

  /** Show the run of a hello; clips follow. */
  open(hello) {
    this.hello = hello;
    this.live.clear();
    this.robots.clear();
    this.scene = null;
  }

  /** Play a recording in place of the run; null goes back to the run. */
  play(reel, hello) {
    this.reel = reel;
    this.reelHello = hello;
    this.robots.clear();
    this.scene = null;
    this.hovered = null;
  }

  scenario() {
    return this.reel ? this.reelHello.state.scenario : this.editor.seen();
  }

  colourNow() {
    return this.colour ?? { name: "team", channel: 9, team: true };
  }

  step(now) {
    requestAnimationFrame((next) => this.step(next));
    const seconds = Math.min((now - (this.before ?? now)) / 1000, 0.25);
    this.before = now;
    (this.reel ?? this.live).advance(seconds);
    if (this.reel) this.live.advance(seconds);
    if (this.canvas.clientWidth && this.hello && this.scenario()) this.draw();
    this.measure(now);
    const moment = (this.reel ?? this.live).moment();
    this.on.drawn(moment ? moment.tick : null);
  }

  measure(now) {
    this.times.push(now);
    while (this.times[0] < now - STATS_MS) this.times.shift();
    const span = now - this.times[0];
    this.stats.fps = span > 0 ? ((this.times.length - 1) * 1000) / span : 0;
    this.stats.clips_received = this.live.received;
    this.stats.clips_dropped = this.live.dropped;
    if (this.touchedAt) this.stats.latency_ms = performance.now() - this.touchedAt;
    this.touchedAt = null;
  }

  draw() {
    const { pen, width, height } = openCanvas(this.canvas);
    pen.fillStyle = theme().paper;
    pen.fillRect(0, 0, width, height);
    const scenario = this.scenario();
    this.view.resize(width, height, this.fieldSize(scenario));
    drawField(pen, this.view, scenario);
    const moment = (this.reel ?? this.live).moment();
    this.scene = moment ? this.sceneOf(moment, scenario) : null;
    drawTurrets(pen, this.view, scenario);
    if (this.scene) this.drawRobots(pen);
    drawFlags(pen, this.view, this.flagsOf(moment, scenario));
    if (this.editor.on && !this.reel) this.editor.draw(pen);
  }

  /** The same object as long as the field has the same size. */
  fieldSize({ width, height }) {
    if (this.size?.width !== width || this.size?.height !== height) this.size = { width, height };
    return this.size;
  }

  sceneOf(moment, scenario) {
    const step = Math.max(GREATEST_STEP, 1.1 * (scenario.max_speed ?? 1));
    this.poses = posesAt(moment, step, this.poses);
    const own = !this.reel || this.reel.offline;
    return {
      view: this.view, scenario, step, clip: moment.clip, poses: this.poses,
      channels: (this.reel ? this.reelHello : this.hello).channels, colour: this.colourNow(),
      chosen: own ? this.chosen : null, hovered: this.hovered,
      protected: own ? this.protected : [], preferred: own ? this.preferred : [],
    };
  }

  drawRobots(pen) {
    const { scene, robot } = this;
    const told = robot && scene.chosen === robot.slot && robot.slot < scene.clip.robots
      && !Number.isNaN(scene.poses[3 * robot.slot]);
    const senses = told && this.senses && !this.editor.on;
    if (senses && this.hello.sensors) {
      drawSenses(pen, scene, this.hello.sensors, robot, this.hello.observations);
    }
    this.robots.draw(pen, scene);
    if (senses && robot.candidates?.length) {
      drawCandidates(pen, scene, robot, this.hello.actions, this.hello.action_high);
    }
    this.drawHovered(pen);
    this.showLegend();
  }

  drawHovered(pen) {
    const { scene } = this;
    if (scene.hovered === null || scene.hovered >= scene.clip.robots) return;
    const { colour, hovered, poses } = scene;
    const value = channelOf(scene.clip, colour.channel, hovered);
    const what = colour.team ? "" : ` · ${colour.name} ${short(value)}`;
    const at = this.view.toScreen(poses[3 * hovered], poses[3 * hovered + 1]);
    label(pen, `robot ${hovered}${what}`, [at[0] + 8, at[1] - 12], true);
  }

  /** Flags of the clip; in the editor those of the scenario, of which the clip's one counts. */
  flagsOf(moment, scenario) {
    const clip = moment?.clip;
    const from = clip ? moment.frame * clip.flagCount * 3 : 0;
    const flags = Array.from({ length: clip?.flagCount ?? 0 }, (_, i) =>
      clip.flags.subarray(from + 3 * i, from + 3 * i + 3));
    const known = flags.filter(([x]) => !Number.isNaN(x));
    if (known.length && !(this.editor.on && !this.reel)) return known;
    const places = flagPlaces(scenario);
    const counts = ([x, y]) => places.length === 1
      || known.some((flag) => flag[2] && Math.hypot(flag[0] - x, flag[1] - y) < 1);
    return places.map((place) => [...place, counts(place)]);
  }

  showLegend() {
    const now = performance.now();
    if (now - this.legendAt < LEGEND_MS) return;
    this.legendAt = now;
    const { colour, clip } = this.scene;
    const legend = byId("legend");
    if (colour.team || colour.categorical) {
      legend.replaceChildren(...this.kindSwatches(clip, colour));
      return;
    }
    const bar = make("span", { class: "scale" });
    bar.style.background = scaleGradient();
    const { low, high } = this.robots.range ?? { low: NaN, high: NaN };
    legend.replaceChildren(make("span", { text: short(low) }), bar,
      make("span", { text: short(high) }));
  }

  kindSwatches(clip, colour) {
    const counts = new Map();
    for (let robot = 0; robot < clip.robots; robot += 1) {
      const kind = channelOf(clip, colour.channel, robot);
      if (Number.isNaN(kind) || !onField(this.scene, robot)) continue;
      counts.set(kind, (counts.get(kind) ?? 0) + 1);
    }
    const most = [...counts].sort((a, b) => b[1] - a[1]).slice(0, MOST_KINDS);
    return most.map(([kind, count]) => {
      const dot = make("i", { class: "dot" });
      dot.style.background = colour.team ? teamColour(kind) : kindColour(kind);
      const name = colour.team ? (this.teamNames?.[kind] ?? `team ${kind + 1}`) : `no. ${kind}`;
      return make("span", { class: "kind" }, dot, `${name} (${count})`);
    });
  }
}
