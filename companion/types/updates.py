"""What became of a measurement, and why it was trusted as it was."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Self

import numpy as np

from companion.types.arrays import F64, I64, Rows


class Channel(IntEnum):
    """Aiding channels: what one innovation, one gate and one adaptation belong to."""

    GNSS_POSITION_H = 0
    GNSS_POSITION_V = 1
    GNSS_VELOCITY_H = 2
    GNSS_VELOCITY_V = 3
    BARO = 4
    MAG = 5
    COURSE = 6
    ZERO_VELOCITY = 7
    ZERO_RATE = 8
    NON_HOLONOMIC = 9
    ATTITUDE = 10
    """Of another estimator; only the direct filter takes it."""
    GYRO = 11
    """Of the direct filter, to which inertial samples are measurements."""
    ACCELEROMETER = 12
    SOURCE_H = 16
    """Not a measurement: how far GNSS position is off what its velocities make of it, once a second
    (estimation/source_faults.py)."""
    SOURCE_V = 17
    """The same for its height."""
    RANGE_GPS = 18
    RANGE_GALILEO = 19
    RANGE_BEIDOU = 20
    RATE_GPS = 21
    RATE_GALILEO = 22
    RATE_BEIDOU = 23


class Verdict(IntEnum):
    """What became of an aiding measurement; a refusal always has a name."""

    ACCEPTED = 0
    REJECTED_GATE = 1
    """Normalised innovation squared above the gate."""
    REFUSED_LATE = 2
    """Older than the delay ring."""
    REFUSED_NO_FIX = 3
    """The receiver itself says that there is no fix, or accuracy is beyond the limit."""
    REFUSED_INVALID = 4
    """Non-finite or impossible values."""
    REFUSED_NOT_ALIGNED = 5
    """There is no solution yet to compare it with."""
    REFUSED_CLOCK = 6
    """Its time of validity cannot be right (far in the future)."""
    REJECTED_SOURCE = 7
    """The source contradicts itself, or has long disagreed: none of it is used."""
    REJECTED_UNCONFIRMED = 8
    """First after a gap: waits for others that agree with it."""


@dataclass(frozen=True, slots=True)
class AidingReports(Rows):
    """One row an update, as columns."""

    t_ns: I64
    channel: I64
    """(N,) :class:`Channel`."""
    source: I64
    """(N,) index of the receiver or sensor among those of its kind."""
    dof: I64
    """(N,) 1 to 3, components used; 0 for a refusal."""
    innovation: F64
    """(N, 3) measured − predicted, channel units."""
    innovation_sd: F64
    """(N, 3) square root of the diagonal of S = H P Hᵀ + R."""
    nis: F64
    """(N,) normalised innovation squared yᵀ S⁻¹ y."""
    gate: F64
    """(N,) threshold that ``nis`` was held against."""
    scale: F64
    """(N,) factor on R by the adaptation; 1 without one."""
    verdict: I64
    """(N,) :class:`Verdict`."""

    @classmethod
    def empty(cls) -> Self:
        i, z = np.zeros(0, np.int64), np.zeros(0)
        return cls(i, i, i, i, np.zeros((0, 3)), np.zeros((0, 3)), z, z, z, i)


class Rule(IntEnum):
    """The nine rules of an adaptation, by what the innovations of a window look like.

    Spread against what the filter believes of it, mean against the spread.
    """

    SPREAD_LOW_MEAN_ZERO = 0
    SPREAD_LOW_MEAN_SMALL = 1
    SPREAD_LOW_MEAN_LARGE = 2
    SPREAD_USUAL_MEAN_ZERO = 3
    SPREAD_USUAL_MEAN_SMALL = 4
    SPREAD_USUAL_MEAN_LARGE = 5
    SPREAD_HIGH_MEAN_ZERO = 6
    SPREAD_HIGH_MEAN_SMALL = 7
    SPREAD_HIGH_MEAN_LARGE = 8


@dataclass(frozen=True, slots=True)
class AdaptationTrace(Rows):
    """Why a measurement was trusted as it was: one row an adapted update, as columns.

    Of ranges: one row an epoch and satellite system, told by what is left over in it.
    """

    t_ns: I64
    channel: I64
    """(N,) :class:`Channel`."""
    source: I64
    """(N,) as in the aiding reports."""
    mean: F64
    """(N,) deviate of the innovations' mean, standard normal for a healthy sensor; NaN, as the
    next two, where the window is too short or the method does not look."""
    spread: F64
    """(N,) deviate of their scatter about it."""
    correlation: F64
    """(N,) deviate of their lag-one correlation."""
    to_model: F64
    """(N,) share of a mean that is taken for the inertial unit's, 0 to 1."""
    to_source: F64
    """(N,) share that is taken for a fault of the source: nothing is scaled for it."""
    firing: F64
    """(N, 9) strength of each :class:`Rule`; all zero where a method has none."""
    r_scale: F64
    """(N,) factor on R of this measurement."""
    q_scale: F64
    """(N,) factor on the noise of the inertial unit from here on; NaN of the ranges of a satellite
    system, which have no say in it."""
    alpha: F64
    """(N,) exponential weight of the epoch (FLAC); 1 without, NaN as above."""

    @property
    def rule(self) -> I64:
        """(N,) the :class:`Rule` that fired most, or −1 where none did."""
        winner: I64 = np.argmax(self.firing, axis=1)
        return np.where(self.firing.any(axis=1), winner, -1)

    @classmethod
    def empty(cls) -> Self:
        i, z = np.zeros(0, np.int64), np.zeros(0)
        return cls(i, i, i, z, z, z, z, z, np.zeros((0, 9)), z, z, z)
