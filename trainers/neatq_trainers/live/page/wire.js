/** What comes over the wire: clips of bytes, messages of JSON, recordings in the page. */

const HEADER_BYTES = 24;
const MAGIC = 0x3143514e; // "NQC1"
const LONGEST_WAIT_MS = 8000;

/**
 * Read a clip; null if the bytes are none.
 *
 * `poses` is [frames, robots, 3], `others` [robots, channels - 3], `flags` [frames, flags, 3],
 * `shots` [shots, 6].
 */
export function decodeClip(buffer) {
  if (buffer.byteLength < HEADER_BYTES) return null;
  const view = new DataView(buffer);
  if (view.getUint32(0, true) !== MAGIC) return null;
  const [frames, robots, channels, ticksPerFrame] = [8, 10, 12, 14].map((at) =>
    view.getUint16(at, true));
  const [shotCount, flagCount] = [20, 22].map((at) => view.getUint16(at, true));
  const sizes = [
    frames * robots * 3, robots * Math.max(channels - 3, 0), frames * flagCount * 3,
    shotCount * 6,
  ];
  const total = sizes.reduce((sum, size) => sum + size, 0);
  if (frames < 1 || buffer.byteLength < HEADER_BYTES + 4 * total) return null;
  let from = HEADER_BYTES;
  const [poses, others, flags, shots] = sizes.map((size) => {
    const values = new Float32Array(buffer, from, size);
    from += 4 * size;
    return values;
  });
  const seconds = view.getFloat32(16, true);
  return {
    tick: view.getUint32(4, true), frames, robots, channels, seconds, shotCount, flagCount,
    ticksPerFrame: Math.max(ticksPerFrame, 1), poses, others, flags, shots,
  };
}

/** The clips of a recording's base64: each has its length as uint32 before it. */
export function clipsOf(base64) {
  const text = atob(base64);
  const bytes = Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  const clips = [];
  for (let at = 0; at + 4 <= bytes.length; ) {
    const length = view.getUint32(at, true);
    const clip = decodeClip(bytes.buffer.slice(at + 4, at + 4 + length));
    if (clip) clips.push(clip);
    at += 4 + length;
  }
  return clips;
}

/** The recording that this page holds, or null. */
export function heldRecording() {
  const element = document.getElementById("recording");
  return element ? parsedMessage(element.textContent) : null;
}

function parsedMessage(text) {
  try {
    return JSON.parse(text);
  } catch {
    return null;
  }
}

/** A WebSocket that comes back by itself. */
export class Wire {
  /** `handlers`: clip(clip), message(object), up(), down(milliseconds until the next try). */
  constructor(handlers) {
    this.handlers = handlers;
    this.wait = 500;
    this.open();
  }

  open() {
    const token = new URLSearchParams(location.search).get("token") ?? "";
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    const query = `token=${encodeURIComponent(token)}`;
    this.socket = new WebSocket(`${scheme}//${location.host}/socket?${query}`);
    this.socket.binaryType = "arraybuffer";
    this.socket.onmessage = ({ data }) => this.receive(data);
    this.socket.onclose = () => this.lose();
  }

  receive(data) {
    this.wait = 500;
    if (typeof data !== "string") {
      const clip = decodeClip(data);
      if (clip) this.handlers.clip(clip);
      return;
    }
    const message = parsedMessage(data);
    if (!message) return;
    if (message.type === "hello") this.handlers.up();
    this.handlers.message(message);
  }

  lose() {
    this.handlers.down(this.wait);
    setTimeout(() => this.open(), this.wait);
    this.wait = Math.min(2 * this.wait, LONGEST_WAIT_MS);
  }

  /** Send a message; false if there is no connection. */
  send(message) {
    if (this.socket.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }
}
