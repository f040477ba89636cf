// The alarms: one banner each, the page title, a sound that can be muted, vibration. Each lasts as long as its cause.

const SOUND_EVERY_MS = 4000;
const TITLE = document.title;

function element(name, text, attributes = {}) {
  const made = document.createElement(name);
  made.textContent = text;
  Object.assign(made, attributes);
  return made;
}

export class AlarmList {
  // press: passes a request on.
  constructor(list, mute, press) {
    this.list = list;
    this.mute = mute;
    this.press = press;
    this.alarms = [];
    this.sounding = null;
    this.soundedAt = 0;
    mute.addEventListener("click", () => this.toggle());
    // A browser allows a page to play sounds only after a user interaction.
    for (const kind of ["pointerdown", "keydown"]) document.addEventListener(kind, () => this.wake(), { once: true });
    setInterval(() => this.sound(), 500);
    this.label();
  }

  get muted() {
    return this.mute.getAttribute("aria-pressed") === "true";
  }

  toggle() {
    this.mute.setAttribute("aria-pressed", !this.muted);
    this.label();
  }

  label() {
    this.mute.textContent = this.muted ? "Sound: off" : "Sound: on";
  }

  wake() {
    this.sounding ??= new AudioContext();
  }

  show(alarms) {
    this.alarms = alarms;
    const keys = new Set(alarms.map((one) => this.key(one)));
    for (const line of [...this.list.children]) if (!keys.has(line.dataset.key)) line.remove();
    for (const alarm of alarms) this.line(alarm);
    this.list.hidden = !alarms.length;
    const unseen = alarms.filter((one) => !one.acknowledged);
    document.title = unseen.length ? `⚠ ${unseen.map((one) => one.text).join("; ")}` : TITLE;
  }

  key(alarm) {
    return `${alarm.aircraft} ${alarm.key}`;
  }

  // A banner is changed in place: screen readers repeat a new banner, and it moves away from the finger.
  line(alarm) {
    let line = [...this.list.children].find((one) => one.dataset.key === this.key(alarm));
    if (!line) {
      line = element("div", "");
      line.dataset.key = this.key(alarm);
      line.append(element("strong", ""), element("span", ""));
      const hold = element("button", "Hold instead", { type: "button", className: "hold" });
      hold.addEventListener("click", () => this.press({ action: "hold", side: null }));
      line.append(hold);
      const confirm = element("button", "This is it", { type: "button", className: "confirm" });
      confirm.addEventListener("click", () => this.press({ action: "confirm", side: null }));
      confirm.hidden = alarm.key !== "object";
      line.append(confirm);
      const seen = element("button", "Acknowledge", { type: "button", className: "seen" });
      const { key, aircraft } = alarm;
      seen.addEventListener("click", () => this.press({ action: "acknowledge", alarm: key, aircraft }));
      line.append(seen);
      this.list.append(line);
    }
    const name = alarm.aircraft ? `${alarm.aircraft}: ` : "";
    const text = `${name}${alarm.text}`;
    if (line.children[0].textContent !== text) line.children[0].textContent = text;
    line.children[1].textContent = alarm.advice;
    line.classList.toggle("seen", alarm.acknowledged);
    line.querySelector("button.hold").hidden = alarm.countdown_s === null;
    line.querySelector("button.seen").hidden = alarm.acknowledged;
  }

  sound() {
    if (this.muted || !this.sounding || !this.alarms.some((one) => !one.acknowledged)) return;
    if (performance.now() - this.soundedAt < SOUND_EVERY_MS) return;
    this.soundedAt = performance.now();
    navigator.vibrate?.([200, 100, 200]);
    for (const [k, hertz] of [880, 660].entries()) {
      const begin = this.sounding.currentTime + 0.25 * k;
      const tone = this.sounding.createOscillator();
      const loudness = this.sounding.createGain();
      tone.frequency.value = hertz;
      loudness.gain.setValueAtTime(0.25, begin);
      loudness.gain.exponentialRampToValueAtTime(0.001, begin + 0.22);
      tone.connect(loudness).connect(this.sounding.destination);
      tone.start(begin);
      tone.stop(begin + 0.23);
    }
  }
}
