/** Short messages to the reader, also read aloud, and the banner of a lost connection. */
import { byId, show } from "./dom.js";

const SEEN_MS = 6000;
let messageTimer = 0;

/** Show a message for a while; a refusal looks like one. */
export function say(text, refused = false) {
  const box = byId("message");
  box.textContent = text;
  box.classList.toggle("refused", refused);
  box.classList.add("seen");
  clearTimeout(messageTimer);
  messageTimer = setTimeout(() => box.classList.remove("seen"), SEEN_MS + 40 * text.length);
}

/** Show a banner over the page, or hide it with null. */
export function banner(text) {
  show(byId("banner"), text !== null);
  byId("banner").textContent = text ?? "";
}
