"use strict";
// One window of one channel on a canvas, to zoom: drag a stretch of time, turn the wheel, or press the buttons.

class Plot {
  constructor(canvas) {
    this.canvas = canvas;
    this.window = null;
    this.unit = "";
    this.span = [0, 1];
    this.dragged = null;
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || !this.window) return;
      canvas.setPointerCapture(event.pointerId);
      this.dragged = [this.timeAt(event), this.timeAt(event)];
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!this.dragged) return;
      this.dragged[1] = this.timeAt(event);
      this.draw();
    });
    canvas.addEventListener("pointerup", () => {
      const [one, other] = this.dragged || [0, 0];
      this.dragged = null;
      if (Math.abs(other - one) > 0.02 * (this.span[1] - this.span[0])) this.show(Math.min(one, other), Math.max(one, other));
      else this.draw();
    });
    canvas.addEventListener("pointercancel", () => { this.dragged = null; this.draw(); });
    canvas.addEventListener("dblclick", () => this.whole());
    canvas.addEventListener("wheel", (event) => {
      if (!this.window) return;
      event.preventDefault();
      this.zoom(Math.exp(0.0015 * event.deltaY), this.timeAt(event));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const step = 0.2 * (this.span[1] - this.span[0]);
      const act = { "+": () => this.zoom(0.7), "-": () => this.zoom(1 / 0.7), Escape: () => this.whole(),
        ArrowLeft: () => this.show(this.span[0] - step, this.span[1] - step),
        ArrowRight: () => this.show(this.span[0] + step, this.span[1] + step) }[event.key];
      if (act) { event.preventDefault(); act(); }
    });
    new ResizeObserver(() => this.draw()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  set(window_, unit) {
    this.window = window_;
    this.unit = unit;
    this.whole();
  }

  whole() {
    const time = this.window.time;
    this.show(time[0], time[time.length - 1]);
  }

  zoom(factor, about = 0.5 * (this.span[0] + this.span[1])) {
    this.show(about + factor * (this.span[0] - about), about + factor * (this.span[1] - about));
  }

  // Never beyond the window, nor nearer than four samples.
  show(low, high) {
    const time = this.window.time, [first, last] = [time[0], time[time.length - 1]];
    const least = 4 * (last - first) / Math.max(time.length - 1, 4);
    const width = Math.min(Math.max(high - low, least), last - first);
    low = Math.min(Math.max(0.5 * (low + high) - 0.5 * width, first), last - width);
    this.span = [low, low + width];
    this.canvas.dataset.span = this.span.map((v) => v.toFixed(4)).join(" ");
    this.draw();
  }

  timeAt(event) {
    const box = this.canvas.getBoundingClientRect();
    const share = (event.clientX - box.left - Plot.LEFT) / Math.max(box.width - Plot.LEFT - Plot.RIGHT, 1);
    return this.span[0] + Math.min(Math.max(share, 0), 1) * (this.span[1] - this.span[0]);
  }

  // Values that are seen, and one beyond at each side, so that lines reach the edge.
  seen(values) {
    const time = this.window.time, found = [];
    for (let i = 0; i < time.length; i++) {
      if (time[Math.min(i + 1, time.length - 1)] >= this.span[0] && time[Math.max(i - 1, 0)] <= this.span[1]) found.push([time[i], values[i]]);
    }
    return found;
  }

  draw() {
    const box = this.canvas.getBoundingClientRect();
    if (!this.window || !box.width) return;
    const ratio = window.devicePixelRatio || 1, style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(name).trim();
    this.canvas.width = Math.round(box.width * ratio);
    this.canvas.height = Math.round(box.height * ratio);
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.font = "12px " + getComputedStyle(document.body).fontFamily;
    const lines = [["measured", "--measured", 6], ["nominal", "--orange", 1.8], ["after", "--blue", 1.8]]
      .map(([key, name, width]) => [this.seen(this.window[key]), colour(name), width]);
    const known = lines.flatMap(([points]) => points.map((p) => p[1])).filter((v) => v !== null);
    let low = Math.min(...known), high = Math.max(...known);
    if (!known.length) [low, high] = [0, 1];
    const edge = 0.06 * (high - low) || 1e-9;
    [low, high] = [low - edge, high + edge];
    const right = box.width - Plot.RIGHT, bottom = box.height - Plot.BOTTOM;
    const x = (t) => Plot.LEFT + (t - this.span[0]) / (this.span[1] - this.span[0]) * (right - Plot.LEFT);
    const y = (v) => bottom - (v - low) / (high - low) * (bottom - Plot.TOP);
    pen.strokeStyle = colour("--line");
    pen.fillStyle = colour("--quiet");
    for (const [value, text] of ticks(low, high, 5)) {
      pen.beginPath(); pen.moveTo(Plot.LEFT, y(value)); pen.lineTo(right, y(value)); pen.stroke();
      pen.textAlign = "right"; pen.textBaseline = "middle"; pen.fillText(text, Plot.LEFT - 6, y(value));
    }
    for (const [value, text] of ticks(this.span[0], this.span[1], Math.min(8, box.width / 90))) {
      pen.textAlign = "center"; pen.textBaseline = "top"; pen.fillText(text, x(value), bottom + 6);
    }
    pen.textAlign = "left"; pen.textBaseline = "bottom"; pen.fillText(this.unit, 2, Plot.TOP - 4);
    pen.textAlign = "right"; pen.fillText("s", right + 10, bottom + 20);
    pen.save();
    pen.beginPath(); pen.rect(Plot.LEFT, Plot.TOP, right - Plot.LEFT, bottom - Plot.TOP); pen.clip();
    for (const [points, stroke, width] of lines) {
      pen.strokeStyle = stroke; pen.lineWidth = width; pen.lineJoin = "round"; pen.beginPath();
      let down = false;
      for (const [t, v] of points) {
        if (v === null) { down = false; continue; }
        if (down) pen.lineTo(x(t), y(v)); else pen.moveTo(x(t), y(v));
        down = true;
      }
      pen.stroke();
    }
    pen.restore();
    if (this.dragged) {
      pen.globalAlpha = 0.15;
      pen.fillStyle = colour("--blue");
      pen.fillRect(x(this.dragged[0]), Plot.TOP, x(this.dragged[1]) - x(this.dragged[0]), bottom - Plot.TOP);
      pen.globalAlpha = 1;
    }
  }
}
Plot.LEFT = 62; Plot.RIGHT = 16; Plot.TOP = 22; Plot.BOTTOM = 26;

// Round values between two, about so many, with their texts.
function ticks(low, high, count) {
  const rough = (high - low) / Math.max(count, 1), power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((s) => s * power >= rough);
  const digits = Math.max(0, -Math.floor(Math.log10(step)));
  const found = [];
  for (let i = Math.ceil(low / step); i * step <= high; i++) found.push([i * step, (i * step).toFixed(Math.min(digits, 9))]);
  return found;
}
