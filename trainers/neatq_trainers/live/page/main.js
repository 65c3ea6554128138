/** The page as a whole: messages of the server, choices of the reader. */
import { CurveChart, SpeciesChart, withRows } from "./charts.js";
import { watchTheme } from "./colour.js";
import { byId, fillSelect, short, show, words } from "./dom.js";
import { EditBar } from "./editbar.js";
import { wireKeys } from "./keys.js";
import { banner, say } from "./messages.js";
import { setFighting, setTeams, Sliders, SpeedSlider, wireFiles, wireTeams } from "./panels.js";
import { Reel } from "./player.js";
import { RobotPanel } from "./robot.js";
import { Stage } from "./stage.js";
import { RobotsTable, robotsOfClip } from "./table.js";
import { Timeline } from "./timeline.js";
import { clipsOf, heldRecording, Wire } from "./wire.js";

const FAST_MS = 100;
const SLOW_MS = 1000;

class Page {
  constructor() {
    Object.assign(this, { hello: null, state: null, chosen: null, breeding: null, wire: null });
    this.stage = new Stage(byId("field"), {
      choose: (slot) => this.choose(slot),
      change: (scenario) => this.change({ kind: "scenario", scenario }),
      edited: () => this.editBar?.draw(),
      drawn: (tick) => this.drawn(tick),
    });
    this.editBar = new EditBar(this.stage.editor);
    this.timeline = new Timeline();
    this.panel = new RobotPanel();
    this.table = new RobotsTable((slot) => this.choose(slot));
    this.curves = new CurveChart(byId("curves"));
    this.species = new SpeciesChart(byId("species"));
    this.speed = new SpeedSlider((value) => this.send({ type: "speed", ticks_per_second: value }));
    this.drawnAt = 0;
    this.tableAt = 0;
    this.wireButtons();
    wireTeams((message) => this.send(message));
    wireFiles(byId("field"), () => this.shown());
    wireKeys(this.keyActions());
    watchTheme(() => this.redraw());
    new ResizeObserver(() => this.redraw()).observe(byId("charts"));
  }

  wireButtons() {
    const clicks = {
      pause: () => this.togglePause(), step: () => this.stepOnce(), undo: () => this.undo(),
      fit: () => this.stage.view.fit(), "zoom-in": () => this.stage.view.zoom(1.4),
      "zoom-out": () => this.stage.view.zoom(1 / 1.4), help: () => byId("keys").showModal(),
      "timeline-back": () => this.endBattle(), close: () => this.choose(null),
      replace: () => this.change({ kind: "replace", slot: this.chosen }),
      protect: () => this.mark("protect", this.state.protected),
      prefer: () => this.mark("prefer", this.state.preferred),
      breed: () => this.startBreeding(), watch: () => this.send({ type: "watch" }),
    };
    for (const [id, action] of Object.entries(clicks)) byId(id).addEventListener("click", action);
    byId("trails").addEventListener("change", () => {
      this.stage.robots.trails = byId("trails").checked;
    });
    byId("senses").addEventListener("change", () => {
      this.stage.senses = byId("senses").checked;
    });
    byId("colour").addEventListener("change", () => this.setColour());
    byId("curve").addEventListener("change", () => this.setCurve());
  }

  keyActions() {
    const { stage } = this;
    return {
      undo: () => this.undo(), pause: () => this.togglePause(), step: () => this.stepOnce(),
      previous: () => this.chooseNear(-1), next: () => this.chooseNear(1),
      leave: () => this.leave(), zoomIn: () => stage.view.zoom(1.4),
      zoomOut: () => stage.view.zoom(1 / 1.4), fit: () => stage.view.fit(),
      remove: () => stage.editor.on && stage.editor.remove(),
      help: () => byId("keys").showModal(),
      edit: () => this.can("scenario") && this.editBar.toggle(!stage.editor.on),
      arrow: (dx, dy, far) => this.arrow(dx, dy, far ? 1 : 10),
    };
  }

  can(what) {
    return Boolean(this.hello?.can.includes(what));
  }

  /** Begin with the recording that the page holds, or with the server. */
  start() {
    const recording = heldRecording();
    if (recording) this.openRecording(recording);
    else {
      banner("Connecting …");
      this.wire = new Wire({
        clip: (clip) => this.stage.live.push(clip),
        message: (message) => this.take(message),
        up: () => banner(null),
        down: (wait) => banner(`Connection lost, trying again in ${short(wait / 1000)} s.`),
      });
    }
  }

  send(message) {
    const sent = Boolean(this.wire?.send(message));
    if (!sent) say("There is no connection to the run.", true);
    return sent;
  }

  change(change) {
    if (!this.send({ type: "change", change })) this.setState(this.state);
  }

  take(message) {
    const takers = {
      hello: () => this.open(message), state: () => this.setState(message.state),
      rows: () => this.addRows(this.curves, message.rows),
      species: () => this.addRows(this.species, message.species),
      robot: () => this.setRobot(message), robots: () => this.table.set(message.robots),
      refused: () => this.refuse(message.message), said: () => say(message.message),
      saved: () => setTeams({ saved: message.saved }), film: () => this.openFilm(message),
      battle: () => this.openBattle(message),
    };
    if (message.type === "hello" || this.hello) takers[message.type]?.();
  }

  open(hello) {
    this.hello = hello;
    const field = hello.world === "arena" || hello.world === "nero";
    document.body.classList.toggle("no-field", !field);
    for (const element of document.querySelectorAll("[data-can]")) {
      show(element, element.dataset.can.split(" ").some((what) => this.can(what)));
    }
    const name = `${hello.task} · ${hello.arm} · seed ${hello.seed}`;
    byId("run-name").textContent = name;
    document.title = `${name} – neatq`;
    this.stage.open(hello);
    this.sliders = new Sliders(hello, (change) => this.change(change));
    this.curves.rows = hello.rows ?? [];
    this.species.rows = hello.species ?? [];
    fillSelect(byId("curve"), hello.curves.map((one) => [one, words(one)]));
    setTeams(hello);
    this.fillColours(hello);
    this.setState(hello.state);
    this.setCurve();
    this.choose(this.chosen !== null && this.chosen < hello.robots ? this.chosen : null);
  }

  fillColours(hello) {
    const team = hello.channels.includes("team") ? [["team", "team"]] : [];
    fillSelect(byId("colour"), [...hello.colours.map((one, i) => [i, one.name]), ...team]);
    this.setColour();
  }

  setColour() {
    const { value } = byId("colour");
    const hello = this.stage.reel ? this.stage.reelHello : this.hello;
    const team = { name: "team", channel: hello.channels.indexOf("team"), team: true };
    this.stage.colour = hello.colours[value] ?? team;
  }

  setCurve() {
    this.curves.name = byId("curve").value;
    this.redraw();
  }

  setState(state) {
    this.state = state;
    const { stage } = this;
    if (state.scenario) stage.editor.settle(state.scenario);
    stage.protected = state.protected ?? [];
    stage.preferred = state.preferred ?? [];
    this.sliders?.set(state);
    this.speed.set(state.ticks_per_second);
    this.editBar.draw();
    byId("pause").textContent = state.paused ? "Go" : "Pause";
    byId("pause").disabled = byId("step").disabled = Boolean(state.over);
    byId("undo").disabled = !state.undo;
    byId("undo").textContent = state.undo ? `Undo (${state.undo})` : "Undo";
    this.showMarks();
    this.showTick(null);
  }

  /** What the server refused is taken back everywhere. */
  refuse(text) {
    say(text, true);
    setFighting(false);
    this.setState(this.state);
  }

  addRows(chart, rows) {
    chart.rows = withRows(chart.rows, rows);
    chart.draw();
  }

  redraw() {
    this.curves.draw();
    this.species.draw();
    this.panel.redraw();
  }

  /** Choose a robot; while a second parent is looked for, breed with it. */
  choose(slot) {
    if (slot !== null && slot >= (this.hello?.robots ?? 0)) return;
    if (this.breeding !== null) {
      const first = this.breeding;
      this.stopBreeding();
      if (slot === null || slot === first) return;
      this.change({ kind: "breed", parents: [first, slot] });
      say("They have an offspring, which replaces the worst robot.");
      return;
    }
    this.chosen = slot;
    this.stage.chosen = slot;
    this.stage.robot = null;
    this.panel.choose(slot);
    this.table.choose(slot);
    this.showMarks();
    if (this.recording) this.setRecorded(slot);
    else if (this.wire?.send({ type: "choose", slot }) === false) this.panel.choose(null);
  }

  chooseNear(by) {
    const count = this.hello?.robots ?? 0;
    const from = this.chosen ?? (by > 0 ? -1 : 0);
    if (count) this.choose((from + by + count) % count);
  }

  setRobot(robot) {
    if (!robot || robot.slot !== this.chosen) return;
    this.stage.robot = robot;
    this.panel.set(robot, this.hello);
  }

  setRecorded(slot) {
    const robot = this.recording.robots?.[slot];
    if (robot) this.setRobot(robot);
    else byId("robot-facts").textContent = "The recording has no network of this robot.";
  }

  showMarks() {
    for (const [id, list] of [["protect", this.state?.protected], ["prefer",
      this.state?.preferred]]) {
      byId(id).setAttribute("aria-pressed", String(list?.includes(this.chosen) ?? false));
    }
  }

  mark(kind, list) {
    this.change({ kind, slot: this.chosen, on: !(list ?? []).includes(this.chosen) });
  }

  startBreeding() {
    this.breeding = this.chosen;
    byId("breed").setAttribute("aria-pressed", "true");
    say("Choose the other parent on the field or in the table. Esc leaves it.");
  }

  stopBreeding() {
    this.breeding = null;
    byId("breed").setAttribute("aria-pressed", "false");
  }

  leave() {
    if (this.breeding !== null) this.stopBreeding();
    else if (this.stage.editor.chosen) this.stage.editor.choose(null);
    else this.choose(null);
  }

  arrow(dx, dy, units) {
    const { editor } = this.stage;
    if (editor.on && editor.nudge(dx * units, dy * units)) return true;
    if (editor.on) return false;
    this.chooseNear(dx || -dy);
    return true;
  }

  togglePause() {
    if (this.stage.reel) this.timeline.toggle();
    else if (this.can("pause")) this.send({ type: this.state.paused ? "go" : "pause" });
  }

  stepOnce() {
    if (this.stage.reel) this.timeline.step(1);
    else if (this.can("pause")) this.send({ type: "step" });
  }

  undo() {
    if (this.can("undo") && this.state.undo) this.send({ type: "undo" });
  }

  shown() {
    const hello = this.stage.reel ? this.stage.reelHello : this.hello;
    return { name: hello.task, scenario: this.stage.scenario() };
  }

  drawn(tick) {
    const now = performance.now();
    if (now - this.drawnAt < FAST_MS) return;
    this.drawnAt = now;
    this.timeline.draw();
    this.showTick(tick);
    const { reel } = this.stage;
    if (!this.recording || now - this.tableAt < SLOW_MS) return;
    this.tableAt = now;
    this.table.set(robotsOfClip(reel.moment().clip, this.hello.channels, this.hello.robots,
      this.recording.robots));
  }

  showTick(tick) {
    if (!this.hello) return;
    const { unit, total } = this.hello.length ?? { unit: "ticks", total: null };
    const seen = tick ?? this.state.tick;
    const whole = total && !this.stage.reel ? ` of ${short(total)}` : "";
    const text = `${short(seen)}${whole} ${unit}`;
    const told = this.state.over && !this.stage.reel ? `${text} · over` : text;
    if (byId("tick").textContent === told) return;
    byId("tick").textContent = told;
    byId("tick").dataset.tick = seen;
  }

  openRecording(recording) {
    const clips = clipsOf(recording.base64);
    if (!clips.length) {
      banner("This recording is empty.");
      return;
    }
    this.recording = recording;
    this.open({ ...recording.hello, can: [] });
    document.body.classList.add("offline");
    show(byId("charts"), recording.hello.curves.length > 0);
    byId("robot-hint").textContent =
      "Click a robot, or a row of the table, to see its network as it was at the end.";
    this.playReel(new Reel(clips, recording.ticks_per_second, (clip, frame) =>
      this.stage.robots.pass(clip, frame)), this.hello);
    this.stage.reel.offline = true;
  }

  playReel(reel, hello) {
    this.stage.play(reel, hello);
    this.timeline.open(reel);
    this.setColour();
  }

  openFilm({ gif, words }) {
    Object.assign(byId("film"), { src: gif, alt: words, hidden: false });
    say(words);
  }

  openBattle(battle) {
    setFighting(false);
    const clips = battle.recording ? clipsOf(battle.recording.base64) : [];
    const winner = { blue: battle.blue, red: battle.red }[battle.winner];
    const end = winner ? `${winner} wins` : "a draw";
    const text = `${battle.blue} against ${battle.red}: ${end}. Damage taken: `
      + `${short(battle.damage_blue)} and ${short(battle.damage_red)}.`;
    byId("timeline-what").textContent = text;
    if (!clips.length) {
      say(text);
      return;
    }
    this.editBar.toggle(false);
    this.stage.teamNames = [battle.blue, battle.red];
    if (!this.stage.reel) this.colourBefore = byId("colour").value;
    byId("colour").value = "team";
    this.playReel(new Reel(clips, battle.recording.ticks_per_second, (clip, frame) =>
      this.stage.robots.pass(clip, frame)), battle.recording.hello);
    document.body.classList.add("battle-seen");
  }

  endBattle() {
    document.body.classList.remove("battle-seen");
    byId("timeline-what").textContent = "";
    this.stage.teamNames = null;
    this.stage.play(null, null);
    this.timeline.open(null);
    byId("colour").value = this.colourBefore;
    this.setColour();
  }
}

const page = new Page();

/** For tests and the curious: what is known, how fast it is, where a field point is seen. */
window.neatq = {
  get hello() { return page.hello; },
  get state() { return page.state; },
  get chosen() { return page.chosen; },
  get robot() { return page.stage.robot; },
  get stats() { return page.stage.stats; },
  /** Where a field point lies in the window, [x, y] in CSS pixels. */
  toScreen(x, y) {
    const box = byId("field").getBoundingClientRect();
    const [column, row] = page.stage.view.toScreen(x, y);
    return [box.left + column, box.top + row];
  },
  /** Where a robot is seen in field units, or null. */
  placeOf(slot) {
    const { scene } = page.stage;
    return scene ? [scene.poses[3 * slot], scene.poses[3 * slot + 1]] : null;
  },
};

page.start();
