// Pictures on canvases: electrodes with currents, what is seen, what is meant, what is felt.

export const CATHODIC = [179, 88, 6];
export const ANODIC = [84, 39, 136];
const BASE = [236, 238, 241];
const EDGE = "#8b98a4";
// Part of the strongest current from which a sign on it is white.
const DEEP = 0.45;

export function bytes(text) {
  const found = atob(text);
  const array = new Uint8Array(found.length);
  for (let at = 0; at < found.length; at += 1) array[at] = found.charCodeAt(at);
  return array;
}

export function numbers(text) {
  return new Int16Array(bytes(text).buffer);
}

// Color of an electrode: the part of the strongest current, with its sign.
export function currentColor(part) {
  const target = part < 0 ? ANODIC : CATHODIC;
  const share = Math.min(1, Math.abs(part));
  const mixed = BASE.map((from, at) => Math.round(from + (target[at] - from) * share));
  return `rgb(${mixed.join(",")})`;
}

/** Latency of a picture in words: to the first pulse, if the board says when that was. */
export const latencyOf = (picture) =>
  picture.pulse_ms === null
    ? `${picture.latency_ms.toFixed(1)} ms, to last byte`
    : `${picture.pulse_ms.toFixed(1)} ms, to first pulse`;
export const calm = () => window.matchMedia("(prefers-reduced-motion: reduce)").matches;

// A canvas in millimeters, with the array's own places.
export class Field {
  constructor(canvas, halfWidth, halfHeight, longest = 560) {
    this.canvas = canvas;
    this.scale = longest / (2 * Math.max(halfWidth, halfHeight));
    canvas.width = Math.round(2 * halfWidth * this.scale);
    canvas.height = Math.round(2 * halfHeight * this.scale);
    this.paint = canvas.getContext("2d", { willReadFrequently: true });
  }

  at([x, y]) {
    return [this.canvas.width / 2 + x * this.scale, this.canvas.height / 2 + y * this.scale];
  }

  clear() {
    this.paint.clearRect(0, 0, this.canvas.width, this.canvas.height);
  }

  disc(place, radius, fill, edge, width = 1.2) {
    const [x, y] = this.at(place);
    this.paint.beginPath();
    this.paint.arc(x, y, radius * this.scale, 0, 2 * Math.PI);
    if (fill) {
      this.paint.fillStyle = fill;
      this.paint.fill();
    }
    if (edge) {
      this.paint.strokeStyle = edge;
      this.paint.lineWidth = width;
      this.paint.stroke();
    }
  }
}

export class ElectrodesView {
  constructor(canvas, array) {
    this.array = array;
    this.field = new Field(canvas, array.extent_mm[0] / 2, array.extent_mm[1] / 2);
    this.current = null;
    this.draw();
  }

  // Takes a picture; its currents are drawn as a whole scan or slot by slot.
  take(picture) {
    this.picture = picture;
    this.slots = picture.slots;
    this.all = numbers(picture.current_ua);
    this.strongest = new Int16Array(this.array.place_mm.length);
    const count = this.strongest.length;
    this.all.forEach((value, at) => {
      const electrode = at % count;
      if (Math.abs(value) > Math.abs(this.strongest[electrode])) this.strongest[electrode] = value;
    });
  }

  // Draws a slot, or the strongest of all slots where it is null.
  show(slot) {
    const count = this.array.place_mm.length;
    this.current = slot === null ? this.strongest : this.all.subarray(slot * count, (slot + 1) * count);
    this.draw();
    this.field.canvas.dataset.number = this.picture.number ?? "";
    this.field.canvas.dataset.slot = slot ?? "";
  }

  draw() {
    const { field, array } = this;
    field.clear();
    array.place_mm.forEach((place, at) => {
      const current = this.current ? this.current[at] : 0;
      const part = current / (1000 * array.full_ma);
      field.disc(place, array.radius_mm, currentColor(part), EDGE);
      if (current) this.sign(place, current > 0, Math.abs(part) > DEEP);
    });
  }

  // The sign is told by its shape, too: a cross is cathodic, a bar anodic.
  sign(place, positive, onDeep) {
    const { paint, scale } = this.field;
    const [x, y] = this.field.at(place);
    const arm = 0.3 * this.array.radius_mm * scale;
    paint.fillStyle = onDeep ? "#ffffff" : "#33404c";
    paint.fillRect(x - arm, y - arm / 5, 2 * arm, arm / 2.5);
    if (positive) paint.fillRect(x - arm / 5, y - arm, arm / 2.5, 2 * arm);
  }

  words() {
    const active = this.current ? [...this.current].filter((each) => each).length : 0;
    if (!active) return "No current at any electrode";
    const strongest = this.current.reduce((most, each) => (Math.abs(each) > Math.abs(most) ? each : most));
    const kind = strongest > 0 ? "cathodic" : "anodic";
    return `Current at ${active} of ${this.current.length} electrodes, ` +
      `strongest ${Math.abs(strongest / 1000).toFixed(2)} mA ${kind} at electrode ${this.current.indexOf(strongest)}`;
  }
}

export class SensorView {
  constructor(canvas) {
    this.canvas = canvas;
  }

  take(image) {
    const { canvas } = this;
    if (canvas.width !== image.width || canvas.height !== image.height) {
      canvas.width = image.width;
      canvas.height = image.height;
    }
    const paint = canvas.getContext("2d", { willReadFrequently: true });
    const data = paint.createImageData(image.width, image.height);
    bytes(image.grey).forEach((grey, at) => {
      data.data.set([grey, grey, grey, 255], 4 * at);
    });
    paint.putImageData(data, 0, 0);
  }
}

export class TactileView {
  constructor(canvas, array) {
    this.array = array;
    this.names = Object.keys(array.colors);
    this.field = new Field(canvas, array.extent_mm[0] / 2, array.extent_mm[1] / 2, 320);
    this.activation = new Uint8Array(this.names.length * array.place_mm.length);
    this.draw();
  }

  take(text) {
    this.activation = bytes(text);
    this.draw();
  }

  // Each class is a part of the ring: they are told apart by place, not by color alone.
  draw() {
    const { field, array } = this;
    const count = array.place_mm.length;
    field.clear();
    array.place_mm.forEach((place, at) => {
      field.disc(place, array.radius_mm, "#eceef1", EDGE);
      const present = this.names.filter((_, row) => this.activation[row * count + at]);
      present.forEach((name, index) => {
        const row = this.names.indexOf(name);
        const [x, y] = field.at(place);
        const paint = field.paint;
        const turn = (2 * Math.PI) / present.length;
        paint.globalAlpha = this.activation[row * count + at] / 255;
        paint.fillStyle = array.colors[name];
        paint.beginPath();
        if (present.length > 1) paint.moveTo(x, y);
        paint.arc(x, y, array.radius_mm * field.scale * 0.9, index * turn, (index + 1) * turn);
        paint.fill();
        paint.globalAlpha = 1;
      });
    });
  }

  words() {
    const count = this.array.place_mm.length;
    const active = this.names.map((name, row) => {
      const part = this.activation.subarray(row * count, (row + 1) * count);
      return [name, part.filter((each) => each).length];
    }).filter(([, each]) => each);
    return active.length ? active.map(([name, each]) => `${name} at ${each} electrodes`).join(", ") : "Nothing is meant to be felt";
  }
}

export class FeltView {
  constructor(canvas, finger, array) {
    this.array = array;
    this.field = new Field(canvas, finger.reach_mm[0], finger.reach_mm[1], 360);
    const places = numbers(finger.receptor_mm);
    this.places = Array.from({ length: places.length / 2 }, (_, at) => [places[2 * at] / 100, places[2 * at + 1] / 100]);
    this.classes = bytes(finger.classes);
    this.colors = Object.values(array.colors);
    this.draw(null);
  }

  draw(counts) {
    const { field } = this;
    field.clear();
    this.array.place_mm.forEach((place) => field.disc(place, this.array.radius_mm, null, "#c3cbd2"));
    this.places.forEach((place, at) => {
      const spikes = counts ? counts[at] : 0;
      const radius = spikes ? 0.14 + 0.08 * Math.min(4, spikes) : 0.05;
      field.disc(place, radius, spikes ? this.colors[this.classes[at]] ?? "#444" : "#9aa5af");
    });
  }

  take(felt) {
    this.draw(bytes(felt.counts));
    this.field.canvas.dataset.spikes = felt.spikes;
    const fired = Object.entries(felt.afferents).filter(([, count]) => count).map(([name, count]) => `${count} ${name}`);
    this.said = felt.spikes ? `${felt.spikes} spikes of ${fired.join(", ") || "no"} afferents` : "Nothing fires";
    if (felt.spikes && felt.misplaced !== null) this.said += `, ${Math.round(100 * felt.misplaced)} % beyond a pitch`;
    return this.said;
  }
}
