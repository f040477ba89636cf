// The main indicator: whether the target is within the range band and the aircraft on the required side.

import { length, lengthOf } from "./units.js";

const degrees = (radians) => Math.round((radians * 180) / Math.PI);

function indicator(root, known, good, states, facts) {
  root.className = `indicator ${known ? (good ? "good" : "bad") : "unknown"}`;
  root.querySelector("strong").textContent = known ? (good ? states[0] : states[1]) : states[2];
  root.querySelector("span").textContent = facts;
}

// Where the aircraft is, seen from the target: left or right of its course, or a bearing where a sector is required.
function place(target, requirement, sectorRad) {
  if (target.stands && !sectorRad) return "the target stands";
  if (target.angle_rad === null) return "unknown until the target has moved";
  const off = `${Math.abs(degrees(target.angle_rad))}° off ${sectorRad ? "the middle" : "abeam"}`;
  if (sectorRad) return off;
  const other = requirement === "left" ? "right" : "left";
  return `${Math.abs(target.angle_rad) <= Math.PI / 2 ? requirement : other}, ${off}`;
}

// old: what is shown is not of now, so nothing is claimed of now.
export function showWatch(band, side, state, setting, old) {
  const { target, asked } = state;
  const inBand = old ? null : target?.in_band ?? null;
  const onSide = old ? null : target?.on_side ?? null;
  const when = old ? "last" : "now";
  const range = target ? length(target.range_m) : "unknown";
  const why = state.unknown && inBand === null ? ` (${state.unknown})` : "";
  indicator(band, inBand !== null, inBand, ["In band", "Out of band", "Band unknown"],
    `required: ${Math.round(lengthOf(asked.range_min_m))} to ${length(asked.range_max_m)}; ${when}: ${range}${why}`);
  const there = target ? place(target, state.side, setting.sector_rad) : "unknown";
  const none = target?.stands && !old ? "No side yet" : "Side unknown";
  indicator(side, onSide !== null, onSide, ["On side", "Off side", none], `required: ${asked.side}; ${when}: ${there}`);
}
