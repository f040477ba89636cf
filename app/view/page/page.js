// The page: asks for what is new, shows it with its age, and sends the buttons back.

import { AlarmList } from "./alarms.js";
import { CameraView } from "./camera.js";
import { Fleet } from "./fleet.js";
import { FlightMap } from "./map.js";
import { Plots } from "./plots.js";
import { ReplayBar } from "./replay.js";
import { CHOICES, choose, configure, display, length, lengthOf, lengthUnit, metresOfLength, next, position, speed, timeOfDay } from "./units.js";
import { showWatch } from "./watch.js";

const byId = (id) => document.getElementById(id);
const degrees = (radians) => Math.round(((radians * 180) / Math.PI + 360) % 360);
const LOG_KEPT = 300;
const OLD_S = 2.5; // data of that age is shown in grey: nothing older than 3 s is green, and a busy browser is late
const AGAIN_MS = 1500;
const GIVEN_UP_MS = 40000;
const ANSWER_MS = { accepted: 12000, refused: 60000 };
const NO_ANSWER_MS = 120000;
const CHANGES = { radius_m: "radius", range_min_m: "least range", range_max_m: "greatest range", height_m: "height", side: "side" };
const ANSWERS_KEPT = 6;
const ALL = { hold: "Hold all", resume: "Resume all", end: "End all" };
const IN_HAND = new Set(["watching", "holding"]);
const PHASE_LOOKS = { watching: "good", holding: "warn", yielded: "bad", ended: "bad" };
const QUALITY_LOOKS = { good: "good", coasting: "warn", lost: "bad" };

const map = new FlightMap(byId("map"), byId("follow"), byId("measure"), byId("cursor"));
const plots = new Plots(byId("plots"), byId("inner-plots"));
const alarms = new AlarmList(byId("alarms"), byId("mute"), (body) => press(body));
const fleet = new Fleet(byId("fleet"), () => { state = fleet.take(fleet.states); draw(); });
const bar = new ReplayBar(byId("replay"), (body) => press(body));
const camera = new CameraView(byId("camera"), (body) => press(body));
let state = null;
let startS = 0;
let stage = { name: "connecting", text: "" }; // where the program stands before, between and after flights
let have = ""; // what the server knows this page to have
let took = null; // the exchange that brought what is shown: when it was sent, and ages in it
let over = false; // the program has ended
let refusal = ""; // why the server sends this page no states
let wasOld = false;
let drawn = true;
let answered = 0;
let answers = [];
let pending = null; // the unanswered request: {text, since}

const minutes = (s) => `${Math.floor(s / 60)}:${String(Math.floor(s % 60)).padStart(2, "0")}`;

// from: when watching began, on the clock of that aircraft.
const clock = (timeS, from = startS) => minutes(Math.max(0, timeS - from));

// Both clocks: one of them may stand still while the computer sleeps.
const now = () => [performance.now(), Date.now()];
const sinceS = (then) => Math.max(performance.now() - then[0], Date.now() - then[1]) / 1000;

// How old what is shown is at most, s: since the program sent it, and since the aircraft did. The whole exchange counts,
// but not the time for which the server had nothing new.
const exchangeS = () => (took ? took.ageS + Math.max(0, sinceS(took.sent) - took.heldS) : 0);
const ageS = () => exchangeS() + Math.max(0, state?.link_age_s ?? 0);
const flying = () => stage.name === "flying";
const live = () => !map.setting.replay;
const isOld = () => live() && (over || !flying() || ageS() > OLD_S);

// -- data from the flight ------------------------------------------------------------------------------------

async function ask() {
  const sent = now();
  try {
    const got = await fetch(`state?have=${have}`, { signal: AbortSignal.timeout(GIVEN_UP_MS) });
    if (!got.ok) {
      refusal = await got.text();
      return false;
    }
    const update = await got.json();
    [refusal, have] = ["", update.at];
    took = { sent, ageS: update.age_s, heldS: update.held_s };
    receive(update);
    return !over;
  } catch (error) {
    if (!(error instanceof TypeError || error.name === "TimeoutError" || error.name === "AbortError")) throw error;
    return false; // the line or the program is down: the age is shown
  }
}

// One request at a time: a slow line drops states, and another program at this address is shown when it comes.
async function follow() {
  for (;;) {
    if (!(await ask())) await new Promise((done) => { setTimeout(done, AGAIN_MS); });
  }
}

function receive(update) {
  if (update.restart) {
    map.forget();
    plots.forget();
    byId("log").replaceChildren();
    state = null;
  }
  over = update.over ?? false;
  if (update.stage) stage = { ...update.stage, since: now() };
  else if (update.replay) stage = { name: "flying", text: "" };
  if (update.start_s !== null && update.start_s !== undefined) startS = update.start_s;
  if (update.setting?.band_m) set(update.setting);
  if (update.replay) bar.show(update.replay);
  map.addTrail(update.trail);
  for (const sample of update.series) map.addTarget(sample);
  plots.add(update.series);
  for (const [timeS, kind, text] of update.announcements) {
    say(timeS, kind, text);
    if (["operator", "refused"].includes(kind) && !update.restart) answer(text);
  }
  if (update.state) state = update.state;
  if (update.fleet) state = fleet.take(update.fleet) ?? state;
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
  byId("legend").querySelector(".rally").hidden = !setting.rally?.length;
  byId("name").textContent = byId("name").title = setting.name;
  byId("buttons").hidden = byId("mute").hidden = Boolean(setting.replay);
  for (const button of byId("buttons").querySelectorAll("button")) button.textContent = setting.fleet ? ALL[button.dataset.action] ?? button.textContent : button.textContent;
  camera.set(setting.camera, !setting.replay);
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

// The result of the operator's last request, of each aircraft. A new request replaces the answers to an older one.
function answer(text) {
  if (pending) answers = [];
  pending = null;
  answers = [...answers, text].slice(-ANSWERS_KEPT);
  const look = answers.some((one) => /refused|not passed on/.test(one)) ? "refused" : "accepted";
  showAnswer(answers.join("\n"), look);
  clearTimeout(answered);
  answered = setTimeout(() => { byId("answer").hidden = true; answers = []; }, ANSWER_MS[look]);
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
  const { vehicle } = state;
  return [
    ["time on side", share(state.share_on_side), ""],
    ["time in band", share(state.share_in_band), ""],
    ["battery", known(vehicle?.battery_percent, (v) => `${v} %`), vehicle?.battery_percent < 25 ? "bad" : ""],
    ["fly home in", leaves(vehicle), leaves(vehicle) === "now" ? "bad" : ""],
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
  const { target, vehicle } = state;
  return [
    ["target's speed", target ? speed(Math.hypot(...target.velocity_m_s)) : "–", ""],
    ["target's course", moves(target) ? known(target.course_rad, (v) => `${degrees(v)}°`) : "–", ""],
    ["course made good", known(target?.watch_course_rad, (v) => `${degrees(v)}°`), ""],
    ["known within", target ? length(target.ellipse[0], 1) : "–", ""],
    ...(vehicle ? [
      ["voltage", known(vehicle.battery_v, (v) => `${v.toFixed(1)}\u00a0V`), ""],
      ["GPS", known(vehicle.gps, (v) => v), vehicle.gps_good === false ? "bad" : ""],
      ["link", known(vehicle.link_percent, (v) => `${v} %${delay(vehicle.round_trip_s)}`), vehicle.link_percent < 80 ? "warn" : ""],
    ] : []), // not known in a replay
  ];
}

// No line break between a number and its unit.
const delay = (seconds) => (seconds === null ? "" : `, ${Math.round(seconds * 1000)}\u00a0ms`);

// What a pilot looks at first, above the map.
function flightRow() {
  const { aircraft, coming, wind_m_s: [east, north] } = state;
  const bank = aircraft?.bank_rad;
  const from = degrees(Math.atan2(-east, -north));
  return [
    ["height", known(aircraft?.height_m, (v) => length(v)), ""],
    ["ground speed", aircraft ? speed(aircraft.ground_speed_m_s) : "–", ""],
    ["course", aircraft ? `${String(degrees(aircraft.course_rad)).padStart(3, "0")}°` : "–", ""],
    ["bank", known(bank, (v) => `${Math.abs(Math.round((v * 180) / Math.PI))}° ${v < 0 ? "left" : "right"}`), ""],
    ["wind", Math.hypot(east, north) < 0.5 ? "calm" : `${speed(Math.hypot(east, north))} from ${String(from).padStart(3, "0")}°`, ""],
    ["next circle", coming ? `in ${minutes(Math.max(0, coming.in_s ?? 0))}` : "none planned", ""],
  ];
}

// An artificial horizon: the ground turns with the bank and moves with the pitch; the aircraft stands.
function horizon() {
  const { bank_rad: bank, pitch_rad: pitch } = state.aircraft ?? {};
  const known = typeof bank === "number" && !isOld();
  byId("horizon").toggleAttribute("hidden", !known);
  if (!known) return;
  const [roll, nose] = [bank, pitch].map((v) => (v * 180) / Math.PI);
  byId("ground").setAttribute("transform", `rotate(${(-roll).toFixed(1)}) translate(0 ${Math.max(-20, Math.min(20, nose)).toFixed(1)})`);
  byId("horizon").setAttribute("aria-label", `Attitude: bank ${Math.abs(Math.round(roll))}° ${roll < 0 ? "left" : "right"}, nose ${Math.round(nose)}°`);
}

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
  const look = (text, kind = "") => { [line.textContent, line.className] = [text, kind]; };
  if (isOld()) look(`All below is from ${state.time_s === null ? "the last message" : clock(state.time_s, state.start_s ?? startS)}.`);
  else if (!state.connected) look("No message of the aircraft; all below is from its last message.", "bad");
  else if (!target) look("The target has not been seen yet.");
  else if (unseen < 2) look(target.stands ? "The target is in sight. It stands, so it has no left and no right: the aircraft keeps its range until it moves." : "The target is in sight.");
  else look(`The target was last seen ${ago(unseen)}.`, unseen < 8 ? "" : unseen < 60 ? "warn" : "bad");
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

// -- before, between and after flights: where the program stands, and what to do ---------------------------------

const TITLES = {
  connecting: "Connecting", preparing: "Preparing", waiting: "Not ready yet", ready: "Ready to watch", fault: "The last watch failed",
  "taking over": "Taking the aircraft over", ended: "The flight has ended",
};
const HINTS = {
  preparing: "Nothing is flown yet. The first start compiles for a minute or two; later starts take seconds.",
  waiting: "A watch can begin once nothing is missing.",
  ready: "Press Watch: on the ground the aircraft arms and takes off; in the air sidelong takes it over.",
  fault: "Press Watch to try again: the vehicle is checked first.",
  ended: "All that is shown is from the end of the flight.",
};

function lines(list, texts, kind = "li") {
  if (list.childElementCount === texts.length && texts.every((text, k) => list.children[k].textContent === text)) return;
  list.replaceChildren(...texts.map((text) => Object.assign(document.createElement(kind), { textContent: text })));
}

function showStage() {
  const ended = over && stage.name !== "ended" ? { name: "ended", text: "The program has ended; this is how things stood last." } : stage;
  const { name, text, checks = [], summary = [], next = [], last = "" } = ended;
  const card = byId("stage");
  card.hidden = !live() || name === "flying";
  if (card.hidden) return;
  const find = (selector) => card.querySelector(selector);
  const waits = ["preparing", "taking over"].includes(name) && stage.since ? `, ${minutes(stage.for_s + sinceS(stage.since))}` : "";
  find("h2").textContent = `${TITLES[name] ?? name}${waits}`;
  find("#stage-text").textContent = text;
  const share = name === "preparing" ? /(\d+) %/.exec(text)?.[1] : undefined;
  find("progress").hidden = name !== "preparing";
  if (share === undefined) find("progress").removeAttribute("value");
  else find("progress").value = share;
  lines(find("#checks"), checks.map(([what, ready, found]) => `${ready ? "✓" : "✗"} ${what}: ${found}`));
  find("#checks").querySelectorAll("li").forEach((line, k) => { line.className = checks[k][1] ? "good" : "bad"; });
  lay(find("#summary"), summary.map(([what, value]) => [what, value, ""]));
  lines(find("#next"), next, "code");
  find("#stage-last").textContent = last;
  find("#stage-hint").textContent = HINTS[name] ?? "";
}

const NEXT = {
  yielded: "You fly the aircraft; sidelong commands nothing. Press Resume to let it watch on: the vehicle is checked again first.",
  holding: "You hold this circle: it is not relocated until you press Resume.",
};

function explainPhase() {
  const line = byId("over");
  const next = flying() && !over && live() ? NEXT[state.phase] : "";
  line.hidden = !next;
  line.className = state.phase === "yielded" ? "bad" : "";
  line.textContent = next ? `${state.over ? `The mission has ${state.phase}: ${state.over}. ` : ""}${next}` : "";
}

function draw() {
  drawn = true;
  const old = wasOld = isOld();
  document.body.classList.toggle("old", old);
  showStage();
  const phase = flying() && !over ? state?.phase ?? "connecting" : over ? "ended" : stage.name;
  const poor = old || !state?.connected || state.target?.quality === "lost";
  chip("phase", phase, flying() && !over && !(phase === "watching" && poor) ? PHASE_LOOKS[phase] ?? "" : "");
  buttons();
  alarms.show(flying() && !over ? state?.alarms ?? [] : []);
  for (const id of ["now", "key-tiles", "where-places"]) byId(id)?.toggleAttribute("hidden", !state);
  if (!state) return;
  map.state = state;
  map.draw();
  plots.draw(state);
  fleet.draw(old);
  byId("whose").hidden = !state.name;
  byId("whose").textContent = state.name;
  const quality = state.target ? (old ? "" : `track ${state.target.quality}`) : "no target yet";
  chip("quality", quality, QUALITY_LOOKS[state.target?.quality] ?? "");
  chip("link", state.connected || old ? "" : "link lost", "bad");
  chip("inputs", old ? "" : (state.inputs ?? []).join(", "), "warn");
  const lead = fleet.states[0] ?? state;
  byId("clock").textContent = lead.time_s === null || lead.phase === "waiting" ? "" : `watched ${clock(lead.time_s, lead.start_s ?? startS)}`;
  byId("quality").title = state.target?.why ?? "";
  byId("phase").title = state.reason;
  chip("mode", state.mode && !old ? `mode ${state.mode}` : "", "");
  explainPhase();
  showWatch(byId("band"), byId("side"), state, map.setting, old);
  lay(byId("now"), flightRow());
  horizon();
  byId("reason").textContent = state.reason ? `Last decision: ${state.reason}` : "";
  lay(byId("key-tiles"), keyTiles());
  lay(byId("tiles"), tiles());
  lay(byId("inner-tiles"), innerTiles());
  seen();
  places();
  byId("legend").querySelector("li.what-if").hidden = !state.what_if;
}

const ofFleet = () => (fleet.states.length ? fleet.states : [state]);

// Whether one of the aircraft takes this action now.
function apt(action, name) {
  if (over) return false;
  if (action === "watch") return ["ready", "fault"].includes(stage.name);
  if (action === "release") return flying() || stage.name === "taking over";
  if (!flying()) return false;
  return ofFleet().some((one) => (!name || one?.name === name) && takes(action, one?.phase));
}

const takes = (action, phase) => (action === "hold" ? phase === "watching"
  : action === "resume" ? ["holding", "yielded"].includes(phase) : IN_HAND.has(phase));

function buttons() {
  for (const button of document.querySelectorAll("button[data-action]")) {
    const { action, name } = button.dataset;
    if (["watch", "release"].includes(action)) button.hidden = !stage.service;
    if (action === "end") button.hidden = Boolean(stage.service);
    button.disabled = !apt(action, name);
    const phase = ofFleet().find((one) => !name || one?.name === name)?.phase;
    button.title = button.disabled ? `refused: the mission is ${over ? "over" : flying() ? phase : stage.name}` : "";
  }
}

setInterval(() => {
  showPending();
  byId("day").hidden = !live() || over || stage.name === "ended";
  byId("day").textContent = timeOfDay(new Date());
  const news = byId("news");
  const old = flying() && exchangeS() > OLD_S;
  news.hidden = !refusal && !(took && old && !over && live());
  news.textContent = refusal ? `Nothing is shown here: ${refusal}.`
    : `No news from sidelong for ${minutes(exchangeS())}: the line is slow, or the program has stopped. What is shown in grey is old.`;
  if (isOld() !== wasOld || stage.name !== "flying") draw();
}, 250);

// -- buttons -------------------------------------------------------------------------------------------------

function asked(question) {
  const dialog = byId("ask");
  const old = flying() && ageS() > OLD_S ? ` What is shown is ${minutes(ageS())} old: the aircraft may be elsewhere.` : "";
  dialog.querySelector("p").textContent = question + old;
  dialog.returnValue = "no";
  dialog.showModal();
  return new Promise((answer) => {
    dialog.addEventListener("close", () => answer(dialog.returnValue === "yes"), { once: true });
  });
}

const numeral = (text) => Number(text.trim().replace(",", "."));

// What is wrong with a typed number; '' if nothing is.
function fault(form, name) {
  const value = numeral(form.elements[name].value);
  const [least, most] = [form.elements[name].min, form.elements[name].max].map(Number);
  if (!(value >= least && value <= most)) return `A number from ${least} to ${most}.`;
  const [from, to] = ["range_min_m", "range_max_m"].map((one) => numeral(form.elements[one].value));
  return name === "range_max_m" && from >= to ? "The greatest range must be above the least one." : "";
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
  form.oninput = () => { for (const field of form.querySelectorAll("[inputmode]")) field.setCustomValidity(fault(form, field.name)); };
  form.oninput();
  for (const unit of form.querySelectorAll(".unit")) unit.textContent = lengthUnit();
  dialog.returnValue = "no";
  dialog.showModal();
  return new Promise((done) => {
    dialog.addEventListener("close", () => {
      const typed = (name) => form.elements[name].value;
      const given = (name) => (name === "side" ? typed(name) : Number(metresOfLength(numeral(typed(name))).toFixed(3)));
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

const ANSWERED = new Set(["hold", "resume", "side", "change", "end", "relieve", "watch", "release", "confirm"]);

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

// Which aircraft of a fleet an action is for, and which of them will refuse it.
function whom(action) {
  if (!fleet.states.length) return "";
  if (action === "side") return " The fleet's coordinator assigns it.";
  const refusing = fleet.states.filter((one) => !takes(action, one.phase)).map((one) => `${one.name} is ${one.phase} and refuses it`);
  return ` This is for ${fleet.states.map((one) => one.name).join(" and ")}.${refusing.length ? ` ${refusing.join("; ")}.` : ""}`;
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
  const question = `${side ? `Watch from the target's ${side} instead?` : ask}${name ? "" : whom(action)}`;
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

new ResizeObserver(() => plots.draw(state ?? {})).observe(byId("plots"));
byId("engineers").addEventListener("toggle", () => plots.draw(state ?? {}));

draw();
follow();
