// Small plots of the last minutes, one below the other over the same time.

import { svg } from "./map.js";
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
    this.shade = svg("rect", { class: "shade", x: LEFT_PX }, this.svg);
    this.bound = svg("path", { class: "bound" }, this.svg);
    this.labels = [0, 1].map(() => svg("text", { x: LEFT_PX - 4, "text-anchor": "end" }, this.svg));
    this.lines = kind.lines.map((_, k) => svg("g", { class: `s${k}` }, this.svg));
  }

  draw(samples, setting) {
    const { kind } = this;
    if (kind.unit) this.title.data = `${kind.title}, ${kind.unit()}`;
    const width = this.svg.clientWidth;
    const height = this.svg.clientHeight;
    if (!width || !samples.length || !setting.band_m) return;
    const values = kind.lines.map(([value]) => samples.map(value));
    const known = values.flat().filter((v) => v !== null && v !== undefined);
    const [least, most] = kind.range(setting, Math.max(0, ...known) * 1.1);
    const end = samples.at(-1).time_s;
    const x = (time) => width - ((end - time) / SPAN_S) * (width - LEFT_PX);
    const y = (v) => height - ((Math.min(Math.max(v, least), most) - least) / (most - least)) * height;
    this.frame.setAttribute("width", width - LEFT_PX);
    this.frame.setAttribute("height", height);
    const shade = kind.shade?.(setting);
    if (shade) {
      this.shade.setAttribute("y", y(shade[1]));
      this.shade.setAttribute("width", width - LEFT_PX);
      this.shade.setAttribute("height", y(shade[0]) - y(shade[1]));
    }
    if (kind.bound) this.bound.setAttribute("d", `M${LEFT_PX} ${y(kind.bound)}H${width}`);
    [most, least].forEach((value, k) => {
      this.labels[k].textContent = Math.round(value);
      this.labels[k].setAttribute("y", k ? height - 1 : 9);
    });
    values.forEach((line, k) => this.lines[k].replaceChildren(...this.strokes(samples, line, x, y)));
    const now = values.map((line) => line.at(-1));
    this.latest.textContent = now.map((v) => (v === null || v === undefined ? "–" : v.toFixed(kind.digits))).join("  ");
  }

  // One polyline for each unbroken stretch: gaps where values are missing, and where an angle wraps around.
  strokes(samples, line, x, y) {
    const stretches = [[]];
    let last = null;
    samples.forEach((sample, k) => {
      const value = line[k];
      const gap = k && sample.time_s - samples[k - 1].time_s > GAP_S;
      const broken = gap || value === null || value === undefined || (this.kind.wraps && last !== null && Math.abs(value - last) > 180);
      if (broken) stretches.push([]);
      if (value !== null && value !== undefined) stretches.at(-1).push(`${x(sample.time_s).toFixed(1)},${y(value).toFixed(1)}`);
      last = value ?? null;
    });
    return stretches.filter((stretch) => stretch.length > 1).map((stretch) => svg("polyline", { points: stretch.join(" ") }));
  }
}

export class Plots {
  // inner: where the plots for engineers go.
  constructor(parent, inner) {
    this.parent = parent;
    this.samples = new Map(); // by the name of the aircraft
    this.setting = {};
    this.plots = PLOTS.map((kind) => new Plot(kind, kind.inner ? inner : parent));
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

  // name: of the aircraft to be shown; "" where there is one only.
  draw(name = "") {
    const samples = this.samples.get(name) ?? [];
    this.parent.hidden = !samples.length;
    for (const plot of this.plots) plot.draw(samples, this.setting);
  }
}
