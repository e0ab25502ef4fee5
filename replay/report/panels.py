"""The panels of a report: what is drawn of a run. Only what happened gives a panel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from companion.navigation.rotation import rpy_from_quat
from companion.types import (
    COV_ACCEL_BIAS,
    COV_ATT,
    COV_GYRO_BIAS,
    COV_POS,
    COV_VEL,
    F64,
    I64,
    NS,
    AidingReports,
    Channel,
    Mode,
    Samples,
    Solution,
)
from replay.evaluation import errors_against
from replay.export import euler_sd
from replay.report.adaptation import adaptation
from replay.report.charts import Chart, Panel, Table, Tabled, spoken
from replay.report.run_view import STOPPED, RunView
from replay.report.satellites import satellites

AXES = (("north", "N"), ("east", "E"), ("down", "D"))
ANGLES = ("roll", "pitch", "yaw")


def panels(run: RunView) -> list[Panel]:
    """Every panel that the run has something for, in the order of the page."""
    makers = (
        _height, _velocity, _attitude, _errors, _innovations, satellites, adaptation, _biases,
        _rates,
    )  # fmt: skip
    return [panel for make in makers if (panel := make(run)) is not None and panel.charts]


def _known(column: F64) -> bool:
    return bool(np.isfinite(column).any())


def _solutions(run: RunView) -> Iterator[tuple[str, Solution]]:
    yield "forward", run.aligned()
    if run.smoothed is not None and len(run.smoothed):
        yield "smoothed", run.smoothed


def _references(run: RunView) -> Iterator[tuple[str, Any]]:
    for kind, samples in (("autopilot", run.vehicle.autopilot), ("truth", run.vehicle.truth)):
        if samples is not None and len(samples):
            yield kind, samples


def _values(run: RunView, pick: Any, sd: Any, reference: Any, gnss: Any = None) -> list[Tabled]:
    """Fixes, forward with its band, smoothed, autopilot and truth of one quantity, upwards."""
    tables = []
    for samples in run.vehicle.gnss[:1] if gnss is not None else ():
        fixed = samples.fix_type >= run.config.gnss.min_fix_type
        values = gnss(samples)[fixed]
        if _known(values):
            table = Table(samples.t_ns[fixed], run)
            tables.append(table.of([table.line("GNSS", "gnss", values, "dots")]))
    for kind, solution in _solutions(run):
        if not len(solution):
            continue
        table, values = Table(solution.t_ns, run), pick(solution)
        lines = [table.line(kind, kind, values)]
        half = sd(solution)
        if kind == "forward" and _known(half):
            lines.insert(0, table.band("± 1 σ", kind, values, half))
        tables.append(table.of(lines))
    for kind, samples in _references(run):
        values = reference(samples)
        if _known(values):
            table = Table(samples.t_ns, run)
            tables.append(table.of([table.line(kind, kind, values)]))
    return tables


def _height(run: RunView) -> Panel | None:
    def sd(s: Solution) -> F64:
        return s.sd[:, COV_POS, 2]

    tables = _values(run, _height_of, sd, _height_of, _height_of)
    datum = "mean sea level" if run.vehicle.height_datum == "msl" else "the ellipsoid"
    if not tables:
        return None
    chart = Chart("Height", "m", tuple(tables))
    return Panel("height", "Height", f"Above {datum}.", (chart,))


def _height_of(samples: Any) -> F64:
    values: F64 = samples.height
    return values


def _velocity(run: RunView) -> Panel | None:
    charts = []
    for i, (name, _) in enumerate(AXES):

        def component(samples: Any, axis: int = i) -> F64:
            column: F64 = samples.vel_n[:, axis]
            return column

        def sd(s: Solution, axis: int = i) -> F64:
            return s.sd[:, COV_VEL, axis]

        tables = _values(run, component, sd, component, component)
        if tables:
            charts.append(Chart(f"Velocity {name}", "m/s", tuple(tables)))
    return Panel("velocity", "Velocity", "", tuple(charts))


def _attitude(run: RunView) -> Panel | None:
    charts = []
    for i, name in enumerate(ANGLES):

        def angle(s: Solution, axis: int = i) -> F64:
            values: F64 = np.degrees(rpy_from_quat(s.q_nb)[:, axis])
            return values

        def sd(s: Solution, axis: int = i) -> F64:
            rpy = rpy_from_quat(s.q_nb)
            return np.degrees(euler_sd(rpy, s.cov[:, COV_ATT])[:, axis])

        def referred(samples: Any, axis: int = i) -> F64:
            values: F64 = np.degrees(samples.rpy[:, axis])
            return values

        tables = _values(run, angle, sd, referred)
        if tables:
            # A heading that nobody knows has a band of more than a turn, which says no more.
            wide = run.aligned()
            limit = 200.0 if len(wide) and np.nanmax(sd(wide)) > 100.0 else None
            charts.append(Chart(name.capitalize(), "°", tuple(tables), limit))
    return Panel("attitude", "Attitude", "", tuple(charts))


def _errors(run: RunView) -> Panel | None:
    if run.reference is None:
        return None
    kind, reference = run.reference
    found = [(of, s, errors_against(s, reference)) for of, s in _solutions(run) if len(s)]
    charts = []
    quantities = (
        ("Position", "m", COV_POS, 1.0, [a[0] for a in AXES]),
        ("Velocity", "m/s", COV_VEL, 1.0, [a[0] for a in AXES]),
        ("Attitude", "°", COV_ATT, 180.0 / np.pi, list(ANGLES)),
    )
    for title, unit, row, factor, names in quantities:
        for axis, name in enumerate(names):
            tables = []
            for of, solution, errors in found:
                columns = (errors.position_n, errors.velocity_n, errors.attitude)
                values = factor * columns[row][:, axis]
                if not _known(values):
                    continue
                table = Table(solution.t_ns, run)
                half = factor * _sd(solution, row, axis)
                lines = [table.line(of, of, values)]
                if of == "forward" and _known(half):
                    lines.insert(0, table.band("± 1 σ", of, np.zeros(len(half)), half))
                tables.append(table.of(lines))
            if tables:
                charts.append(Chart(f"{title} error {name}", unit, tuple(tables)))
    what = "truth" if kind == "truth" else "the autopilot's own estimate, which is not truth"
    return Panel("errors", "Errors", f"Solution − {what}.", tuple(charts))


def _sd(solution: Solution, row: int, axis: int) -> F64:
    if row == COV_ATT:
        return euler_sd(rpy_from_quat(solution.q_nb), solution.cov[:, COV_ATT])[:, axis]
    return solution.sd[:, row, axis]


_WHO = ("worst satellite of each epoch",)
_WIDE = 10.0
"""Gates this many times as wide as usual are those of a clock that is just being found."""
_RANGES: dict[Channel, tuple[str, Sequence[str]]] = {
    Channel.RANGE_GPS: ("m", _WHO),
    Channel.RANGE_GALILEO: ("m", _WHO),
    Channel.RANGE_BEIDOU: ("m", _WHO),
    Channel.RATE_GPS: ("m/s", _WHO),
    Channel.RATE_GALILEO: ("m/s", _WHO),
    Channel.RATE_BEIDOU: ("m/s", _WHO),
}
"""Channels with several measurements, one a satellite, at one time."""
_UNITS: dict[Channel, tuple[str, Sequence[str]]] = {
    Channel.GNSS_POSITION_H: ("m", ("north", "east")),
    Channel.GNSS_POSITION_V: ("m", ("down",)),
    Channel.GNSS_VELOCITY_H: ("m/s", ("north", "east")),
    Channel.GNSS_VELOCITY_V: ("m/s", ("down",)),
    Channel.BARO: ("m", ("height",)),
    Channel.SOURCE_H: ("m", ("north", "east")),
    Channel.SOURCE_V: ("m", ("down",)),
    **_RANGES,
}


def _innovations(run: RunView) -> Panel | None:
    reports = run.reports
    charts = []
    for channel in Channel:
        used = (reports.channel == channel) & (reports.dof > 0)
        if not used.any():
            continue
        rows = np.flatnonzero(used)
        rows = rows[np.argsort(reports.t_ns[rows], kind="stable")]
        if channel in _RANGES:
            rows = _worst(reports, rows)
        unit, names = _UNITS.get(channel, ("", ("x", "y", "z")))
        gate = np.sqrt(reports.gate[rows])
        for axis in range(int(reports.dof[rows].max())):
            y = reports.innovation[rows, axis]
            half = gate * reports.innovation_sd[rows, axis]
            if not _known(y):
                continue
            table = Table(reports.t_ns[rows], run)
            refused = np.isin(reports.verdict[rows], STOPPED)
            lines = [
                table.band("gate", "gate", np.zeros(len(y)), half),
                table.line("innovation", "innovation", np.where(refused, np.nan, y), "dots"),
            ]
            tables = [table.of(lines)]
            if refused.any():
                # On an axis of their own: a refusal is never lost among what was accepted.
                apart = Table(reports.t_ns[rows[refused]], run)
                tables.append(apart.of([apart.line("refused", "refused", y[refused], "dots")]))
            # Every innovation is inside; a gate that an outage opened wide is not, nor is what a
            # clock that nobody knows yet makes of a range.
            usual = float(np.nanmedian(half))
            known = np.abs(y[half < _WIDE * usual]) if channel in _RANGES else np.abs(y)
            limit = 1.3 * max(float(np.nanmax(known, initial=0.0)), usual)
            title = f"{spoken(channel)}, {_axis(names, axis)}"
            charts.append(Chart(title, unit, tuple(tables), limit))
    note = (
        "Measured − predicted. The band is the gate, along one axis: refused in red. A measurement "
        "of two or three axes is refused as one."
    )
    return Panel("innovations", "Innovations", note, tuple(charts))


def _worst(reports: AidingReports, rows: I64) -> I64:
    """Of ``rows`` in order of time, the satellite of each epoch that is nearest to its gate."""
    over = reports.nis[rows] / reports.gate[rows]
    order = np.lexsort((over, reports.t_ns[rows]))
    t_ns = reports.t_ns[rows[order]]
    worst: I64 = rows[order[np.append(np.diff(t_ns) > 0, True)]]
    return worst


def _axis(names: Sequence[str], axis: int) -> str:
    return names[axis] if axis < len(names) else "xyz"[axis]


def _biases(run: RunView) -> Panel | None:
    charts = []
    for title, unit, row, name, factor in (
        ("Gyro bias", "°/s", COV_GYRO_BIAS, "gyro_bias_b", 180.0 / np.pi),
        ("Accelerometer bias", "m/s²", COV_ACCEL_BIAS, "accel_bias_b", 1.0),
    ):
        for axis, letter in enumerate("xyz"):
            tables = []
            for of, solution in _solutions(run):
                values = factor * getattr(solution, name)[:, axis]
                if not len(solution) or not _known(values):
                    continue
                table = Table(solution.t_ns, run)
                lines = [table.line(of, of, values)]
                half = factor * solution.sd[:, row, axis]
                if of == "forward" and _known(half):
                    lines.insert(0, table.band("± 1 σ", of, values, half))
                tables.append(table.of(lines))
            if tables:
                charts.append(Chart(f"{title} {letter}", unit, tuple(tables)))
    return Panel("biases", "Sensor biases", "In body axes.", tuple(charts))


def _rates(run: RunView) -> Panel | None:
    kinds: list[tuple[str, tuple[Samples, ...]]] = [
        ("imu", run.vehicle.imu),
        ("gnss", run.vehicle.gnss),
        ("raw gnss", run.vehicle.raw),
        ("baro", run.vehicle.baro),
        ("mag", run.vehicle.mag),
    ]
    charts = []
    for kind, streams in kinds:
        tables = []
        for samples in streams:
            if len(samples) < 2:
                continue
            seconds = max(1, round(_slowest_s(samples)))
            t, rate = _rate(samples.t_ns, seconds)
            table = Table(t, run)
            tables.append(table.of([table.line(samples.source, samples.source, rate)]))
        if tables:
            charts.append(Chart(f"{kind.upper()} samples a second", "Hz", tuple(tables)))
    return Panel("rates", "Sensor rates", "By time of validity.", tuple(charts))


def _slowest_s(samples: Samples) -> float:
    """Length of the counting interval: some ten samples, at least a second."""
    return 10.0 * float(np.median(np.diff(np.sort(samples.t_ns)))) / NS


def _rate(t_ns: I64, seconds: int) -> tuple[I64, F64]:
    """Samples a second in successive intervals of ``seconds``, at their middles."""
    step = seconds * NS
    first, last = int(t_ns.min()), int(t_ns.max())
    count = max(1, (last - first) // step)
    inside = t_ns[t_ns < first + count * step]
    n = np.bincount((inside - first) // step, minlength=count)[:count]
    return first + step * np.arange(count, dtype=np.int64) + step // 2, n / seconds


def mode_spans(run: RunView) -> list[dict[str, float | str]]:
    """What the estimator stood for, from when to when [s], for the strip over the time axis."""
    s = run.solution
    if not len(s):
        return []
    change = np.flatnonzero(np.diff(s.mode)) + 1
    starts = np.concatenate([[0], change])
    ends = np.concatenate([change, [len(s) - 1]])
    t = (s.t_ns - run.origin_ns) / NS
    return [
        {
            "from": float(t[a]),
            "to": float(t[b]),
            "mode": Mode(int(s.mode[a])).name.lower().replace("_", " "),
        }
        for a, b in zip(starts, ends, strict=True)
    ]
