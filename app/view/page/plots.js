// Small plots of the last minutes, one below the other over the same time.

import { draw, scale, svg } from "./charts.js";
import { lengthOf, lengthUnit } from "./units.js";

const SPAN_S = 180;
const GAP_S = 10; // no line is drawn over a longer one: nothing is known of what was between
const LEFT_PX = 34;
const degrees = (radians) => (radians === null || radians === undefined ? null : (radians * 180) / Math.PI);

// lines: [sample -> value or null, name]; range: [least, most] from the setting and what is shown.
const PLOTS = [
  {
    title: "range", unit: lengthUnit, digits: 0, lines: [[(s) => (s.range_m === null || s.range_m === undefined ? null : lengthOf(s.range_m)), ""]],
    shade: (setting) => setting.band_m.map(lengthOf), range: (setting, most) => [0, Math.max(1.08 * lengthOf(setting.band_m[1]), most)],
  },
  {
    title: "angle from abeam, °", digits: 0, lines: [[(s) => degrees(s.angle_rad), ""]], wraps: true,
    shade: (setting) => allowed(setting), range: () => [-180, 180],
  },
  {
    inner: true, title: "innovation squared (NIS)", digits: 1, lines: [[(s) => s.nis, ""]],
    bound: 7.81, range: (_, most) => [0, Math.min(Math.max(16, most), 60)],
  },
  {
    inner: true, title: "bank, °", digits: 0, lines: [[(s) => degrees(s.bank_rad), ""]],
    range: (setting) => [-1.1 * degrees(setting.bank_max_rad), 1.1 * degrees(setting.bank_max_rad)],
  },
  {
    inner: true, title: "time since last message, s", digits: 1,
    lines: [[(s) => s.range_age_s, "laser"], [(s) => s.gimbal_age_s, "gimbal"], [(s) => s.link_age_s, "link"]],
    range: (_, most) => [0, Math.min(Math.max(2, most), 60)],
  },
];

function allowed(setting) {
  if (setting.either_side) return [-180, 180];
  if (!setting.sector_rad) return [-90, 90];
  const [from, to] = setting.sector_rad;
  const half = degrees(((to - from + 2 * Math.PI) % (2 * Math.PI) || 2 * Math.PI) / 2);
  return [-half, half];
}

class Plot {
  constructor(kind, parent) {
    this.kind = kind;
    const figure = document.createElement("figure");
    const caption = document.createElement("figcaption");
    this.title = document.createTextNode(kind.title);
    caption.append(this.title);
    kind.lines.forEach(([, name], k) => {
      if (!name) return;
      const key = document.createElement("span");
      key.className = `c${k}`;
      key.textContent = name;
      caption.append(key);
    });
    this.latest = document.createElement("b");
    caption.append(this.latest);
    this.svg = svg("svg", { role: "img", "aria-label": kind.title });
    figure.append(caption, this.svg);
    parent.append(figure);
    this.frame = svg("rect", { class: "frame", x: LEFT_PX, y: 0 }, this.svg);
    this.labels = [0, 1].map(() => svg("text", { x: LEFT_PX - 4, "text-anchor": "end" }, this.svg));
    this.marks = svg("g", { transform: `translate(${LEFT_PX})` }, this.svg);
  }

  // The frame and its labels; returns the scales, null while there is no room.
  lay([first, last], [least, most]) {
    if (this.kind.unit) this.title.data = `${this.kind.title}, ${this.kind.unit()}`;
    const width = this.svg.clientWidth;
    const height = this.svg.clientHeight;
    if (!width) return null;
    const at = { x: scale([first, last], 0, width - LEFT_PX), y: scale([least, most], height, 0), width: width - LEFT_PX, height };
    for (const side of ["width", "height"]) this.frame.setAttribute(side, at[side]);
    [most, least].forEach((value, k) => {
      this.labels[k].textContent = Math.round(value);
      this.labels[k].setAttribute("y", k ? height - 1 : 9);
    });
    return at;
  }

  draw(samples, setting) {
    const { kind } = this;
    if (!samples.length || !setting.band_m) return;
    const values = kind.lines.map(([value]) => samples.map(value));
    const known = values.flat().filter((v) => v !== null && v !== undefined);
    const [least, most] = kind.range(setting, Math.max(0, ...known) * 1.1);
    const end = samples.at(-1).time_s;
    const at = this.lay([end - SPAN_S, end], [least, most]);
    if (!at) return;
    const x = samples.map((sample) => sample.time_s);
    const shade = kind.shade?.(setting);
    const marks = shade ? [{ kind: "bands", of: "shade", rects: [[null, null, ...shade]] }] : [];
    if (kind.bound) marks.push({ kind: "rules", of: "bound", y: [kind.bound] });
    const within = (v) => (v === null || v === undefined ? null : Math.min(Math.max(v, least), most));
    const lines = values.map((y, k) => ({ kind: "line", of: `s${k}`, x, y: y.map(within), gap: GAP_S, wraps: kind.wraps ? 180 : Infinity }));
    draw([...marks, ...lines], at, this.marks);
    const now = values.map((line) => line.at(-1));
    this.latest.textContent = now.map((v) => (v === null || v === undefined ? "–" : v.toFixed(kind.digits))).join("  ");
  }
}

// The ground below the path from the aircraft to the end of the next lap, and the heights planned for it.
class Profile extends Plot {
  constructor(parent) {
    super({ title: "ground ahead", unit: lengthUnit, lines: [[null, "planned height"], [null, "ground"]] }, parent);
  }

  draw(ahead) {
    this.svg.parentElement.hidden = !ahead;
    if (!ahead) return;
    const inUnits = (values) => values.map((value) => (value === null ? null : lengthOf(value)));
    const [ground, planned] = [inUnits(ahead.ground_m), inUnits(ahead.height_m)];
    const x = ground.map((_, k) => (k * lengthOf(ahead.length_m)) / (ground.length - 1));
    const known = [...ground, ...planned].filter((value) => value !== null);
    const [least, most] = [Math.min(...known), Math.max(...known)];
    const at = this.lay([0, x.at(-1)], [least - 0.1 * (most - least), most + 0.1 * (most - least)]);
    if (!at) return;
    draw([{ kind: "line", of: "s1", x, y: ground }, { kind: "line", of: "s0", x, y: planned }], at, this.marks);
    const clear = ground.map((value, k) => (value === null || planned[k] === null ? Infinity : planned[k] - value));
    const lowest = Math.min(...clear);
    this.latest.textContent = Number.isFinite(lowest) ? `${lowest.toFixed(0)} at the lowest, over ${Math.round(x.at(-1))}` : "unknown";
  }
}

export class Plots {
  // inner: where the plots for engineers go.
  constructor(parent, inner) {
    this.parent = parent;
    this.samples = new Map(); // by the name of the aircraft
    this.setting = {};
    this.plots = PLOTS.map((kind) => new Plot(kind, kind.inner ? inner : parent));
    this.profile = new Profile(parent);
    const under = document.createElement("figcaption");
    under.textContent = `the last ${SPAN_S} s of the flight; the latest values are at the right edge`;
    const figure = document.createElement("div");
    figure.append(under);
    parent.append(figure);
  }

  forget() {
    this.samples.clear();
  }

  add(samples) {
    for (const sample of samples) {
      if (sample.time_s === null) continue;
      if (!this.samples.has(sample.name)) this.samples.set(sample.name, []);
      this.samples.get(sample.name).push(sample);
    }
    for (const kept of this.samples.values()) {
      const since = kept.at(-1).time_s - SPAN_S;
      kept.splice(0, Math.max(0, kept.findIndex((sample) => sample.time_s >= since) - 1));
    }
  }

  // name: of the aircraft to be shown; "" where there is one only. ahead: the ground on its path; null: not known.
  draw({ name = "", ahead = null } = {}) {
    const samples = this.samples.get(name) ?? [];
    this.parent.hidden = !samples.length;
    for (const plot of this.plots) plot.draw(samples, this.setting);
    this.profile.draw(ahead);
  }
}
