"""The same filter with time reversed: what changes sign, and what does not.

With t' = t₀ − t the strapdown equations hold as they are once angular rate, gyro bias, velocity and
the Earth's rate are negated; specific force, gravity, attitude and position stay (mechanisation.py;
Kamil et al. 2014, section 4.2, inverts "orientation and turn rate values" in the same intent). So
the filter runs backwards through its own kernel, on samples in reversed order. Scale factors, lever
arm, barometer offset and slow GNSS error stay, too; P has its sign turned where one factor has.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.estimation import parameters as par
from companion.estimation.aid_table import A_VELOCITY, KIND_GNSS
from companion.estimation.source_faults import forget
from companion.estimation.stretch import Block
from companion.navigation import layout as lo
from companion.types import F64, I64

_NEVER = np.int64(1) << 62
"""Period of a grid that is never reached: no rows and snapshots of the walk's own."""


@dataclass(frozen=True, slots=True)
class Mirror:
    """The map from a time of validity to its mirror image and back: t' = twice the end − t."""

    end_ns: int

    def __call__(self, t: I64) -> I64:
        """Times that grow as ``t`` (N,) falls."""
        return 2 * self.end_ns - t


def reversed_parameters(ipar: I64) -> I64:
    """Integer parameters of a run backwards: feedback, one filter, no output of its own."""
    out = ipar.copy()
    out[par.OUTPUT_NS] = out[par.SNAPSHOT_NS] = _NEVER
    out[par.FEEDFORWARD] = 0
    return out


def reversed_block(block: Block, mirror: Mirror, following: F64 | None) -> Block:
    """Samples and aids of ``block`` as they come in reversed time.

    A sample that is the mean over the interval behind it belongs, reversed, to the step that ends
    at the sample before; ``following`` is the sample after the block, None at the end of the data.
    An aid at the instant of a sample comes after it, as forwards it came before: an epoch's
    forward and backward estimates never share a measurement.
    """
    imu = block.imu
    if len(imu) and (imu[:, 6] > 0.0).any():
        imu = np.concatenate([imu[1:], imu[-1:] if following is None else following[None]])
    imu = imu[::-1].copy()
    imu[:, :3] *= -1.0
    aid = block.aid[::-1].copy()
    fix = block.aid_key[::-1, 0] == KIND_GNSS
    aid[np.ix_(fix, range(A_VELOCITY, A_VELOCITY + 3))] *= -1.0
    return Block(
        np.ascontiguousarray(mirror(block.imu_t)[::-1]),
        imu,
        np.ascontiguousarray(mirror(block.aid_t)[::-1]) + 1,
        np.ascontiguousarray(block.aid_key[::-1]),
        aid,
    )


def turn_around(nominal: F64) -> None:
    """Negate velocity and gyro bias of states (..., ≥ GNSS_BIAS + 3) in place; an involution."""
    nominal[..., lo.VEL_N : lo.VEL_N + 3] *= -1.0
    nominal[..., lo.GYRO_BIAS_B : lo.GYRO_BIAS_B + 3] *= -1.0


def signs(n: int) -> F64:
    """(n,) of the errors, −1 for what :func:`turn_around` negates: P' = diag(s) P diag(s)."""
    out = np.ones(n)
    out[lo.VEL : lo.VEL + 3] = out[lo.GYRO_BIAS : lo.GYRO_BIAS + 3] = -1.0
    return out


def reversed_state(s: F64, k: I64, n: int, ipar: I64, mirror: Mirror) -> tuple[F64, I64]:
    """A forward filter's state as the start of a run backwards; P is the same but for signs.

    What was learned of the sensors (vibration, spread at rest, adaptive scales) is kept; what is
    under way (interval sums, standstill window, windows of innovations, the shadow that sources are
    held against) begins anew.
    """
    s, k = s.copy(), k.copy()
    turn_around(s)
    s[lo.EARTH_RATE] *= -1.0
    s[lo.LAST_GYRO : lo.LAST_GYRO + 3] *= -1.0
    s[lo.SUM_T : lo.SUM_XA + 1] = 0.0
    s[lo.STILL_SUM : lo.STILL_LEARNED] = 0.0
    s[lo.STILL_ANCHOR : lo.STILL_ANCHOR + 4] = 0.0
    s[lo.VELOCITY_FIT] = 0.0
    s[lo.WINDOWS : lo.P] = 0.0
    forget(s, k)
    P = s[lo.P :].reshape(n, n)
    sign = signs(n)
    P *= sign[:, None] * sign
    t = int(mirror(k[lo.T_NOW]))
    for name in (lo.T_NOW, lo.T_IMU, lo.T_POSITION_AID, lo.T_VELOCITY_AID):
        k[name] = t
    for name in (lo.T_GNSS_SPEED, lo.T_CHECK, lo.STANDING, lo.STILL_COUNT):
        k[name] = 0
    k[lo.T_OUTPUT] = k[lo.T_SNAPSHOT] = 0
    for cell, period in ((lo.T_COVARIANCE, par.COVARIANCE_NS), (lo.STILL_CELL, par.STILL_NS)):
        k[cell] = t // int(ipar[period])
    if ipar[par.CONSTRAINT_NS]:
        k[lo.T_CONSTRAINT] = t // int(ipar[par.CONSTRAINT_NS])
    return s, k
