"""What was trusted how far, and why: the adaptation's factors, its rules and source faults."""

from __future__ import annotations

import numpy as np

from companion.types import F64, NS, Channel
from replay.adaptation_story import episodes
from replay.report.charts import Chart, Panel, Table, Tabled, Told, spoken
from replay.report.run_view import RunView

_NOTHING = 1e-3
"""A factor nearer to 1 than this is 1."""
Row = tuple[float, tuple[str, ...]]
_SHOWN = {"R": "R of", "Q": "Q, by", "α": "α, by"}


def adaptation(run: RunView) -> Panel | None:
    """Factors over time, and each episode in words; None where nothing was adapted or faulty."""
    charts = [c for c in (_r(run), _one(run, "q_scale"), _one(run, "alpha"), _faults(run)) if c]
    if not charts:
        return None
    rows = sorted([*_adapted(run), *_faulty(run)])
    told = Told(("From s", "To s", "What", "At most", "Because"), tuple(rows)) if rows else None
    note = (
        "Factors on what the configuration says of variances; 1 is as configured. In words, what "
        "at least doubled, and sources that were held for faulty: click to see one."
    )
    return Panel("adaptation", "Adaptation and source faults", note, tuple(charts), told)


def _r(run: RunView) -> Chart | None:
    """The factor on R of each channel that had another than 1, from the reports themselves.

    Of ranges from the trace: they come to the filter with the factor in their variance.
    """
    reports, trace = run.reports, run.adaptation
    lines = []
    for channel in Channel:
        rows = np.flatnonzero((reports.channel == channel) & (reports.dof > 0))
        if len(rows) and np.any(np.abs(reports.scale[rows] - 1.0) > _NOTHING):
            rows = rows[np.argsort(reports.t_ns[rows], kind="stable")]
            table = Table(reports.t_ns[rows], run)
            name = spoken(channel)
            lines.append(table.of([table.line(name, name, reports.scale[rows])]))
        told = np.flatnonzero((trace.channel == channel) & (channel >= Channel.RANGE_GPS))
        if len(told) and np.any(np.abs(trace.r_scale[told] - 1.0) > _NOTHING):
            table = Table(trace.t_ns[told], run)
            name = spoken(channel)
            lines.append(table.of([table.line(name, name, trace.r_scale[told])]))
    title = "Factor on the measurement's variance R"
    return Chart(title, "", tuple(lines), logarithmic=True) if lines else None


def _one(run: RunView, name: str) -> Chart | None:
    """The factor on Q, or α: one for all channels, by the last one in each epoch."""
    trace = run.adaptation
    values: F64 = getattr(trace, name)
    if not np.any(np.abs(values - 1.0) > _NOTHING):
        return None
    said = np.flatnonzero(np.isfinite(values))
    order = said[np.argsort(trace.t_ns[said], kind="stable")]
    t_ns = trace.t_ns[order]
    last = order[np.append(np.diff(t_ns) > 0, True)]
    table = Table(trace.t_ns[last], run)
    if name == "alpha":
        line = table.line("α", "α", values[last])
        return Chart("Exponential weight α of an epoch", "", (table.of([line]),))
    line = table.line("Q", "Q", values[last])
    title = "Factor on the inertial unit's noise Q"
    return Chart(title, "", (table.of([line]),), logarithmic=True)


def _faults(run: RunView) -> Chart | None:
    """How far a source is off what its own velocities make of it, where it was ever faulty."""
    if not run.source_faults():
        return None
    reports, lines = run.reports, list[Tabled]()
    for channel, name in ((Channel.SOURCE_H, "position"), (Channel.SOURCE_V, "height")):
        rows = np.flatnonzero((reports.channel == channel) & (reports.gate > 0))
        if not len(rows):
            continue
        rows = rows[np.argsort(reports.t_ns[rows], kind="stable")]
        table = Table(reports.t_ns[rows], run)
        over = np.sqrt(reports.nis[rows] / reports.gate[rows])
        lines.append(table.of([table.line(name, f"source {name}", over)]))
    title = "GNSS against its own velocities, over what is usual; held for faulty above 1"
    return Chart(title, "", tuple(lines)) if lines else None


def _adapted(run: RunView) -> list[Row]:
    return [
        (
            e.start_s,
            (
                f"{e.start_s:.1f}",
                f"{e.end_s:.1f}",
                f"{_SHOWN[e.what]} {spoken(Channel[e.channel.upper()])}",
                f"× {e.greatest:.3g}",
                e.because,
            ),
        )
        for e in episodes(run.adaptation, run.origin_ns)
    ]


def _faulty(run: RunView) -> list[Row]:
    rows: list[Row] = []
    for fault in run.source_faults():
        start, end = ((t - run.origin_ns) / NS for t in (fault.start_ns, fault.end_ns))
        receiver = f" of receiver {fault.source + 1}" if fault.source else ""
        name = f"{spoken(fault.channel)}{receiver} not used"
        rows.append((start, (f"{start:.1f}", f"{end:.1f}", name, "", _why(run, fault.start_ns))))
    return rows


def _why(run: RunView, start_ns: int) -> str:
    """The event that began a fault: the last one of its kind up to then, or just after."""
    said = [
        e
        for e in run.events
        if e.kind in ("source-fault", "source-latched") and e.t_ns <= start_ns + NS
    ]
    return max(said, key=lambda e: e.t_ns).text if said else ""
