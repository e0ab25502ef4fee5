"use strict";
/* The report's charts over one common time axis, its strip of modes, and its track. */

const LOWER = "lower edge";  // a band is two series, and one entry of the legend
const FAULT = "rgba(106, 27, 154, 0.9)", FAULTY = "rgba(106, 27, 154, 0.10)";
const charts = [];
let range = RUN.span.slice();
const plane = document.getElementById("map")
  ? new Plane(document.getElementById("map"), (t) => mark(t)) : null;

function zoom(from, to) {
  range = [Math.max(from, RUN.span[0]), Math.min(to, RUN.span[1])];
  for (const chart of charts) chart.setScale("x", { min: range[0], max: range[1] });
  drawStrip();
  if (plane) {
    plane.window = range[0] > RUN.span[0] || range[1] < RUN.span[1] ? range : null;
    plane.draw();
  }
}

function mark(t) {
  for (const chart of charts) {
    chart.setCursor({ left: chart.valToPos(t, "x"), top: 10 }, false);
  }
  if (plane) { plane.marked = t; plane.draw(); }
}

/* Outages as grey spans, events as ticks, under the series of a chart. */
function drawBackground(u) {
  const g = u.ctx, { left, top, width, height } = u.bbox;
  g.save();
  g.beginPath(); g.rect(left, top, width, height); g.clip();
  g.fillStyle = "rgba(255, 112, 67, 0.13)";
  for (const [a, b] of RUN.outages) {
    const x = u.valToPos(a, "x", true);
    g.fillRect(x, top, u.valToPos(b, "x", true) - x, height);
  }
  g.fillStyle = FAULTY;
  for (const [a, b] of RUN.faults) {
    const x = u.valToPos(a, "x", true);
    g.fillRect(x, top, Math.max(1, u.valToPos(b, "x", true) - x), height);
  }
  for (const event of RUN.events) {
    if (event.level === "info") continue;
    g.fillStyle = LEVELS[event.level];
    g.fillRect(u.valToPos(event.t, "x", true), top, 1, height);
  }
  g.restore();
}

function drawStrip() {
  const [g, width, height] = sharp(document.getElementById("strip"));
  const x = (t) => ((t - range[0]) / Math.max(range[1] - range[0], 1e-9)) * width;
  for (const span of RUN.modes) {
    g.fillStyle = MODES[span.mode];
    g.fillRect(x(span.from), 4, Math.max(1, x(span.to) - x(span.from)), 14);
  }
  g.fillStyle = "rgba(191, 54, 12, 0.9)";
  for (const [a, b] of RUN.outages) g.fillRect(x(a), 20, Math.max(1, x(b) - x(a)), 5);
  g.fillStyle = FAULT;
  for (const [a, b] of RUN.faults) g.fillRect(x(a), 20, Math.max(1, x(b) - x(a)), 5);
  for (const event of RUN.events) {
    g.fillStyle = LEVELS[event.level];
    g.fillRect(x(event.t) - 1, 27, 2, 7);
  }
}

/* uPlot's options and data of one chart. */
function assemble(chart, width) {
  const tables = [], series = [{ label: "s" }], bands = [];
  for (const table of chart.tables) {
    const columns = [unpack(table.t)];
    for (const line of table.lines) {
      const colour = colourOf(line.of);
      if (line.style === "band") {
        columns.push(unpack(line.values), unpack(line.low));
        bands.push({ series: [series.length, series.length + 1], fill: colour + "22" });
        const edge = { stroke: colour + "55", width: 1, points: { show: false } };
        series.push({ label: line.label, ...edge }, { label: LOWER, ...edge });
        continue;
      }
      columns.push(unpack(line.values));
      const size = line.of === "refused" ? 6 : 2.5;
      series.push(line.style === "dots"
        ? { label: line.label, stroke: colour, paths: () => null,
            points: { show: true, size, fill: colour, width: 0 } }
        : { label: line.label, stroke: colour, width: 1.5, points: { show: false } });
    }
    tables.push(columns);
  }
  const unit = chart.unit ? ` (${chart.unit})` : "";
  return [{
    title: chart.title + unit, width, height: 190, series, bands,
    scales: { x: { time: false }, y: chart.limit ? { range: [-chart.limit, chart.limit] }
      : chart.logarithmic ? { distr: 3 } : {} },
    axes: [{ size: 26 }, { size: 64 }],
    cursor: { sync: { key: "time", setSeries: false }, drag: { x: true, y: false } },
    legend: { live: false, markers: { width: 3 } },
    hooks: {
      drawClear: [drawBackground],
      setSelect: [(u) => {
        if (u.select.width < 4) return;
        const left = u.posToVal(u.select.left, "x");
        const right = u.posToVal(u.select.left + u.select.width, "x");
        u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
        zoom(left, right);
      }],
      setCursor: [(u) => {
        if (!u.cursor.event || !plane) return;
        plane.marked = u.posToVal(u.cursor.left, "x");
        plane.draw();
      }],
    },
  }, uPlot.join(tables)];
}

function build(holder, chart) {
  const [options, data] = assemble(chart, holder.clientWidth);
  options.cursor.drag.setScale = false;
  const u = new uPlot(options, data, holder);
  for (const row of holder.querySelectorAll(".u-legend .u-series")) {
    if (["s", LOWER].includes(row.textContent.trim())) row.style.display = "none";
  }
  u.over.addEventListener("dblclick", (e) => { e.stopImmediatePropagation(); zoom(...RUN.span); }, true);
  charts.push(u);
  u.setScale("x", { min: range[0], max: range[1] });
}

/* Charts are built when they come near the window: a long page opens at once. */
const near = new IntersectionObserver((entries) => {
  for (const entry of entries) {
    if (!entry.isIntersecting) continue;
    near.unobserve(entry.target);
    build(entry.target, entry.target.chart);
  }
}, { rootMargin: "600px" });

for (const panel of RUN.panels) {
  const into = document.querySelector(`#${panel.id} .charts`);
  for (const chart of panel.charts) {
    const holder = document.createElement("div");
    holder.className = "chart";
    holder.chart = chart;
    into.append(holder);
    near.observe(holder);
  }
}

if (plane) {
  const columns = (x, dots) => ({ of: x.of, t: unpack(x.t), n: unpack(x.n), e: unpack(x.e), dots });
  const ground = RUN.track;
  if (ground.fixes) plane.tracks.push(columns(ground.fixes, true));
  for (const one of ground.tracks) plane.tracks.push(columns(one, false));
  if (ground.refused) plane.tracks.push(columns(ground.refused, true));
  plane.outages = RUN.outages;
  const entries = plane.tracks.map((t) => [t.of === "gnss" ? "fixes" : t.of === "refused"
    ? "refused fixes" : t.of, colourOf(t.of)]);
  if (RUN.outages.length) entries.push(["no GNSS", "rgba(255, 112, 67, 0.55)"]);
  legend(document.getElementById("map-legend"), entries);
  plane.draw();
}

const shown = new Set(RUN.modes.map((m) => m.mode));
const stripEntries = Object.entries(MODES).filter(([mode]) => shown.has(mode));
if (RUN.outages.length) stripEntries.push(["no GNSS", "rgba(191, 54, 12, 0.9)"]);
if (RUN.faults.length) stripEntries.push(["GNSS held for faulty", FAULT]);
if (RUN.events.length) stripEntries.push(["events", LEVELS.info]);
legend(document.getElementById("strip-legend"), stripEntries);
new ResizeObserver(() => drawStrip()).observe(document.getElementById("strip"));
let resizing = 0;
window.addEventListener("resize", () => {
  clearTimeout(resizing);
  resizing = setTimeout(() => {
    for (const u of charts) u.setSize({ width: u.root.parentElement.clientWidth, height: 190 });
  }, 150);
});
for (const row of document.querySelectorAll("tr[data-t]")) {
  row.addEventListener("click", () => {
    const t = Number(row.dataset.t);
    zoom(t - 20, t + 20);
    mark(t);
  });
}
