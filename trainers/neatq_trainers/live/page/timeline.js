/** The time line of a recording: play, pause, scrub, speed. */
import { byId, make, show } from "./dom.js";

const STEPS = 1000;
const REEL_SPEEDS = [0.25, 0.5, 1, 2, 4, 8];

export class Timeline {
  constructor() {
    this.reel = null;
    this.range = byId("timeline-at");
    this.range.max = STEPS;
    byId("timeline-speed").replaceChildren(...REEL_SPEEDS.map((value) =>
      make("option", { value, text: `${value}×`, selected: value === 1 })));
    byId("timeline-play").addEventListener("click", () => this.toggle());
    byId("timeline-speed").addEventListener("change", () => {
      if (this.reel) this.reel.speed = Number(byId("timeline-speed").value);
    });
    this.range.addEventListener("input", () => {
      if (!this.reel) return;
      this.reel.playing = false;
      this.reel.seek((Number(this.range.value) / STEPS) * this.reel.duration);
    });
  }

  /** Serve a reel, or none. */
  open(reel) {
    this.reel = reel;
    show(byId("timeline"), Boolean(reel));
    if (reel) reel.speed = Number(byId("timeline-speed").value);
  }

  toggle() {
    const { reel } = this;
    if (!reel) return;
    if (!reel.playing && reel.time >= reel.duration) reel.seek(0);
    reel.playing = !reel.playing;
  }

  /** Go on by so many ticks and stop. */
  step(ticks) {
    this.reel.playing = false;
    this.reel.seek(this.reel.time + ticks / 60);
  }

  draw() {
    if (!this.reel) return;
    const { time, duration, playing } = this.reel;
    const text = playing ? "Pause" : "Play";
    if (byId("timeline-play").textContent !== text) byId("timeline-play").textContent = text;
    this.range.value = duration ? Math.round((time / duration) * STEPS) : 0;
    const told = `${time.toFixed(1)} of ${duration.toFixed(1)} s`;
    if (byId("timeline-time").textContent !== told) byId("timeline-time").textContent = told;
    this.range.setAttribute("aria-valuetext", told);
  }
}
