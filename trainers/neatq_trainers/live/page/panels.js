/** Sliders of rewards, exploration and lives; saving, loading, battles; files to take home. */
import { theme } from "./colour.js";
import { byId, clamp, debounce, download, fillSelect, make, short, show, words } from "./dom.js";

const CALM_MS = 150;
const CLIP_FPS = 30;
const SPEEDS = [0.25, 0.5, 1, 2, 3, 5, 8, 12, 20, null];

/** One slider with its name and value; `send(value)` is called when it is let go. */
class Slider {
  constructor(id, name, { low, high, step }, send) {
    this.input = make("input", {
      type: "range", id, min: low, max: high, step, "data-testid": id,
    });
    this.text = make("output", { for: id });
    this.row = make("div", { class: "slider" }, make("label", { for: id, text: words(name) }),
      this.text, this.input);
    this.held = false;
    const calm = debounce(() => {
      this.held = false;
      send(Number(this.input.value));
    }, CALM_MS);
    this.input.addEventListener("input", () => {
      this.held = true;
      this.say();
    });
    this.input.addEventListener("change", calm);
  }

  say() {
    this.text.textContent = short(Number(this.input.value));
  }

  /** The server's word; a slider that is being moved is left alone. */
  set(value) {
    if (this.held || !Number.isFinite(value)) return;
    if (value > Number(this.input.max)) this.input.max = value;
    if (value < Number(this.input.min)) this.input.min = value;
    this.input.value = value;
    this.say();
  }
}

/** All sliders of a run; `change(change)` sends one. */
export class Sliders {
  constructor(hello, change) {
    const can = new Set(hello.can);
    const group = (prefix, ranges, changeOf) => Object.fromEntries(Object.entries(ranges ?? {})
      .map(([name, range]) => [name, new Slider(`${prefix}-${name}`, name,
        { ...range, step: stepOf(range) }, (value) => change(changeOf(name, value)))]));
    this.weights = can.has("weights") ? group("weight", hello.weights, (name, value) =>
      ({ kind: "weights", weights: { [name]: value } })) : {};
    this.exploration = can.has("exploration") ? group("exploration", hello.exploration,
      (name, value) => ({ kind: "exploration", [name]: value })) : {};
    this.scenario = {};
    if (can.has("lifetime")) this.addScenario("lifetime", "lifetime_ticks", 5000, 50, change);
    if (can.has("hit_points")) this.addScenario("hit-points", "hit_points", 200, 1, change);
    this.place("weights", this.weights);
    this.place("exploration", this.exploration);
    this.place("life", this.scenario);
  }

  addScenario(id, key, high, step, change) {
    const range = { low: step, high, step };
    this.scenario[key] = new Slider(id, key, range, (value) =>
      change({ kind: "scenario", scenario: { ...this.whole, [key]: value } }));
  }

  place(name, sliders) {
    const rows = Object.values(sliders).map((slider) => slider.row);
    byId(`${name}-sliders`).replaceChildren(...rows);
    show(byId(`${name}-part`), rows.length > 0);
  }

  set(state) {
    this.whole = state.scenario;
    const groups = [[this.weights, state.weights], [this.exploration, state.exploration],
      [this.scenario, state.scenario]];
    for (const [sliders, values] of groups) {
      for (const [name, slider] of Object.entries(sliders)) slider.set(values?.[name]);
    }
  }
}

function stepOf({ low, high }) {
  return 10 ** Math.round(Math.log10((high - low || 1) / 200));
}

/** The slider of speeds; `send(ticks per second or null)`. */
export class SpeedSlider {
  constructor(send) {
    this.input = byId("speed");
    this.input.max = SPEEDS.length - 1;
    this.held = false;
    const calm = debounce(() => {
      this.held = false;
      const times = this.times();
      send(times === null ? null : 60 * times);
    }, CALM_MS);
    this.input.addEventListener("input", () => {
      this.held = true;
      this.say();
      calm();
    });
  }

  times() {
    return SPEEDS[Number(this.input.value)];
  }

  say(times = this.times()) {
    const text = times === null ? "as fast as possible" : `${short(times)}×`;
    byId("speed-text").textContent = times === null ? "max" : text;
    this.input.setAttribute("aria-valuetext", text);
  }

  set(ticksPerSecond) {
    if (this.held) return;
    const far = (times) => (times === null ? Infinity : Math.abs(times - ticksPerSecond / 60));
    const nearest = SPEEDS.reduce((best, one) => (far(one) < far(best) ? one : best));
    this.input.value = SPEEDS.indexOf(ticksPerSecond === null ? null : nearest);
    this.say(ticksPerSecond === null ? null : ticksPerSecond / 60);
  }

  /** One speed faster or slower. */
  move(by) {
    this.input.value = clamp(Number(this.input.value) + by, 0, SPEEDS.length - 1);
    this.input.dispatchEvent(new Event("input"));
  }
}

/** Teams by name: save, load, battle. */
export function wireTeams(send) {
  byId("save-form").addEventListener("submit", (event) => {
    event.preventDefault();
    const name = byId("save-name").value.trim();
    if (name) send({ type: "save", name });
    else byId("save-name").focus();
  });
  byId("load").addEventListener("click", () => {
    if (byId("load-name").value) send({ type: "load", name: byId("load-name").value });
  });
  byId("battle").addEventListener("click", () => {
    const against = byId("opponent").value;
    if (against && send({ type: "battle", against })) setFighting(true);
  });
}

/** Between the asking and the end of a battle its button waits. */
export function setFighting(on) {
  byId("battle").disabled = on;
  byId("battle").textContent = on ? "Fighting…" : "Battle";
}

export function setTeams({ saved, opponents }) {
  if (saved) {
    fillSelect(byId("load-name"), saved.map((name) => [name, name]));
    byId("load").disabled = !saved.length;
  }
  if (opponents) {
    fillSelect(byId("opponent"), opponents.map((name) => [name, name.replace(/\.pop.*$/, "")]));
    setFighting(false);
    byId("battle").disabled = !opponents.length;
  }
}

/** Buttons that make files; `now()` tells {name, scenario}. */
export function wireFiles(canvas, now) {
  byId("export-scenario").addEventListener("click", () => {
    const text = `${JSON.stringify(now().scenario, null, 2)}\n`;
    download(new Blob([text], { type: "application/json" }), `${now().name}.json`);
  });
  byId("export-picture").addEventListener("click", () => {
    canvas.toBlob((blob) => blob && download(blob, `${now().name}.png`), "image/png");
  });
  const button = byId("export-clip");
  show(button, Boolean(window.MediaRecorder && canvas.captureStream));
  let recorder = null;
  button.addEventListener("click", () => {
    if (recorder) recorder.stop();
    else {
      recorder = record(canvas, (blob) => {
        recorder = null;
        button.textContent = "Film";
        button.style.color = "";
        download(blob, `${now().name}.${blob.type.includes("mp4") ? "mp4" : "webm"}`);
      });
      button.textContent = "Stop filming";
      button.style.color = theme().enemy;
    }
  });
}

function record(canvas, done) {
  const parts = [];
  const kinds = ["video/webm", "video/mp4"];
  const mimeType = kinds.find((kind) => MediaRecorder.isTypeSupported(kind));
  const recorder = new MediaRecorder(canvas.captureStream(CLIP_FPS), { mimeType });
  recorder.ondataavailable = ({ data }) => parts.push(data);
  recorder.onstop = () => done(new Blob(parts, { type: mimeType }));
  recorder.start();
  return recorder;
}
