"""One epoch of the solution, taken apart for encoders of single messages."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from companion.navigation.rotation import matrix_from_quat, rpy_from_quat
from companion.types import COV_ATT, COV_POS, COV_VEL, F64, NS, Mode, Solution

_FULL = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""From an upper triangle to the whole matrix."""
_LONGEST_NS = NS // 2
"""Between epochs that rates are taken from."""
_STEEPEST = 0.05
"""Least cosine of pitch with which Euler angles have a covariance: about 87°."""


@dataclass(frozen=True, slots=True)
class Epoch:
    """Navigation state at one time; SI, radians, north-east-down, body forward-right-down."""

    t_ns: int
    lat: float
    lon: float
    height: float
    vel_n: F64
    q_nb: F64
    C_nb: F64
    rpy: F64
    """Roll, pitch, yaw [rad]."""
    cov_pos: F64
    """(3, 3) [m²]."""
    cov_vel: F64
    """(3, 3) [m²/s²]."""
    cov_att: F64
    """(3, 3) of the attitude error in n [rad²]."""
    mode: Mode
    resets: int
    rate_b: F64
    """(3,) mean angular rate since the epoch before [rad/s]; NaN for a first one."""
    accel_n: F64
    """(3,) mean acceleration since the epoch before [m/s²]; NaN for a first one."""

    @property
    def sd_horizontal(self) -> float:
        """Square root of the summed north and east variances [m]."""
        return math.sqrt(max(0.0, self.cov_pos[0, 0] + self.cov_pos[1, 1]))

    @property
    def vel_b(self) -> F64:
        """Velocity in body axes [m/s]."""
        turned: F64 = self.C_nb.T @ self.vel_n
        return turned

    @property
    def cov_vel_b(self) -> F64:
        """Covariance of the velocity in body axes (3, 3); attitude is taken as known."""
        turned: F64 = self.C_nb.T @ self.cov_vel @ self.C_nb
        return turned

    @property
    def cov_rpy(self) -> F64:
        """Covariance of roll, pitch and yaw (3, 3) [rad²].

        A small turn φ in n changes yaw by φ_D + tan θ (cos ψ φ_N + sin ψ φ_E), pitch by
        −sin ψ φ_N + cos ψ φ_E and roll by (cos ψ φ_N + sin ψ φ_E) / cos θ.
        """
        _, pitch, yaw = self.rpy
        c, s = math.cos(yaw), math.sin(yaw)
        cos_pitch = max(math.cos(pitch), _STEEPEST)
        tan_pitch = math.sin(pitch) / cos_pitch
        J = np.array(
            [[c / cos_pitch, s / cos_pitch, 0.0], [-s, c, 0.0], [c * tan_pitch, s * tan_pitch, 1.0]]
        )
        cov: F64 = J @ self.cov_att @ J.T
        return cov

    @property
    def usable(self) -> bool:
        """Everything that would be sent is finite."""
        return bool(
            np.isfinite([self.lat, self.lon, self.height]).all()
            and np.isfinite(self.vel_n).all()
            and np.isfinite(self.q_nb).all()
            and np.isfinite(self.cov_pos).all()
            and np.isfinite(self.cov_vel).all()
            and np.isfinite(self.cov_att).all()
        )


class Before(NamedTuple):
    """What is kept of an epoch for the next one's rates."""

    t_ns: int
    q_nb: F64
    vel_n: F64


def before_next(solution: Solution, i: int) -> Before:
    """Row ``i`` of a solution, to be passed with the epoch after it."""
    return Before(int(solution.t_ns[i]), solution.q_nb[i], solution.vel_n[i])


def epoch_at(solution: Solution, i: int, before: Before | None) -> Epoch:
    """Row ``i`` of a solution; ``before`` is the epoch that rates are differences to."""
    t_ns, q, vel_n = before_next(solution, i)
    rate_b = accel_n = np.full(3, np.nan)
    if before is not None and 0 < t_ns - before.t_ns <= _LONGEST_NS:
        dt = (t_ns - before.t_ns) / NS
        rate_b = _turn(before.q_nb, q) / dt
        accel_n = (vel_n - before.vel_n) / dt
    return Epoch(
        t_ns,
        float(solution.lat[i]),
        float(solution.lon[i]),
        float(solution.height[i]),
        vel_n,
        q,
        matrix_from_quat(q),
        rpy_from_quat(q[None])[0],
        solution.cov[i, COV_POS][_FULL],
        solution.cov[i, COV_VEL][_FULL],
        solution.cov[i, COV_ATT][_FULL],
        Mode(int(solution.mode[i])),
        int(solution.resets[i]),
        rate_b,
        accel_n,
    )


def _turn(q0: F64, q1: F64) -> F64:
    """Rotation vector in body axes (3,) that takes attitude ``q0`` to ``q1``: 2 log(q0* ⊗ q1)."""
    w = float(q0 @ q1)
    v = q0[0] * q1[1:] - q1[0] * q0[1:] - np.cross(q0[1:], q1[1:])
    if w < 0:
        w, v = -w, -v
    sine = math.sqrt(float(v @ v))
    turned: F64 = v * (2.0 * math.atan2(sine, w) / sine if sine > 0 else 2.0)
    return turned
