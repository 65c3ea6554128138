/** A network as a graph in columns: what it thinks now and what it has learned since birth. */
import { theme } from "./colour.js";
import { FONT, openCanvas, short, words } from "./dom.js";

const ROW_PIXELS = 17;
const NAME_PIXELS = 118;
const OUTPUT_PIXELS = 72;
const RADIUS = 6;

/** Places of nodes in 0..1 x 0..1 by id; nodes of hidden columns lie near what they read. */
function layOut(network) {
  const columns = new Map();
  for (const node of network.nodes) {
    const column = columnOf(node);
    columns.set(column, [...(columns.get(column) ?? []), node]);
  }
  const places = new Map();
  for (const column of [...columns.keys()].sort((a, b) => a - b)) {
    const nodes = columns.get(column);
    const hidden = column > 0 && column < 1;
    if (hidden) sortByReading(nodes, network.links, places);
    nodes.forEach((node, i) => {
      const stagger = hidden && nodes.length > 8 ? 0.03 * ((i % 3) - 1) : 0;
      places.set(node.id, [column + stagger, (i + 0.5) / nodes.length]);
    });
  }
  return places;
}

function columnOf(node) {
  if (node.kind === "input" || node.kind === "bias") return 0;
  if (node.kind === "output") return 1;
  return Math.round(Math.min(Math.max(node.column ?? 0.5, 0.12), 0.88) * 50) / 50;
}

function sortByReading(nodes, links, places) {
  const height = new Map(nodes.map((node) => {
    const rows = links.filter((link) => link.enabled !== false && link.to === node.id)
      .flatMap((link) => (places.has(link.from) ? [places.get(link.from)[1]] : []));
    return [node, rows.length ? rows.reduce((sum, one) => sum + one, 0) / rows.length : 0.5];
  }));
  nodes.sort((a, b) => height.get(a) - height.get(b));
}

/** The graph on its canvas; the pointer chooses a node whose links stand out. */
export class NetworkGraph {
  /** `onPoint(text)` tells in words what the pointer is at. */
  constructor(canvas, onPoint) {
    Object.assign(this, { canvas, onPoint, network: null, activations: {}, pointed: null });
    canvas.addEventListener("pointermove", (event) => this.point(event.offsetX, event.offsetY));
    canvas.addEventListener("pointerleave", () => this.point(-100, -100));
  }

  set(network, activations) {
    this.activations = activations ?? {};
    if (network && network !== this.network) {
      this.network = network;
      this.places = layOut(network);
      const ends = network.nodes.filter((node) => columnOf(node) % 1 === 0);
      const most = Math.max(ends.filter((node) => node.kind !== "output").length, 8);
      this.canvas.style.height = `${most * ROW_PIXELS + 12}px`;
      const links = network.links.filter((link) => link.enabled !== false);
      const told = `Network of ${network.nodes.length} nodes and ${links.length} links`;
      this.canvas.setAttribute("aria-label", told);
    }
    this.draw();
  }

  place(id) {
    const [x, y] = this.places.get(id);
    const wide = this.canvas.clientWidth - NAME_PIXELS - OUTPUT_PIXELS;
    return [NAME_PIXELS + x * wide, 6 + y * (this.canvas.clientHeight - 12)];
  }

  point(column, row) {
    if (!this.network) return;
    const near = this.network.nodes.filter((node) => {
      const [x, y] = this.place(node.id);
      const wide = columnOf(node) === 0 ? NAME_PIXELS : 9;
      return column > x - wide && column < x + 9 && Math.abs(row - y) < 9;
    });
    const node = near[0] ?? null;
    this.pointed = node?.id ?? null;
    this.onPoint(node ? this.describe(node) : "");
    this.draw();
  }

  describe(node) {
    const links = this.network.links.filter((one) => one.to === node.id && one.enabled !== false);
    const value = short(this.activations[node.id]);
    const name = node.name ? words(node.name) : `${node.kind} ${node.id}`;
    const kind = node.activation && node.kind !== "input" ? ` · ${node.activation}` : "";
    const count = links.length ? ` · reads ${links.length}` : "";
    return `${name}: ${value}${kind}${count}`;
  }

  draw() {
    if (!this.network) return;
    const { pen } = openCanvas(this.canvas);
    const links = this.network.links.filter((link) => link.enabled !== false
      && this.places.has(link.from) && this.places.has(link.to));
    const most = Math.max(1e-9, ...links.map((link) => Math.abs(link.weight)));
    for (const link of links) this.drawLearned(pen, link, most);
    for (const link of links) this.drawLink(pen, link, most);
    for (const node of this.network.nodes) this.drawNode(pen, node);
  }

  /** How strong a link is drawn: those of the node under the pointer stand out. */
  strength(link) {
    if (this.pointed === null) return 1;
    return link.from === this.pointed || link.to === this.pointed ? 1.4 : 0.15;
  }

  drawLearned(pen, link, most) {
    if (!Number.isFinite(link.born)) return;
    const change = Math.abs(link.weight - link.born) / most;
    if (change < 0.01) return;
    pen.strokeStyle = theme().learned;
    pen.globalAlpha = Math.min(0.75, (0.15 + 2 * change) * this.strength(link));
    pen.lineWidth = 3 + 9 * Math.min(change, 0.6) + 3 * (Math.abs(link.weight) / most);
    this.path(pen, link);
    pen.stroke();
    pen.globalAlpha = 1;
  }

  drawLink(pen, link, most) {
    const share = Math.abs(link.weight) / most;
    pen.strokeStyle = link.weight < 0 ? theme().negative : theme().positive;
    pen.globalAlpha = Math.min(1, (0.3 + 0.6 * share) * this.strength(link));
    pen.lineWidth = 0.6 + 3.2 * share;
    pen.setLineDash(link.recurrent ? [4, 3] : []);
    this.path(pen, link);
    pen.stroke();
    pen.setLineDash([]);
    pen.globalAlpha = 1;
  }

  path(pen, link) {
    const [x, y] = this.place(link.from);
    const [toX, toY] = this.place(link.to);
    pen.beginPath();
    if (link.from === link.to) {
      pen.arc(x, y - RADIUS - 5, 6, 0, 2 * Math.PI);
      return;
    }
    pen.moveTo(x, y);
    if (link.recurrent || toX <= x + 1) {
      const bend = Math.min(y, toY) - 24;
      pen.bezierCurveTo(x + 26, bend, toX - 26, bend, toX, toY);
    } else {
      const half = (toX - x) / 2;
      pen.bezierCurveTo(x + half, y, toX - half, toY, toX, toY);
    }
  }

  drawNode(pen, node) {
    const [x, y] = this.place(node.id);
    const value = this.activations[node.id] ?? 0;
    pen.beginPath();
    pen.arc(x, y, RADIUS, 0, 2 * Math.PI);
    pen.fillStyle = theme().paper;
    pen.fill();
    pen.fillStyle = value < 0 ? theme().negative : theme().positive;
    pen.globalAlpha = Math.min(1, Math.abs(value));
    pen.fill();
    pen.globalAlpha = 1;
    pen.strokeStyle = node.id === this.pointed ? theme().accent : theme().muted;
    pen.lineWidth = node.id === this.pointed ? 2.5 : 1;
    pen.stroke();
    const end = columnOf(node);
    if (end > 0 && end < 1) return;
    pen.font = FONT;
    pen.fillStyle = theme().ink;
    pen.textBaseline = "middle";
    pen.textAlign = end ? "left" : "right";
    const name = words(node.name ?? node.kind);
    pen.fillText(name, x + (end ? RADIUS + 5 : -RADIUS - 5), y, NAME_PIXELS - RADIUS - 6);
  }
}
