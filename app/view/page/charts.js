// Charts as SVG, of the live page and of reports. A chart is data: {x, y, marks, equal, height}.
//
// An axis is {label, range: [least, most], time, degrees, words}; a missing end of its range is that of the marks.
// A mark has a kind, a class that gives its colour (of), and words for the legend (label):
//   line     x, y, null: a gap, as are steps of x above `gap` and of y above `wraps`; t: seconds that colour it;
//            dashed, thick, filled
//   dots     x, y, null: none
//   rules    x or y: lines through the frame
//   bands    rects: [x0, x1, y0, y1], null: the edge of the frame
//   circles  circles: [x, y, radius]
//   texts    x, y, texts, boxed
//   image    href, rect
//   cells    rows: numbers at x = 0, 1, ... and y = 0, 1, ...

const NS = "http://www.w3.org/2000/svg";
const STEPS_S = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 28800, 86400];
const STEPS_DEG = [1, 2, 5, 10, 15, 30, 60, 90];
const MARGIN = { left: 54, right: 26, top: 8, bottom: 38 };
const COLOURS = 60; // of a line coloured by time
const NEAR_PX = 40;
const DRAGGED_PX = 6; // less is a click

export function svg(name, attributes = {}, parent = null) {
  const element = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (parent) parent.append(element);
  return element;
}

const isKnown = (value) => value !== null && value !== undefined;
const clock = (seconds) => `${Math.floor(Math.round(seconds) / 60)}:${String(Math.round(seconds) % 60).padStart(2, "0")}`;
const byTime = (share) => `oklch(.6 .16 ${Math.round(140 + 170 * share)})`;

export const scale = ([from, to], begin, end) => (value) => begin + ((value - from) / (to - from || 1)) * (end - begin);

// Stretches of points without a gap.
function stretches({ x, y, gap = Infinity, wraps = Infinity }) {
  const found = [[]];
  let last = null;
  x.forEach((across, k) => {
    const up = y[k];
    if (!isKnown(up) || (last !== null && (across - x[last] > gap || Math.abs(up - y[last]) > wraps))) found.push([]);
    if (isKnown(up)) found.at(-1).push(k);
    last = isKnown(up) ? k : null;
  });
  return found.filter((stretch) => stretch.length > 1);
}

function drawLine(mark, at, group) {
  const point = (k) => `${at.x(mark.x[k]).toFixed(1)},${at.y(mark.y[k]).toFixed(1)}`;
  for (const stretch of stretches(mark)) {
    if (!mark.t) {
      svg("polyline", { points: stretch.map(point).join(" ") }, group);
      continue;
    }
    const share = scale([mark.t[0], mark.t.at(-1)], 0, 1);
    const step = Math.ceil(stretch.length / COLOURS);
    for (let begin = 0; begin < stretch.length - 1; begin += step) {
      const part = stretch.slice(begin, begin + step + 1);
      svg("polyline", { points: part.map(point).join(" ") }, group).style.stroke = byTime(share(mark.t[part[0]]));
    }
  }
}

const DRAWN = {
  line: drawLine,
  dots: ({ x, y, radius = 2.5 }, at, group) =>
    x.forEach((across, k) => isKnown(y[k]) && svg("circle", { cx: at.x(across).toFixed(1), cy: at.y(y[k]).toFixed(1), r: radius }, group)),
  rules: ({ x = [], y = [] }, at, group) => {
    for (const value of x) svg("path", { d: `M${at.x(value).toFixed(1)} 0V${at.height}` }, group);
    for (const value of y) svg("path", { d: `M0 ${at.y(value).toFixed(1)}H${at.width}` }, group);
  },
  bands: ({ rects }, at, group) => {
    for (const [x0, x1, y0, y1] of rects) {
      const [left, right] = [isKnown(x0) ? at.x(x0) : 0, isKnown(x1) ? at.x(x1) : at.width];
      const [top, bottom] = [isKnown(y1) ? at.y(y1) : 0, isKnown(y0) ? at.y(y0) : at.height];
      svg("rect", { x: left, y: top, width: Math.max(right - left, 0), height: Math.max(bottom - top, 0) }, group);
    }
  },
  circles: ({ circles }, at, group) => {
    for (const [x, y, radius] of circles) svg("circle", { cx: at.x(x), cy: at.y(y), r: at.x(x + radius) - at.x(x) }, group);
  },
  texts: ({ x, y, texts, boxed }, at, group) =>
    texts.forEach((text, k) => {
      const place = { x: at.x(x[k]).toFixed(1), y: at.y(y[k]).toFixed(1) };
      if (boxed) svg("circle", { cx: place.x, cy: place.y, r: 8 }, group);
      svg("text", { ...place, dy: ".35em", "text-anchor": boxed ? "middle" : "start", dx: boxed ? 0 : 6 }, group).textContent = text;
    }),
  image: ({ href, rect: [x0, x1, y0, y1] }, at, group) =>
    svg("image", { href, x: at.x(x0), y: at.y(y1), width: at.x(x1) - at.x(x0), height: at.y(y0) - at.y(y1), preserveAspectRatio: "none" }, group),
  cells: ({ rows }, at, group) => {
    const values = rows.flat().filter(isKnown);
    const share = scale([Math.min(...values), Math.max(...values)], 0, 1);
    rows.forEach((row, j) =>
      row.forEach((value, i) => {
        if (!isKnown(value)) return;
        const [x, y] = [at.x(i - 0.5), at.y(j + 0.5)];
        const cell = svg("rect", { x, y, width: at.x(i + 0.5) - x, height: at.y(j - 0.5) - y }, group);
        cell.style.fill = `oklch(${0.4 + 0.5 * share(value)} .12 ${270 - 160 * share(value)})`;
        const words = svg("text", { x: at.x(i), y: at.y(j), dy: ".35em", "text-anchor": "middle" }, group);
        words.textContent = value.toFixed(1);
        words.style.fill = share(value) > 0.45 ? "#000" : "#fff";
      }),
    );
  },
};

// at: {x, y: scales, width, height}, px.
export function draw(marks, at, parent) {
  const groups = marks.map((mark) => {
    const group = svg("g", { class: ["mark", mark.kind, mark.of, ...["dashed", "thick", "filled"].filter((one) => mark[one])].join(" ") });
    DRAWN[mark.kind](mark, at, group);
    return group;
  });
  parent.replaceChildren(...groups);
}

function extent(marks, axis, [least, most] = []) {
  let [low, high] = [Infinity, -Infinity];
  const take = (value) => {
    if (!isKnown(value)) return;
    low = Math.min(low, value);
    high = Math.max(high, value);
  };
  const own = axis === "x" ? 0 : 1;
  for (const mark of marks) {
    if (mark.kind === "line" || mark.kind === "dots") mark[axis].forEach(take);
    for (const circle of mark.circles ?? []) [-1, 1].forEach((sign) => take(circle[own] + sign * circle[2]));
    for (const rect of mark.rects ?? []) rect.slice(2 * own, 2 * own + 2).forEach(take);
    if (mark.rows) [-0.5, (own ? mark.rows : mark.rows[0]).length - 0.5].forEach(take);
  }
  if (low > high) [low, high] = [0, 1];
  const room = 0.03 * (high - low || 1);
  return [least ?? low - room, most ?? high + room];
}

function ticks([from, to], most, axis) {
  if (axis.words) return axis.words.map((_, k) => k);
  const least = (to - from) / most;
  const power = 10 ** Math.floor(Math.log10(least));
  const steps = axis.time && least > 1 ? STEPS_S : axis.degrees && least > 1 ? STEPS_DEG : [1, 2, 5, 10].map((factor) => factor * power);
  const step = steps.find((one) => one >= least * 0.999) ?? steps.at(-1);
  const first = Math.ceil(from / step - 1e-9);
  return Array.from({ length: Math.floor(to / step + 1e-9) - first + 1 }, (_, k) => (first + k) * step);
}

// The words of a value of an axis that shows this much: finer where less is shown.
function worded(value, axis, span) {
  if (axis.words) return axis.words[Math.round(value)] ?? "";
  if (axis.time) return span > 60 ? clock(value) : `${clock(Math.floor(value))}${(value % 1).toFixed(1).slice(1)}`;
  return value.toFixed(Math.max(0, Math.ceil(1.5 - Math.log10(span))));
}

// A chart of a report, with its legend: a value is shown under the pointer, a dragged frame is zoomed to, a double
// click shows all again.
export class Chart {
  constructor(chart, title, parent) {
    this.chart = chart;
    this.all = { x: extent(chart.marks, "x", chart.x.range), y: extent(chart.marks, "y", chart.y.range) };
    const [across, up] = ["x", "y"].map((axis) => this.all[axis][1] - this.all[axis][0]);
    this.height = (width) => (chart.equal ? width * Math.min(Math.max(up / across, 0.45), 0.9) : chart.height ?? 240);
    this.svg = svg("svg", { role: "img", "aria-label": title, viewBox: `0 0 900 ${this.height(900)}` });
    this.tip = document.createElement("div");
    this.tip.className = "tip";
    this.tip.hidden = true;
    const frame = document.createElement("div");
    frame.className = "chart";
    frame.append(this.svg, this.tip);
    parent.append(this.legend(), frame);
    this.listen();
    this.zoom(this.all);
    new ResizeObserver(() => this.draw()).observe(frame);
  }

  legend() {
    const list = document.createElement("ul");
    list.className = "legend";
    for (const mark of this.chart.marks.filter((one) => one.label)) {
      const key = document.createElement("i");
      key.className = ["mark", mark.kind, mark.of, mark.dashed ? "dashed" : "", mark.thick ? "thick" : ""].join(" ");
      if (mark.t) key.style.background = `linear-gradient(to right in oklch, ${byTime(0)}, ${byTime(1)})`;
      const item = document.createElement("li");
      item.append(key, mark.t ? `${mark.label}, ${clock(mark.t[0])} to ${clock(mark.t.at(-1))}` : mark.label);
      list.append(item);
    }
    return list;
  }

  zoom(view) {
    this.view = { x: [...view.x], y: [...view.y] };
    this.draw();
  }

  draw() {
    const { chart } = this;
    const width = this.svg.clientWidth;
    if (!width) return;
    const height = this.height(width);
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    const inner = { width: width - MARGIN.left - MARGIN.right, height: height - MARGIN.top - MARGIN.bottom };
    const { x, y } = this.view;
    if (chart.equal) {
      const scaled = Math.max((x[1] - x[0]) / inner.width, (y[1] - y[0]) / inner.height);
      for (const [range, pixels] of [[x, inner.width], [y, inner.height]]) {
        const middle = (range[0] + range[1]) / 2;
        range.splice(0, 2, middle - (scaled * pixels) / 2, middle + (scaled * pixels) / 2);
      }
    }
    this.at = { x: scale(x, 0, inner.width), y: scale(y, inner.height, 0), ...inner };
    this.svg.replaceChildren();
    const plot = svg("g", { transform: `translate(${MARGIN.left} ${MARGIN.top})` }, this.svg);
    const grid = svg("g", { class: "grid" }, plot);
    svg("rect", { class: "frame", ...inner }, grid);
    for (const value of ticks(x, inner.width / 90, chart.x)) {
      svg("path", { d: `M${this.at.x(value)} 0v${inner.height}` }, grid);
      svg("text", { x: this.at.x(value), y: inner.height + 15, "text-anchor": "middle" }, grid).textContent = worded(value, chart.x, x[1] - x[0]);
    }
    for (const value of ticks(y, inner.height / 36, chart.y)) {
      svg("path", { d: `M0 ${this.at.y(value)}h${inner.width}` }, grid);
      svg("text", { x: -6, y: this.at.y(value), dy: ".35em", "text-anchor": "end" }, grid).textContent = worded(value, chart.y, y[1] - y[0]);
    }
    svg("text", { x: inner.width / 2, y: inner.height + 32, "text-anchor": "middle" }, grid).textContent = chart.x.label;
    svg("text", { transform: `translate(${12 - MARGIN.left} ${inner.height / 2}) rotate(-90)`, "text-anchor": "middle" }, grid).textContent = chart.y.label;
    draw(chart.marks, this.at, svg("svg", { ...inner }, plot)); // which cuts off what lies outside
    this.over = svg("g", { class: "over" }, plot);
  }

  listen() {
    const place = (event) => {
      const box = this.svg.getBoundingClientRect();
      const within = (value, most) => Math.min(Math.max(value, 0), most);
      return [within(event.clientX - box.left - MARGIN.left, this.at.width), within(event.clientY - box.top - MARGIN.top, this.at.height)];
    };
    let from = null;
    const leave = () => {
      from = null;
      this.tip.hidden = true;
      this.over?.replaceChildren();
    };
    this.svg.addEventListener("pointerdown", (event) => {
      if (event.pointerType === "touch" || event.button) return; // a finger scrolls the page
      this.svg.setPointerCapture(event.pointerId);
      from = place(event);
    });
    this.svg.addEventListener("pointermove", (event) => (from ? this.select(from, place(event)) : this.hover(place(event))));
    this.svg.addEventListener("pointerup", (event) => {
      const [begin, end] = [from, place(event)];
      leave();
      if (!begin || Math.abs(end[0] - begin[0]) < DRAGGED_PX) return;
      const [x0, y0, x1, y1] = this.selected(begin, end);
      const { x, y } = this.view;
      const across = scale([0, this.at.width], ...x);
      const up = scale([this.at.height, 0], ...y);
      this.zoom({ x: [across(x0), across(x1)], y: [up(y1), up(y0)] });
    });
    this.svg.addEventListener("pointerleave", leave);
    this.svg.addEventListener("dblclick", () => this.zoom(this.all));
  }

  // The frame between two places, px; over its whole height where that was hardly left.
  selected([x0, y0], [x1, y1]) {
    const flat = Math.abs(y1 - y0) < 3 * DRAGGED_PX && !this.chart.equal;
    const [top, bottom] = flat ? [0, this.at.height] : [Math.min(y0, y1), Math.max(y0, y1)];
    return [Math.min(x0, x1), top, Math.max(x0, x1), bottom];
  }

  select(from, to) {
    const [x0, y0, x1, y1] = this.selected(from, to);
    this.over.replaceChildren(svg("rect", { x: x0, y: y0, width: x1 - x0, height: y1 - y0 }));
  }

  hover([left, top]) {
    const { chart, at, view } = this;
    const found = [];
    for (const mark of chart.marks) {
      if ((mark.kind !== "line" && mark.kind !== "dots") || !mark.label) continue;
      let [near, best] = [-1, Infinity];
      mark.x.forEach((across, k) => {
        if (!isKnown(mark.y[k])) return;
        const apart = chart.equal ? Math.hypot(at.x(across) - left, at.y(mark.y[k]) - top) : Math.abs(at.x(across) - left);
        if (apart < best) [near, best] = [k, apart];
      });
      if (best < NEAR_PX) found.push([best, mark, near]);
    }
    if (chart.equal) found.sort((one, other) => one[0] - other[0]).splice(1);
    this.tip.hidden = !found.length;
    this.over.replaceChildren();
    if (!found.length) return;
    const words = (axis, value) => worded(value, chart[axis], (view[axis][1] - view[axis][0]) / 10);
    const lines = found.map(([, mark, k]) => {
      svg("circle", { cx: at.x(mark.x[k]), cy: at.y(mark.y[k]), r: 4 }, this.over);
      const time = mark.t ? ` at ${clock(mark.t[k])}` : "";
      return `${mark.label}${time}: ${chart.equal ? `${words("x", mark.x[k])}, ` : ""}${words("y", mark.y[k])}`;
    });
    if (!chart.equal) lines.unshift(words("x", found[0][1].x[found[0][2]]));
    this.tip.textContent = lines.join("\n");
    this.tip.style.top = `${top + MARGIN.top + 12}px`;
    const right = left > at.width / 2;
    this.tip.style.left = right ? "auto" : `${left + MARGIN.left + 14}px`;
    this.tip.style.right = right ? `${at.width - left + MARGIN.right + 14}px` : "auto";
  }
}
