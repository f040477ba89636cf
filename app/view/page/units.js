// Units, formats of positions and the time of day, as the configuration or the operator of this page chose them.

const KEPT = "sidelong display";
export const CHOICES = {
  units: { metric: "metres, m/s", nautical: "feet, nautical miles, knots", imperial: "feet, miles, mph" },
  coordinates: { degrees: "decimal degrees", dms: "degrees, minutes, seconds", utm: "UTM", mgrs: "MGRS" },
  times: { local: "local time", utc: "UTC" },
};
// Lengths: [unit, metres, long unit, metres]; speeds: [unit, m/s].
const LENGTHS = {
  metric: ["m", 1, "km", 1000], nautical: ["ft", 0.3048, "NM", 1852], imperial: ["ft", 0.3048, "mi", 1609.344],
};
const SPEEDS = { metric: ["m/s", 1], nautical: ["kn", 1852 / 3600], imperial: ["mph", 0.44704] };
export const display = { units: "metric", coordinates: "degrees", times: "local" };

// Take the configured values; what was chosen on this page before has precedence.
export function configure(values) {
  let chosen = {};
  try {
    chosen = JSON.parse(localStorage.getItem(KEPT)) ?? {};
  } catch { /* the browser keeps nothing, or something else */ }
  for (const [key, choices] of Object.entries(CHOICES)) {
    display[key] = [chosen[key], values?.[key], display[key]].find((one) => Object.hasOwn(choices, one));
  }
}

export function choose(key, value) {
  display[key] = value;
  try {
    const kept = JSON.parse(localStorage.getItem(KEPT)) ?? {};
    localStorage.setItem(KEPT, JSON.stringify({ ...kept, [key]: value }));
  } catch { /* as above: the choice lasts as long as the page */ }
}

export const next = (key) => {
  const names = Object.keys(CHOICES[key]);
  choose(key, names[(names.indexOf(display[key]) + 1) % names.length]);
};

export const lengthUnit = () => LENGTHS[display.units][0];
export const lengthOf = (metres) => metres / LENGTHS[display.units][1];
export const metresOfLength = (length) => length * LENGTHS[display.units][1];
export const length = (metres, digits = 0) => `${lengthOf(metres).toFixed(digits)} ${lengthUnit()}`;
export const speed = (metresPerS) => `${(metresPerS / SPEEDS[display.units][1]).toFixed(1)} ${SPEEDS[display.units][0]}`;

// A scale bar of a round length, at most this many metres long: [metres, text].
export function roundLength(most) {
  const [unit, one, longUnit, long] = LENGTHS[display.units];
  const [name, metres] = most >= long ? [longUnit, long] : [unit, one];
  const power = 10 ** Math.floor(Math.log10(most / metres));
  const size = ([5, 2, 1].find((k) => k * power * metres <= most) ?? 1) * power;
  return [size * metres, `${Number(size.toPrecision(1))} ${name}`];
}

export function timeOfDay(date) {
  if (display.times === "utc") return `${date.toISOString().slice(11, 19)} UTC`;
  return `${[date.getHours(), date.getMinutes(), date.getSeconds()].map((v) => String(v).padStart(2, "0")).join(":")} local`;
}

// -- positions -------------------------------------------------------------------------------------------------

function sexagesimal(degrees, letters, width) {
  const tenths = Math.round(Math.abs(degrees) * 36000);
  const pad = (value, size) => String(value).padStart(size, "0");
  const seconds = (tenths % 600) / 10;
  const whole = Math.floor(tenths / 36000);
  return `${pad(whole, width)}°${pad(Math.floor(tenths / 600) % 60, 2)}′${pad(seconds.toFixed(1), 4)}″${letters[degrees < 0 ? 1 : 0]}`;
}

const BANDS = "CDEFGHJKLMNPQRSTUVWX";

// The zone's number, with the exceptions of Norway and Svalbard.
function zoneOf(latitude, longitude) {
  if (latitude >= 56 && latitude < 64 && longitude >= 3 && longitude < 12) return 32;
  if (latitude >= 72 && longitude >= 0 && longitude < 42) return longitude < 9 ? 31 : longitude < 21 ? 33 : longitude < 33 ? 35 : 37;
  return Math.min(60, Math.floor((longitude + 180) / 6) + 1);
}

// {zone, band, east, north} on WGS 84, by Krüger's series to the third order: below a millimetre; null near the poles.
export function utm(latitude, longitude) {
  if (!(latitude >= -80 && latitude < 84)) return null;
  const zone = zoneOf(latitude, longitude);
  const [a, f] = [6378137, 1 / 298.257223563];
  const n = f / (2 - f);
  const radius = (a / (1 + n)) * (1 + n ** 2 / 4 + n ** 4 / 64);
  const series = [
    n / 2 - (2 / 3) * n ** 2 + (5 / 16) * n ** 3, (13 / 48) * n ** 2 - (3 / 5) * n ** 3, (61 / 240) * n ** 3,
  ];
  const phi = (latitude * Math.PI) / 180;
  const lambda = ((longitude - (6 * zone - 183)) * Math.PI) / 180;
  const e = (2 * Math.sqrt(n)) / (1 + n);
  const t = Math.sinh(Math.atanh(Math.sin(phi)) - e * Math.atanh(e * Math.sin(phi)));
  const xi = Math.atan2(t, Math.cos(lambda));
  const eta = Math.atanh(Math.sin(lambda) / Math.hypot(1, t));
  let [east, north] = [eta, xi];
  series.forEach((c, k) => {
    const m = 2 * (k + 1);
    east += c * Math.cos(m * xi) * Math.sinh(m * eta);
    north += c * Math.sin(m * xi) * Math.cosh(m * eta);
  });
  const scale = 0.9996 * radius;
  const band = BANDS[Math.min(19, Math.floor((latitude + 80) / 8))];
  return { zone, band, east: 500000 + scale * east, north: (latitude < 0 ? 1e7 : 0) + scale * north };
}

function mgrs({ zone, band, east, north }) {
  const columns = ["ABCDEFGH", "JKLMNPQR", "STUVWXYZ"][(zone - 1) % 3];
  const row = (Math.floor(north / 1e5) + (zone % 2 ? 0 : 5)) % 20;
  const digits = (metres) => String(Math.floor(metres % 1e5)).padStart(5, "0"); // MGRS truncates
  return `${zone}${band} ${columns[Math.floor(east / 1e5) - 1]}${"ABCDEFGHJKLMNPQRSTUV"[row]} ${digits(east)} ${digits(north)}`;
}

// A position as text; digits: of decimal degrees.
export function position([latitude, longitude], digits = 6) {
  const { coordinates } = display;
  if (coordinates === "dms") return `${sexagesimal(latitude, "NS", 2)} ${sexagesimal(longitude, "EW", 3)}`;
  const grid = coordinates === "degrees" ? null : utm(latitude, longitude);
  if (!grid) return `${latitude.toFixed(digits)}, ${longitude.toFixed(digits)}`;
  return coordinates === "mgrs" ? mgrs(grid) : `${grid.zone}${grid.band} ${Math.round(grid.east)} ${Math.round(grid.north)}`;
}
