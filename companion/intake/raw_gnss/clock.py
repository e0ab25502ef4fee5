"""A receiver's clock, epoch by epoch: what is taken off for its steps, how noisy it is."""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.gnss.clock_noise import interrupt, learn_clock
from companion.gnss.clock_steps import C_OFFSET, offset_at
from companion.gnss.corrected import S_RANGE
from companion.gnss.sight import G_RANGE, look, stand
from companion.gnss.single_point import P_CLOCK, P_RATE, SOLVED
from companion.gnss.systems import SYSTEMS
from companion.intake.raw_gnss.state import K_CLOCK, T_KNOWN, T_POS, T_TIME
from companion.types import F64, I64

FASTEST_MPS = 100.0


@njit("f8(f8[:, ::1], i8, f8[:, ::1])", cache=True, counted=False)
def _median_residual(rows: F64, m: int, sight: F64) -> float:
    """Median of range less what is expected of ``m`` > 0 satellites; orders ``sight`` by it."""
    for s in range(m):
        value, at = rows[s, S_RANGE] - sight[s, G_RANGE], s
        while at > 0 and sight[at - 1, 0] > value:
            sight[at, 0] = sight[at - 1, 0]
            at -= 1
        sight[at, 0] = value
    return float(0.5 * (sight[m // 2, 0] + sight[(m - 1) // 2, 0]))


@njit("i8(f8[::1])", cache=True, counted=False)
def _first_clock(point: F64) -> int:
    """The first system whose clock is solved: one clock in all but the systems' biases."""
    c = 0
    while c < SYSTEMS - 1 and np.isnan(point[P_CLOCK + c]):
        c += 1
    return c


@njit(
    "f8(f8, i8, f8[:, ::1], i8, f8[::1], f8[::1], f8[::1], f8[::1], f8[:, ::1])",
    cache=True,
    counted=False,
)
def clock_offset(
    now: float, code: int, rows: F64, m: int, point: F64, place: F64, clock: F64, frame: F64,
    sight: F64,
) -> float:  # fmt: skip
    """Clock offset to take off; without a solution, steps are looked for at the last place."""
    if code == SOLVED:
        bias = point[P_CLOCK + _first_clock(point)]
        return offset_at(clock, now, bias, point[P_RATE], 0.0)
    if np.isnan(clock[C_OFFSET]):
        return 0.0
    if place[T_KNOWN] == 0.0 or m == 0:
        return float(clock[C_OFFSET])
    stand(place[T_POS], place[T_POS + 1], place[T_POS + 2], frame)
    look(rows, m, place[T_POS : T_POS + 3], frame, sight)
    # The vehicle has gone on since it was last known where it is.
    doubt = FASTEST_MPS * (now - place[T_TIME])
    return offset_at(clock, now, _median_residual(rows, m, sight), np.nan, doubt)


@njit("void(f8, b1, b1, f8[::1], f8, i8[::1], f8[::1])", cache=True)
def learn_clock_noise(
    now: float, solved: bool, jumped: bool, point: F64, offset: float, memory: I64, learner: F64
) -> None:
    """Let the noise of the clock be learned from an epoch's own solution, if it has one."""
    if jumped:
        interrupt(learner)
    if solved:
        system = _first_clock(point)
        if system != memory[K_CLOCK]:
            interrupt(learner)
            memory[K_CLOCK] = system
        learn_clock(learner, now, point[P_CLOCK + system] - offset, point[P_RATE])
