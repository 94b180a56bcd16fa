// Recordings: a time line, steps and slots, events to jump to, one or two side by side.

import { ElectrodesView, FeltView, PageView, SensorView, SeriesView, SumView, bytes, calm, latencyOf } from "./views.js";

const find = (id) => document.getElementById(id);
const AGAIN_MS = 500;
let sides = [];
let slot = null;
let step = 0;
let playing = null;

// One recording and its pictures.
class Side {
  constructor(about, number) {
    const part = find("side").content.cloneNode(true);
    this.root = part.querySelector(".side");
    this.number = number;
    this.times = [];
    this.step = null;
    this.wanted = 0;
    this.fetched = Promise.resolve();
    const get = (name) => this.root.querySelector(`.${name}`);
    get("side-name").textContent = about.name;
    const facts = Object.entries(about.facts).map(([key, value]) => `${key} ${value}`);
    get("side-told").textContent = [about.array.profile, about.started.replace("T", " "), ...facts].join(" · ");
    this.electrodes = new ElectrodesView(get("electrodes"), about.array);
    this.sensor = new SensorView(get("sensor"));
    this.page = new PageView(get("page"), about.array);
    this.series = new SeriesView(get("series"), about.array);
    for (const name of ["felt-card", "sum-card"]) get(name).hidden = !about.finger;
    if (about.finger) {
      this.felt = new FeltView(get("felt"), about.finger, about.array);
      this.sum = new SumView(get("sum"), this.page, this.felt);
    }
    this.get = get;
    this.events = -1;
    find("main").append(part);
  }

  // Takes what has been read since.
  take(about) {
    about.series.slice(Math.max(0, this.times.length - about.from)).forEach((each, at) => {
      this.series.points.push([about.times_s[Math.max(0, this.times.length - about.from) + at], ...each]);
    });
    if (about.sheet && !this.page.corner) this.page.lay(about.sheet);
    this.times = this.times.concat(about.times_s.slice(Math.max(0, this.times.length - about.from)));
    if (this.events !== about.events.length) {
      this.events = about.events.length;
      this.get("jumps").replaceChildren(...about.events.map(({ time_s, text }) => {
        const item = document.createElement("li");
        const button = document.createElement("button");
        const time = document.createElement("time");
        time.textContent = `${time_s.toFixed(2)} s`;
        button.type = "button";
        button.append(time, text);
        button.addEventListener("click", () => goToTime(time_s));
        item.append(button);
        return item;
      }));
    }
  }

  // The newest step at a time of the run.
  at(time) {
    let low = 0;
    let high = this.times.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.times[middle] <= time + 1e-9) low = middle + 1;
      else high = middle;
    }
    return Math.max(0, low - 1);
  }

  // Shows a step; of those that are asked for meanwhile only the last is fetched.
  async show(wanted) {
    this.wanted = wanted;
    if (this.busy) return;
    this.busy = true;
    while (this.step !== this.wanted) {
      const next = this.wanted;
      const answer = await fetch(`step/${this.number}/${next}`);
      if (!answer.ok) break;
      this.picture = await answer.json();
      this.step = next;
      this.draw(true);
    }
    this.busy = false;
  }

  // Fetches what the finger answers to the newest step that is shown.
  async feel() {
    if (!this.felt || this.feels) return;
    this.feels = true;
    let step = null;
    while (step !== this.step) {
      step = this.step;
      const answer = await fetch(`felt/${this.number}/${step}`);
      if (!answer.ok) break;
      const felt = await answer.json();
      this.get("felt").setAttribute("aria-label", this.felt.take(felt));
      if (step < this.summed) this.sum.clear();
      if (step !== this.summed) this.sum.add(felt.pose, bytes(felt.counts));
      this.summed = step;
      this.get("sum").setAttribute("aria-label", `${this.sum.spikes} spikes so far`);
    }
    this.feels = false;
  }

  draw(fresh) {
    if (!this.picture) return;
    const { picture } = this;
    if (fresh) this.electrodes.take(picture);
    const shown = slot === null || !picture.slots ? null : Math.min(slot, picture.slots - 1);
    this.electrodes.show(shown);
    const canvas = this.get("electrodes");
    canvas.dataset.step = this.step;
    canvas.setAttribute("aria-label", this.electrodes.words());
    const query = shown === null ? "" : `?slot=${shown}`;
    this.get("save-png").href = `view/${this.number}/${this.step}.png${query}`;
    this.get("save-svg").href = `view/${this.number}/${this.step}.svg${query}`;
    const end = Math.min(this.times.length - 1, this.at(this.times[this.step] + 60));
    this.get("save-mp4").href = `film/${this.number}/${this.step}-${end}.mp4`;
    this.get("save-mp4").textContent = `MP4, ${(this.times[end] - this.times[this.step]).toFixed(0)} s from here`;
    if (!fresh) return;
    this.page.take(picture);
    this.get("page").setAttribute("aria-label", this.page.words());
    this.series.draw(this.times[0], this.times.at(-1), this.step);
    this.feel();
    this.get("sensor-card").hidden = !picture.image;
    if (picture.image) {
      this.sensor.take(picture.image);
      this.get("sensor").setAttribute("aria-label", `Image of ${picture.image.width} by ${picture.image.height} pixels`);
    }
    const rows = [
      ["step", `${this.step + 1} of ${this.times.length}`],
      ["time", `${this.times[this.step].toFixed(3)} s`],
      ["mode", picture.mode],
      ["intensity", `${Math.round(100 * picture.intensity)} %`],
      ["force", picture.force_n === null ? "unknown" : `${picture.force_n.toFixed(2)} N`],
      ["rate", `${(1e6 / picture.period_us).toFixed(1)} Hz`],
      ["scan", `${picture.points} points, ${picture.slots} slots`],
      ["strongest", `${picture.peak_ma.toFixed(3)} mA, ${picture.charge_uc.toFixed(3)} µC`],
      ["latency", latencyOf(picture)],
    ];
    this.get("numbers").replaceChildren(...rows.flatMap(([name, value]) => {
      const term = document.createElement("dt");
      const words = document.createElement("dd");
      term.textContent = name;
      words.textContent = value;
      return [term, words];
    }));
  }
}

const longest = () => sides.reduce((most, each) => (each.times.length > most.times.length ? each : most));

function goTo(wanted) {
  const first = longest();
  step = Math.max(0, Math.min(wanted, first.times.length - 1));
  const time = first.times[step];
  for (const each of sides) each.show(each === first ? step : each.at(time));
  find("time").value = step;
  find("time").setAttribute("aria-valuetext", `step ${step + 1}, ${time.toFixed(3)} seconds`);
  find("now").textContent = `${time.toFixed(3)} s, step ${step + 1}`;
}

function goToTime(time) {
  pause();
  goTo(longest().at(time));
}

function goToSlot(wanted) {
  pause();
  const most = Math.max(1, ...sides.map((each) => each.picture?.slots ?? 1));
  slot = wanted === null ? null : Math.max(0, Math.min(wanted, most - 1));
  find("slot").textContent = slot === null ? "all slots" : `slot ${slot + 1} of ${most}`;
  find("whole").setAttribute("aria-pressed", String(slot === null));
  for (const each of sides) each.draw(false);
}

function pause() {
  playing = null;
  find("play").textContent = "Play";
}

function play() {
  if (playing) {
    pause();
    return;
  }
  if (step >= longest().times.length - 1) goTo(0);
  playing = { since: performance.now(), from: longest().times[step] };
  find("play").textContent = "Pause";
  requestAnimationFrame(tick);
}

function tick(now) {
  if (!playing) return;
  const time = playing.from + ((now - playing.since) / 1000) * Number(find("speed").value);
  const wanted = longest().at(time);
  // Whoever wants little motion sees a few steps a second.
  if (wanted !== step && (!calm() || now - (playing.drawn ?? 0) > 500)) {
    playing.drawn = now;
    goTo(wanted);
  }
  if (wanted >= longest().times.length - 1) pause();
  else requestAnimationFrame(tick);
}

async function read() {
  const from = sides.length ? Math.min(...sides.map((each) => each.times.length)) : 0;
  const found = await (await fetch(`recordings?from=${from}`)).json();
  const first = !sides.length;
  if (first) {
    sides = found.map((about, number) => new Side(about, number));
    find("main").classList.toggle("two", sides.length > 1);
    find("title").textContent = found.map((each) => each.name).join("  |  ");
  }
  found.forEach((about, number) => sides[number].take({ ...about, from }));
  const steps = longest().times.length;
  find("time").max = Math.max(0, steps - 1);
  const ended = found.every((each) => each.ended);
  find("status").textContent = ended ? `${steps} steps` : `reading, ${steps} steps`;
  find("status").className = `status ${ended ? "runs" : "waits"}`;
  const wrong = found.filter((each) => each.wrong).map((each) => `${each.name}: ${each.wrong}`).join("; ");
  find("alert").hidden = !wrong;
  if (find("alert").textContent !== wrong) find("alert").textContent = wrong;
  if (steps && sides[0].step === null) goTo(0);
  if (!ended) setTimeout(read, AGAIN_MS);
}

find("before").addEventListener("click", () => { pause(); goTo(step - 1); });
find("after").addEventListener("click", () => { pause(); goTo(step + 1); });
find("play").addEventListener("click", play);
find("time").addEventListener("input", () => { pause(); goTo(Number(find("time").value)); });
find("speed").addEventListener("change", () => playing && (pause(), play()));
find("whole").addEventListener("click", () => goToSlot(null));
find("slot-before").addEventListener("click", () => goToSlot(slot === null ? 0 : slot - 1));
find("slot-after").addEventListener("click", () => goToSlot(slot === null ? 0 : slot + 1));

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey || event.target.matches?.("select, input")) return;
  if (event.key === " " && event.target.matches?.("button")) return;
  const does = { ArrowLeft: "before", ArrowRight: "after", " ": "play", "[": "slot-before", "]": "slot-after" };
  if (!does[event.key]) return;
  event.preventDefault();
  find(does[event.key]).click();
});

read();
