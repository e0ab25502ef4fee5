"""The experiment: GPS withheld for 10, 20 and 30 s, several times in a drive, and smoothed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from companion.smoothing.offline import smooth
from companion.types import Solution
from replay.preparation import withhold_gnss
from replay.recorded import record
from replay.reproduce.kamil.drives import Drive, simulate
from replay.reproduce.kamil.routes import ROUTES
from replay.reproduce.paper import Cell, Reproduction, Table

SEEDS = 3
CITATION = (
    "M. Kamil, T. Chobtrong, E. Günes, M. Haid: Low-cost object tracking with MEMS sensors, Kalman "
    "filtering and simplified two-filter-smoothing. Applied Mathematics and Computation, 2014."
)
OUTAGES_S = (10.0, 20.0, 30.0)
_RATE_HZ = 10.0
NOTES = ("The paper prints no table: its results are figures of one drive and one number.",)


def reproduce(out: Path | None, seeds: int, progress: Callable[[str], None]) -> Reproduction:
    """Every route, outage length and seed; errors inside the outages by kind of solution."""
    del out
    drives: list[list[Drive]] = []
    for route in ROUTES:
        progress(f"Driving: {route.name}")
        drives.append([simulate(route, seed) for seed in range(seeds)])
    rows: list[tuple[Cell, ...]] = []
    for seconds in OUTAGES_S:
        progress(f"Outages of {seconds:.0f} s")
        rows += _rows(seconds, [drive for same in drives for drive in same])
    return Reproduction(
        "kamil",
        CITATION,
        (_routes_table([same[0] for same in drives]), _outage_table(rows)),
        (),
        NOTES,
    )


def _routes_table(drives: list[Drive]) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (d.route.name, d.length_m, d.duration_s, d.route.turns, d.route.stops) for d in drives
    ]
    rows.append(("the paper's eight", "350-1700", "70-350", None, None))
    return Table("Routes", ("route", "length m", "seconds", "turns", "stops"), tuple(rows))


def _outage_table(rows: list[tuple[Cell, ...]]) -> Table:
    columns = ("solution", "outage s", "outages", "worst m: mean", "largest", "middle m: mean")
    return Table("Horizontal error inside outages", columns, tuple(rows))


def _rows(seconds: float, drives: list[Drive]) -> list[tuple[Cell, ...]]:
    worst: dict[str, list[float]] = {}
    middle: dict[str, list[float]] = {}
    for drive in drives:
        for name, solution in _solutions(drive, seconds).items():
            t, error = drive.errors(solution)
            horizontal = np.hypot(error[:, 0], error[:, 1])
            for window in drive.windows(seconds):
                inside = (t >= window.start_s) & (t <= window.start_s + seconds)
                half = int(np.argmin(np.abs(t - window.start_s - 0.5 * seconds)))
                worst.setdefault(name, []).append(float(np.max(horizontal[inside])))
                middle.setdefault(name, []).append(float(horizontal[half]))
    return [
        (name, seconds, len(x), float(np.mean(x)), float(np.max(x)), float(np.mean(middle[name])))
        for name, x in worst.items()
    ]


def _solutions(drive: Drive, seconds: float) -> dict[str, Solution]:
    """The solutions of one drive with outages, by name."""
    vehicle = withhold_gnss(drive.vehicle, drive.windows(seconds))
    forward = record(vehicle, drive.config, rate_hz=_RATE_HZ, covariance=False)
    return {
        "forward": forward.solution,
        "optimal": smooth(forward.tapes, forward.config),
    }
