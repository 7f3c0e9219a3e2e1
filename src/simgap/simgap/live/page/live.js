"use strict";
// Follows the events of a diagnosis, each shown as it comes; at the end everything is here, and the command may go.

const at = (id) => document.getElementById(id);
const shown = (id, yes = true) => { at(id).hidden = !yes; };
const made = (tag, text = "", kind = "") => Object.assign(document.createElement(tag), { textContent: text, className: kind });
const digits = (value, n = 1) => value === null ? "broke down" : value.toFixed(n);

const plot = new Plot(at("plot"));
const source = new EventSource("events");
let begun = null, ended = false, curves = [];

source.onopen = () => shown("lost", false);
source.onerror = () => { letGo(); if (!ended) shown("lost"); };
source.onmessage = (message) => {
  const event = JSON.parse(message.data);
  begun = performance.now() - 1e3 * event.seconds;
  if (event.kind in heard) heard[event.kind](event);
};
setInterval(clock, 500);

function clock() {
  if (begun !== null && !ended) at("clock").textContent = `${Math.round((performance.now() - begun) / 1e3)} s`;
}

const heard = {
  progress({ step, stage, share }) {
    for (const item of at("steps").children) {
      if (item.dataset.step === step) {
        item.className = "now";
        item.style.setProperty("--share", `${(100 * share).toFixed(0)}%`);
        item.lastElementChild.textContent = stage === step ? "" : stage;
      } else if (item.className === "now") {
        passed(item);
      }
    }
  },

  checked({ channels, runs, duration, warnings }) {
    at("recording").textContent = `${digits(duration)} s in ${runs === 1 ? "one run" : runs + " runs"}, ${channels.length} channels: ${channels.join(", ")}.`;
    listed("warnings", warnings);
    shown("checks");
  },

  located({ shares, candidates, spoken }) {
    at("shares").replaceChildren(...shares.map(([name, share]) => row(name, 0, share, `${Math.round(100 * share)} %`)));
    at("looked").textContent = `${candidates} effects are looked at.` + (spoken.length ? ` Single parts speak for: ${spoken.join(", ")}.` : "");
    shown("where");
  },

  leading({ causes, before, after, promising, leaders }) {
    answered(causes, before, after, causes.length ? "If it ended now" : "So far no cause has earned its place");
    const low = Math.min(0, ...leaders.map((l) => l[2])), high = Math.max(0, ...leaders.map((l) => l[3])), wide = high - low || 1;
    at("leaders").replaceChildren(...leaders.map(([name, gain, from, to]) => row(name, (from - low) / wide, (to - low) / wide, digits(gain))));
    at("promising").textContent = promising.length ? `At a first look at all, most was promised by: ${promising.join(", ")}.` : "";
    shown("fitted", leaders.length > 0);
    shown("leading", leaders.length + promising.length > 0);
  },

  decided({ causes, before, after, verdict, reasons }) {
    answered(causes, before, after, "The answer");
    listed("reasons", reasons);
    judged(verdict);
  },

  async finished(event) {
    ended = true;
    shown("lost", false);
    for (const item of at("steps").children) passed(item);
    at("clock").textContent = `${digits(event.wall)} s`;
    at("what").textContent = "The diagnosis has ended";
    document.title = at("title").textContent = event.title;
    judged(event.verdict);
    at("sentences").replaceChildren(...event.sentences.map((sentence) => made("p", sentence)));
    at("file").textContent = event.file || "";
    listed("warnings", event.warnings);
    drawn("waterfall", event.waterfall);
    shown("far");
    chosen(event.curves);
    next(event);
    shown("leading", false);
    shown("end");
    try {
      // Held here, so that the link leads to it when the command is gone.
      const answer = await fetch("report.html");
      if (!answer.ok) throw new Error(answer.statusText);
      at("report").href = URL.createObjectURL(new Blob([await answer.text()], { type: "text/html" }));
      shown("report");
    } finally {
      // The command waits for this.
      if (!event.playable) source.close();
    }
  },

  playable({ robot, prepare }) {
    at("prepare").textContent = prepare;
    at("robot").textContent = robot;
    shown("play");
    shown("norobot", false);
    shown("next");
    beat = setInterval(tellHand, BEAT_MS);
  },

  plays() {
    at("told").replaceChildren();
    shown("told");
  },

  told({ sentence }) {
    at("told").append(made("li", sentence));
  },

  played({ sentence, folder, command }) {
    letGo();
    const item = made("li", sentence + (folder ? " " : ""));
    if (folder) item.append(made("code", folder), commandLine(command));
    at("played").append(item);
  },

  over() {
    letGo();
    clearInterval(beat);
    source.close();
    at("hold").disabled = true;
    at("prepare").textContent = "The command has ended: nothing is played from here any more.";
  },

  failed({ sentence }) {
    ended = true;
    source.close();
    shown("lost", false);
    at("what").textContent = "The diagnosis has ended without an answer";
    at("failure").textContent = sentence;
    shown("failure");
  },
};

function passed(item) {
  item.className = "done";
  item.style.removeProperty("--share");
  item.lastElementChild.textContent = "";
}

function answered(causes, before, after, what) {
  at("answerwhat").textContent = what;
  at("causes").replaceChildren(...causes.map(({ name, values }) => {
    const item = made("li", name + " ");
    item.append(made("small", values));
    return item;
  }));
  at("before").textContent = digits(before);
  at("after").textContent = digits(after);
  shown("answer");
}

function judged(verdict) {
  at("verdict").textContent = verdict.replace("_", " ");
  at("verdict").className = `badge ${verdict}`;
  shown("verdict");
}

function listed(id, sentences) {
  at(id).replaceChildren(...sentences.map((sentence) => made("li", sentence)));
}

function row(name, from, to, text) {
  const line = made("div"), track = made("i"), bar = made("b");
  bar.style.left = `${100 * from}%`;
  bar.style.width = `${100 * Math.max(to - from, 0)}%`;
  track.append(bar);
  line.append(made("span", name), track, made("output", text));
  return line;
}

function drawn(id, svg) {
  const parsed = new DOMParser().parseFromString(svg, "image/svg+xml").documentElement;
  at(id).replaceChildren(document.importNode(parsed, true));
}

function chosen(all) {
  curves = all;
  if (!curves.length) return;
  at("channel").replaceChildren(...curves.map(({ channel }, i) => new Option(channel, i)));
  at("window").replaceChildren(...curves[0].windows.map(({ start }, i) => new Option(`from ${start}`, i)));
  // Shown first: a canvas that is hidden has no size to draw in.
  shown("curves");
  const changed = () => {
    const { windows, channel, unit } = curves[at("channel").value];
    plot.set(windows[at("window").value], unit ? `${channel} [${unit}]` : channel);
  };
  at("channel").onchange = at("window").onchange = changed;
  at("nearer").onclick = () => plot.zoom(0.6);
  at("further").onclick = () => plot.zoom(1 / 0.6);
  at("whole").onclick = () => plot.whole();
  changed();
}

function next({ next: sentence, experiment, commands }) {
  at("experiment").textContent = [sentence, experiment && `Its command file: ${experiment}`].filter(Boolean).join(" ");
  at("commands").replaceChildren(...commands.map(commandLine));
  shown("next", Boolean(sentence) || commands.length > 0);
}

function commandLine(command) {
  const line = made("div", "", "command"), button = made("button", "copy");
  button.onclick = async () => {
    try { await navigator.clipboard.writeText(command); button.textContent = "copied"; }
    catch { getSelection().selectAllChildren(line.firstChild); button.textContent = "selected"; }
  };
  line.append(made("code", command), button);
  return line;
}

// The button that plays the next experiment, only while it is held: by a pointer, the space bar or Enter.

const HAND_MS = 50;  // four times in the 0.25 s after which silence lets go
const BEAT_MS = 500;
const WAITING = 3;   // more than these unanswered, and what is said now would only come late
const hand = { viewer: 0, presses: 0, press: 0, timer: 0, pointer: null, waiting: 0 };
let beat = 0;

source.addEventListener("you", (message) => { letGo(); hand.viewer = Number(message.data); });

async function tellHand() {
  const press = hand.press;
  if (press && hand.waiting >= WAITING) return;
  hand.waiting++;
  const body = JSON.stringify({ viewer: hand.viewer, press, sent: performance.now() });
  try {
    const answer = await fetch("hand", { method: "POST", body, headers: { "Content-Type": "application/json" }, keepalive: press === 0, signal: AbortSignal.timeout(2000) });
    const refused = await answer.text();
    if (refused) {
      at("refused").textContent = refused;
      shown("refused");
      if (hand.press === press) letGo();
    }
  } catch { /* Silence lets go by itself. */ } finally { hand.waiting--; }
}

function press(pointer) {
  if (hand.press || at("hold").disabled) return;
  hand.pointer = pointer;
  hand.press = ++hand.presses;
  shown("refused", false);
  at("hold").classList.add("held");
  tellHand();
  hand.timer = setInterval(tellHand, HAND_MS);
}

function letGo() {
  if (!hand.press) return;
  clearInterval(hand.timer);
  hand.press = 0;
  hand.pointer = null;
  at("hold").classList.remove("held");
  tellHand();
}

at("hold").addEventListener("pointerdown", (event) => {
  if (event.button !== 0) return;
  at("hold").setPointerCapture(event.pointerId);
  press(event.pointerId);
});
for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
  at("hold").addEventListener(end, (event) => { if (event.pointerId === hand.pointer) letGo(); });
}
at("hold").addEventListener("keydown", (event) => {
  if (event.key !== " " && event.key !== "Enter") return;
  event.preventDefault();
  if (!event.repeat) press(event.key);
});
at("hold").addEventListener("keyup", (event) => { if (event.key === hand.pointer) letGo(); });
at("hold").addEventListener("contextmenu", (event) => event.preventDefault());
at("hold").addEventListener("blur", letGo);
window.addEventListener("blur", letGo);
window.addEventListener("pagehide", letGo);
document.addEventListener("visibilitychange", () => { if (document.hidden) letGo(); });
