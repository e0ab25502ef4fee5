"""What refused samples of a unit say: a motion beyond the model, or a shaking airframe.

A motion lasts and has a direction, and no other unit denies it: after some samples it is believed.
A vibration has none; its variance is learned and added to that of the samples.
"""

from __future__ import annotations

import math

from companion._jit import njit
from companion.estimation.direct.layout import (
    ACC,
    ATT,
    L_N,
    L_P,
    L_UNITS,
    RATE,
    UNIT_INTS,
    UNIT_TIMES,
)
from companion.estimation.update import R_INNOVATION, R_SD
from companion.types import F64, I64

PERSISTENT = 3
"""Refused samples of a unit in a row after which it is believed, unless another unit disagrees."""
AGREED_NS = 200_000_000
"""How long an accepted sample of one unit speaks against a refused one of another."""
MISSED_S = 1.0
"""Longest turn that attitude makes up for once its rate is believed."""
SHAKE_S = 4.0
"""Memory of what is learned of a unit's vibration."""
SURPRISE = 4.0
"""A persistent surprise is a motion beyond the model: its square, times this, is what the model
allows for once."""


@njit("b1(i8[::1], i8[::1], i8, i8)", cache=True)
def contradicted(k: I64, lay: I64, unit: int, t: int) -> bool:
    """Whether another unit was accepted just now: then it is this one that errs."""
    for other in range(lay[L_UNITS]):
        if other != unit and k[UNIT_TIMES + UNIT_INTS * other + 1] > t - AGREED_NS:
            return True
    return False


@njit("void(f8[::1], i8[::1], i8, f8[::1], f8)", cache=True)
def allow(s: F64, lay: I64, half: int, y: F64, since: float) -> None:
    """Widen rate (``half`` 0) or acceleration by the size of a surprise ``y`` (3,).

    ``since`` [s]: what was refused so long was a turn, which attitude has to make up for.
    """
    n = lay[L_N]
    P = s[lay[L_P] : lay[L_P] + n * n].reshape((n, n))
    var = SURPRISE * (y[0] * y[0] + y[1] * y[1] + y[2] * y[2])
    first = RATE if half == 0 else ACC
    for i in range(3):
        P[first + i, first + i] += var
        if half == 0:
            P[ATT + i, ATT + i] += var * since * since
            P[ATT + i, RATE + i] += var * since
            P[RATE + i, ATT + i] += var * since


@njit("void(f8[::1], i8, f8[::1], f8)", cache=True)
def learn_shaking(s: F64, shake: int, report: F64, age: float) -> None:
    """Variance of a unit's force beyond model and density, from its innovations, axis by axis.

    A sample of a slow stream is one of a vibration that the stream cannot show: tens of m/s² on an
    airframe with an engine. The excess follows min(y², 16 S) − S with :data:`SHAKE_S`, not below 0.
    """
    gain = -math.expm1(-min(age, 1.0) / SHAKE_S)
    for i in range(3):
        S = report[R_SD + i] * report[R_SD + i]
        y = report[R_INNOVATION + i]
        if S > 0.0:
            s[shake + i] = max(s[shake + i] + gain * (min(y * y, 16.0 * S) - S), 0.0)


@njit("b1(f8[::1], i8, f8[::1])", cache=True)
def turned_round(s: F64, shake: int, y: F64) -> bool:
    """Whether a refused innovation points away from the one refused last; keeps the new one.

    A motion that the model did not foresee has a direction; what shakes has none.
    """
    along = 0.0
    for i in range(3):
        along += s[shake + 3 + i] * y[i]
        s[shake + 3 + i] = y[i]
    return along < 0.0
