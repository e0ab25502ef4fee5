"use strict";
/* Parts of the live page: tables whose cells keep their place, an artificial horizon, the plane. */

const STANDING = {
  "navigating": "ok", "heading unknown": "warning", "aligning": "warning", "waiting": "warning",
  "coasting": "error", "silent": "error", "gone": "error",
};
const STATES = {
  "ok": "ok", "up": "ok", "writing": "ok", "off": "", "back": "warning", "slow": "warning",
  "waiting": "warning", "retrying": "warning", "no-fix": "warning",
  "silent": "error", "lost": "error", "stopped": "error", "overdue": "error",
};

const known = (x) => x !== null && x !== undefined;
const fixed = (x, digits, unit = "") => (known(x) ? x.toFixed(digits) + unit : "–");
/* A ratio in at most four places. */
const ratio = (x) => ({ text: known(x) && x >= 99.5 ? "> 99" : fixed(x, 2), number: true });
const words = (name) => name.replaceAll("_", " ");

/* Texts, classes and bars of a table; elements are made once and then only changed, so that a
   selection or a tooltip outlives the next frame. A cell: text, or {text, level, number}. */
function fill(table, head, rows) {
  const wanted = head ? [head, ...rows] : rows;
  while (table.rows.length > wanted.length) table.deleteRow(-1);
  wanted.forEach((cells, y) => {
    const row = table.rows[y] || table.insertRow();
    while (row.cells.length > cells.length) row.deleteCell(-1);
    cells.forEach((given, x) => {
      const cell = typeof given === "object" && given !== null ? given : { text: given };
      const at = row.cells[x] || row.appendChild(document.createElement(head && !y ? "th" : "td"));
      const text = String(cell.text);
      if (at.textContent !== text) at.textContent = text;
      const kind = [cell.level || "", cell.number ? "number" : ""].join(" ").trim();
      if (at.className !== kind) at.className = kind;
    });
  });
}

const number = (x, digits, unit = "") => ({ text: fixed(x, digits, unit), number: true });

/* Sky over ground as seen from the vehicle, and the heading on a rose; angles in degrees. */
function drawHorizon(canvas, attitude) {
  const [g, width, height] = sharp(canvas);
  if (!width || !attitude) return;
  const [roll, pitch, yaw] = attitude, radius = height / 2 - 12, perDegree = radius / 45;
  const rad = Math.PI / 180;
  g.save();
  g.translate(width * 0.3, height / 2);
  g.beginPath(); g.arc(0, 0, radius, 0, 2 * Math.PI); g.save(); g.clip();
  g.rotate(-roll * rad);
  const y = pitch * perDegree;
  g.fillStyle = "#90caf9"; g.fillRect(-2 * radius, y - 8 * radius, 4 * radius, 8 * radius);
  g.fillStyle = "#a1887f"; g.fillRect(-2 * radius, y, 4 * radius, 8 * radius);
  g.strokeStyle = "#fff"; g.lineWidth = 2;
  g.beginPath(); g.moveTo(-2 * radius, y); g.lineTo(2 * radius, y); g.stroke();
  g.lineWidth = 1; g.fillStyle = "#fff"; g.font = "11px system-ui"; g.textAlign = "left";
  for (let mark = -80; mark <= 80; mark += 10) {
    if (!mark) continue;
    const at = y - mark * perDegree, half = mark % 20 ? 12 : 22;
    g.beginPath(); g.moveTo(-half, at); g.lineTo(half, at); g.stroke();
    if (mark % 20 === 0) g.fillText(String(mark), half + 4, at + 4);
  }
  g.restore();
  g.strokeStyle = "#1c2127"; g.lineWidth = 1.5; g.stroke();
  g.strokeStyle = "#ffb300"; g.lineWidth = 4;
  g.beginPath();
  g.moveTo(-0.55 * radius, 0); g.lineTo(-0.2 * radius, 0); g.lineTo(0, 0.12 * radius);
  g.lineTo(0.2 * radius, 0); g.lineTo(0.55 * radius, 0); g.stroke();
  g.restore();

  g.save();
  g.translate(width * 0.74, height / 2);
  g.strokeStyle = "#90a4ae"; g.lineWidth = 1.5;
  g.beginPath(); g.arc(0, 0, radius, 0, 2 * Math.PI); g.stroke();
  g.fillStyle = "#5b6570"; g.font = "13px system-ui"; g.textAlign = "center"; g.textBaseline = "middle";
  ["N", "E", "S", "W"].forEach((name, i) => {
    const a = i * 90 * rad;
    g.fillText(name, Math.sin(a) * (radius - 12), -Math.cos(a) * (radius - 12));
  });
  g.fillText(`${Math.round(((yaw % 360) + 360) % 360) % 360}°`, radius + 24, 0);
  g.rotate(yaw * rad);
  arrow(g, 0.62 * radius, "#1565c0");
  g.restore();
}

/* An arrow that points up, `size` long from its middle. */
function arrow(g, size, colour) {
  g.fillStyle = colour;
  g.beginPath();
  g.moveTo(0, -size); g.lineTo(0.45 * size, 0.6 * size); g.lineTo(0, 0.3 * size);
  g.lineTo(-0.45 * size, 0.6 * size); g.closePath(); g.fill();
}

/* The report's plane, which follows until somebody moves it, with every vehicle where it is now. */
class LivePlane extends Plane {
  constructor(canvas) {
    super(canvas, null);
    this.vehicles = [];  // {of, place, yaw}
    this.following = true;
    for (const kind of ["wheel", "pointerdown"]) {
      canvas.addEventListener(kind, () => { this.following = false; });
    }
    canvas.addEventListener("dblclick", () => { this.following = true; });
  }

  draw() {
    if (this.following) this.view = null;
    super.draw();
  }

  drawMark(g) {
    for (const vehicle of this.vehicles || []) {
      const [x, y] = this.at(...vehicle.place);
      g.save();
      g.translate(x, y);
      g.rotate((vehicle.yaw * Math.PI) / 180);
      arrow(g, 12, colourOf(vehicle.of));
      g.restore();
    }
  }
}

/* Limits of an axis that shows what changes, and not the last digits of what does not. */
function around(u, low, high) {
  const middle = (low + high) / 2, half = Math.max(0.55 * (high - low), 1);
  return low === null ? [0, 1] : [middle - half, middle + half];
}

/* Charts over the last minutes; one is built anew only when it has other series than before. */
class Charts {
  constructor(holder, spanS) {
    this.holder = holder;
    this.spanS = spanS;
    this.charts = new Map();
  }

  /* `lines`: [[label, values]]; an empty list takes the chart away. */
  show(title, unit, range, times, lines) {
    const key = lines.map(([label]) => label).join("\n");
    let chart = this.charts.get(title);
    if (!chart) {
      const place = this.holder.appendChild(document.createElement("div"));
      place.className = "chart";
      chart = { place, plot: null, key };
      this.charts.set(title, chart);
    }
    chart.place.hidden = !lines.length;
    if (chart.plot && chart.key !== key) {
      chart.plot.destroy();
      chart.place.replaceChildren();
      chart.plot = null;
    }
    if (!lines.length) return;
    const data = [times, ...lines.map(([, values]) => values)];
    if (chart.plot) { chart.plot.setData(data); return; }
    chart.key = key;
    chart.plot = new uPlot({
      title: unit ? `${title} (${unit})` : title, width: chart.place.clientWidth, height: 150,
      series: [{}, ...lines.map(([label], i) => ({
        label, stroke: LINES[i % LINES.length], width: 1.5, spanGaps: false,
        // Single values between gaps: measurements come slower than rows.
        points: { show: title === GATES, size: 4, fill: LINES[i % LINES.length] },
        paths: title === GATES ? () => null : undefined,
      }))],
      scales: { x: { time: false, range: [-this.spanS, 0] }, y: { range: range || around } },
      axes: [{ size: 26 }, { size: 58 }],
      cursor: { drag: { x: false, y: false }, sync: { key: "live", setSeries: false } },
      legend: { live: false, markers: { width: 3 } },
    }, data, chart.place);
  }

  resize() {
    for (const { plot, place } of this.charts.values()) {
      if (plot) plot.setSize({ width: place.clientWidth, height: 150 });
    }
  }
}

const LINES = ["#1565c0", ...OTHERS];
const GATES = "Innovation² over gate, refused above 1";
