// The aircraft of a fleet: a row for each, and which of them the rest of the page shows.

import { length } from "./units.js";

const COLUMNS = ["Aircraft", "State", "Side", "Range", "Battery", "Link", "Alarms", ""];

export class Fleet {
  // changed: called after another aircraft was selected.
  constructor(root, changed) {
    this.root = root;
    this.held = root.querySelector("#held");
    this.body = root.querySelector("tbody");
    this.changed = changed;
    this.states = [];
    this.selected = "";
  }

  // Take the states of all; return the selected one, with the other aircraft and their targets next to it.
  take(states) {
    this.states = states;
    const own = states.find((one) => one.name === this.selected) ?? states[0];
    this.selected = own?.name ?? "";
    const others = states.filter((one) => one !== own);
    const targets = new Map(others.map((one) => [one.target?.name, one.target]));
    for (const name of [undefined, own?.target?.name]) targets.delete(name);
    return own && { ...own, alarms: states.flatMap((one) => one.alarms), others, targets: [...targets.values()] };
  }

  select(name) {
    this.selected = name;
    this.changed();
  }

  // Select the next aircraft.
  next() {
    if (!this.states.length) return;
    const at = this.states.findIndex((one) => one.name === this.selected);
    this.select(this.states[(at + 1) % this.states.length].name);
  }

  // old: what is shown is not of now.
  draw(old) {
    this.root.hidden = !this.states.length;
    for (const state of this.states) this.row(state);
    this.drawHeld(old);
  }

  // Rows are changed in place: a row that is made again moves away from the finger and the focus.
  row(state) {
    let row = [...this.body.children].find((one) => one.dataset.name === state.name);
    if (!row) {
      row = document.createElement("tr");
      row.dataset.name = state.name;
      COLUMNS.forEach((title, k) => {
        const cell = row.appendChild(document.createElement(k ? "td" : "th"));
        if (k) cell.dataset.title = title;
        else cell.scope = "row";
      });
      const button = row.firstChild.appendChild(document.createElement("button"));
      button.type = "button";
      button.textContent = state.name;
      button.addEventListener("click", () => this.select(state.name));
      const relieve = row.lastChild.appendChild(document.createElement("button"));
      Object.assign(relieve, { type: "button", textContent: "Relieve", ariaLabel: `Relieve ${state.name}` });
      const ask = `Relieve ${state.name}? It goes home once another has taken over.`;
      Object.assign(relieve.dataset, { action: "relieve", name: state.name, ask });
      this.body.append(row);
    }
    row.querySelector("button").setAttribute("aria-pressed", state.name === this.selected);
    cells(state).forEach(([text, look], k) => {
      const cell = row.children[k + 1];
      if (cell.textContent !== text) cell.textContent = text;
      cell.className = look;
    });
  }

  // Which aircraft hold the required side of each target.
  drawHeld(old) {
    const targets = [...new Set(this.states.map((one) => one.target?.name))].filter((name, _, all) => name || all.length === 1);
    const lines = targets.map((name) => {
      const own = this.states.filter((one) => one.target?.name === name);
      const holds = own.filter((one) => one.target?.on_side && one.target.in_band && one.side === one.wanted);
      const known = own.some((one) => typeof one.target?.on_side === "boolean");
      if (old) return [`${name ? `${name}: ` : ""}required side ${own[0].wanted}`, "unknown"];
      const held = holds.length ? `held by ${holds.map((one) => one.name).join(", ")}` : known ? "held by no aircraft" : "unknown";
      return [`${name ? `${name}: ` : ""}required side ${own[0].wanted}, ${held}`, holds.length ? "good" : known ? "bad" : "unknown"];
    });
    while (this.held.children.length < lines.length) this.held.append(document.createElement("p"));
    [...this.held.children].forEach((line, k) => {
      const [text, look] = lines[k] ?? ["", ""];
      line.hidden = !text;
      if (line.textContent !== text) line.textContent = text;
      line.className = `indicator ${look}`;
    });
  }
}

// [text, style] of a row's cells after the name.
function cells({ phase, mode, connected, target, side, vehicle, alarms, link_age_s: age }) {
  const onSide = { true: "on side", false: "off side" }[target?.on_side] ?? "unknown";
  const range = typeof target?.range_m === "number" ? length(target.range_m) : "–";
  const percent = (value) => (typeof value === "number" ? `${value} %` : "–");
  const open = alarms.filter((one) => !one.acknowledged).length;
  return [
    [`${phase} ${mode}`.trim(), phase === "watching" ? "" : "warn"],
    [`${side}, ${onSide}`, target?.on_side === false ? "bad" : ""],
    [range, target?.in_band === false ? "bad" : ""],
    [percent(vehicle?.battery_percent), vehicle?.battery_percent < 25 ? "bad" : ""],
    connected ? [percent(vehicle?.link_percent), vehicle?.link_percent < 80 ? "warn" : ""] : [`lost ${Math.round(age)} s`, "bad"],
    [alarms.length ? (open ? `${open} new` : `${alarms.length} seen`) : "none", open ? "bad" : ""],
  ];
}
