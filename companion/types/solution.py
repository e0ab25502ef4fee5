"""What an estimator says of the vehicle, in columns."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Self

import numpy as np

from companion.types.arrays import F64, I64, Flags, Rows


class Mode(IntEnum):
    """What the estimator can stand for at an epoch."""

    ALIGNING = 0
    """No solution yet."""
    HEADING_UNKNOWN = 1
    """Position, velocity and level are estimated; heading is being found from motion."""
    NAVIGATING = 2
    """Aided within the last second or as configured."""
    COASTING = 3
    """Position and velocity aiding is missing for longer than ``engine.coasting_after_s``."""


COV_POS, COV_VEL, COV_ATT, COV_ACCEL_BIAS, COV_GYRO_BIAS = range(5)
"""Rows of :attr:`Solution.cov`."""


@dataclass(frozen=True, slots=True)
class Solution(Rows):
    """Navigation states at output epochs, as columns."""

    t_ns: I64
    lat: F64
    """(N,) [rad] of the IMU's origin."""
    lon: F64
    height: F64
    vel_n: F64
    """(N, 3) [m/s]."""
    q_nb: F64
    """(N, 4) scalar first."""
    accel_bias_b: F64
    """(N, 3) [m/s²]."""
    gyro_bias_b: F64
    """(N, 3) [rad/s]."""
    cov: F64
    """(N, 5, 6) covariance blocks of position (NED, m²), velocity, attitude error (rad², in n),
    accelerometer bias and gyro bias; each the upper triangle xx, xy, xz, yy, yz, zz."""
    mode: I64
    """(N,) :class:`Mode`."""
    resets: I64
    """(N,) how many declared resets came before."""

    @property
    def sd(self) -> F64:
        """(N, 5, 3) standard deviations of the blocks of :attr:`cov`."""
        out: F64 = np.sqrt(self.cov[:, :, [0, 3, 5]])
        return out

    @classmethod
    def empty(cls) -> Self:
        z = np.zeros
        i = np.zeros(0, np.int64)
        return cls(
            i, z(0), z(0), z(0), z((0, 3)), z((0, 4)), z((0, 3)), z((0, 3)), z((0, 5, 6)), i, i
        )


@dataclass(frozen=True, slots=True)
class Smoothed:
    """Epochs smoothed on line, in forward order of time, each given out once."""

    solution: Solution
    lag_ns: I64
    """(N,) how much younger the youngest data behind each epoch may be, with the delay ring in
    which they settle: so much later than the filter's the epoch can be had."""
    smoothed: Flags
    """(N,) false where the estimate is the filter's: between smoothed epochs of a mixed output, and
    where the smoother gave way or failed."""

    def __len__(self) -> int:
        return len(self.solution)

    @classmethod
    def empty(cls) -> Smoothed:
        return cls(Solution.empty(), np.zeros(0, np.int64), np.zeros(0, np.bool_))

    @classmethod
    def concatenate(cls, parts: list[Smoothed]) -> Smoothed:
        """Join in order; empty for an empty list."""
        if len(parts) == 1:
            return parts[0]
        if not parts:
            return cls.empty()
        return cls(
            Solution.concatenate([p.solution for p in parts]),
            np.concatenate([p.lag_ns for p in parts]),
            np.concatenate([p.smoothed for p in parts]),
        )
