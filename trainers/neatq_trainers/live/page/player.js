/** When which frame is seen: clips as they come, and recordings with a time line. */
import { clamp } from "./dom.js";

const MOST_SECONDS = 2;
const KEPT_SECONDS = 0.6;
const SPARE_SECONDS = 0.05;
const SHORT_WAY_FRAMES = 30;

/**
 * Clips as they come from the server, played at their own speed.
 *
 * What is seen lies between frame `floor(at)` of the first clip and the one that follows, which
 * may be the next clip's first. `onFrame(clip, frame)` is called for each frame that passes.
 */
export class LivePlayer {
  constructor(onFrame) {
    this.onFrame = onFrame;
    this.received = 0;
    this.dropped = 0;
    this.clear();
  }

  clear() {
    this.queue = [];
    this.at = 0;
  }

  push(clip) {
    this.received += 1;
    this.queue.push(clip);
    if (this.queue.length === 1) this.enter(0);
    if (clip.seconds > 0) this.trim();
    else this.skipTo(this.queue.length - 1, clip.frames - 1);
  }

  /** Seconds that are still to be played. */
  buffered() {
    const played = this.queue.length ? (this.at / this.queue[0].frames) * this.queue[0].seconds : 0;
    return this.queue.reduce((sum, clip) => sum + clip.seconds, -played);
  }

  trim() {
    if (this.buffered() <= MOST_SECONDS) return;
    let first = 0;
    let left = this.buffered();
    while (first < this.queue.length - 1 && left > KEPT_SECONDS) {
      left -= this.queue[first].seconds;
      first += 1;
    }
    this.dropped += first;
    this.skipTo(first, 0);
  }

  skipTo(index, frame) {
    this.queue.splice(0, index);
    this.at = 0;
    this.enter(frame);
  }

  enter(frame) {
    this.at = frame;
    this.onFrame(this.queue[0], frame);
  }

  /** Let `seconds` pass, a little faster when much is waiting and slower when little is. */
  advance(seconds) {
    if (!this.queue.length) return;
    const wanted = this.queue[0].seconds + SPARE_SECONDS;
    let left = seconds * clamp(1 + 0.5 * (this.buffered() - wanted), 0.9, 1.3);
    for (;;) {
      const clip = this.queue[0];
      const perFrame = clip.seconds / clip.frames;
      const last = this.queue.length === 1;
      const end = last ? Math.max(clip.frames - 1, this.at) : clip.frames;
      const room = (end - this.at) * perFrame;
      if (last || left < room) {
        this.pass(perFrame > 0 ? Math.min(end, this.at + left / perFrame) : end);
        return;
      }
      this.pass(clip.frames - 0.5);
      left -= room;
      this.skipTo(1, 0);
    }
  }

  pass(to) {
    const clip = this.queue[0];
    const through = Math.min(Math.floor(to), clip.frames - 1);
    for (let frame = Math.floor(this.at) + 1; frame <= through; frame += 1) {
      this.onFrame(clip, frame);
    }
    this.at = to;
  }

  moment() {
    return this.queue.length ? momentAt(this.queue, 0, this.at) : null;
  }
}

/** A recording: all clips are there (at least one), time goes from 0 to `duration`. */
export class Reel {
  constructor(clips, ticksPerSecond, onFrame) {
    this.clips = clips;
    this.onFrame = onFrame;
    this.speed = 1;
    this.playing = true;
    this.frames = clips.flatMap((clip, index) =>
      Array.from({ length: clip.frames }, (_, frame) => ({ index, frame, clip })));
    this.starts = [];
    this.duration = 0;
    for (const { clip } of this.frames) {
      this.starts.push(this.duration);
      this.duration += clip.ticksPerFrame / (ticksPerSecond || 60);
    }
    this.now = -1;
    this.seek(0);
  }

  advance(seconds) {
    if (!this.playing) return;
    this.seek(this.time + seconds * this.speed);
    if (this.time >= this.duration) this.playing = false;
  }

  /** Go to a time; frames that are passed on a short way are told, those of a leap are not. */
  seek(time) {
    this.time = clamp(time, 0, this.duration);
    const after = this.starts.findIndex((start) => start > this.time);
    const now = (after < 0 ? this.frames.length : after) - 1;
    const near = now > this.now && now - this.now <= SHORT_WAY_FRAMES;
    for (let i = near ? this.now + 1 : now; i <= now && i !== this.now; i += 1) {
      this.onFrame(this.frames[i].clip, this.frames[i].frame);
    }
    this.now = now;
  }

  moment() {
    const { index, frame } = this.frames[this.now];
    const start = this.starts[this.now];
    const end = this.starts[this.now + 1] ?? this.duration;
    const share = this.now + 1 < this.frames.length ? (this.time - start) / (end - start) : 0;
    return momentAt(this.clips, index, frame + clamp(share, 0, 0.999));
  }
}

/** The clip and frame that are seen, the ones that follow, and the share `mix` of those. */
function momentAt(clips, index, at) {
  const clip = clips[index];
  const frame = Math.min(Math.floor(at), clip.frames - 1);
  const inside = frame + 1 < clip.frames;
  const next = inside ? clip : clips[index + 1];
  const fits = next && next.robots === clip.robots && next.flagCount === clip.flagCount;
  const mix = fits ? clamp(at - frame, 0, 1) : 0;
  return {
    clip, frame, mix, next: fits ? next : clip, nextFrame: fits && !inside ? 0 : frame + inside,
    tick: clip.tick + Math.round((frame + mix) * clip.ticksPerFrame),
  };
}

/** Where robots are seen: x, y, heading of each; those that jump farther than a step stay. */
export function posesAt(moment, step, into) {
  const { clip, frame, next, nextFrame, mix } = moment;
  const size = clip.robots * 3;
  const poses = into && into.length === size ? into : new Float32Array(size);
  const [from, to] = [frame * size, nextFrame * size];
  const farthest = step * clip.ticksPerFrame;
  for (let i = 0; i < size; i += 3) {
    const [x, y, heading] = [clip.poses[from + i], clip.poses[from + i + 1],
      clip.poses[from + i + 2]];
    const [dx, dy] = [next.poses[to + i] - x, next.poses[to + i + 1] - y];
    const share = Math.hypot(dx, dy) <= farthest ? mix : 0; // NaN is not less
    const turn = share ? shortTurn(next.poses[to + i + 2] - heading) : 0;
    poses[i] = x + (share ? share * dx : 0);
    poses[i + 1] = y + (share ? share * dy : 0);
    poses[i + 2] = heading + share * turn;
  }
  return poses;
}

function shortTurn(angle) {
  return angle - 2 * Math.PI * Math.round(angle / (2 * Math.PI));
}
