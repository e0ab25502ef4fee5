"""The experiment: GPS withheld for 10, 20 and 30 s, several times in a drive, and smoothed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from companion.smoothing.backward_run import run_backwards
from companion.smoothing.correction import from_rows, state_rows
from companion.types import F64, Solution
from replay.preparation import withhold_gnss
from replay.recorded import RecordedRun, record
from replay.reproduce import figures
from replay.reproduce.kamil.drives import FIRST_OUTAGE_S, Drive, simulate
from replay.reproduce.kamil.figure import draw
from replay.reproduce.kamil.routes import REST_S, ROUTES
from replay.reproduce.paper import Cell, Reproduction, Table
from replay.smoothing import record_for, smoothed
from replay.window import Window

SEEDS = 6
"""As often as the paper's routes were driven."""
CITATION = (
    "M. Kamil, T. Chobtrong, E. Günes, M. Haid: Low-cost object tracking with MEMS sensors, Kalman "
    "filtering and simplified two-filter-smoothing. Applied Mathematics and Computation, 2014."
)
OUTAGES_S = (10.0, 20.0, 30.0)
UNAIDED_S = 91.5
"""The paper's measurement of an INS by itself..."""
UNAIDED_ERROR_M = 414.0
"""...and how far it had gone by then."""
_FIGURE_ROUTE = ROUTES[1]
_RATE_HZ = 10.0
NOTES = (
    "The paper prints one number, 414 m; the rest is figures of a drive of 91.5 s without GPS from "
    "40 to 70 s. There is nothing else to put beside ours.",
    "Routes follow its words (350-1700 m, 70-350 s, turns one way, both ways, stops); the sensors "
    "are a consumer MEMS IMU at 100 Hz and GPS of 1 Hz, in error by 0.5 m white and 1 m slow.",
    "Straight: each quantity by itself from 1:0 through 1:1 to 0:1, as its Fig. 2. Consistent: the "
    "same ends and middle, position faded together with velocity; neither inverts a covariance.",
    "Filter as in the paper: 15 states, GPS position and velocity, no constraint for cars.",
)

_NAMES = {
    "forward": "forward",
    "backward": "backward",
    "two-filter-straight": "straight (the paper's)",
    "two-filter": "consistent",
    "bryson-frazier": "optimal",
}


def reproduce(out: Path | None, seeds: int, progress: Callable[[str], None]) -> Reproduction:
    """Every route, outage length and seed; errors inside the outages by kind of solution."""
    drives: list[list[Drive]] = []
    for route in ROUTES:
        progress(f"Driving: {route.name}")
        drives.append([simulate(route, seed) for seed in range(seeds)])
    every = [drive for same in drives for drive in same]
    rows: list[tuple[Cell, ...]] = []
    several: list[tuple[Cell, ...]] = []
    for seconds in OUTAGES_S:
        progress(f"Outages of {seconds:.0f} s")
        found = [_outages(drive, seconds) for drive in every]
        rows += _by_solution(seconds, found)
        several += _by_number(seconds, found)
    tables = (
        _routes_table([same[0] for same in drives]),
        _unaided_table(every),
        Table("Horizontal error inside outages", _HEAD, tuple(rows)),
        Table(
            "Several outages in a drive: mean of the worst error m, by their number",
            _SEVERAL,
            tuple(several),
        ),
    )
    notes: tuple[str, ...] = NOTES
    files: tuple[str, ...] = ()
    if out is not None and figures.available():
        progress("Figure")
        files = (_figure(out),)
    elif out is not None:
        notes = (*NOTES, figures.HOW_TO_GET)
    return Reproduction("kamil", CITATION, tables, files, notes)


_HEAD = (
    "solution",
    "outage s",
    "outages",
    "worst m: mean",
    "largest",
    "middle m: RMS",
    "over optimal",
)
_SEVERAL = ("solution", "outage s", "first", "second", "third", "fourth and on")

Errors = dict[str, list[tuple[float, float]]]
"""By solution: largest horizontal error [m] and that in the middle, of each outage of a drive."""


def _outages(drive: Drive, seconds: float) -> Errors:
    windows = drive.windows(seconds)
    found: Errors = {}
    for name, solution in solutions(drive, windows).items():
        t, error = drive.errors(solution)
        horizontal = np.hypot(error[:, 0], error[:, 1])
        found[name] = []
        for window in windows:
            inside = (t >= window.start_s) & (t <= window.start_s + seconds)
            half = int(np.argmin(np.abs(t - window.start_s - 0.5 * seconds)))
            found[name].append((float(np.max(horizontal[inside])), float(horizontal[half])))
    return found


def solutions(drive: Drive, windows: list[Window]) -> dict[str, Solution]:
    """The solutions of one drive with outages, by name."""
    vehicle = withhold_gnss(drive.vehicle, windows)
    run = record_for("two-filter-weighted", vehicle, drive.config, rate_hz=_RATE_HZ)
    return {
        "forward": run.solution,
        "backward": _backward(run),
        "two-filter-straight": smoothed(run, "two-filter-straight"),
        "two-filter": smoothed(run, "two-filter"),
        "bryson-frazier": smoothed(run, "bryson-frazier"),
    }


def _backward(run: RecordedRun) -> Solution:
    """The run over the reversed drive, alone."""
    forward = run.solution
    back = run_backwards(run.stretches[0], run.config, forward.t_ns)
    cov = np.full((len(forward), 5, 6), np.nan)
    rows = state_rows(back.nominal)
    return from_rows(rows, forward.t_ns, cov, forward.mode, forward.resets)


def _by_solution(seconds: float, found: list[Errors]) -> list[tuple[Cell, ...]]:
    middle, worst = (
        {name: np.array([e[part] for drive in found for e in drive[name]]) for name in _NAMES}
        for part in (1, 0)
    )
    best = _rms(middle["bryson-frazier"])
    return [
        (
            label,
            seconds,
            len(worst[name]),
            float(np.mean(worst[name])),
            float(np.max(worst[name])),
            _rms(middle[name]),
            _rms(middle[name]) / best,
        )
        for name, label in _NAMES.items()
    ]


def _by_number(seconds: float, found: list[Errors]) -> list[tuple[Cell, ...]]:
    """Mean of the worst errors of first, second, … outages, of drives that have that many."""
    rows: list[tuple[Cell, ...]] = []
    for name in ("forward", "two-filter-straight", "two-filter"):
        cells: list[Cell] = []
        for first, last in ((0, 1), (1, 2), (2, 3), (3, None)):
            worst = [e[0] for drive in found for e in drive[name][first:last]]
            cells.append(float(np.mean(worst)) if worst else None)
        rows.append((_NAMES[name], seconds, *cells))
    return rows


def _rms(x: F64) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def _routes_table(drives: list[Drive]) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (d.route.name, d.length_m, d.duration_s, d.route.turns, d.route.stops) for d in drives
    ]
    rows.append(("the paper's eight", "350-1700", "70-350", None, None))
    return Table("Routes", ("route", "length m", "seconds", "turns", "stops"), tuple(rows))


def _unaided_table(drives: list[Drive]) -> Table:
    """How far the INS goes by itself, once levelled: the paper's Fig. 4."""
    ends = []
    for drive in drives:
        if drive.duration_s < UNAIDED_S:
            continue
        blind = withhold_gnss(drive.vehicle, [Window(REST_S, drive.duration_s)])
        t, error = drive.errors(record(blind, drive.config, rate_hz=1.0, tape=False).solution)
        at = int(np.argmin(np.abs(t - UNAIDED_S)))
        ends.append(float(np.hypot(error[at, 0], error[at, 1])))
    columns = ("", "drives", "median m", "least", "largest", "paper")
    row = (
        f"INS alone after {UNAIDED_S:g} s",
        len(ends),
        float(np.median(ends)),
        min(ends),
        max(ends),
        UNAIDED_ERROR_M,
    )
    return Table("Without any GPS after the start", columns, (row,))


def _figure(out: Path) -> str:
    """The drive nearest to the paper's sample, with its outage from 40 to 70 s."""
    drive = simulate(_FIGURE_ROUTE, 0)
    window = Window(FIRST_OUTAGE_S, 30.0)
    tracks = solutions(drive, [window])
    return draw(out, drive, window, {_NAMES[name]: track for name, track in tracks.items()})
