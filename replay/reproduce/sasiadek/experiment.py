"""Best four satellites by GDOP through hours of rising and setting; feedforward and feedback."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from companion.config import RawGnss
from companion.estimation.pseudorange8 import EightState, Tuning
from companion.gnss.corrected import S_SAT
from companion.gnss.geometry import ned_axes
from companion.intake.raw_gnss.receiver import Receiver
from companion.navigation.earth import ecef
from companion.types import F64, I64
from replay.reproduce import figures
from replay.reproduce.paper import Cell, Reproduction, Table
from replay.reproduce.sasiadek.flight import EVERY_S, SD_RANGE_M, Flight, fly

SEEDS = 2
SETTLED_S = 300.0
"""Left out of the statistics: the start, from an INS that may be kilometres off."""
AFTER_S = 10
"""A spike is looked for this long behind a change of set."""
MODES = ("feedforward", "feedback")
CITATION = (
    "J.Z. Sasiadek, P. Hartana: GPS/INS Sensor Fusion for Accurate Positioning and Navigation "
    "Based on Kalman Filtering, 2004"
)
TUNING = Tuning(accel_mps2_rthz=0.01, clock_m_rts=0.3, drift_mps_rts=0.2)


@dataclass(frozen=True, slots=True)
class Run:
    """One flight through both filters, on the best four."""

    seconds: F64
    errors: dict[str, F64]
    """By mode (N, 3) position error, east, north, up [m]."""
    rates: dict[str, F64]
    """By mode (N, 3) velocity error [m/s]."""
    sd: dict[str, F64]
    """By mode (N,) deviation that the filter states for east velocity [m/s]."""
    gain: dict[str, F64]
    gdop: F64
    visible: I64
    sets: list[tuple[int, ...]]

    @property
    def changes(self) -> I64:
        """Epochs whose set is not that of the epoch before."""
        same = [a == b for a, b in zip(self.sets[:-1], self.sets[1:], strict=True)]
        return np.flatnonzero(~np.array(same)) + 1


def _choosing(choice: Literal["all", "best"]) -> RawGnss:
    """The receiver's settings: noise as it is simulated, the best four or all."""
    return RawGnss(
        choice=choice,
        best_of=4,
        elevation_mask_deg=5.0,
        sd_range_m=SD_RANGE_M,
        sd_multipath_m=0.0,
        iono_residual=0.0,
    )


def run(flight: Flight, config: RawGnss, tuning: Tuning = TUNING) -> Run:
    """Both filters through ``flight`` on the satellites that ``config`` chooses."""
    receiver = Receiver(config)
    receiver.listen(flight.sky.broadcast)
    filters = {mode: EightState(tuning, feedback=mode == "feedback") for mode in MODES}
    n = len(flight.seconds)
    errors = {mode: np.empty((n, 3)) for mode in MODES}
    rates = {mode: np.empty((n, 3)) for mode in MODES}
    sd, gain = ({mode: np.empty(n) for mode in MODES} for _ in range(2))
    gdop, visible, sets = np.empty(n), np.empty(n, np.int64), []
    truth = ecef(*flight.truth.T)
    axes = np.empty((3, 3))
    for i in range(n):
        prepared = receiver.take(flight.sky.raw, i)
        sets.append(tuple(sorted(prepared.rows[:, S_SAT].astype(int).tolist())))
        gdop[i], visible[i] = prepared.dop[0], (flight.sky.raw.sat[i] > 0).sum()
        ned_axes(flight.truth[i, 0], flight.truth[i, 1], axes)
        east_north_up = np.stack([axes[1], axes[0], -axes[2]])
        for mode, filter_ in filters.items():
            out = filter_.step(EVERY_S, flight.ins[i], prepared.rows)
            errors[mode][i] = east_north_up @ (out.ecef - truth[i])
            rates[mode][i] = out.velocity_error - flight.velocity_error[i]
            sd[mode][i], gain[mode][i] = np.sqrt(out.variances[1]), out.gain
    return Run(flight.seconds, errors, rates, sd, gain, gdop, visible, sets)


def reproduce(out: Path | None, seeds: int, progress: Callable[[str], None]) -> Reproduction:
    """Do it; figures go to ``out``."""
    best: list[Run] = []
    every: list[Run] = []
    for seed in range(seeds):
        progress(f"flight {seed + 1} of {seeds}")
        flight = fly(seed)
        best.append(run(flight, _choosing("best")))
        every.append(run(flight, _choosing("all")))
    drawn: tuple[str, ...] = ()
    notes = [
        "the paper prints curves and no numbers, so its columns are empty; its flight is not given",
        "the sky, the flight and the INS are simulated; ranges have white noise and multipath",
        "both modes are one filter but for where the range is linearised: they differ by the "
        "square of the INS's error over twice the range, which stays below the noise here",
    ]
    if out is not None:
        if figures.available():
            from replay.reproduce.sasiadek.figure import draw

            drawn = draw(best[0], out)
        else:
            notes.append(figures.HOW_TO_GET)
    return Reproduction(
        "sasiadek", CITATION, (_errors(best, every), _spikes(best)), drawn, tuple(notes)
    )


def _errors(best: list[Run], every: list[Run]) -> Table:
    """RMS of position and velocity, by mode, on the best four and on all."""
    rows: list[tuple[Cell, ...]] = []
    for words, runs in (("best four", best), ("all in view", every)):
        for mode in MODES:
            cells: list[Cell] = [f"{words}, {mode}", None]
            for of in ("errors", "rates"):
                settled = [getattr(r, of)[mode][r.seconds > SETTLED_S] for r in runs]
                rms = np.sqrt(np.mean(np.concatenate(settled) ** 2, axis=0))
                cells += [round(float(x), 3) for x in rms]
            cells.append(round(float(np.mean([r.gdop[r.seconds > SETTLED_S] for r in runs])), 2))
            rows.append(tuple(cells))
    columns = ("satellites, filter", "paper", "east m", "north m", "up m", "east m/s", "north m/s",
               "up m/s", "mean GDOP")  # fmt: skip
    return Table("RMS errors over 2.5 h", columns, tuple(rows))


def _spikes(best: list[Run]) -> Table:
    """How far the position moves at a change of set, against an epoch without one."""
    rows: list[tuple[Cell, ...]] = []
    for mode in MODES:
        at_change, elsewhere, count = [], [], 0
        for r in best:
            step = np.linalg.norm(np.diff(r.errors[mode], axis=0), axis=1)
            changes = r.changes[r.seconds[r.changes] > SETTLED_S]
            count += len(changes)
            near = np.zeros(len(step), np.bool_)
            for c in changes:
                at_change.append(float(step[c - 1]))
                near[max(c - 1, 0) : c + AFTER_S] = True
            elsewhere += step[~near & (r.seconds[1:] > SETTLED_S)].tolist()
        rows.append(
            (mode, None, count, round(float(np.sqrt(np.mean(np.square(at_change)))), 3),
             round(float(np.max(at_change)), 2),
             round(float(np.sqrt(np.mean(np.square(elsewhere)))), 3))
        )  # fmt: skip
    columns = ("filter", "paper", "changes of set", "step there m RMS", "largest m",
               "step elsewhere m RMS")  # fmt: skip
    return Table("Spikes where the set of four changes", columns, tuple(rows))
