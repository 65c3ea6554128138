/** Colours that everybody can tell apart: viridis for numbers, Okabe and Ito's for kinds. */
import { clamp } from "./dom.js";

const VIRIDIS = [
  [68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142],
  [31, 158, 137], [53, 183, 121], [110, 206, 88], [181, 222, 43], [253, 231, 37],
];
const KINDS = [
  "#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#b8a900", "#7a7f87",
];
const SHADES = 64;
const TEAMS = ["#0072b2", "#d55e00", "#7a7f87"];
const TEAMS_DARK = ["#56b4e9", "#f0803c", "#9aa0a8"];
const THEME_NAMES = [
  "ground", "paper", "ink", "muted", "line", "accent", "wall", "flag", "spawn", "positive",
  "negative", "learned", "enemy", "unknown", "edge",
];

let themeNow = null;

/** The colours of the style sheet by name, and `dark`. */
export function theme() {
  if (themeNow) return themeNow;
  const style = getComputedStyle(document.documentElement);
  themeNow = { dark: matchMedia("(prefers-color-scheme: dark)").matches };
  for (const name of THEME_NAMES) themeNow[name] = style.getPropertyValue(`--${name}`).trim();
  return themeNow;
}

/** Call `action` after the reader's choice of light or dark has changed. */
export function watchTheme(action) {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    themeNow = null;
    action();
  });
}

/** The colour of a share in 0..1, from a table that is made once for light and dark. */
export function scaleColour(share) {
  const colours = theme();
  colours.scale ??= Array.from({ length: SHADES }, (_, i) => shade(i / (SHADES - 1), colours.dark));
  return colours.scale[Math.round(clamp(share, 0, 1) * (SHADES - 1))];
}

/** The end of the scale that the ground would swallow is left out. */
function shade(share, dark) {
  const [low, high] = dark ? [0.22, 1] : [0, 0.93];
  const place = (low + (high - low) * share) * (VIRIDIS.length - 1);
  const index = Math.min(Math.floor(place), VIRIDIS.length - 2);
  const mix = place - index;
  const parts = VIRIDIS[index].map((one, i) => one + (VIRIDIS[index + 1][i] - one) * mix);
  return `rgb(${parts.map(Math.round).join(" ")})`;
}

export function kindColour(kind) {
  return KINDS[((Math.round(kind) % KINDS.length) + KINDS.length) % KINDS.length];
}

export function teamColour(team) {
  const colours = theme().dark ? TEAMS_DARK : TEAMS;
  return colours[clamp(Math.round(team) || 0, 0, colours.length - 1)];
}

/** A CSS gradient of the whole scale, from left to right. */
export function scaleGradient() {
  const stops = Array.from({ length: 10 }, (_, i) => scaleColour(i / 9));
  return `linear-gradient(to right, ${stops.join(", ")})`;
}
