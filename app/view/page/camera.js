// The camera's picture with what is tracked in it. A click, or a rectangle that is drawn, begins to track.

const EVERY_MS = 200;
const LITTLE = 0.02; // of the picture's width: a shorter drag is a click
const WORDS = { idle: "Click the target, or draw a rectangle around it.", object: "tracked", lost: "lost: searching" };

export class CameraView {
  // press: passes a button on.
  constructor(root, press) {
    this.root = root;
    this.press = press;
    [this.canvas, this.words, this.stop] = ["canvas", "output", "button"].map((name) => root.querySelector(name));
    this.begun = null; // where the pointer went down, in shares of the picture
    this.canvas.addEventListener("pointerdown", (event) => { this.begun = this.at(event); });
    this.canvas.addEventListener("pointerup", (event) => this.drawn(event));
    this.stop.addEventListener("click", () => press({ action: "track", where: [] }));
  }

  // live: whether it is of a flight, in which something can be tracked.
  set(shown, live) {
    this.live = live;
    this.stop.hidden = !live;
    if (shown && this.root.hidden) this.follow();
    this.root.hidden = !shown;
  }

  // Each picture is asked for after the last one has come: a slow line gets fewer of them, and none of them late.
  async follow() {
    do {
      const wait = new Promise((resolve) => setTimeout(resolve, EVERY_MS));
      try {
        const got = document.hidden ? null : await fetch("picture", { signal: AbortSignal.timeout(5000) });
        if (got?.ok) await this.show(new Uint8Array(await got.arrayBuffer()));
      } catch {
        // The next one may come.
      }
      await wait;
    } while (!this.root.hidden);
  }

  async show(data) {
    const end = data.indexOf(10);
    const marks = JSON.parse(new TextDecoder().decode(data.subarray(0, end)));
    if (marks.time_s === this.timeS) return;
    this.timeS = marks.time_s;
    const picture = await createImageBitmap(new Blob([data.subarray(end + 1)], { type: "image/jpeg" }));
    const { canvas } = this;
    [canvas.width, canvas.height] = [picture.width, picture.height];
    this.draw(canvas.getContext("2d"), picture, marks);
    const share = marks.state === "object" ? `, confidence ${Math.round(100 * marks.confidence)} %` : "";
    this.words.textContent = this.live || marks.state !== "idle" ? WORDS[marks.state] + share : "nothing is tracked";
    canvas.setAttribute("aria-label", `Picture of the camera: ${this.words.textContent}`);
  }

  draw(context, picture, { state, box, estimate, ellipse }) {
    const [width, height] = [picture.width, picture.height];
    context.drawImage(picture, 0, 0);
    context.lineWidth = 2;
    const line = (points, colour, dashes = []) => {
      context.strokeStyle = colour;
      context.setLineDash(dashes);
      context.beginPath();
      for (const [x, y] of points) context.lineTo(x * width, y * height);
      context.stroke();
    };
    if (ellipse?.length) line(ellipse, "#ffd23f");
    if (estimate) {
      const [x, y] = estimate;
      line([[x - 6 / width, y], [x + 6 / width, y]], "#ffd23f");
      line([[x, y - 6 / height], [x, y + 6 / height]], "#ffd23f");
    }
    if (box && state !== "idle") {
      const [left, top, right, bottom] = box;
      line([[left, top], [right, top], [right, bottom], [left, bottom], [left, top]], state === "object" ? "#4cff7a" : "#ff6b5e", state === "object" ? [] : [6, 4]);
    }
  }

  // The place of a pointer in shares of the picture.
  at({ clientX, clientY }) {
    const { left, top, width, height } = this.canvas.getBoundingClientRect();
    return [(clientX - left) / width, (clientY - top) / height].map((share) => Math.min(Math.max(share, 0), 1));
  }

  drawn(event) {
    if (!this.begun || !this.live) return;
    const [[x, y], [x0, y0]] = [this.at(event), this.begun];
    this.begun = null;
    const size = [Math.abs(x - x0), Math.abs(y - y0)];
    const where = Math.min(...size) < LITTLE ? [x, y] : [(x + x0) / 2, (y + y0) / 2, ...size];
    this.press({ action: "track", where });
  }
}
