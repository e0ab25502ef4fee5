"use strict";
/* The live page: frames of /stream in, pictures out. It keeps as many rows and points as a frame of
   a server that it has just found would bring, and no more. */

const SILENT_MS = 1500, REOPEN_MS = 6000, ROWS = 900, EVENTS = 50;
const el = (id) => document.getElementById(id);
const plane = new LivePlane(el("map"));
const vehicles = new Map();  // name: {now, track: [[t, n, e, mode]], rows: [[tick, {}]], events: []}
let chosen = decodeURIComponent(location.hash.slice(1));
let frame = null, heardAt = performance.now(), openedAt = heardAt, source = null, pending = false;
let charts = null;

function open() {
  if (source) source.close();
  openedAt = performance.now();
  source = new EventSource("/stream");
  source.onmessage = (event) => take(JSON.parse(event.data));
}

function take(said) {
  heardAt = performance.now();
  // Another process, or this one after a new connection: it tells everything from the beginning.
  if (!frame || frame.session !== said.session) vehicles.clear();
  frame = said;
  for (const [name, news] of Object.entries(said.vehicles)) {
    const v = vehicles.get(name) || { track: [], rows: [], events: [] };
    vehicles.set(name, v);
    v.now = news.now;
    v.track = news.track.again ? news.track.points : v.track.concat(news.track.points);
    const last = v.rows.length ? v.rows[v.rows.length - 1][0] : -1;
    v.rows = v.rows.concat(news.rows.filter(([tick]) => tick > last)).slice(-ROWS);
    v.events = (news.anew ? [] : v.events).concat(news.events).slice(-EVENTS);
  }
  if (!pending) { pending = true; requestAnimationFrame(draw); }
}

function current() {
  if (vehicles.has(chosen)) return chosen;
  for (const [name, v] of vehicles) if (v.now.is === "navigating") return name;
  return vehicles.keys().next().value;
}

function levelOf(v) {
  const worst = v.now.alarms.length ? v.now.alarms[0].level : "ok";
  return STANDING[v.now.is] === "error" ? "error" : worst;
}

function draw() {
  pending = false;
  drawCut();
  drawVehicles();
  const name = current(), v = vehicles.get(name);
  if (!v) return;
  drawStanding(name, v);
  drawPlane(name);
  drawHorizon(el("horizon"), v.now.state && v.now.state.rpy_deg);
  drawNumbers(v.now);
  drawSources(v.now);
  drawGates(v.now.gates);
  drawAdaptation(v.now.adaptation);
  drawProcess(v.now);
  drawEvents(v.events);
  drawCharts(v.rows, v.now.gates);
  el("columns").classList.toggle("stale", ["gone", "silent"].includes(v.now.is));
}

function drawVehicles() {
  const nav = el("vehicles");
  if (vehicles.size < 2) { nav.replaceChildren(); return; }
  const names = [...vehicles.keys()];
  while (nav.children.length > names.length) nav.lastChild.remove();
  names.forEach((name, i) => {
    let button = nav.children[i];
    if (!button) {
      button = nav.appendChild(document.createElement("button"));
      button.append(document.createElement("b"), document.createElement("span"));
      button.addEventListener("click", () => {
        chosen = button.dataset.name;
        location.hash = encodeURIComponent(chosen);
        draw();
      });
    }
    const v = vehicles.get(name), s = v.now.state;
    button.dataset.name = name;
    button.className = levelOf(v);
    button.setAttribute("aria-pressed", String(name === current()));
    button.children[0].textContent = name;
    button.children[1].textContent = v.now.is + (s
      ? `, ${Math.hypot(s.vel_n_mps[0], s.vel_n_mps[1]).toFixed(1)} m/s, ${s.height_m.toFixed(0)} m` : "");
  });
}

function drawStanding(name, v) {
  el("standing").className = levelOf(v);
  el("name").textContent = `${name}: ${v.now.is}`;
  document.title = `${name}: ${v.now.is}`;
  const items = v.now.alarms.map((alarm) => {
    const item = document.createElement("li");
    item.className = alarm.level;
    item.textContent = alarm.text;
    return item;
  });
  el("alarms").replaceChildren(...items);
}

/* Times at which a track was without aiding, for the plane's orange. */
function coasting(track) {
  const spans = [];
  for (const [t, , , mode] of track) {
    const last = spans[spans.length - 1];
    if (mode !== 3) { if (last && last.open) { last[1] = t; last.open = false; } continue; }
    if (last && last.open) last[1] = t;
    else spans.push(Object.assign([t, t], { open: true }));
  }
  return spans;
}

function drawPlane(name) {
  plane.tracks = [];
  plane.vehicles = [];
  for (const [other, v] of vehicles) {
    const of = other === name ? "forward" : other, column = (i) => v.track.map((p) => p[i]);
    plane.tracks.push({ of, t: column(0), n: column(1), e: column(2), dots: false });
    if (v.now.place_m && v.now.state) {
      plane.vehicles.push({ of, place: v.now.place_m, yaw: v.now.state.rpy_deg[2] });
    }
  }
  plane.outages = coasting(vehicles.get(name).track);
  const entries = [...vehicles.keys()].map((x) => [x, colourOf(x === name ? "forward" : x)]);
  if (plane.outages.length) entries.push(["coasting", "rgba(255, 112, 67, 0.55)"]);
  legend(el("map-legend"), entries);
  plane.draw();
}

function drawNumbers(now) {
  const s = now.state;
  if (!s) { fill(el("numbers").lastElementChild, null, [["no state yet"]]); return; }
  const sd = (values, digits, unit) => ({ text: `± ${values.map((x) => fixed(x, digits)).join(" ")}${unit}`, number: true });
  const [n, e, d] = s.vel_n_mps, course = ((Math.atan2(e, n) * 180) / Math.PI + 360) % 360;
  fill(el("numbers").lastElementChild, null, [
    ["Position", number(s.lat_deg, 7, "°"), number(s.lon_deg, 7, "°"), number(s.height_m, 2, " m"),
      sd(s.sd_pos_m, 2, " m")],
    ["Velocity N E D", number(n, 2), number(e, 2), number(d, 2, " m/s"), sd(s.sd_vel_mps, 2, " m/s")],
    ["Roll pitch yaw", number(s.rpy_deg[0], 1), number(s.rpy_deg[1], 1),
      number((s.rpy_deg[2] + 360) % 360, 1, "°"), sd(s.sd_att_deg, 2, "°")],
    ["Over ground", number(Math.hypot(n, e), 2, " m/s"), number(course, 0, "°"), "",
      { text: s.resets ? `${s.resets} resets` : "", level: "warning", number: true }],
  ]);
}

/* A sensor whose measurements are overdue is shown so before health says that it is silent. */
function drawSources(now) {
  const table = el("sources").lastElementChild;
  if (!now.health) { fill(table, null, [["no report of health yet"]]); return; }
  const late = new Set(now.alarms.filter((a) => a.level === "error" || a.text.includes("no measurement"))
    .map((a) => a.part));
  const sensors = now.health.sensors.map((s) => {
    const state = s.used && s.state === "ok" && late.has(s.kind) ? "overdue" : s.state;
    const level = s.used || state === "ok" ? STATES[state] : "";
    return [s.source, s.kind, { text: state, level }, number(s.rate_hz, 1, " Hz"),
      number(s.age_s, 2, " s"), s.used ? "used" : "logged only",
      s.lost ? `${s.lost} lost` : s.saturated ? `${s.saturated} saturated` : ""];
  });
  const links = now.health.links.map((link) => [link.name, "link",
    { text: link.state, level: STATES[link.state] }, "", "", `${link.received} in`,
    [link.malformed ? `${link.malformed} malformed` : "", link.reopened ? `reopened ${link.reopened}×` : "",
      link.note].filter(Boolean).join(", ")]);
  fill(table, ["", "", "State", { text: "Rate", number: true }, { text: "Age", number: true }, "", ""],
    [...sensors, ...links]);
}

/* A constraint that is rejected is no fault: the vehicle moves. */
function drawGates(gates) {
  const rows = Object.entries(gates).map(([channel, g]) => {
    const told = g.sensor || channel.startsWith("source");
    const latest = g.overdue ? "overdue" : g.latest ? words(g.latest) : "silent";
    const bad = g.overdue || (g.latest || "").startsWith("rejected");
    return [words(channel), number(g.accepted, 0), number(g.rejected, 0), number(g.refused, 0),
      ratio(g.nis_over_gate),
      { text: latest, level: !told ? "" : bad ? "error" : g.latest === "accepted" ? "ok" : "warning" },
      number(g.age_s, 1, " s")];
  });
  const head = (text) => ({ text, number: true });
  fill(el("gates").lastElementChild, ["Channel", head("Accepted"), head("Rejected"), head("Refused"),
    head("² / gate"), "Latest", head("Age")], rows);
}

function drawAdaptation(adaptation) {
  const entries = Object.entries(adaptation);
  el("adaptation").hidden = !entries.length;
  fill(el("adaptation").lastElementChild, ["Channel", { text: "R ×", number: true },
    { text: "Q ×", number: true }, { text: "α", number: true }, "Because"],
  entries.map(([channel, a]) => [words(channel),
    { text: fixed(a.r_scale, 2), number: true, level: a.r_scale > 2 ? "warning" : "" },
    { text: fixed(a.q_scale, 2), number: true, level: a.q_scale > 2 ? "warning" : "" },
    number(a.alpha, 3), a.because]));
}

function drawProcess(now) {
  const rows = [["States", number(now.state_rate_hz, 1, " Hz")],
    ["Sample to this page's server", { text: known(now.latency_ms) ? fixed(now.latency_ms, 2, " ms")
      : "unknown: another machine's clock", number: true }]];
  if (now.health) {
    const { loop, log } = now.health;
    rows.push(["Sample to output, p50 / p99", { text: `${fixed(loop.latency_p50_ms, 2)} / ${fixed(loop.latency_p99_ms, 2, " ms")}`, number: true }],
      ["Load", number(100 * loop.load, 0, " % of a core")],
      ["Up", number(now.health.uptime_s, 0, " s")],
      ["Log", { text: log.state === "off" ? "off" : `${log.state}, ${fixed(log.written_bytes / 1e6, 1)} MB`
        + (log.dropped_bytes ? `, ${log.dropped_bytes} bytes dropped` : ""), number: true, level: STATES[log.state] === "error" ? "error" : "" }]);
  }
  if (now.unreadable) rows.push(["Messages that could not be read", { text: now.unreadable, level: "warning", number: true }]);
  fill(el("process").lastElementChild, null, rows);
}

function drawEvents(events) {
  fill(el("events").querySelector("table"), null, events.slice().reverse().map((e) => {
    const level = e.level === "info" ? "" : e.level;
    return [new Date(e.t_ns / 1e6).toISOString().slice(11, 19), { text: e.kind, level }, e.text];
  }));
}

function drawCharts(rows, gates) {
  charts = charts || new Charts(el("charts"), ROWS * frame.tick_s);
  const times = rows.map(([tick]) => (tick - frame.tick) * frame.tick_s);
  const column = (name) => rows.map(([, row]) => (name in row ? row[name] : null));
  const lines = (...pairs) => pairs.map(([name, label]) => [label, column(name)])
    .filter(([, values]) => values.some((x) => x !== null));
  const all = (prefix) => [...new Set(rows.flatMap(([, row]) => Object.keys(row)
    .filter((name) => name.startsWith(prefix))))].sort().map((name) => [name, words(name.slice(prefix.length))]);
  const fromZero = (u, low, high) => [0, Math.max(high * 1.1, 1e-3)];
  charts.show(GATES, "", (u, low, high) => [0, Math.min(Math.max(1.3, high * 1.05), 10)], times,
    lines(...all("gate.").filter(([name]) => (gates[name.slice(5)] || {}).sensor)));
  charts.show("Position, 1 σ", "m", fromZero, times, lines(["sd_h", "horizontal"], ["sd_v", "vertical"]));
  charts.show("Height", "m", null, times, lines(["height", "height"]));
  charts.show("Speed", "m/s", null, times, lines(["speed", "over ground"], ["climb", "climb"]));
  charts.show("Roll and pitch", "°", null, times, lines(["roll", "roll"], ["pitch", "pitch"]));
  charts.show("Adaptation: factor on R, and on Q", "", null, times, lines(...all("r."), ["q", "Q"]));
  charts.show("Sample to this page's server, at most", "ms", fromZero, times, lines(["latency", "latency"]));
  charts.show("States a second", "Hz", fromZero, times, lines(["rate", "states"]));
}

/* What is on the page is only as good as the connection that it came by. */
function drawCut() {
  const silent = performance.now() - heardAt;
  const cut = silent > SILENT_MS;
  document.body.classList.toggle("cut", cut);
  const text = cut ? `No connection to companion watch for ${(silent / 1000).toFixed(0)} s; tried again and again`
    : frame && frame.link ? `companion watch: ${frame.link}` : "";
  el("cut").hidden = !text;
  el("cut").textContent = text;
}

setInterval(() => {
  drawCut();
  const now = performance.now();
  // A refused answer ends an EventSource for good, and a machine that slept leaves a dead one.
  if (source.readyState === EventSource.CLOSED ? now - openedAt > 1000
    : now - Math.max(heardAt, openedAt) > REOPEN_MS) open();
}, 500);
window.addEventListener("resize", () => { if (charts) charts.resize(); });
open();
