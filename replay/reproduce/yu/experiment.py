"""The experiment: the track of Table I over many seeds, with the mechanisms and without."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.types import F64
from replay.reproduce import figures
from replay.reproduce.paper import Cell, Reproduction, Table
from replay.reproduce.yu.run import Errors, fly
from replay.reproduce.yu.track import SECONDS, STEPS, Track, measure, table_one

SEEDS = 50
CITATION = (
    "F. Yu, M. Zhu, S. Xiao, J. Wang: Practical mechanisms to realize smooth transitions for "
    "unconventional multi-sensor integrated kinematic positioning and navigation. 2018."
)
JERK = 0.1
"""White jerk of the trajectory model [m/s³/√Hz]: the plain model that the mechanisms are for."""
JERKS = (0.03, 0.1, 0.3, 1.0, 3.0)
SWEEP_SEEDS = 10
PRINTED_M = (100.0, 800.0, 62.5, 10.0, 15.0)
"""Travel distances of Table I."""
NOTES = (
    "The paper prints ranges of its curves, no table of errors: what it says stands beside ours.",
    "It prints no process noise, start error, scale factors or GPS error: ours are assumptions, "
    "told to the filter as they are (docs/yu-2018.md). GPS is a position once a second here.",
    "A mechanism forgets the acceleration on its axis and lets the accelerometers set it anew, so "
    "that its uncertainty is known: eq. 42 is that update in the limit. Eq. 44 is a measurement.",
    "The model without mechanisms is helped by more jerk; the last table shows where they meet.",
)

Inside = NDArray[np.bool_] | slice
"""Which of the epochs."""
Pair = tuple[list[Errors], list[Errors]]
"""Runs with the mechanisms, and the same runs without."""


def reproduce(out: Path | None, seeds: int, progress: Callable[[str], None]) -> Reproduction:
    """Every seed with and without mechanisms; ranges, comparison, and how much jerk decides."""
    track = table_one()
    progress(f"Table I: {seeds} runs with mechanisms and without")
    runs = _runs(track, seeds, JERK)
    sweep: list[tuple[Cell, ...]] = []
    for jerk in JERKS:
        progress(f"Model with a jerk of {jerk:g} m/s³/√Hz")
        few = min(seeds, SWEEP_SEEDS)
        pair = (runs[0][:few], runs[1][:few]) if jerk == JERK else _runs(track, few, jerk)
        sweep.append((jerk, *(x for kind in _KINDS for x in (_rms(p, kind) for p in pair))))
    tables = (
        _track_table(track),
        _range_table(runs[0]),
        _comparison(runs),
        Table("RMS by the jerk of the model", ("jerk m/s³/√Hz", *_HEADS), tuple(sweep)),
    )
    notes: tuple[str, ...] = NOTES
    files: tuple[str, ...] = ()
    if out is not None and figures.available():
        from replay.reproduce.yu.figure import draw

        progress("Figures")
        files = draw(runs, out)
    elif out is not None:
        notes = (*NOTES, figures.HOW_TO_GET)
    return Reproduction("yu", CITATION, tables, files, notes)


_KINDS = {"position": "m", "velocity": "m/s", "acceleration": "m/s²"}
_HEADS = [
    f"{kind} {unit} {which}" for kind, unit in _KINDS.items() for which in ("with", "without")
]


def _runs(track: Track, seeds: int, jerk: float) -> Pair:
    """The same sensors and start errors, with the mechanisms and without."""
    found: Pair = ([], [])
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        start = rng.standard_normal(12)
        sensors = measure(track, rng)
        for runs, transitions in zip(found, (True, False), strict=True):
            runs.append(fly(track, sensors, start, jerk, transitions))
    return found


def stacked(runs: list[Errors], kind: str) -> F64:
    """(runs, M, 3) one kind of error of all runs."""
    return np.array([getattr(run, kind) for run in runs])


def _rms(runs: list[Errors], kind: str, inside: Inside = slice(None)) -> float:
    """Three-dimensional, over runs and time."""
    return float(np.sqrt(np.mean(np.sum(stacked(runs, kind)[:, inside] ** 2, axis=2))))


def _track_table(track: Track) -> Table:
    edges = [*(step[0] for step in STEPS), float(SECONDS)]
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(track.position_n[:, :2].T)))])
    rows: list[tuple[Cell, ...]] = []
    for i, ((_, along, turn), printed) in enumerate(zip(STEPS, PRINTED_M, strict=True)):
        a, b = np.searchsorted(track.t, [edges[i] + 1e-6, edges[i + 1] - 1e-6]) - 1
        speed = float(np.linalg.norm(track.vel_n[max(a, 0)]))
        length = float(way[b + 1 if b + 1 < len(way) else b] - way[max(a, 0)])
        if i == 0:
            length += float(np.linalg.norm(track.position_n[0]))
        rows.append((f"{edges[i]:g}-{edges[i + 1]:g} s", turn * speed, along, printed, length))
    head = ("interval", "a_n m/s²", "a_t m/s²", "Table I m", "ours m")
    return Table("The track", head, tuple(rows))


def _range_table(runs: list[Errors]) -> Table:
    """What the paper says of its curves with the mechanisms, and ours."""
    position = np.linalg.norm(stacked(runs, "position"), axis=2)
    velocity = np.abs(stacked(runs, "velocity"))
    acceleration = np.abs(stacked(runs, "acceleration"))
    attitude = np.abs(stacked(runs, "attitude_deg"))

    def row(name: str, said: str, x: F64) -> tuple[Cell, ...]:
        p95 = float(np.percentile(x, 95))
        return name, said, p95, float(np.median(x.max(axis=1))), float(x.max())

    return Table(
        "With the mechanisms",
        ("error", "paper", "95 %", "worst of a run: median", "worst of all"),
        (
            row("position 3-D m", "below 20", position),
            row("velocity north m/s", "0 to 0.4", velocity[..., 0]),
            row("velocity east m/s", "± 0.5", velocity[..., 1]),
            row("velocity up m/s", "± 0.5", velocity[..., 2]),
            row("acceleration north m/s²", "relatively high accuracy", acceleration[..., 0]),
            row("acceleration east m/s²", "relatively high accuracy", acceleration[..., 1]),
            row("acceleration up m/s²", "within 0.05", acceleration[..., 2]),
            row("roll °", "± 0.5", attitude[..., 0]),
            row("pitch °", "± 0.5", attitude[..., 1]),
            row("heading °", "± 1", attitude[..., 2]),
        ),
    )


def _comparison(runs: Pair) -> Table:
    """RMS with and without the mechanisms, by interval of the track."""
    t = runs[0][0].t
    edges = [*(step[0] for step in STEPS), float(SECONDS) + 1.0]
    spans: list[tuple[str, Inside]] = [("whole track", slice(None))]
    spans += [(f"{a:g}-{min(b, SECONDS):g} s", (t > a) & (t <= b)) for a, b in pairwise(edges)]
    rows: list[tuple[Cell, ...]] = []
    for name, inside in spans:
        pairs = [(_rms(runs[0], kind, inside), _rms(runs[1], kind, inside)) for kind in _KINDS]
        rows.append((name, *(x for pair in pairs for x in pair)))
    return Table("RMS, three-dimensional", ("interval", *_HEADS), tuple(rows))
