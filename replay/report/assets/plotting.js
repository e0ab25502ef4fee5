"use strict";
/* Colours, packed columns and the plane of a track. */

const COLOURS = {
  forward: "#1565c0", smoothed: "#7b1fa2", autopilot: "#ef8f00", truth: "#2e7d32",
  gnss: "#78909c", refused: "#d32f2f", innovation: "#1565c0", gate: "#1565c0",
  GDOP: "#37474f", HDOP: "#00838f", VDOP: "#c2185b",
};
const OTHERS = ["#00838f", "#6d4c41", "#c2185b", "#558b2f", "#4527a0", "#ef8f00", "#37474f"];
const MODES = {
  "aligning": "#b0bec5", "heading unknown": "#ffca28", "navigating": "#66bb6a", "coasting": "#ff7043",
};
const LEVELS = { info: "#546e7a", warning: "#b36b00", error: "#b3261e" };

function colourOf(name) {
  if (COLOURS[name]) return COLOURS[name];
  let hash = 0;
  for (const c of name) hash = (hash * 31 + c.charCodeAt(0)) >>> 0;
  return OTHERS[hash % OTHERS.length];
}

/* Little-endian float32 in base64 as numbers, null for what is none. */
function unpack(text) {
  const raw = atob(text);
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return Array.from(new Float32Array(bytes.buffer), (x) => (Number.isFinite(x) ? x : null));
}

/* A canvas as sharp as the screen; its drawing context in CSS pixels. */
function sharp(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const g = canvas.getContext("2d");
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.clearRect(0, 0, width, height);
  return [g, width, height];
}

/* A length that a scale bar can show: 1, 2 or 5 times a power of ten, at most `most`. */
function roundLength(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return power * (most >= 5 * power ? 5 : most >= 2 * power ? 2 : 1);
}

/* Tracks on a plane of north and east, with scale bar and north arrow.
   `tracks`: [{of, t, n, e, dots}] with arrays; `onPoint(t)` is told the time under the pointer. */
class Plane {
  constructor(canvas, onPoint) {
    this.canvas = canvas;
    this.onPoint = onPoint;
    this.tracks = [];
    this.outages = [];
    this.marked = null;
    this.window = null;
    this.view = null;
    canvas.addEventListener("wheel", (e) => this.wheel(e), { passive: false });
    canvas.addEventListener("pointerdown", (e) => this.down(e));
    canvas.addEventListener("pointermove", (e) => this.move(e));
    canvas.addEventListener("pointerup", () => { this.held = null; });
    canvas.addEventListener("dblclick", () => { this.view = null; this.draw(); });
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  fit(width, height) {
    let [n0, n1, e0, e1] = [Infinity, -Infinity, Infinity, -Infinity];
    // What was flown fills the plane; a fix from far away must not shrink it to a dot.
    const flown = this.tracks.filter((t) => !t.dots);
    for (const track of flown.length ? flown : this.tracks) {
      for (let i = 0; i < track.n.length; i++) {
        if (track.n[i] === null || track.e[i] === null) continue;
        n0 = Math.min(n0, track.n[i]); n1 = Math.max(n1, track.n[i]);
        e0 = Math.min(e0, track.e[i]); e1 = Math.max(e1, track.e[i]);
      }
    }
    if (!(n1 >= n0)) [n0, n1, e0, e1] = [-1, 1, -1, 1];
    const span = Math.max((n1 - n0) / (height - 60), (e1 - e0) / (width - 60), 0.02);
    this.view = { n: (n0 + n1) / 2, e: (e0 + e1) / 2, metres: span };
  }

  at(n, e) {
    const v = this.view;
    return [this.width / 2 + (e - v.e) / v.metres, this.height / 2 - (n - v.n) / v.metres];
  }

  draw() {
    const [g, width, height] = sharp(this.canvas);
    if (!width || !height) return;
    this.width = width; this.height = height;
    if (!this.view) this.fit(width, height);
    for (const track of this.tracks) this.drawTrack(g, track);
    this.drawMark(g);
    this.drawScale(g, width, height);
  }

  drawTrack(g, track) {
    g.strokeStyle = g.fillStyle = colourOf(track.of);
    g.lineWidth = 1.6;
    g.lineJoin = "round";
    if (track.dots) {
      const size = track.of === "refused" ? 5 : 2.4;
      for (let i = 0; i < track.n.length; i++) {
        if (track.n[i] === null) continue;
        const [x, y] = this.at(track.n[i], track.e[i]);
        g.fillRect(x - size / 2, y - size / 2, size, size);
      }
      return;
    }
    this.stroke(g, track, () => true);
    if (track.of !== "forward") return;
    g.lineWidth = 5;
    g.strokeStyle = "rgba(255, 112, 67, 0.55)";
    this.stroke(g, track, (t) => this.outages.some(([a, b]) => t >= a && t <= b));
    if (this.window) {
      g.lineWidth = 4;
      g.strokeStyle = "rgba(21, 101, 192, 0.45)";
      this.stroke(g, track, (t) => t >= this.window[0] && t <= this.window[1]);
    }
  }

  stroke(g, track, wanted) {
    g.beginPath();
    let on = false;
    for (let i = 0; i < track.n.length; i++) {
      if (track.n[i] === null || track.e[i] === null || !wanted(track.t[i])) { on = false; continue; }
      const [x, y] = this.at(track.n[i], track.e[i]);
      if (on) g.lineTo(x, y); else g.moveTo(x, y);
      on = true;
    }
    g.stroke();
  }

  drawMark(g) {
    const track = this.tracks.find((t) => t.of === "forward");
    if (this.marked === null || !track) return;
    const i = nearest(track.t, this.marked);
    if (i < 0 || track.n[i] === null) return;
    const [x, y] = this.at(track.n[i], track.e[i]);
    g.beginPath();
    g.arc(x, y, 6, 0, 2 * Math.PI);
    g.strokeStyle = "#000"; g.lineWidth = 2; g.stroke();
  }

  drawScale(g, width, height) {
    const length = roundLength(this.view.metres * Math.min(220, width / 3));
    const pixels = length / this.view.metres;
    g.strokeStyle = g.fillStyle = "#1c2127";
    g.lineWidth = 2;
    g.beginPath();
    g.moveTo(16, height - 22); g.lineTo(16, height - 16);
    g.lineTo(16 + pixels, height - 16); g.lineTo(16 + pixels, height - 22);
    g.stroke();
    g.font = "13px system-ui, sans-serif";
    g.textAlign = "left";
    g.fillText(length >= 1000 ? `${length / 1000} km` : `${+length.toPrecision(1)} m`, 20, height - 24);
    g.beginPath();
    g.moveTo(width - 26, 16); g.lineTo(width - 33, 36); g.lineTo(width - 26, 31);
    g.lineTo(width - 19, 36); g.closePath(); g.fill();
    g.textAlign = "center";
    g.fillText("N", width - 26, 51);
  }

  wheel(event) {
    event.preventDefault();
    if (!this.view) return;
    const factor = Math.exp(0.0015 * event.deltaY), v = this.view;
    const dx = event.offsetX - this.width / 2, dy = event.offsetY - this.height / 2;
    v.e += dx * v.metres * (1 - factor);
    v.n -= dy * v.metres * (1 - factor);
    v.metres *= factor;
    this.draw();
  }

  down(event) {
    this.held = { x: event.offsetX, y: event.offsetY };
    this.canvas.setPointerCapture(event.pointerId);
  }

  move(event) {
    if (!this.view) return;
    if (this.held) {
      this.view.e -= (event.offsetX - this.held.x) * this.view.metres;
      this.view.n += (event.offsetY - this.held.y) * this.view.metres;
      this.held = { x: event.offsetX, y: event.offsetY };
      this.draw();
      return;
    }
    const track = this.tracks.find((t) => t.of === "forward");
    if (!track || !this.onPoint) return;
    let best = -1, least = 400;
    for (let i = 0; i < track.n.length; i++) {
      if (track.n[i] === null) continue;
      const [x, y] = this.at(track.n[i], track.e[i]);
      const d = (x - event.offsetX) ** 2 + (y - event.offsetY) ** 2;
      if (d < least) { least = d; best = i; }
    }
    if (best >= 0) this.onPoint(track.t[best]);
  }
}

/* Index of the rising, never empty `times` that is nearest to `t`. */
function nearest(times, t) {
  if (!times.length) return -1;
  let low = 0, high = times.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle; else high = middle;
  }
  return t - times[low] < times[high] - t ? low : high;
}

function legend(element, entries) {
  element.replaceChildren(...entries.map(([label, colour]) => {
    const item = document.createElement("span"), mark = document.createElement("i");
    mark.style.background = colour;
    item.append(mark, label);
    return item;
  }));
}
