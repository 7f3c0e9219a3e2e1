"use strict";
// The page's line to the graph: what the hands do goes out, what the mouse does comes in. No text that comes in is
// ever taken for HTML.

const STICK_PERIOD_MS = 50;    // four times in the 0.25 s after which silence stops the mouse
const BEAT_PERIOD_MS = 500;
const LOST_MS = 1500;          // without a word from the robot
const RELEASE_MS = 1000;
const CENTRE = 0.08;           // of the stick's radius: rest, not a wish
const LEGS = ["front left", "front right", "rear left", "rear right"];
const FULL_LOAD_N = 2.0;

const $ = (id) => document.getElementById(id);
let line = null, me = 0, heardAt = -Infinity, state = null;

const send = (message) => {
  if (line && line.readyState === WebSocket.OPEN) line.send(JSON.stringify(message));
};

// --- The line

function open() {
  line = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/line`);
  line.onmessage = (event) => {
    heardAt = performance.now();
    const message = JSON.parse(event.data);
    ({ hello, state: show, parameters, said })[message.kind](message);
  };
  line.onopen = tellStop;
  line.onclose = () => { letGo(); setTimeout(open, 1000); };
}
setInterval(() => {
  send({ kind: "beat", sent: performance.now() });
  const lost = performance.now() - heardAt > LOST_MS;
  if (lost) {
    $("status").textContent = (stopWanted ? "STOP has not arrived: " : "") + "no word from the robot: trying to reach it …";
    $("status").className = "bad";
  }
  tellStop();
  document.body.dataset.connected = !lost;
}, BEAT_PERIOD_MS);

let saidTimer = 0;
function said(message) {
  const box = $("said");
  box.textContent = message.text;
  box.className = message.good ? "good" : "";
  box.hidden = false;
  clearTimeout(saidTimer);
  saidTimer = setTimeout(() => { box.hidden = true; }, message.good ? 2000 : 6000);
}

// --- The stick, which drives only while it is pressed

const stick = { presses: 0, held: 0, forward: 0, turn: 0, timer: 0, pointer: null };

function tellStick() {
  send({ kind: "stick", sent: performance.now(), press: stick.held, forward: stick.forward, turn: stick.turn });
}
function moveStick(event) {
  const box = $("stick").getBoundingClientRect(), radius = box.width / 2;
  let x = (event.clientX - box.left - radius) / radius, y = (event.clientY - box.top - radius) / radius;
  const far = Math.max(1, Math.hypot(x, y));
  x /= far; y /= far;
  $("knob").style.transform = `translate(${x * (radius - 32)}px, ${y * (radius - 32)}px)`;
  const rest = (value) => Math.sign(value) * Math.max(0, Math.abs(value) - CENTRE) / (1 - CENTRE);
  stick.forward = rest(-y); stick.turn = rest(-x);
}
function press(event) {
  if (stick.held) return;
  stick.pointer = event.pointerId;
  $("stick").setPointerCapture(event.pointerId);
  event.preventDefault();
  stick.held = ++stick.presses;
  $("stick").classList.add("held");
  moveStick(event);
  tellStick();
  stick.timer = setInterval(tellStick, STICK_PERIOD_MS);
}
function letGo() {
  if (!stick.held) return;
  clearInterval(stick.timer);
  Object.assign(stick, { held: 0, forward: 0, turn: 0, pointer: null });
  $("stick").classList.remove("held");
  $("knob").style.transform = "";
  tellStick();
}
$("stick").addEventListener("pointerdown", press);
$("stick").addEventListener("pointermove", (event) => { if (event.pointerId === stick.pointer) moveStick(event); });
for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
  $("stick").addEventListener(end, (event) => { if (event.pointerId === stick.pointer) letGo(); });
}
$("stick").addEventListener("contextmenu", (event) => event.preventDefault());
window.addEventListener("blur", letGo);
window.addEventListener("pagehide", letGo);
document.addEventListener("visibilitychange", () => { if (document.hidden) letGo(); });

// --- Stop, and its deliberate end

// A stop that is pressed while the line is down must not be lost: it is said again until the robot's side says it is
// stopped, also by a line that is opened later.
let stopWanted = false;
function tellStop() { if (stopWanted) send({ kind: "stop" }); }
function pressStop() { letGo(); stopWanted = true; tellStop(); }
$("stop").addEventListener("pointerdown", pressStop);
$("stop").addEventListener("keydown", (event) => { if (event.key === "Enter" || event.key === " ") pressStop(); });
let releaseTimer = 0;
function holdRelease(event) {
  event.preventDefault();
  $("release").classList.add("held");
  clearTimeout(releaseTimer);
  releaseTimer = setTimeout(() => { endRelease(); send({ kind: "release" }); }, RELEASE_MS);
}
function endRelease() { clearTimeout(releaseTimer); $("release").classList.remove("held"); }
$("release").addEventListener("pointerdown", holdRelease);
for (const end of ["pointerup", "pointercancel", "pointerleave"]) $("release").addEventListener(end, endRelease);

// --- Settings of the walk

const touched = new Map();  // controls that a hand has just moved are not moved back by what the robot said before
const touch = (element) => touched.set(element, performance.now());
const atRest = (element) => performance.now() - (touched.get(element) ?? -Infinity) > 1000;

function setting(element, event, make) {
  element.addEventListener("input", () => touch(element));
  element.addEventListener(event, () => { touch(element); send({ kind: "settings", ...make(element) }); });
}
setting($("gait"), "change", (e) => ({ gait: e.value }));
setting($("frequency"), "change", (e) => ({ frequency: Number(e.value) }));
setting($("pace"), "change", (e) => ({ speed: Number(e.value) }));
setting($("straight"), "change", (e) => ({ straight_line: e.checked }));
for (const button of document.querySelectorAll("[data-posture]")) {
  button.addEventListener("click", () => send({ kind: "posture", posture: button.dataset.posture }));
}

$("record").addEventListener("click", () => send({ kind: "record", on: !$("record").classList.contains("on") }));

let limits = null;
function hello(message) {
  me = message.you; limits = message;
  document.body.classList.toggle("recording", message.recording !== "");
  stick.held = 0;
  [$("frequency").min, $("frequency").max] = message.frequency_hz;
  $("pace").max = message.speed_steps;
  $("spine").replaceChildren(...message.spine.map((name) => {
    const box = Object.assign(document.createElement("input"), { type: "checkbox", name });
    setting(box, "change", () => ({ spine: { [name]: box.checked } }));
    const label = Object.assign(document.createElement("label"), { className: "check" });
    label.append(box, ` ${name.replaceAll("_", " ")}`);
    return label;
  }));
  $("loads").replaceChildren(...LEGS.flatMap((leg) => {
    const bar = document.createElement("div");
    bar.append(document.createElement("i"));
    return [Object.assign(document.createElement("span"), { textContent: leg }), bar, document.createElement("output")];
  }));
}

// --- What the mouse does

const put = (id, text) => { if ($(id).textContent !== text) $(id).textContent = text; };

function show(message) {
  state = message;
  if (message.stopped) stopWanted = false;
  put("speed", (100 * message.speed_m_s).toFixed(1));
  put("commanded", (100 * message.commanded_m_s).toFixed(1));
  put("turn", (message.turn_rad_s * 180 / Math.PI).toFixed(0));
  $("stopped").hidden = !(message.stopped || message.power.startsWith("limp"));
  put("power", message.power);
  const trouble = message.trouble.join(" · ");
  put("status", trouble || limits.recording || (message.viewers > 1 ? `${message.viewers} look at this page` : ""));
  $("status").className = trouble ? "bad" : "";
  const other = message.drives !== null && message.drives !== me;
  $("stick").classList.toggle("refused", other || message.stopped);
  put("driver", message.stopped ? "Stopped. Release it to drive." : other ? `Viewer ${message.drives} drives.`
    : message.drives === me ? "You drive. Let go to stop." : "Press the stick to drive; let go to stop.");
  walk(message.settings);
  watch(message.cameras);
  const loads = $("loads").children;
  LEGS.forEach((_, leg) => {
    const load = message.loads_n?.[leg];
    loads[3 * leg + 1].firstChild.style.width = `${Math.min(100, 100 * Math.max(0, load ?? 0) / FULL_LOAD_N)}%`;
    loads[3 * leg + 2].textContent = load === undefined ? "-" : `${load.toFixed(2)} N`;
  });
  const records = message.recorder && message.recorded !== null;
  $("record").disabled = !message.recorder;
  $("record").classList.toggle("on", records);
  put("record", records ? "End recording" : "Record");
  put("recorded", !message.recorder ? "no recorder here" : records ? `${message.recorded} messages` : "");
  const facts = { posture: message.posture, servos: message.power || "-", place: message.place_m ? `${message.place_m.slice(0, 2).map((v) => v.toFixed(2)).join(", ")} m` : "-",
    battery: message.battery_v === null ? "-" : `${message.battery_v.toFixed(2)} V`, "× real time": message.pace || "-" };
  const list = $("facts");
  Object.entries(facts).forEach(([name, value], row) => {
    if (!list.children[2 * row]) {
      list.append(Object.assign(document.createElement("dt"), { textContent: name }), document.createElement("dd"));
    }
    list.children[2 * row + 1].textContent = value;
  });
}

// --- Cameras: each picture is asked for when the one before is there, so that a slow line carries few

const PICTURE_MS = 100;
function watch(topics) {
  const box = $("cameras");
  if ([...box.children].map((f) => f.dataset.topic).join() === topics.join()) return;
  box.replaceChildren(...topics.map((topic, number) => {
    const figure = document.createElement("figure"), image = document.createElement("img");
    figure.dataset.topic = image.alt = topic;
    let count = 0;
    const next = () => { if (figure.isConnected) image.src = `camera/${number}?${++count}`; };
    image.onload = image.onerror = () => setTimeout(next, PICTURE_MS);
    figure.append(image, Object.assign(document.createElement("figcaption"), { textContent: topic }));
    setTimeout(next, 0);
    return figure;
  }));
}

function walk(settings) {
  const gait = $("gait");
  if ([...gait.options].map((o) => o.value).join() !== settings.gaits.join()) {
    gait.replaceChildren(...settings.gaits.map((name) => new Option(name.replaceAll("_", " "), name)));
  }
  if (atRest(gait)) gait.value = settings.gait;
  if (atRest($("frequency"))) $("frequency").value = settings.frequency_hz;
  if (atRest($("pace"))) $("pace").value = settings.speed;
  if (atRest($("straight"))) $("straight").checked = settings.straight_line;
  put("frequency_out", `${Number($("frequency").value).toFixed(1)} Hz`);
  put("pace_out", `${(100 * limits.max_forward_m_s * $("pace").value / limits.speed_steps).toFixed(1)} cm/s`);
  for (const box of $("spine").querySelectorAll("input")) if (atRest(box)) box.checked = settings.spine[box.name];
}

// --- Parameters of the nodes

const rows = new Map();  // by node and name: how to show a value

function parameters(message) {
  const box = $("parameters"), there = new Set();
  for (const { node, parameters } of message.nodes) {
    let group = box.querySelector(`details[data-node="${CSS.escape(node)}"]`);
    if (!group) {
      group = document.createElement("details");
      group.dataset.node = node;
      group.append(Object.assign(document.createElement("summary"), { textContent: node.replaceAll("_", " ") }));
      box.append(group);
    }
    for (const parameter of parameters) {
      const key = `${node}/${parameter.name}`;
      there.add(key);
      if (!rows.has(key)) rows.set(key, makeRow(group, node, parameter));
      rows.get(key).show(parameter.value);
    }
  }
  for (const [key, row] of rows) if (!there.has(key)) { row.label.remove(); rows.delete(key); }
  for (const group of [...box.children]) if (!group.querySelector("label")) group.remove();
  filter();
}

function makeRow(group, node, { name, type, text, lower, upper }) {
  const label = Object.assign(document.createElement("label"), { className: type === "bool" ? "parameter check" : "parameter", title: text });
  const unit = /\[([^\]]+)\]$/.exec(text)?.[1];
  const tell = (value) => { if (value !== null) send({ kind: "parameter", node, name, value }); };
  const entry = document.createElement("input");
  label.append(type === "bool" ? entry : `${name}${unit ? ` [${unit}]` : ""}`);
  const inputs = [entry];
  const number = type === "number" || type === "integer";
  if (type === "bool") { entry.type = "checkbox"; label.append(name); }
  else if (number) { entry.type = "number"; entry.step = type === "integer" ? 1 : "any"; label.append(entry); }
  else { entry.type = "text"; label.append(entry); }
  entry.dataset.parameter = `${node}/${name}`;
  const read = (value) => type === "numbers" ? value.split(",").map(Number) : number ? (value === "" ? null : Number(value)) : value;
  let typing = false;  // what is half written is not written over
  entry.addEventListener("input", () => { typing = true; });
  entry.addEventListener("blur", () => { typing = false; });
  entry.addEventListener("change", () => { typing = false; tell(type === "bool" ? entry.checked : read(entry.value)); });
  if (number && lower != null && upper != null) {
    const slider = Object.assign(document.createElement("input"), { type: "range", min: lower, max: upper, step: type === "integer" ? 1 : "any" });
    slider.dataset.slider = `${node}/${name}`;
    slider.addEventListener("input", () => { typing = true; entry.value = short(Number(slider.value)); });
    slider.addEventListener("change", () => { typing = false; tell(Number(short(Number(slider.value)))); });
    label.append(slider);
    inputs.push(slider);
  }
  group.append(label);
  const show = (value) => {
    if (typing) return;
    for (const input of inputs) {
      if (type === "bool") input.checked = value;
      else input.value = value === null ? "" : type === "number" ? short(value) : String(value);
    }
  };
  return { label, show, words: `${node} ${name} ${text}`.toLowerCase() };
}
const short = (value) => String(Number(value.toPrecision(4)));

function filter() {
  const wanted = $("filter").value.trim().toLowerCase();
  for (const row of rows.values()) row.label.hidden = wanted !== "" && !row.words.includes(wanted);
  for (const group of $("parameters").children) {
    group.hidden = !group.querySelector("label:not([hidden])");
    if (wanted) group.open = true;
  }
}
$("filter").addEventListener("input", filter);

// --- The scene, as a page of another name where this machine has two: browsers give it a process of its own then, and
// drawing, which is slow without a graphics card, does not hold up the stick

const OTHER_NAME = { "127.0.0.1": "localhost", localhost: "127.0.0.1" }[location.hostname] ?? location.hostname;
$("scene").src = `//${OTHER_NAME}:${location.port}/3d/`;

open();
