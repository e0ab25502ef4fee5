"""The page: one HTML file that opens without a network, everything inside it."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion import __version__
from companion.types import NS, CompanionError
from replay.report.charts import Panel, Told
from replay.report.panels import mode_spans, panels
from replay.report.run_view import RunView
from replay.report.track import track
from replay.report.verdict import Judgement, judge
from replay.summary import Summary, summarise

_ASSETS = resources.files("replay.report") / "assets"


def write_report(run: RunView, path: Path) -> Judgement:
    """Write the page of one vehicle's run; the verdict that stands at its top.

    Raises :class:`~companion.types.CompanionError` when the file cannot be written.
    """
    judgement = judge(run)
    try:
        path.write_text(page(run, judgement), encoding="utf-8")
    except OSError as error:
        raise CompanionError(f"{path}: {error.strerror or error}") from None
    return judgement


def page(run: RunView, judgement: Judgement) -> str:
    """The page's text."""
    summary = summarise(run.vehicle, run.solution, run.reports, run.events)
    shown = panels(run)
    ground = track(run)
    data = {
        "modes": mode_spans(run),
        "outages": [
            [(o.start_ns - run.origin_ns) / NS, (o.end_ns - run.origin_ns) / NS]
            for o in run.outages()
        ],
        "faults": [
            [(f.start_ns - run.origin_ns) / NS, (f.end_ns - run.origin_ns) / NS]
            for f in run.source_faults()
        ],
        "events": [
            {"t": (e.t_ns - run.origin_ns) / NS, "kind": e.kind, "level": e.level, "text": e.text}
            for e in run.events
        ],
        "span": _span(run),
        "track": ground,
        "panels": [{"id": p.id, "charts": msgspec.to_builtins(p.charts)} for p in shown],
    }
    sections = "\n".join(_section(panel) for panel in shown)
    return _PAGE.format(
        title=html.escape(f"{run.name}: {run.vehicle.name}"),
        style=_asset("uPlot.min.css") + _asset("report.css"),
        verdict=_verdict(judgement),
        flight=_flight(run, summary),
        track=_TRACK if ground is not None else "",
        sections=sections,
        sensors=_sensors(summary),
        gates=_gates(summary),
        events=_events(run),
        version=html.escape(__version__),
        digest=html.escape(run.digest or "not in the log"),
        data=_embedded(data),
        script=_asset("uPlot.iife.min.js") + "\n" + _asset("plotting.js") + _asset("report.js"),
    )


def _asset(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")


def _embedded(data: dict[str, Any]) -> str:
    """JSON that may stand inside a script element."""
    return json.dumps(_finite(data), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _finite(value: Any) -> Any:
    """What JSON can hold: None for a number that is none."""
    if isinstance(value, dict):
        return {key: _finite(x) for key, x in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(x) for x in value]
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value


def _span(run: RunView) -> list[float]:
    """First and last second of the common time axis: the solution, else the inertial samples."""
    times = run.solution.t_ns if len(run.solution) else run.vehicle.imu[0].t_ns
    return [(int(times.min()) - run.origin_ns) / NS, (int(times.max()) - run.origin_ns) / NS]


def _verdict(judgement: Judgement) -> str:
    lines = "\n".join(
        f'<li class="{e.level}"><b>{html.escape(e.text)}.</b>'
        + (f" {html.escape(e.action)}" if e.action else "")
        + "</li>"
        for e in judgement.evidence
    )
    head = html.escape(judgement.headline)
    return (
        f'<section id="verdict" class="{judgement.level}"><h2>{head}</h2><ul>{lines}</ul></section>'
    )


def _flight(run: RunView, summary: Summary) -> str:
    flight, start = summary.flight, summary.start
    facts = [
        ("Log", run.name),
        ("Vehicle", run.vehicle.name),
        ("Begun", flight.start_utc or "no date in the log"),
        ("Length", f"{flight.duration_s:.0f} s"),
        ("Distance", f"{flight.distance_m:.0f} m"),
        ("Fastest", f"{flight.max_speed_mps:.1f} m/s"),
        ("At the end", start.final_mode.replace("_", " ")),
    ]
    cells = "".join(
        f"<div><dt>{html.escape(k)}</dt><dd>{html.escape(v)}</dd></div>" for k, v in facts
    )
    notes = "".join(f"<li>{html.escape(n)}</li>" for n in run.notes)
    return f"<dl>{cells}</dl>" + (f'<ul class="notes">{notes}</ul>' if notes else "")


def _section(panel: Panel) -> str:
    note = f"<p>{html.escape(panel.note)}</p>" if panel.note else ""
    return (
        f'<section id="{panel.id}"><h2>{html.escape(panel.title)}</h2>{note}'
        f'<div class="charts"></div>{_told(panel.told)}</section>'
    )


def _told(told: Told | None) -> str:
    if told is None:
        return ""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in told.head)
    rows = "".join(
        f'<tr data-t="{t:.3f}">{"".join(f"<td>{html.escape(c)}</td>" for c in cells)}</tr>'
        for t, cells in told.rows
    )
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead>{rows}</table></div>'


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]], numbers: frozenset[int]) -> str:
    def row(cells: tuple[str, ...], tag: str) -> str:
        parts = (
            f"<{tag}{' class=number' if i in numbers else ''}>{html.escape(c)}</{tag}>"
            for i, c in enumerate(cells)
        )
        return f"<tr>{''.join(parts)}</tr>"

    body = "".join(row(r, "td") for r in rows)
    return f'<div class="scroll"><table><thead>{row(head, "th")}</thead>{body}</table></div>'


def _sensors(summary: Summary) -> str:
    rows = [
        (
            s.source,
            s.kind,
            str(s.count),
            f"{s.rate_hz:.4g}",
            str(s.gaps),
            f"{s.longest_gap_s:.2f}",
            s.note,
        )
        for s in summary.sensors
    ]
    if not rows:
        return ""
    head = ("Stream", "Kind", "Samples", "Rate Hz", "Gaps", "Longest gap s", "Note")
    table = _table(head, rows, frozenset({2, 3, 4, 5}))
    return f'<section id="sensors"><h2>What the log holds</h2>{table}</section>'


def _gates(summary: Summary) -> str:
    rows = [
        (
            name.replace("_", " "),
            str(gate.accepted),
            ", ".join(f"{n} {why.replace('_', ' ')}" for why, n in gate.refused.items()),
            "–" if gate.nis_per_dof is None else f"{gate.nis_per_dof:.2f}",
        )
        for name, gate in summary.gates.items()
    ]
    if not rows:
        return ""
    head = ("Channel", "Accepted", "Refused", "NIS per degree of freedom")
    table = _table(head, rows, frozenset({1, 3}))
    note = "<p>NIS is 1 where the stated noise is right, larger where it is too small.</p>"
    return f'<section id="gates"><h2>Aiding</h2>{note}{table}</section>'


def _events(run: RunView) -> str:
    if not run.events:
        return ""
    rows = "".join(
        f'<tr class="{e.level}" data-t="{(e.t_ns - run.origin_ns) / NS:.3f}">'
        f'<td class="number">{(e.t_ns - run.origin_ns) / NS:.1f}</td>'
        f"<td>{html.escape(e.kind)}</td><td>{html.escape(e.text)}</td></tr>"
        for e in sorted(run.events, key=lambda e: e.t_ns)
    )
    head = "<tr><th>Time s</th><th>Event</th><th></th></tr>"
    return (
        '<section id="events"><h2>Events</h2><div class="scroll"><table>'
        f"<thead>{head}</thead>{rows}</table></div></section>"
    )


_TRACK = """<section id="track"><h2>Track</h2>
<p>North up, metres. Drag to move, wheel to zoom, double click for everything; the time under the
pointer is marked in the charts.</p>
<canvas id="map"></canvas><div id="map-legend" class="legend"></div></section>"""

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>{style}</style></head>
<body><main>
<h1>{title}</h1>
{verdict}
{flight}
{track}
<section id="time"><canvas id="strip"></canvas><div id="strip-legend" class="legend"></div>
<p>Seconds since the recording began. Drag across any chart to zoom all of them, double click for
the whole run. Long runs are drawn in spans of equal time: the smallest and the largest value of
each span are kept.</p></section>
{sections}
{sensors}
{gates}
{events}
<footer>companion {version}; digest of the settled solution {digest}</footer>
</main>
<script>const RUN = {data};</script>
<script>{script}</script>
</body></html>
"""
