// The page: takes the flight's stream, shows it, and sends the buttons back.

import { AlarmList } from "./alarms.js";
import { Fleet } from "./fleet.js";
import { FlightMap } from "./map.js";
import { Plots } from "./plots.js";
import { ReplayBar } from "./replay.js";
import { CHOICES, choose, configure, display, length, lengthOf, lengthUnit, metresOfLength, next, position, speed, timeOfDay } from "./units.js";
import { showWatch } from "./watch.js";

const byId = (id) => document.getElementById(id);
const degrees = (radians) => Math.round(((radians * 180) / Math.PI + 360) % 360);
const LOG_KEPT = 300;
const SILENT_MS = 2000;
const ANSWER_MS = { accepted: 12000, refused: 60000 };
const NO_ANSWER_MS = 120000;
const CHANGES = { radius_m: "radius", range_min_m: "least range", range_max_m: "greatest range", height_m: "height", side: "side" };
const IN_HAND = new Set(["watching", "holding"]);
const PHASE_LOOKS = { watching: "good", holding: "warn", yielded: "bad", ended: "bad" };
const QUALITY_LOOKS = { good: "good", coasting: "warn", lost: "bad" };

const map = new FlightMap(byId("map"), byId("follow"), byId("measure"), byId("cursor"));
const plots = new Plots(byId("plots"), byId("inner-plots"));
const alarms = new AlarmList(byId("alarms"), byId("mute"), (body) => press(body));
const fleet = new Fleet(byId("fleet"), () => { state = fleet.take(fleet.states); draw(); });
const bar = new ReplayBar(byId("replay"), (body) => press(body));
let state = null;
let startS = 0;
let heardAt = performance.now();
let over = false;
let refusal = ""; // why the server sends this page no states
let drawn = true;
let answered = 0;
let pending = null; // the unanswered request: {text, since}

// from: when watching began, on the clock of that aircraft.
function clock(timeS, from = startS) {
  const since = Math.max(0, timeS - from);
  return `${Math.floor(since / 60)}:${String(Math.floor(since % 60)).padStart(2, "0")}`;
}

// -- data from the flight ------------------------------------------------------------------------------------

function receive(update) {
  heardAt = performance.now();
  if (update.restart) {
    map.forget();
    plots.forget();
    byId("log").replaceChildren();
  }
  if (update.start_s !== null) startS = update.start_s;
  if (update.setting?.band_m) set(update.setting);
  if (update.replay) bar.show(update.replay);
  map.addTrail(update.trail);
  for (const sample of update.series ?? []) map.addTarget(sample);
  plots.add(update.series ?? []);
  for (const [timeS, kind, text] of update.announcements) {
    say(timeS, kind, text);
    if (["operator", "refused"].includes(kind) && !update.restart) answer(text);
  }
  if (update.state) state = update.state;
  if (update.fleet) state = fleet.take(update.fleet) ?? state;
  over ||= update.over ?? false;
  if (drawn) {
    drawn = false;
    requestAnimationFrame(draw);
  }
}

function set(setting) {
  map.setting = plots.setting = setting;
  configure(setting.display);
  showDisplay();
  map.drawFixed();
  byId("legend").querySelector(".route").hidden = !setting.routes.length;
  byId("legend").querySelector(".fence").hidden = !(setting.keep_in.length + setting.keep_out.length);
  byId("name").textContent = byId("name").title = setting.name;
  byId("buttons").hidden = byId("mute").hidden = Boolean(setting.replay);
  if (setting.replay) {
    bar.set(setting.replay, startS);
    document.title = "sidelong: replay";
  }
}

function say(timeS, kind, text) {
  const line = document.createElement("li");
  line.className = kind;
  const time = document.createElement("time");
  time.textContent = timeS === null ? "" : clock(timeS);
  line.append(time, text);
  byId("log").prepend(line);
  while (byId("log").childElementCount > LOG_KEPT) byId("log").lastChild.remove();
}

// The result of the operator's last request. A new request replaces the answer to an older one at once.
function answer(text) {
  pending = null;
  const look = /refused|not passed on/.test(text) ? "refused" : "accepted";
  showAnswer(text, look);
  clearTimeout(answered);
  answered = setTimeout(() => { byId("answer").hidden = true; }, ANSWER_MS[look]);
}

function showAnswer(text, look) {
  byId("answer").hidden = false;
  byId("answer").className = look;
  byId("answer").textContent = text;
}

function wait(text) {
  clearTimeout(answered);
  pending = { text, since: performance.now() };
  showPending();
}

function showPending() {
  if (!pending) return;
  const waited = performance.now() - pending.since;
  const seconds = Math.round(waited / 1000);
  if (waited > NO_ANSWER_MS) answer(`${pending.text}: not passed on, no answer for ${seconds} s`);
  else showAnswer(`${pending.text}: pending${seconds > 1 ? `, ${seconds} s` : ""}`, "pending");
}

// -- display -------------------------------------------------------------------------------------------------

function chip(id, text, look) {
  const element = byId(id);
  element.hidden = !text;
  element.textContent = text;
  element.className = `chip ${look}`;
}

const known = (value, text) => (value === null || value === undefined ? "–" : text(value));

// The course of a stationary target is meaningless.
const moves = (target) => target && Math.hypot(...target.velocity_m_s) >= 0.2;

const share = (value) => known(value, (v) => `${Math.round(100 * v)} %`);

// [name, text, style] of the most important readings.
function keyTiles() {
  const { target, vehicle } = state;
  const look = (good) => (good === false ? "bad" : "");
  return [
    ["range", known(target?.range_m, (v) => length(v)), look(target?.in_band)],
    ["off abeam", known(target?.angle_rad, (v) => `${Math.round((v * 180) / Math.PI)}°`), look(target?.on_side)],
    ["time on side", share(state.share_on_side), ""],
    ["time in band", share(state.share_in_band), ""],
    ["battery", known(vehicle?.battery_percent, (v) => `${v} %`), vehicle?.battery_percent < 25 ? "bad" : ""],
    ["must leave in", leaves(vehicle), leaves(vehicle) === "now" ? "bad" : ""],
    ...progress(state),
  ];
}

// The target's progress along its route, if it has one.
function progress({ route }) {
  if (!route) return [];
  if (!route.on) return [["route", "off route", "warn"]];
  const end = route.to_end_s !== null ? `, ${duration(route.to_end_s)} to go` : "";
  const unused = route.of_use ? "" : ", not used";
  return [["route", `${lengthOf(route.along_m).toFixed()} of ${length(route.length_m)}${end}${unused}`, unused && "warn"]];
}

const duration = (s) => (s < 90 ? `${s} s` : s < 3600 ? `${Math.round(s / 60)} min` : `${(s / 3600).toFixed(1)} h`);

// Time until 120 % of the energy for the flight home is left.
function leaves(vehicle) {
  if (!vehicle || vehicle.endurance_s === null || vehicle.home_s === null) return "–";
  const left = vehicle.endurance_s - 1.2 * vehicle.home_s;
  return left <= 0 ? "now" : duration(left);
}

// The other readings.
function tiles() {
  const { target, aircraft, vehicle } = state;
  return [
    ["target's speed", target ? speed(Math.hypot(...target.velocity_m_s)) : "–", ""],
    ["target's course", moves(target) ? known(target.course_rad, (v) => `${degrees(v)}°`) : "–", ""],
    ["course made good", known(target?.watch_course_rad, (v) => `${degrees(v)}°`), ""],
    ["known within", target ? length(target.ellipse[0], 1) : "–", ""],
    ["ground speed", aircraft ? speed(aircraft.ground_speed_m_s) : "–", ""],
    ["height", known(aircraft?.height_m, (v) => length(v)), ""],
    ["wind", speed(Math.hypot(...state.wind_m_s)), ""],
    ...(vehicle ? [
      ["voltage", known(vehicle.battery_v, (v) => `${v.toFixed(1)}\u00a0V`), ""],
      ["GPS", known(vehicle.gps, (v) => v), vehicle.gps_good === false ? "bad" : ""],
      ["link", known(vehicle.link_percent, (v) => `${v} %${delay(vehicle.round_trip_s)}`), vehicle.link_percent < 80 ? "warn" : ""],
    ] : []), // not known in a replay
  ];
}

// No line break between a number and its unit.
const delay = (seconds) => (seconds === null ? "" : `, ${Math.round(seconds * 1000)}\u00a0ms`);

// Further readings for engineers.
function innerTiles() {
  return [
    ["plan changes", state.moves, ""],
    ["uploads", state.upload_failures ? `${state.uploads}, ${state.upload_failures} failed` : state.uploads, ""],
    ["sightings", `${state.sightings}, ${state.rejected} refused`, ""],
    ["upload takes", known(state.latency_s, (v) => `${v.toFixed(2)} s`), ""],
    ["NIS", known(state.nis, (v) => v.toFixed(1)), state.nis > 7.81 ? "warn" : ""],
    ["95 % within", state.target ? length(state.target.ellipse[0], 1) : "–", ""],
  ];
}

function lay(list, entries) {
  list.replaceChildren(...entries.map(([name, text, look]) => {
    const tile = document.createElement("div");
    const [dt, dd] = ["dt", "dd"].map((kind) => document.createElement(kind));
    dt.textContent = name;
    dd.textContent = text;
    dd.className = look;
    tile.append(dt, dd);
    return tile;
  }));
}

function ago(seconds) {
  if (seconds < 2) return "now";
  return seconds < 90 ? `${Math.round(seconds)} s ago` : `${Math.round(seconds / 60)} min ago`;
}

// When the target was seen last, in words.
function seen() {
  const target = state.target;
  const unseen = target?.unseen_s;
  const line = byId("seen");
  if (!state.connected) {
    line.textContent = "No message of the aircraft; all below is from its last message.";
    line.className = "bad";
    return;
  }
  line.textContent = !target ? "The target has not been seen yet."
    : unseen < 2 ? "The target is in sight."
      : `The target was last seen ${ago(unseen)}.`;
  line.className = !target || unseen < 8 ? "" : unseen < 60 ? "warn" : "bad";
}

function places() {
  for (const button of document.querySelectorAll(".place")) {
    const at = state[button.dataset.of]?.at_deg;
    button.disabled = !at;
    button.value = at ? position(at) : "";
    button.textContent = `${called(button.dataset.of)} ${button.value || "–"}`;
  }
}

// The names of the aircraft and the target, if there are several.
const called = (what) => (what === "aircraft" ? state.name : state.target?.name) || what;

// The result of the end of the mission, and how to continue.
function ended() {
  const line = byId("over");
  const next = {
    yielded: "You fly the aircraft; sidelong commands nothing. Press Resume to let it watch on: the vehicle is checked again first.",
    ended: "Nothing more is commanded; start launch again to watch on.",
  }[state.phase];
  line.hidden = !next;
  line.textContent = next ? `The mission has ${state.phase}${state.over ? `: ${state.over}` : ""}. ${next}` : "";
}

function draw() {
  drawn = true;
  if (!state) return;
  map.state = state;
  map.draw();
  plots.draw(state.name);
  fleet.draw();
  byId("whose").hidden = !state.name;
  byId("whose").textContent = state.name;
  const lost = state.phase === "watching" && (!state.connected || state.target?.quality === "lost");
  chip("phase", state.phase, lost ? "bad" : PHASE_LOOKS[state.phase] ?? "");
  chip("quality", state.target ? `track ${state.target.quality}` : "no target yet", QUALITY_LOOKS[state.target?.quality] ?? "");
  chip("link", state.connected ? "" : "link lost", "bad");
  chip("inputs", (state.inputs ?? []).join(", "), "warn");
  byId("clock").textContent = state.time_s === null || state.phase === "waiting" ? "" : clock(state.time_s, state.start_s ?? startS);
  byId("quality").title = state.target?.why ?? "";
  byId("phase").title = state.reason;
  chip("mode", state.mode ? `mode ${state.mode}` : "", "");
  alarms.show(over ? [] : state.alarms ?? []);
  ended();
  showWatch(byId("band"), byId("side"), state, map.setting);
  lay(byId("key-tiles"), keyTiles());
  lay(byId("tiles"), tiles());
  lay(byId("inner-tiles"), innerTiles());
  seen();
  places();
  byId("legend").querySelector("li.what-if").hidden = !state.what_if;
  buttons();
}

function buttons() {
  for (const button of document.querySelectorAll("button[data-action]")) {
    const { action, name } = button.dataset;
    const phase = (name ? fleet.states.find((one) => one.name === name) : state)?.phase;
    const inHand = IN_HAND.has(phase) && !over;
    const apt = (action !== "hold" || phase === "watching") && (action !== "resume" || ["holding", "yielded"].includes(phase));
    const resumes = action === "resume" && phase === "yielded" && !over;
    button.disabled = !((inHand || resumes) && apt);
    button.title = inHand || resumes ? "" : `refused: the mission is ${over ? "over" : phase ?? "not begun"}`;
  }
}

setInterval(() => {
  showPending();
  byId("day").hidden = Boolean(map.setting.replay);
  byId("day").textContent = timeOfDay(new Date());
  const silent = performance.now() - heardAt;
  const news = byId("news");
  news.hidden = !over && !refusal && silent < SILENT_MS;
  news.textContent = over
    ? "The flight's program has ended; this is how things stood last. Reload the page for another flight."
    : refusal ? `Nothing is shown here: ${refusal}.`
    : `No message from the flight's program for ${Math.round(silent / 1000)} s; what is shown is old.`;
  if (over) buttons();
}, 250);

// -- buttons -------------------------------------------------------------------------------------------------

function asked(question) {
  const dialog = byId("ask");
  dialog.querySelector("p").textContent = question;
  dialog.returnValue = "no";
  dialog.showModal();
  return new Promise((answer) => {
    dialog.addEventListener("close", () => answer(dialog.returnValue === "yes"), { once: true });
  });
}

// The changed fields of the form, by name; null if unchanged.
function changed() {
  const dialog = byId("change");
  const form = dialog.querySelector("form");
  const before = {};
  for (const name of Object.keys(CHANGES)) {
    const field = form.elements[name];
    const value = state.asked[name];
    before[name] = field.value = name === "side" ? value : String(Number(lengthOf(value).toFixed(1)));
    if (name === "side") continue;
    const [least, most] = map.setting.limits[name];
    // A limit that is rounded inwards is never refused afterwards.
    Object.assign(field, { min: Math.ceil(10 * lengthOf(least)) / 10, max: Math.floor(10 * lengthOf(most)) / 10 });
  }
  for (const unit of form.querySelectorAll(".unit")) unit.textContent = lengthUnit();
  dialog.returnValue = "no";
  dialog.showModal();
  return new Promise((done) => {
    dialog.addEventListener("close", () => {
      const typed = (name) => form.elements[name].value;
      const given = (name) => (name === "side" ? typed(name) : Number(metresOfLength(Number(typed(name))).toFixed(3)));
      const names = Object.keys(CHANGES).filter((name) => typed(name) !== before[name]);
      const values = Object.fromEntries(names.map((name) => [name, given(name)]));
      done(dialog.returnValue === "yes" && names.length ? values : null);
    }, { once: true });
  });
}

byId("change").querySelector("button[value=no]").addEventListener("click", () => byId("change").close("no"));

function described(values) {
  const unit = (value) => (typeof value === "number" ? `${Number(lengthOf(value).toFixed(1))} ${lengthUnit()}` : value);
  return Object.entries(values).map(([name, value]) => `${CHANGES[name]} ${unit(value)} instead of ${unit(state.asked[name])}`);
}

const ANSWERED = new Set(["hold", "resume", "side", "change", "end", "relieve"]);

async function press(body) {
  if (ANSWERED.has(body.action)) wait(requested(body));
  const headers = { "Content-Type": "application/json" };
  const got = await fetch("press", { method: "POST", headers, body: JSON.stringify(body) });
  if (!got.ok) answer(`${body.action} was not passed on: ${await got.text()}`);
}

// A request in words.
function requested({ action, side, values, name }) {
  if (action === "change") return described(values).join(", ");
  return { side: `watch from the ${side}`, relieve: `relieve ${name}` }[action] ?? action;
}

async function commanded({ target: button }) {
  const { action, ask, name } = button.dataset;
  if (!action) return;
  if (action === "change") {
    const values = await changed();
    if (values && (await asked(`Change ${described(values).join(", ")}?`))) press({ action, values });
    return;
  }
  const side = action !== "side" ? null : (state.wanted ?? state.side) === "left" ? "right" : "left";
  const question = side ? `Watch from the target's ${side} instead?` : ask;
  if (!(await asked(question))) return;
  press(name ? { action, name } : { action, side });
}
for (const id of ["buttons", "fleet"]) byId(id).addEventListener("click", commanded);

// -- units, positions, keys -----------------------------------------------------------------------------------

function showDisplay() {
  for (const select of byId("help").querySelectorAll("select")) select.value = display[select.name];
  map.drawFixed();
  draw();
}

for (const select of byId("help").querySelectorAll("select")) {
  select.append(...Object.entries(CHOICES[select.name]).map(([value, text]) => new Option(text, value)));
  select.addEventListener("change", () => { choose(select.name, select.value); showDisplay(); });
}
byId("help-button").addEventListener("click", () => byId("help").showModal());

// Keys of buttons do what the button does: those of the mission ask first.
const click = (selector) => { const button = document.querySelector(selector); if (button && !button.disabled && !button.closest("[hidden]")) button.click(); };
const KEYS = {
  h: () => click("[data-action=hold]"), r: () => click("[data-action=resume]"), s: () => click("[data-action=side]"),
  c: () => click("[data-action=change]"), a: () => click("#alarms button.seen:not([hidden])"), m: () => click("#mute"),
  d: () => click("#measure"), n: () => fleet.next(), f: () => map.follow(), "+": () => map.zoomAt([0, 0], 1.3), "-": () => map.zoomAt([0, 0], 1 / 1.3),
  u: () => { next("units"); showDisplay(); }, p: () => { next("coordinates"); showDisplay(); },
  t: () => { next("times"); showDisplay(); }, "?": () => byId("help").showModal(),
};
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey || event.repeat || event.defaultPrevented) return;
  if (byId("ask").open) {
    if (event.key === "y" || event.key === "n") byId("ask").close(event.key === "y" ? "yes" : "no");
    return;
  }
  if (document.querySelector("dialog[open]") || event.target.closest("input, select")) return;
  if (!Object.hasOwn(KEYS, event.key)) return;
  event.preventDefault();
  KEYS[event.key]();
});

byId("places").addEventListener("click", async ({ target: button }) => {
  if (!button.value) return;
  await navigator.clipboard.writeText(button.value);
  button.textContent = `${called(button.dataset.of)}: copied`;
});

new ResizeObserver(() => plots.draw(state?.name)).observe(byId("plots"));
byId("engineers").addEventListener("toggle", () => plots.draw(state?.name));

buttons();
const stream = new EventSource("events");
stream.onmessage = (event) => receive(JSON.parse(event.data));
stream.onerror = async () => {
  if (over) stream.close(); // the server has ended: do not reconnect
  else if (stream.readyState === EventSource.CLOSED) { // refused: a stream does not say why
    const answer = await fetch("events");
    if (answer.ok) location.reload();
    else refusal = await answer.text();
  }
};
