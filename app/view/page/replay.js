// The replay's bar: play, pause, seek, speed, and from decision to decision. None of the buttons commands a flight.

const SPEEDS = [0.5, 1, 2, 5, 10, 20, 50, 100];

function clock(seconds) {
  const whole = Math.max(0, Math.round(seconds));
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}

export class ReplayBar {
  // press: passes a button on.
  constructor(root, press) {
    this.root = root;
    this.press = press;
    this.playing = true;
    this.held = false; // whether the user holds the slider
    const find = (selector) => root.querySelector(selector);
    [this.play, this.seek, this.at, this.speed, this.decided] = ["#play", "#seek", "#at", "#speed", "#decided"].map(find);
    this.play.addEventListener("click", () => this.toggle());
    for (const button of root.querySelectorAll("[data-step]")) {
      button.addEventListener("click", () => press({ action: "step", value: Number(button.dataset.step) }));
    }
    this.seek.addEventListener("input", () => { this.held = true; this.seekTo(Number(this.seek.value)); });
    this.seek.addEventListener("change", () => {
      this.held = false;
      press({ action: "seek", value: Number(this.seek.value) });
    });
    this.speed.addEventListener("change", () => press({ action: "speed", value: Number(this.speed.value) }));
    document.addEventListener("keydown", (event) => this.key(event));
  }

  toggle() {
    this.press({ action: this.playing ? "pause" : "play" });
  }

  key(event) {
    if (this.root.hidden || event.target.closest("button, input, select, dialog, summary")) return;
    if (event.key === " ") this.toggle();
    else if (event.key === "[" || event.key === "]") this.press({ action: "step", value: event.key === "]" ? 1 : -1 });
    else return;
    event.preventDefault();
  }

  // The data of the whole flight; startS: origin of the displayed times.
  set({ begin_s: begin, end_s: end, decided_s: decided }, startS) {
    this.root.hidden = false;
    this.startS = startS;
    this.endS = end;
    [this.seek.min, this.seek.max] = [begin, end];
    this.decided.replaceChildren(...decided.map((time) => {
      const mark = document.createElementNS(this.decided.namespaceURI, "path");
      mark.setAttribute("d", `M${(1000 * (time - begin)) / Math.max(end - begin, 1)} 0v10`);
      return mark;
    }));
  }

  show({ playing, speed, at_s: at }) {
    this.playing = playing;
    this.play.textContent = playing ? "Pause" : "Play";
    const speeds = [...new Set([...SPEEDS, speed])].sort((a, b) => a - b);
    if (this.speed.childElementCount !== speeds.length) {
      this.speed.replaceChildren(...speeds.map((one) => new Option(`${one} ×`, one)));
    }
    if (document.activeElement !== this.speed) this.speed.value = speed;
    if (this.held) return;
    this.seek.value = at;
    this.seekTo(at);
  }

  seekTo(at) {
    this.at.textContent = `${clock(at - this.startS)} of ${clock(this.endS - this.startS)}`;
    this.seek.setAttribute("aria-valuetext", this.at.textContent);
  }
}
