"""The figure: a track through an outage, errors over time, and errors by rate and window."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from companion.navigation.earth import ned_difference
from companion.types import F64, Solution
from replay.preparation import start_ns
from replay.reproduce import figures
from replay.reproduce.duong.drives import Drive

_COLOURS = {"forward": "tab:red", "on-line": "tab:blue", "off-line": "tab:green"}
_AROUND_S = 15.0


def draw(
    out: Path,
    drive: Drive,
    solutions: Mapping[str, Solution],
    few_fixes: Mapping[tuple[str, float], float],
) -> tuple[str, ...]:
    """Draw the drive with outages, at the outage that the filter came through worst."""
    figure = figures.new_figure(11.0, 9.0)
    (track, error), (rate, window) = figure.subplots(2, 2)
    shown = _worst(drive, solutions["forward"])
    _track(track, drive, solutions, shown)
    _errors(error, drive, solutions, shown)
    _bars(rate, window, few_fixes)
    return (figures.save(figure, out, "duong"),)


def _worst(drive: Drive, forward: Solution) -> tuple[float, float]:
    """Begin and end [s] of the outage with the largest error."""
    t, error = drive.errors(forward)
    size = np.linalg.norm(error, axis=1)
    spans = [(w.start_s, w.start_s + w.seconds) for w in drive.outages]
    return max(spans, key=lambda span: float(np.max(size[(t >= span[0]) & (t <= span[1])])))


def _around(t: F64, outage: tuple[float, float]) -> Any:
    return (t >= outage[0] - _AROUND_S) & (t <= outage[1] + _AROUND_S)


def _track(
    axes: Any, drive: Drive, solutions: Mapping[str, Solution], outage: tuple[float, float]
) -> None:
    truth = drive.vehicle.truth
    assert truth is not None
    since = start_ns(drive.vehicle)
    near = _around((truth.t_ns - since) / 1e9, outage)
    origin = tuple(np.full(1, x[near][0]) for x in (truth.lat, truth.lon, truth.height))

    def east_north(lat: F64, lon: F64, height: F64) -> tuple[F64, F64]:
        place = (np.full(len(lat), x[0]) for x in origin)
        ned = ned_difference(lat, lon, height, *place)
        return ned[:, 1], ned[:, 0]

    axes.plot(
        *east_north(truth.lat[near], truth.lon[near], truth.height[near]), "k-", label="truth"
    )
    for name, solution in solutions.items():
        part = solution.take(np.flatnonzero(_around((solution.t_ns - since) / 1e9, outage)))
        axes.plot(
            *east_north(part.lat, part.lon, part.height), color=_COLOURS[name], lw=1, label=name
        )
    axes.set(xlabel="east m", ylabel="north m", title="Track through an outage")
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend()


def _errors(
    axes: Any, drive: Drive, solutions: Mapping[str, Solution], outage: tuple[float, float]
) -> None:
    axes.axvspan(*outage, color="0.9", label="no GPS")
    for name, solution in solutions.items():
        t, error = drive.errors(solution)
        near = _around(t, outage)
        axes.plot(
            t[near], np.linalg.norm(error[near], axis=1), color=_COLOURS[name], lw=1, label=name
        )
    axes.set(xlabel="time s", ylabel="3-D error m", title="The same, over time", yscale="log")
    axes.legend()


def _bars(rate: Any, window: Any, found: Mapping[tuple[str, float], float]) -> None:
    for kind, marker in (("rate", "o-"), ("mixed", "s--")):
        points = sorted((key, value) for (name, key), value in found.items() if name == kind)
        label = "smoothed" if kind == "rate" else "mixed"
        rate.plot(*zip(*points, strict=True), marker, label=label)
    points = sorted((key, value) for (name, key), value in found.items() if name == "window")
    window.plot(*zip(*points, strict=True), "o-", label="on-line")
    for axes in (rate, window):
        for name in ("forward", "off-line"):
            axes.axhline(found[name, 0.0], color=_COLOURS[name], ls=":", label=name)
        axes.set(ylabel="3-D RMSE m", ylim=(0.0, None))
        axes.legend()
    rate.set(xlabel="output rate Hz", title="A fix every 20 s: by output rate, window 1")
    window.set(xlabel="window, update intervals", title="A fix every 20 s: by window, 50 Hz")
