// Pictures on canvases: page and finger, electrodes with currents, time series.

export const CATHODIC = [179, 88, 6];
export const ANODIC = [84, 39, 136];
const BASE = [236, 238, 241];
const EDGE = "#8b98a4";
const INK = "#16202a";
const MARGIN_MM = 1.2; // around the electrodes, for the scale bar
const LASTS_S = 20; // seconds that the time series shows
// Current relative to full current above which the sign on an electrode is drawn in white.
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

// Returns the color of an electrode for its current relative to full current.
export function currentColor(part) {
  const target = part < 0 ? ANODIC : CATHODIC;
  const share = Math.min(1, Math.abs(part));
  const mixed = BASE.map((from, at) => Math.round(from + (target[at] - from) * share));
  return `rgb(${mixed.join(",")})`;
}

/** Latency as text: from the image to its first pulse or, if unknown, to its last byte sent. */
export const latencyOf = (picture) =>
  picture.pulse_ms === null
    ? `image to last byte ${picture.latency_ms.toFixed(1)} ms`
    : `image to first pulse ${picture.pulse_ms.toFixed(1)} ms`;
export const calm = () => window.matchMedia("(prefers-reduced-motion: reduce)").matches;

// A canvas in millimeters, with the center of the electrode array as origin.
class Field {
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

  // Draws a scale bar at the lower right.
  bar() {
    const { paint, canvas, scale } = this;
    const most = (0.3 * canvas.width) / scale;
    const length = [100, 50, 20, 10, 5, 2, 1].find((each) => each <= most) ?? 0.5;
    const size = 0.04 * Math.max(canvas.width, canvas.height);
    const [right, y] = [canvas.width - size / 2, canvas.height - size / 2];
    paint.fillStyle = INK;
    paint.fillRect(right - length * scale, y - size / 4, length * scale, size / 6);
    paint.font = `600 ${size}px system-ui, sans-serif`;
    paint.textAlign = "right";
    paint.fillText(`${length} mm`, right - length * scale - size / 3, y + size / 6);
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
    this.half = array.extent_mm.map((each) => each / 2 + MARGIN_MM);
    this.field = new Field(canvas, this.half[0], this.half[1]);
    this.current = null;
    canvas.addEventListener("pointermove", (event) => {
      // The picture is fitted into the canvas with its proportions kept.
      const side = Math.min(canvas.clientWidth / canvas.width, canvas.clientHeight / canvas.height);
      const part = (at, size, own) => 0.5 + (at - size / 2) / (own * side);
      canvas.title = this.nameOf(this.nearest(
        part(event.offsetX, canvas.clientWidth, canvas.width), part(event.offsetY, canvas.clientHeight, canvas.height),
      ));
    });
    this.draw();
  }

  // Returns the electrode nearest to a place, given as shares of the picture's width and height.
  nearest(x, y) {
    const [wide, high] = this.half;
    const away = this.array.place_mm.map(([a, b]) => Math.hypot(a - (2 * x - 1) * wide, b - (2 * y - 1) * high));
    return away.indexOf(Math.min(...away));
  }

  nameOf(electrode) {
    const [x, y] = this.array.place_mm[electrode];
    const current = this.current ? this.current[electrode] / 1000 : 0;
    return `electrode ${electrode} at ${x.toFixed(1)}, ${y.toFixed(1)} mm: ${current.toFixed(3)} mA`;
  }

  // Stores a picture; `show` draws its scan or one slot.
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

  // Draws a slot; if null, the strongest current of each electrode in all slots.
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
      this.name(place, at, Math.abs(part) > DEEP);
    });
    field.bar();
  }

  // Draws the number of an electrode if the electrode is large enough.
  name(place, number, onDeep) {
    const { paint, scale } = this.field;
    const size = 0.55 * this.array.radius_mm * scale;
    if (size < 9) return;
    const [x, y] = this.field.at(place);
    paint.font = `${Math.round(size)}px system-ui, sans-serif`;
    paint.textAlign = "center";
    paint.fillStyle = onDeep ? "#ffffff" : "#4d5a66";
    paint.fillText(number, x, y + 0.85 * this.array.radius_mm * scale);
  }

  // Draws the sign of a current for color-blind readers: a plus is cathodic, a minus anodic.
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

// The page with the finger on it; without a page, everything that the sensor has seen so far.
export class PageView {
  constructor(canvas, array) {
    this.canvas = canvas;
    this.array = array;
    this.seen = document.createElement("canvas");
    this.lay(null);
  }

  // Sets the page under the finger by corner and size, mm; its picture is shown once it is loaded.
  lay(sheet, address) {
    const [wide, high] = sheet?.size_mm ?? [4 * this.array.field_mm[0], 2 * this.array.field_mm[1]];
    this.corner = sheet?.corner_mm ?? null;
    this.scale = Math.min(1100 / wide, 420 / high);
    this.canvas.width = this.seen.width = Math.round(wide * this.scale);
    this.canvas.height = this.seen.height = Math.round(high * this.scale);
    this.page = null;
    if (!address) return;
    const page = new Image();
    page.addEventListener("load", () => {
      this.page = page;
      if (this.pose) this.draw(this.pose);
    });
    page.src = address;
  }

  // Returns the place of a pose on the canvas. Without a page the first pose is in the middle.
  at([x, y]) {
    const { canvas, scale } = this;
    this.corner ??= [x - canvas.width / scale / 2, y - canvas.height / scale / 2];
    return [(x - this.corner[0]) * scale, (y - this.corner[1]) * scale];
  }

  // Returns the place of the pointer on the page, mm; null without a page or outside the page.
  under({ offsetX, offsetY }) {
    const { canvas, corner, scale } = this;
    const { clientWidth, clientHeight } = canvas;
    // screen pixels per millimeter: the picture is fitted into the canvas
    const zoom = scale * Math.min(clientWidth / canvas.width, clientHeight / canvas.height);
    const x = (offsetX - clientWidth / 2) / zoom + canvas.width / scale / 2;
    const y = (offsetY - clientHeight / 2) / zoom + canvas.height / scale / 2;
    if (!this.page || Math.min(x, y) < 0 || x > canvas.width / scale || y > canvas.height / scale) return null;
    return [corner[0] + x, corner[1] + y];
  }

  take(picture) {
    const [x, y] = this.at(picture.pose);
    if (x < 0 || y < 0 || x > this.canvas.width || y > this.canvas.height) this.lay(null);
    if (!this.page && picture.image) this.see(picture.image, picture.pose);
    this.draw(picture.pose);
  }

  // Draws the sensor's image at the sensor's place.
  see(image, [x, y, angle]) {
    const small = document.createElement("canvas");
    new SensorView(small).take(image);
    const paint = this.seen.getContext("2d");
    const [wide, high] = this.array.field_mm.map((each) => each * this.scale);
    paint.save();
    paint.translate(...this.at([x, y]));
    paint.rotate(angle);
    paint.drawImage(small, -wide / 2, -high / 2, wide, high);
    paint.restore();
  }

  draw(pose) {
    const { canvas, array, scale } = this;
    const paint = canvas.getContext("2d");
    this.pose = pose;
    paint.clearRect(0, 0, canvas.width, canvas.height);
    paint.drawImage(this.page ?? this.seen, 0, 0, canvas.width, canvas.height);
    const [wide, high] = array.field_mm.map((each) => each * scale);
    const radius = 0.62 * wide;
    paint.save();
    paint.translate(...this.at(pose));
    paint.rotate(pose[2]);
    paint.fillStyle = "rgba(214, 158, 122, .28)";
    paint.strokeStyle = "#a0684a";
    paint.lineWidth = 3;
    paint.beginPath();
    paint.arc(0, radius - 0.62 * high, radius, Math.PI, 0);
    paint.lineTo(radius, 3 * high);
    paint.lineTo(-radius, 3 * high);
    paint.closePath();
    paint.fill();
    paint.stroke();
    paint.strokeStyle = INK;
    paint.strokeRect(-wide / 2, -high / 2, wide, high);
    paint.restore();
    canvas.dataset.x = pose[0].toFixed(2);
    Field.prototype.bar.call({ paint, canvas, scale });
  }

  words() {
    return this.pose ? `The finger is ${this.pose[0].toFixed(0)} mm from the left and ${this.pose[1].toFixed(0)} mm from the top` : "No finger yet";
  }
}

// Current, charge and force over time, each with its limit.
export class SeriesView {
  constructor(canvas, array) {
    this.canvas = canvas;
    const { limits } = array;
    this.rows = [
      ["Strongest current", "mA", limits.current_ma, limits.current_ma, "limit", "#b35806"],
      ["Charge of a pulse", "µC", limits.charge_uc, limits.charge_uc, "limit", "#542788"],
      ["Force", "N", array.full_n, 1.5 * array.full_n, "full", "#0b5c8a"],
    ];
    this.points = [];
  }

  take({ time_s, peak_ma, charge_uc, force_n }) {
    const { points } = this;
    if (points.length && time_s < points.at(-1)[0]) points.length = 0;
    points.push([time_s, peak_ma, charge_uc, force_n ?? 0]);
    while (points[0][0] < time_s - LASTS_S) points.shift();
    this.draw(time_s - LASTS_S, time_s);
  }

  draw(from, to) {
    const { canvas, rows, points } = this;
    const paint = canvas.getContext("2d");
    const [wide, high] = [canvas.width, canvas.height / rows.length];
    paint.clearRect(0, 0, wide, canvas.height);
    rows.forEach(([name, unit, line, most, word, color], row) => {
      const base = (row + 1) * high - 8;
      const y = (value) => base - Math.min(1, value / most) * (high - 36);
      const x = (time) => (wide * (time - from)) / Math.max(1e-9, to - from);
      paint.strokeStyle = "#c3cbd2";
      paint.setLineDash([6, 5]);
      paint.strokeRect(0, y(line), wide, 0.1);
      paint.setLineDash([]);
      paint.strokeRect(0, base, wide, 0.1);
      paint.fillStyle = paint.strokeStyle = color;
      paint.font = "600 17px system-ui, sans-serif";
      const latest = points.at(-1)?.[row + 1] ?? 0;
      paint.fillText(`${name} ${latest.toFixed(2)} ${unit}   (${word} ${line.toFixed(2)})`, 2, base - high + 26);
      paint.lineWidth = 2;
      paint.beginPath();
      points.forEach((point) => paint.lineTo(x(point[0]), y(point[row + 1])));
      paint.stroke();
      paint.lineWidth = 1;
    });
  }
}
