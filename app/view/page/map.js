import { svg } from "./charts.js";
import { length, lengthOf, lengthUnit, metresOfLength, position, roundLength } from "./units.js";

// The map: metres east and north in one scaled group, symbols and words in pixels above it.

const PREDICTED_S = 60;
const GRID_PX = 90;
const TRAIL_KEPT = 2400;
const SCALE_PX = 120;
const NAME_PX = [130, 17]; // room of a name, width and height
const AIRCRAFT = "M0 -11 L8 9 L0 4 L-8 9 Z";
const COURSE = "M0 -17 L6 -7 L-6 -7 Z"; // of the target, ahead of its symbol
const [AGES, AGE_S] = [8, 60]; // a track fades in steps, each of these seconds
const EQUATOR_M_PER_PX = 156543.034; // of zoom 0, at 256 px a tile
const TILES_MAX = 80;
const KEY_PAN = 0.15; // of the map's width

// The world in Web Mercator, as tiles are cut; near the flight degrees are metres by a constant.
const column = (longitudeDeg, zoom) => Math.floor(((longitudeDeg + 180) / 360) * 2 ** zoom);
const row = (latitudeDeg, zoom) => Math.floor((0.5 - Math.asinh(Math.tan((latitudeDeg * Math.PI) / 180)) / (2 * Math.PI)) * 2 ** zoom);
const longitude = (i, zoom) => (i / 2 ** zoom) * 360 - 180;
const latitude = (j, zoom) => (Math.atan(Math.sinh(Math.PI * (1 - (2 * j) / 2 ** zoom))) * 180) / Math.PI;
const metresOf = (origin, latitudeDeg, longitudeDeg) => [
  (longitudeDeg - origin.longitude_deg) * origin.east_m_per_deg, (latitudeDeg - origin.latitude_deg) * origin.north_m_per_deg,
];
const degreesOf = (origin, east, north) => [
  origin.longitude_deg + east / origin.east_m_per_deg, origin.latitude_deg + north / origin.north_m_per_deg,
];

const points = (line) => line.map((p) => p.join(",")).join(" ");

// A sector of a ring about (0, 0), bearings clockwise from north, as a path in metres.
function ringSector(least, most, from, to) {
  const at = (r, b) => `${r * Math.sin(b)} ${r * Math.cos(b)}`;
  const large = (to - from) % (2 * Math.PI) > Math.PI ? 1 : 0;
  // With y pointing up in metres, clockwise on the map is sweep 0.
  return `M${at(most, from)} A${most} ${most} 0 ${large} 0 ${at(most, to)} L${at(least, to)} `
    + `A${least} ${least} 0 ${large} 1 ${at(least, from)} Z`;
}

function extend(trails, name, at) {
  if (!trails.has(name)) trails.set(name, []);
  const trail = trails.get(name);
  trail.push(at);
  trail.splice(0, trail.length - TRAIL_KEPT);
}

export class FlightMap {
  constructor(root, followButton, measureButton, cursor) {
    this.root = root;
    this.cursor = cursor;
    this.measureButton = measureButton;
    this.measured = []; // up to two points, metres
    this.pointers = new Map();
    this.trails = new Map(); // of each aircraft, by its name
    this.targetTrails = new Map(); // of its target
    this.setting = {};
    this.state = null;
    this.view = null; // {east, north, scale px/m}; null follows the target
    this.ground = svg("g", {}, root);
    const shape = (name, kind) => svg(name, { class: kind }, this.ground);
    this.about = svg("g", {}, this.ground); // moves with the target
    this.fences = svg("g", {}, this.ground);
    this.routes = svg("g", {}, this.ground);
    this.side = svg("path", { class: "side" }, this.about);
    this.rings = [0, 1].map(() => svg("circle", { class: "ring" }, this.about));
    const track = (kind) => { const group = shape("g", kind); return [...Array(AGES).keys()].map((k) => svg("polyline", { class: `a${k}` }, group)); };
    this.trailLines = track("trail");
    this.targetLines = track("target-trail");
    this.otherCircles = svg("g", {}, this.ground);
    this.circle = shape("circle", "circle");
    this.line = shape("polyline", "line");
    this.coming = shape("circle", "coming");
    this.comingLine = shape("polyline", "coming");
    this.whatIf = shape("circle", "what-if");
    this.whatIfLine = shape("polyline", "what-if");
    this.sight = shape("polyline", "sight");
    this.measureLine = shape("polyline", "measure");
    this.predicted = shape("polyline", "predicted");
    this.ellipse = shape("ellipse", "ellipse");
    this.grid = svg("g");
    this.under = svg("g", { class: "under" }); // the map's tiles or picture, and the ground's shading
    this.pictures = new Map();
    root.prepend(this.under, this.grid);
    this.scales = svg("g", {}, root);
    this.symbols = svg("g", {}, root);
    this.others = svg("g", {}, this.symbols);
    this.home = svg("g", { class: "home" }, this.symbols);
    svg("circle", { r: 9 }, this.home);
    svg("text", { "text-anchor": "middle", y: 5 }, this.home).textContent = "H";
    this.target = svg("circle", { class: "target", r: 5 }, this.symbols);
    this.course = svg("path", { class: "target-course", d: COURSE }, this.symbols);
    this.aircraft = svg("path", { class: "aircraft", d: AIRCRAFT }, this.symbols);
    this.words = svg("text", { class: "label" }, this.symbols);
    this.followButton = followButton;
    followButton.addEventListener("click", () => this.follow());
    root.addEventListener("dblclick", () => this.follow());
    root.addEventListener("wheel", (event) => this.zoom(event), { passive: false });
    root.addEventListener("pointerdown", (event) => this.grab(event));
    root.addEventListener("pointermove", (event) => this.point(event));
    root.addEventListener("pointerleave", () => { cursor.hidden = true; });
    root.addEventListener("keydown", (event) => this.key(event));
    measureButton.addEventListener("click", () => this.measure());
    new ResizeObserver(() => this.draw()).observe(root);
  }

  forget() {
    this.trails.clear();
    this.targetTrails.clear();
  }

  addTrail(samples) {
    for (const [time, east, north, name = ""] of samples) extend(this.trails, name, [east, north, time]);
  }

  addTarget({ name, target_m: at, time_s: time }) {
    const last = this.targetTrails.get(name)?.at(-1);
    if (at && (!last || Math.hypot(at[0] - last[0], at[1] - last[1]) > 2)) extend(this.targetTrails, name, [...at, time]);
  }

  // The track in lines by its age, each from where the older one ends.
  drawTrack(lines, track, now) {
    const parts = lines.map(() => []);
    const age = ([, , time]) => Math.min(AGES - 1, Math.max(0, Math.floor((now - time) / AGE_S)));
    track.forEach((at, k) => {
      parts[age(at)].push(at);
      if (k && age(track[k - 1]) !== age(at)) parts[age(track[k - 1])].push(at);
    });
    lines.forEach((line, k) => line.setAttribute("points", parts[k].map(([e, n]) => `${e},${n}`).join(" ")));
  }

  // -- view ------------------------------------------------------------------------------------------------

  follow() {
    this.view = null;
    this.followButton.hidden = true;
    this.draw();
  }

  leave(view) {
    this.view = view;
    this.followButton.hidden = false;
    this.draw();
  }

  zoom(event) {
    event.preventDefault();
    this.zoomAt(this.pixel(event), Math.exp(-event.deltaY * 0.0015));
  }

  // Zoom by a factor and keep what is at a pixel (from the middle of the map) there.
  zoomAt([x, y], factor) {
    const view = this.shown();
    const scale = Math.min(20, Math.max(0.01, view.scale * factor));
    const shift = 1 / view.scale - 1 / scale;
    this.leave({ east: view.east + x * shift, north: view.north - y * shift, scale });
  }

  pixel(event) {
    const box = this.root.getBoundingClientRect();
    return [event.clientX - box.left - box.width / 2, event.clientY - box.top - box.height / 2];
  }

  metres(event) {
    const view = this.shown();
    const [x, y] = this.pixel(event);
    return [view.east + x / view.scale, view.north - y / view.scale];
  }

  // One pointer moves the map, two zoom it.
  grab(start) {
    if (this.measureButton.getAttribute("aria-pressed") === "true") {
      this.measured = [...(this.measured.length > 1 ? [] : this.measured), this.metres(start)];
      this.draw();
      return;
    }
    this.pointers.set(start.pointerId, start);
    let last = start;
    const move = (event) => {
      if (!this.pointers.has(event.pointerId)) return;
      const others = [...this.pointers.values()].filter((other) => other.pointerId !== event.pointerId);
      const before = this.pointers.get(event.pointerId);
      this.pointers.set(event.pointerId, event);
      if (others.length) {
        const [a, b, c] = [this.pixel(others[0]), this.pixel(before), this.pixel(event)];
        const apart = (p, q) => Math.max(Math.hypot(p[0] - q[0], p[1] - q[1]), 1);
        this.zoomAt([(a[0] + c[0]) / 2, (a[1] + c[1]) / 2], apart(a, c) / apart(a, b));
      } else {
        const view = this.shown();
        this.leave({
          ...view,
          east: view.east - (event.clientX - last.clientX) / view.scale,
          north: view.north + (event.clientY - last.clientY) / view.scale,
        });
      }
      last = event;
    };
    const drop = (event) => {
      if (event.pointerId !== start.pointerId) return;
      this.pointers.delete(event.pointerId);
      window.removeEventListener("pointermove", move);
      window.removeEventListener("pointerup", drop);
      window.removeEventListener("pointercancel", drop);
    };
    window.addEventListener("pointermove", move);
    window.addEventListener("pointerup", drop);
    window.addEventListener("pointercancel", drop);
  }

  key(event) {
    const view = this.shown();
    const step = (KEY_PAN * this.root.clientWidth) / view.scale;
    const pans = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const zooms = { "+": 1.3, "=": 1.3, "-": 1 / 1.3 };
    if (event.key in pans) {
      const [e, n] = pans[event.key];
      this.leave({ ...view, east: view.east + e * step, north: view.north + n * step });
    } else if (event.key in zooms) this.zoomAt([0, 0], zooms[event.key]);
    else if (event.key === "0") this.follow();
    else return;
    event.preventDefault();
  }

  measure() {
    const pressed = this.measureButton.getAttribute("aria-pressed") !== "true";
    this.measureButton.setAttribute("aria-pressed", pressed);
    this.measured = [];
    this.draw();
  }

  // The position under the cursor, in degrees if known, and the measured distance.
  point(event) {
    const [east, north] = this.metres(event);
    const { origin } = this.setting;
    const place = origin
      ? position(degreesOf(origin, east, north).reverse(), 5)
      : `${length(east)} east, ${length(north)} north`;
    const [from, to] = this.measured.length > 1 ? this.measured : [this.measured[0], [east, north]];
    let measured = "";
    if (from) {
      const [de, dn] = [to[0] - from[0], to[1] - from[1]];
      const bearing = Math.round((Math.atan2(de, dn) * 180) / Math.PI + 360) % 360;
      measured = `  ${length(Math.hypot(de, dn))}, bearing ${String(bearing).padStart(3, "0")}°`;
      this.measureLine.setAttribute("points", points([from, to]));
    }
    this.cursor.hidden = false;
    this.cursor.textContent = place + measured;
  }

  shown() {
    if (this.view) return this.view;
    const { clientWidth: width, clientHeight: height } = this.root;
    const { state, setting } = this;
    const seen = [];
    const reach = (at, r) => seen.push([at[0] - r, at[1] - r], [at[0] + r, at[1] + r]);
    if (state?.target) reach(state.target.at_m, setting.band_m?.[1] ?? 100);
    const others = (state?.others ?? []).map((one) => one.aircraft);
    for (const one of [state?.aircraft, ...others, ...(state?.targets ?? [])]) if (one?.at_m) reach(one.at_m, 30);
    for (const plan of [state?.present, state?.coming]) if (plan) reach(plan.circle, plan.circle[2]);
    if (!seen.length) reach([0, 0], 500);
    const [east, north] = [0, 1].map((k) => seen.map((p) => p[k]));
    const [w, e, s, n] = [Math.min(...east), Math.max(...east), Math.min(...north), Math.max(...north)];
    const scale = Math.min((width - 90) / (e - w), (height - 70) / (n - s));
    return { east: (w + e) / 2, north: (s + n) / 2, scale: Math.max(scale, 0.001) };
  }

  // -- drawing ---------------------------------------------------------------------------------------------

  draw() {
    const { clientWidth: width, clientHeight: height } = this.root;
    if (!width || !height) return;
    const { east, north, scale } = this.shown();
    const x = (e) => width / 2 + (e - east) * scale;
    const y = (n) => height / 2 - (n - north) * scale;
    this.ground.setAttribute("transform", `translate(${x(0)} ${y(0)}) scale(${scale} ${-scale})`);
    this.under.setAttribute("transform", `translate(${x(0)} ${y(0)}) scale(${scale})`);
    this.drawUnder(width, height, { east, north, scale });
    this.drawGrid(width, height, { east, north, scale }, x, y);
    const name = this.state?.name ?? "";
    const now = this.state?.time_s ?? 0;
    this.drawTrack(this.trailLines, this.trails.get(name) ?? [], now);
    this.drawTrack(this.targetLines, this.targetTrails.get(name) ?? [], now);
    if (!this.measured.length) this.measureLine.setAttribute("points", "");
    const { state } = this;
    this.plan(state?.present, this.circle, this.line);
    this.plan(state?.coming, this.coming, this.comingLine);
    const other = state?.what_if;
    this.plan(other?.proposed ?? other?.coming ?? other?.present, this.whatIf, this.whatIfLine);
    this.drawTarget(state, x, y);
    const home = state?.vehicle?.home_m;
    this.home.toggleAttribute("hidden", !home);
    if (home) this.home.setAttribute("transform", `translate(${x(home[0])} ${y(home[1])})`);
    const aircraft = state?.aircraft;
    this.aircraft.toggleAttribute("hidden", !aircraft);
    const placed = (one) => `translate(${x(one.at_m[0])} ${y(one.at_m[1])}) rotate(${(one.course_rad * 180) / Math.PI})`;
    if (aircraft) this.aircraft.setAttribute("transform", placed(aircraft));
    const others = [...(state?.others ?? []), ...(state?.traffic ?? []), ...(other?.aircraft ? [{ ...other, name: "what if" }] : [])];
    this.drawFleet(others.filter((one) => one.aircraft), placed, x, y);
    for (const [e, n] of state?.waypoints ?? []) svg("circle", { class: "waypoint", cx: x(e), cy: y(n), r: 3 }, this.others);
    for (const { name, at_m } of state?.targets ?? []) {
      svg("circle", { class: "target", cx: x(at_m[0]), cy: y(at_m[1]), r: 5 }, this.others);
      svg("text", { class: "label", x: x(at_m[0]) + 9, y: y(at_m[1]) + 16 }, this.others).textContent = name;
    }
  }

  // The names of a fleet's aircraft, and the others with their circles.
  drawFleet(others, placed, x, y) {
    this.others.replaceChildren();
    this.otherCircles.replaceChildren();
    this.named = []; // where names are, pixels
    if (this.state?.name && this.state.aircraft) this.nameOf(this.state, x, y);
    for (const one of others) {
      svg("path", { class: "aircraft other", d: AIRCRAFT, transform: placed(one.aircraft) }, this.others);
      this.nameOf(one, x, y);
      const [cx, cy, r] = one.present?.circle ?? [0, 0, 0];
      svg("circle", { class: "circle other", cx, cy, r }, this.otherCircles);
    }
  }

  // Name and height next to an aircraft, on the side where there is room, below the names that are there already.
  nameOf({ name, aircraft: one }, x, y) {
    const at = [x(one.at_m[0]), y(one.at_m[1]) + 4];
    while (this.named.some((other) => Math.abs(other[0] - at[0]) < NAME_PX[0] && Math.abs(other[1] - at[1]) < NAME_PX[1])) at[1] += NAME_PX[1];
    this.named.push(at);
    const words = svg("text", { class: "label", x: at[0] + 12, y: at[1] }, this.others);
    words.textContent = one.height_m === null ? name : `${name}, ${length(one.height_m)}`;
    if (x(one.at_m[0]) + 12 + words.getComputedTextLength() > this.root.clientWidth) {
      words.setAttribute("x", x(one.at_m[0]) - 12);
      words.setAttribute("text-anchor", "end");
    }
  }

  plan(plan, circle, line) {
    const [east, north, radius] = plan?.circle ?? [0, 0, 0];
    circle.setAttribute("cx", east);
    circle.setAttribute("cy", north);
    circle.setAttribute("r", radius);
    line.setAttribute("points", points(plan?.line ?? []));
  }

  drawTarget(state, x, y) {
    const target = state?.target;
    for (const element of [this.about, this.target, this.words]) element.toggleAttribute("hidden", !target);
    const course = target && !target.stands && Math.hypot(...target.velocity_m_s) >= 0.3 ? target.course_rad : null;
    this.course.toggleAttribute("hidden", course === null);
    if (!target) return;
    const [east, north] = target.at_m;
    const [major, minor, bearing] = target.ellipse;
    this.about.setAttribute("transform", `translate(${east} ${north})`);
    const ahead = target.velocity_m_s.map((v, k) => target.at_m[k] + v * PREDICTED_S);
    const line = state.route?.on ? [target.at_m, ...state.route.ahead.slice(1)] : [target.at_m, ahead];
    this.predicted.setAttribute("points", course === null ? "" : points(line));
    this.sight.setAttribute("points", state.aircraft ? points([target.at_m, state.aircraft.at_m]) : "");
    this.ellipse.setAttribute("rx", minor);
    this.ellipse.setAttribute("ry", major);
    // The ellipse's long axis is drawn northwards, then turned to its bearing: clockwise is negative with y up.
    this.ellipse.setAttribute("transform", `translate(${east} ${north}) rotate(${(-bearing * 180) / Math.PI})`);
    this.target.setAttribute("cx", x(east));
    this.target.setAttribute("cy", y(north));
    this.course.setAttribute("transform", `translate(${x(east)} ${y(north)}) rotate(${((course ?? 0) * 180) / Math.PI})`);
    this.words.setAttribute("x", x(east) + 9);
    this.words.setAttribute("y", y(north) + 16);
    const good = target.quality === "good";
    this.words.textContent = target.name ? `${target.name}${good ? "" : ` ${target.quality}`}` : good ? "" : `target ${target.quality}`;
    this.drawSide(state, target);
  }

  drawSide(state, target) {
    const { band_m: band, sector_rad: sector, either_side: either } = this.setting;
    if (!band) return;
    this.rings.forEach((ring, k) => ring.setAttribute("r", band[k]));
    let from = 0;
    let to = 2 * Math.PI - 1e-6;
    if (sector) [from, to] = [sector[0], sector[1] <= sector[0] ? sector[1] + 2 * Math.PI : sector[1]];
    else if (!either && target.watch_course_rad !== null) {
      from = target.watch_course_rad + ((state.wanted ?? state.side) === "left" ? -Math.PI : 0);
      to = from + Math.PI;
    } else if (!either) { // a target that has not moved has no side
      this.side.setAttribute("d", "");
      return;
    }
    this.side.setAttribute("d", ringSector(band[0], band[1], from, to));
  }

  drawFixed() {
    const routes = this.setting.routes ?? [];
    this.routes.replaceChildren(...routes.map((line) => svg("polyline", { class: "route", points: points(line) })));
    const outlines = (kind) => (this.setting[kind.replace("-", "_")] ?? [])
      .map((outline) => svg("polygon", { class: kind, points: points(outline) }));
    const rally = (this.setting.rally ?? []).map((point) => svg("polyline", { class: "rally", points: points([point, point]) }));
    this.fences.replaceChildren(...outlines("keep-in"), ...outlines("keep-out"), ...rally);
  }

  // The background map. The tiles' zoom level is the one whose pixels are about as large as the screen's.
  drawUnder(width, height, { east, north, scale }) {
    const { origin, map, shade_m: shade } = this.setting;
    const wanted = new Map(); // url -> west, north, east, south, m
    if (origin && map?.bounds_deg) {
      const [south, west, northern, eastern] = map.bounds_deg;
      wanted.set("map", [...metresOf(origin, northern, west), ...metresOf(origin, south, eastern)]);
    } else if (origin && map?.zooms) {
      const [least, most] = map.zooms;
      const fit = Math.log2((EQUATOR_M_PER_PX * Math.cos((origin.latitude_deg * Math.PI) / 180)) * scale);
      const [halfWidth, halfHeight] = [width / scale / 2, height / scale / 2];
      const [west, top] = degreesOf(origin, east - halfWidth, north + halfHeight);
      const [right, bottom] = degreesOf(origin, east + halfWidth, north - halfHeight);
      let zoom = Math.min(most, Math.max(least, Math.round(fit)));
      const count = () => (column(right, zoom) - column(west, zoom) + 1) * (row(bottom, zoom) - row(top, zoom) + 1);
      while (zoom > least && count() > TILES_MAX) zoom -= 1;
      if (count() <= TILES_MAX) {
        for (let i = column(west, zoom); i <= column(right, zoom); i += 1) {
          for (let j = row(top, zoom); j <= row(bottom, zoom); j += 1) {
            wanted.set(`map/${zoom}/${i}/${j}`, [
              ...metresOf(origin, latitude(j, zoom), longitude(i, zoom)),
              ...metresOf(origin, latitude(j + 1, zoom), longitude(i + 1, zoom)),
            ]);
          }
        }
      }
    }
    if (shade) wanted.set("shade", [shade[0], shade[3], shade[2], shade[1]]);
    for (const [url, picture] of this.pictures) {
      if (!wanted.has(url)) {
        picture.remove();
        this.pictures.delete(url);
      }
    }
    for (const [url, [west, top, right, bottom]] of wanted) {
      if (this.pictures.has(url)) continue;
      const place = { x: west, y: -top, width: right - west, height: top - bottom, preserveAspectRatio: "none" };
      this.pictures.set(url, svg("image", { ...place, href: url, class: url === "shade" ? "shade" : "tile" }, this.under));
      this.pictures.get(url).addEventListener("error", (event) => event.target.setAttribute("visibility", "hidden"));
    }
    this.root.classList.toggle("on-map", Boolean(map));
  }

  drawGrid(width, height, { east, north, scale }, x, y) {
    const rough = lengthOf(GRID_PX / scale);
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = metresOfLength([1, 2, 5, 10].map((k) => k * power).find((size) => size >= rough));
    const parts = [];
    const words = [];
    const word = (text, attributes) => {
      words.push(svg("text", { class: "tick", ...attributes }));
      words.at(-1).textContent = text;
    };
    for (let e = Math.ceil((east - width / 2 / scale) / step) * step; x(e) < width; e += step) {
      parts.push(svg("path", { class: "grid", d: `M${x(e)} 0V${height}` }));
      if (x(e) > 60 && x(e) < width - 90) word(Math.round(lengthOf(e)), { x: x(e), y: height - 6, "text-anchor": "middle" });
    }
    for (let n = Math.ceil((north - height / 2 / scale) / step) * step; y(n) > 0; n += step) {
      parts.push(svg("path", { class: "grid", d: `M0 ${y(n)}H${width}` }));
      if (y(n) > 40 && y(n) < height - 24) word(Math.round(lengthOf(n)), { x: 6, y: y(n) + 4 });
    }
    this.drawScale(width, height, scale, words, word);
    word(`east, ${lengthUnit()}`, { x: width - 8, y: height - 6, "text-anchor": "end" });
    word(`north, ${lengthUnit()}`, { x: 6, y: 16 });
    this.grid.replaceChildren(...parts);
    this.scales.replaceChildren(...words);
  }

  // The scale bar, of a round length, and the north arrow.
  drawScale(width, height, scale, words, word) {
    const [size, text] = roundLength(SCALE_PX / scale);
    const [right, below] = [width - 14, height - 44];
    words.push(svg("path", { class: "scale", d: `M${right - size * scale} ${below - 5}v5H${right}v-5` }));
    word(text, { x: right, y: below - 8, "text-anchor": "end" });
    words.push(svg("path", { class: "north", d: `M${width - 22} 34l6 -18l6 18l-6 -5Z` }));
    word("N", { x: width - 16, y: 48, "text-anchor": "middle" });
  }
}
