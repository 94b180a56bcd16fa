// Page of a run: shows its newest state, controls it and stops it.

import { ElectrodesView, PageView, SensorView, SeriesView, bytes, calm, latencyOf } from "./views.js";
import { SlotPlayer } from "./slots.js";

const find = (id) => document.getElementById(id);
const CALM_MS = 500;
const WORDS_MS = 1000;
const MOST_EVENTS = 200;

let socket;
let over = false;
let views = {};
let player;
let array;
let keys = [];
let state;
let newest = null;
let asked = false;
let drawnAt = 0;
let saidAt = 0;
let slidAt = -Infinity;

function say(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(message);
}

function stop() {
  if (over) return;
  say("stop");
  // Also send a request, because the connection of the socket may be lost.
  fetch("stop", { method: "POST", keepalive: true }).catch(() => {});
  setStatus("stopping …", "waits");
}

function alertUser(words) {
  find("alert").hidden = !words;
  if (find("alert").textContent !== words) find("alert").textContent = words;
}

function setStatus(words, kind) {
  if (find("status").textContent !== words) find("status").textContent = words;
  find("status").className = `status ${kind}`;
}

function connect() {
  socket = new WebSocket(new URL("socket", location.href.replace(/^http/, "ws")));
  socket.addEventListener("message", ({ data }) => {
    const message = JSON.parse(data);
    if (message.type === "hello") greet(message);
    else if (message.type === "update") update(message);
    else end(message);
  });
  socket.addEventListener("close", () => {
    if (over) return;
    setStatus("not connected", "waits");
    alertUser("The connection is lost. Stop may still end the run. If it does not, press q in the terminal, or type: smarttouch stop");
    disable(true);
    setTimeout(connect, 1000);
  });
}

function greet(hello) {
  alertUser("");
  over = false;
  newest = null;
  find("stop").disabled = false;
  array = hello.array;
  keys = hello.keys;
  find("keys").textContent = hello.keys_help.trim();
  find("full").textContent = `+${array.full_ma.toFixed(1)} mA`;
  find("full-anodic").textContent = `−${array.full_ma.toFixed(1)} mA`;
  for (const id of ["electrodes-card", "page-card", "series-card", "table-card"]) find(id).hidden = hello.blind;
  views = {
    electrodes: new ElectrodesView(find("electrodes"), array),
    sensor: new SensorView(find("sensor")),
    page: new PageView(find("page"), array),
    series: new SeriesView(find("series"), array),
  };
  views.moves = hello.moves;
  find("page").style.touchAction = hello.moves ? "none" : "";
  player ??= new SlotPlayer(find);
  player.view = views.electrodes;
  views.blind = hello.blind;
  views.board = hello.board;
  find("modes").replaceChildren(...hello.modes.map((mode) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = mode;
    button.dataset.mode = mode;
    button.addEventListener("click", () => say(`do mode:${mode}`));
    return button;
  }));
  find("events").replaceChildren();
  disable(false);
}

function disable(off) {
  for (const id of ["less", "more", "slider", "none", "pause", "steer"]) find(id).disabled = off;
  for (const each of find("modes").children) each.disabled = off;
}

function update(message) {
  say("seen");
  state = message.state;
  state.events.forEach(note);
  if (message.picture) newest = message.picture;
  if (message.sheet !== undefined) views.page.lay(message.sheet, `sheet.png?n=${message.sheet?.number}-${Date.now()}`);
  if (message.picture && !views.blind) views.series.take(message.picture);
  if (message.refused) alertUser(message.refused);
  if (!asked) {
    asked = true;
    requestAnimationFrame(draw);
  }
}

function draw(now) {
  asked = false;
  if (over || socket.readyState !== WebSocket.OPEN) return;
  if (calm() && now - drawnAt < CALM_MS) return;
  drawnAt = now;
  showState();
  if (newest && newest !== views.shown) {
    views.shown = newest;
    player.take(newest);
    if (!find("page-card").hidden) views.page.take(newest);
    find("sensor-card").hidden = !newest.image;
    if (newest.image) views.sensor.take(newest.image);
  }
  if (now - saidAt > WORDS_MS) {
    saidAt = now;
    describe();
  }
}

// Describes the pictures for screen readers, at most once a second, so that they can be read out.
function describe() {
  if (!newest) return;
  find("electrodes").setAttribute("aria-label", views.electrodes.words());
  find("page").setAttribute("aria-label", views.page.words());
  find("series").setAttribute("aria-label", `Strongest current ${newest.peak_ma.toFixed(2)} mA, charge ${newest.charge_uc.toFixed(3)} µC, force ${(newest.force_n ?? 0).toFixed(2)} N`);
  if (newest.image) {
    const grey = bytes(newest.image.grey);
    const dark = Math.round((100 * grey.filter((each) => each < 128).length) / grey.length);
    find("sensor").setAttribute("aria-label", `Image of ${newest.image.width} by ${newest.image.height} pixels, ${dark} % of it dark`);
  }
  if (!find("table-more").open || !views.electrodes.current) return;
  find("currents").replaceChildren(...[...views.electrodes.current].flatMap((current, at) => {
    if (!current) return [];
    const row = document.createElement("tr");
    for (const text of [at, (current / 1000).toFixed(3)]) {
      const cell = document.createElement("td");
      cell.textContent = text;
      row.append(cell);
    }
    return [row];
  }));
}

function showState() {
  find("title").textContent = `${state.title}  →  ${array.profile}  →  ${views.board}`;
  find("level").textContent = Math.round(100 * state.level);
  find("most").textContent = Math.round(100 * state.most);
  find("slider").max = 100 * state.most;
  if (performance.now() - slidAt > CALM_MS) find("slider").value = 100 * state.level;
  find("words-read").textContent = state.words;
  find("pause").textContent = state.paused ? "Resume" : "Pause";
  find("pause").setAttribute("aria-pressed", String(state.paused));
  const mine = state.steers === "you";
  find("steer").setAttribute("aria-pressed", String(mine));
  find("steer").textContent = mine ? "Leave" : "Steer";
  find("steers").textContent = `${state.steers === "you" ? "this page" : state.steers === "nobody" ? "nobody" : "another page"} steers`;
  disable(state.steers === "another");
  if (state.level >= state.most) find("more").disabled = true;
  for (const each of find("modes").children) each.setAttribute("aria-pressed", String(each.dataset.mode === state.mode));
  if (state.phase !== "running") setStatus(state.phase, "waits");
  else setStatus(state.paused ? "paused" : state.level ? "running" : "running at zero intensity", state.paused ? "waits" : "runs");
  const { limits } = array;
  const picture = views.blind ? null : newest;
  table([
    ["time", `${state.time_s.toFixed(1)} s`],
    ["mode", state.mode],
    picture && ["delivered intensity", `${Math.round(100 * picture.intensity)} %`],
    ["force", state.force_n === null ? "unknown" : `${state.force_n.toFixed(2)} N`],
    picture && ["rate", `${(1e6 / picture.period_us).toFixed(1)} Hz`],
    picture && ["scan", `${picture.points} points, ${picture.slots} slots`],
    picture && ["latency", latencyOf(picture)],
    ...(views.blind ? [] : [
      ["session", `${state.dose_s.toFixed(0)} of ${limits.session_s} s`],
      ["dose", `${state.dose_mc.toFixed(2)} of ${limits.session_mc} mC`],
      ["sequences", `${state.sequences}, ${state.acknowledged} acknowledged`],
      ["late", String(state.late)],
      ["computing", `${(100 * state.work_share).toFixed(1)} % of the time`],
    ]),
  ].filter(Boolean));
}

// Returns the value elements of a list of terms. They are replaced only if the names change.
function rows(id, names, make) {
  const list = find(id);
  if (list.dataset.names !== names.join()) {
    list.dataset.names = names.join();
    list.replaceChildren(...names.flatMap(make));
  }
  return [...list.querySelectorAll("dd.value")];
}

function term(name) {
  const term = document.createElement("dt");
  term.textContent = name;
  return term;
}

function value() {
  const value = document.createElement("dd");
  value.className = "value";
  return value;
}

function table(given) {
  const values = rows("numbers", given.map(([name]) => name), (name) => [term(name), value()]);
  given.forEach(([, words], at) => {
    values[at].textContent = words;
  });
}

function note({ time_s, text }) {
  const item = document.createElement("p");
  const time = document.createElement("time");
  time.textContent = `${time_s.toFixed(1)} s`;
  item.append(time, text);
  find("events").prepend(item);
  while (find("events").children.length > MOST_EVENTS) find("events").lastChild.remove();
}

function end({ reason, failed }) {
  if (state) draw(Infinity);
  over = true;
  setStatus("ended", "waits");
  alertUser(failed ? `The run has failed: ${reason}` : `The run is over: ${reason || "it was ended"}. All electrodes are off.`);
  disable(true);
  find("stop").disabled = true;
}

// The pointer moves the finger on the page or texture.
find("page").addEventListener("pointermove", (event) => {
  const place = views.moves && views.page.under(event);
  if (place) say(`move ${place.join(" ")}`);
});
find("stop").addEventListener("click", stop);
find("less").addEventListener("click", () => say("do less"));
find("more").addEventListener("click", () => say("do more"));
find("none").addEventListener("click", () => say("do none"));
find("pause").addEventListener("click", () => say(state?.paused ? "do resume" : "do pause"));
find("slider").addEventListener("input", () => {
  slidAt = performance.now();
  say(`do level:${Number(find("slider").value) / 100}`);
});
find("steer").addEventListener("click", () => say(state?.steers === "you" ? "leave" : "steer"));

const ARROWS = { ArrowLeft: "left", ArrowRight: "right", Enter: "\n" };

document.addEventListener("keydown", (event) => {
  if (event.key === "Escape" || event.key === " ") {
    event.preventDefault();
    event.stopPropagation();
    // While another page has control, this page can only stop the run.
    if (event.key === "Escape" || find("pause").disabled) stop();
    else if (!event.repeat) find("pause").click();
    return;
  }
  if (event.ctrlKey || event.altKey || event.metaKey || event.target.matches?.("select, #slider")) return;
  if (event.key === "Enter" && event.target !== document.body) return;
  const key = ARROWS[event.key] ?? event.key;
  const own = { "+": "do more", "=": "do more", "-": "do less", "_": "do less", 0: "do none" };
  if (keys.includes(key)) say(`do key:${key}`);
  else if (own[key]) say(own[key]);
  else return;
  event.preventDefault();
}, true);
// Otherwise a focused button would also act when the space bar is released.
document.addEventListener("keyup", (event) => {
  if (event.key === " ") event.preventDefault();
}, true);

connect();
