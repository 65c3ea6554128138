/** The panel of the chosen robot: its network, what it weighs, gets, senses, and its ancestors. */
import { scaleColour } from "./colour.js";
import { byId, make, short, show, words } from "./dom.js";
import { NetworkGraph } from "./network.js";

const MOST_CANDIDATES = 10;
const MOST_INDENT = 7;

/** Named numbers as bars; as soon as one is negative, bars begin in the middle. */
class Bars {
  constructor(box) {
    Object.assign(this, { box, names: [], most: 0, signed: false });
  }

  set(entries) {
    const names = entries.map(([name]) => name);
    if (names.join() !== this.names.join()) this.build(names);
    const known = entries.map(([, value]) => value).filter(Number.isFinite);
    this.most = Math.max(this.most, ...known.map(Math.abs));
    this.signed ||= known.some((value) => value < 0);
    entries.forEach(([, value], i) => this.fill(this.parts[i], value));
  }

  build(names) {
    Object.assign(this, { names, most: 0, signed: false });
    this.parts = names.map(() => ({ bar: make("i"), text: make("span", { class: "value" }) }));
    this.box.replaceChildren(...names.map((name, i) =>
      make("div", { class: "bar" }, make("span", { class: "name", text: words(name) }),
        make("span", { class: "track" }, this.parts[i].bar), this.parts[i].text)));
  }

  fill({ bar, text }, value) {
    const share = Number.isFinite(value) ? Math.abs(value) / (this.most || 1) : 0;
    const [middle, room] = this.signed ? [50, 50] : [0, 100];
    bar.style.left = `${value < 0 ? middle - share * room : middle}%`;
    bar.style.width = `${share * room}%`;
    bar.classList.toggle("negative", value < 0);
    text.textContent = short(value);
  }
}

/** Everything about one robot. */
export class RobotPanel {
  constructor() {
    this.graph = new NetworkGraph(byId("network"), (text) => {
      byId("network-word").textContent = text || "Point at a node to read it.";
    });
    this.rewards = new Bars(byId("reward-bars"));
    this.senses = new Bars(byId("observation-bars"));
    this.ancestors = "";
    this.slot = null;
  }

  /** Show the panel of a robot whose message may still be on its way; null closes it. */
  choose(slot) {
    this.slot = slot;
    this.network = null;
    show(byId("robot-panel"), slot !== null);
    show(byId("robot-hint"), slot === null);
    byId("robot-title").textContent = `Robot ${slot}`;
    byId("robot-facts").textContent = "";
    show(byId("robot-inside"), false);
  }

  set(robot, hello) {
    if (robot.slot !== this.slot) return;
    this.network = robot.network ?? this.network;
    show(byId("robot-inside"), true);
    byId("robot-facts").textContent = factsOf(robot);
    show(byId("network-part"), Boolean(this.network));
    if (this.network) this.graph.set(this.network, robot.activations);
    this.setCandidates(robot.candidates ?? [], hello.actions);
    this.setBars(this.rewards, "rewards-part", Object.entries(robot.rewards ?? {}));
    this.setBars(this.senses, "senses-part", (robot.observation ?? []).map((value, i) =>
      [hello.observations[i] ?? `input ${i}`, value]));
    this.setAncestors(robot.ancestors ?? []);
  }

  setBars(bars, part, entries) {
    show(byId(part), entries.length > 0);
    if (entries.length) bars.set(entries);
  }

  setCandidates(candidates, actions) {
    show(byId("candidates-part"), candidates.length > 0);
    const values = candidates.map((one) => one.value).filter(Number.isFinite);
    const [low, high] = [Math.min(...values), Math.max(...values)];
    byId("candidates").replaceChildren(...candidates.slice(0, MOST_CANDIDATES).map((one, i) => {
      const dot = make("i", { class: "dot" });
      const share = (one.value - low) / (high - low || 1);
      if (Number.isFinite(one.value)) dot.style.background = scaleColour(share);
      const what = one.action.map((value, k) => `${words(actions[k] ?? k)} ${short(value)}`);
      return make("li", { class: i ? null : "taken" }, dot,
        make("span", { text: what.join(", ") }), make("b", { text: short(one.value) }));
    }));
    show(byId("candidates-more"), candidates.length > MOST_CANDIDATES);
    byId("candidates-more").textContent = `and ${candidates.length - MOST_CANDIDATES} more`;
  }

  /** A tree whose branches end where a genome was shown before or nothing more is known. */
  setAncestors(list) {
    show(byId("ancestors-part"), list.length > 0);
    const key = list.map((one) => one.genome_id).join();
    if (key === this.ancestors) return;
    this.ancestors = key;
    const known = new Map(list.map((one) => [one.genome_id, one]));
    const rows = [];
    if (list.length) treeRows(known, list[0].genome_id, 0, new Set(), rows);
    byId("ancestors").replaceChildren(...rows.map(({ id, depth, text }) => {
      const row = make("li", {}, make("b", { text: String(id) }), ` ${text}`);
      row.style.paddingLeft = `${Math.min(depth, MOST_INDENT) * 14}px`;
      return row;
    }));
  }

  redraw() {
    if (this.slot !== null) this.graph.draw();
  }
}

function factsOf(robot) {
  const facts = [
    `genome ${robot.genome_id}`, robot.species === undefined ? "" : `species ${robot.species}`,
    `${short(robot.age_ticks)} ticks old`, `fitness ${short(robot.fitness)}`,
    robot.teacher ? `learns from ${robot.teacher}` : "",
  ];
  return facts.filter(Boolean).join(" · ");
}

function originOf(one) {
  if (one.parents.length) return `born at ${short(one.born_tick)}`;
  return one.born_tick === 0 ? "founder" : "born before anybody looked";
}

function treeRows(known, id, depth, seen, rows) {
  const one = known.get(id);
  const again = seen.has(id);
  seen.add(id);
  const parents = again ? [] : one?.parents ?? [];
  let text = again ? "(see above)" : "";
  if (one && !again) text = originOf(one);
  rows.push({ id, depth, text });
  for (const parent of new Set(parents)) treeRows(known, parent, depth + 1, seen, rows);
}
