// Drawing on the electrodes: by mouse, finger or keys; letters, patterns, and a list that is played.

import { Field, bytes } from "./views.js";

const REACH = 0.55;
const CURSOR = "#b3161c";

function text(level) {
  return btoa(String.fromCharCode(...level));
}

export class Drawing {
  constructor(find, say, array) {
    this.find = find;
    this.say = say;
    this.array = array;
    this.field = new Field(find("sketch"), array.extent_mm[0] / 2, array.extent_mm[1] / 2);
    this.pitch = array.radius_mm / 0.42;
    this.level = new Uint8Array(array.place_mm.length);
    this.tool = "paint";
    this.cursor = null;
    this.drawn = { patterns: [], playing: null };
    this.paint();
    this.listen();
  }

  listen() {
    const { find } = this;
    const sketch = find("sketch");
    for (const tool of ["paint", "erase", "line"]) {
      find(`tool-${tool}`).addEventListener("click", () => {
        this.tool = tool;
        for (const each of ["paint", "erase", "line"]) find(`tool-${each}`).setAttribute("aria-pressed", String(each === tool));
      });
    }
    find("draw-fleeting").addEventListener("click", () => {
      this.fleeting = !this.fleeting;
      find("draw-fleeting").setAttribute("aria-pressed", String(this.fleeting));
    });
    find("draw-clear").addEventListener("click", () => this.set(new Uint8Array(this.level.length)));
    find("letter").addEventListener("input", () => {
      if (find("letter").value.trim()) this.say(`draw letter ${find("letter").value}`);
      find("letter").select();
    });
    find("library").addEventListener("change", () => {
      if (find("library").value) this.say(`draw library ${find("library").value}`);
      find("library").value = "";
    });
    find("keep").addEventListener("click", () => {
      const lasts = Math.round(Number(find("lasts").value));
      if (lasts >= 20 && lasts <= 60000) this.say(`draw keep ${lasts}`);
      else find("draw-said").textContent = "A pattern lasts from 20 to 60000 ms";
    });
    find("play").addEventListener("click", () => this.say(this.drawn.playing === null ? "draw play once" : "draw halt"));
    find("loop").addEventListener("click", () => this.say(this.drawn.playing === null ? "draw play loop" : "draw halt"));
    find("save-json").addEventListener("click", () => this.say("draw save"));
    sketch.addEventListener("pointerdown", (event) => this.begin(event));
    sketch.addEventListener("pointermove", (event) => this.move(event));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) sketch.addEventListener(kind, () => this.end());
    sketch.addEventListener("keydown", (event) => this.key(event));
    sketch.addEventListener("blur", () => {
      this.cursor = null;
      this.paint();
    });
  }

  // Takes what is drawn by whoever steers; a stroke of one's own goes first.
  take(drawn) {
    const { find } = this;
    const listed = JSON.stringify(drawn.patterns) !== JSON.stringify(this.drawn.patterns);
    this.drawn = drawn;
    if (!this.from) this.level = bytes(drawn.playing === null ? drawn.level : drawn.patterns[drawn.playing].level);
    this.paint();
    find("draw-said").textContent = drawn.said;
    find("play").textContent = drawn.playing !== null && !drawn.loops ? "Halt" : "Play";
    find("loop").textContent = drawn.playing !== null && drawn.loops ? "Halt" : "Loop";
    if (find("library").children.length === 1) {
      for (const name of drawn.library) find("library").append(new Option(name, name));
    }
    if (listed) this.list();
    [...find("patterns").children].forEach((item, at) => item.classList.toggle("now", at === drawn.playing));
  }

  list() {
    this.find("patterns").replaceChildren(...this.drawn.patterns.map(({ level, ms }, at) => {
      const item = document.createElement("li");
      const show = document.createElement("button");
      const drop = document.createElement("button");
      const small = document.createElement("canvas");
      const field = new Field(small, this.array.extent_mm[0] / 2, this.array.extent_mm[1] / 2, 58);
      this.discs(field, bytes(level), false);
      show.type = drop.type = "button";
      show.setAttribute("aria-label", `Show pattern ${at + 1}, ${ms} ms`);
      drop.setAttribute("aria-label", `Remove pattern ${at + 1}`);
      drop.textContent = "Remove";
      show.append(small, `${ms} ms`);
      show.addEventListener("click", () => this.say(`draw show ${at}`));
      drop.addEventListener("click", () => this.say(`draw drop ${at}`));
      item.append(show, drop);
      return item;
    }));
  }

  place(event) {
    const box = this.field.canvas.getBoundingClientRect();
    const scale = this.field.canvas.width / box.width / this.field.scale;
    return [(event.clientX - box.left - box.width / 2) * scale, (event.clientY - box.top - box.height / 2) * scale];
  }

  begin(event) {
    event.preventDefault();
    if (event.button || this.from) return;
    this.field.canvas.focus();
    this.field.canvas.setPointerCapture(event.pointerId);
    this.before = this.level.slice();
    this.from = this.place(event);
    this.stroke(this.from, this.from);
  }

  move(event) {
    if (!this.from) return;
    const to = this.place(event);
    if (this.tool === "line") {
      this.level = this.before.slice();
      this.stroke(this.from, to);
    } else {
      this.stroke(this.from, to);
      this.from = to;
    }
  }

  end() {
    if (!this.from) return;
    this.from = null;
    if (this.fleeting) this.set(new Uint8Array(this.level.length));
  }

  // Every electrode within reach of the way from one place to another.
  stroke([x0, y0], [x1, y1]) {
    const length = (x1 - x0) ** 2 + (y1 - y0) ** 2;
    const level = this.level.slice();
    this.array.place_mm.forEach(([x, y], at) => {
      const part = length ? Math.max(0, Math.min(1, ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / length)) : 0;
      const away = Math.hypot(x - x0 - part * (x1 - x0), y - y0 - part * (y1 - y0));
      if (away <= REACH * this.pitch) level[at] = this.tool === "erase" ? 0 : this.strength;
    });
    this.set(level);
  }

  get strength() {
    return Number(this.find("strength").value);
  }

  set(level) {
    if (level.every((each, at) => each === this.level[at]) && this.drawn.playing === null) return;
    this.level = level;
    this.say(`draw level ${text(level)}`);
    this.paint();
  }

  key(event) {
    const ways = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const way = ways[event.key];
    if (!way && event.key !== "Enter") return;
    event.preventDefault();
    event.stopPropagation();
    if (this.cursor === null) this.cursor = this.nearest([0, 0]);
    else if (way) this.cursor = this.beside(way);
    if (!way) {
      const level = this.level.slice();
      level[this.cursor] = level[this.cursor] ? 0 : this.strength;
      this.set(level);
    }
    this.paint();
    const on = this.level[this.cursor] ? `on, ${Math.round(this.level[this.cursor] / 2.55)} %` : "off";
    this.find("sketch-said").textContent = `Electrode ${this.cursor} ${on}`;
  }

  nearest([x, y]) {
    const away = this.array.place_mm.map(([a, b]) => Math.hypot(a - x, b - y));
    return away.indexOf(Math.min(...away));
  }

  // The nearest electrode in a direction, within 45 degrees of it.
  beside([dx, dy]) {
    const [x, y] = this.array.place_mm[this.cursor];
    let best = this.cursor;
    let least = Infinity;
    this.array.place_mm.forEach(([a, b], at) => {
      const ahead = (a - x) * dx + (b - y) * dy;
      const aside = Math.abs((a - x) * dy) + Math.abs((b - y) * dx);
      if (ahead > 1e-6 && aside <= ahead && ahead + 2 * aside < least) {
        least = ahead + 2 * aside;
        best = at;
      }
    });
    return best;
  }

  paint() {
    this.field.clear();
    this.discs(this.field, this.level, true);
    if (this.cursor !== null) this.field.disc(this.array.place_mm[this.cursor], this.array.radius_mm * 1.08, null, CURSOR, 4);
    this.field.canvas.dataset.level = text(this.level);
  }

  discs(field, level, edges) {
    this.array.place_mm.forEach((place, at) => {
      const grey = Math.round(236 - level[at] * 0.82);
      field.disc(place, this.array.radius_mm, `rgb(${grey},${grey},${grey})`, edges ? "#8b98a4" : null);
    });
  }
}
