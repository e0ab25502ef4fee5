"""What sensors give, in columns."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from companion.types.arrays import F64, I64

SATELLITES = 64
"""Columns of an epoch of raw GNSS measurements: more satellites than are ever seen at once."""


@cache
def _columns(kind: type[Samples]) -> tuple[str, ...]:
    """Names of the array columns of a kind of samples, in order: all fields but the source."""
    return tuple(f.name for f in fields(kind))[1:]


@dataclass(frozen=True, slots=True)
class Samples:
    """Columns shared by every sensor; all arrays have the same first dimension N."""

    source: str
    """Name of the stream, as the log names it (``HIGHRES_IMU``, ``imu2``, ``GPS[0]``)."""
    t_ns: I64
    """(N,) time of validity as stamped by the source; latencies are taken off by the engine."""
    t_rx_ns: I64
    """(N,) time of arrival on the same clock, never decreasing."""
    seq: I64
    """(N,) arrival number, unique and increasing over all streams of one vehicle."""

    def __len__(self) -> int:
        return int(self.t_ns.shape[0])

    def take(self, index: slice | NDArray[np.int64] | NDArray[np.bool_]) -> Self:
        """The same columns, restricted to the rows of ``index``."""
        # As `object`: mypy takes the __hash__ of a frozen dataclass's instances for its class's.
        kind: object = type(self)
        return type(self)(self.source, *[getattr(self, n)[index] for n in _columns(kind)])


_NOT_SAID = np.zeros(0)


def _not_said() -> F64:
    """What an optional column holds until :func:`_fill` has seen how many samples there are."""
    return _NOT_SAID


def _fill(samples: Samples, name: str, value: float) -> None:
    """Give an optional column that nobody named its rows, all ``value``."""
    if getattr(samples, name) is _NOT_SAID:
        object.__setattr__(samples, name, np.full(len(samples), value))


@dataclass(frozen=True, slots=True)
class ImuSamples(Samples):
    """Inertial samples: angular rate and specific force, or their means over an interval."""

    gyro_b: F64
    """(N, 3) angular rate [rad/s]."""
    accel_b: F64
    """(N, 3) specific force [m/s²]; (0, 0, −9.81) level and at rest."""
    interval_s: F64
    """(N,) for an IMU that gives integrals: the integration interval that ends at ``t_ns`` [s],
    ``gyro_b`` and ``accel_b`` then being integral / interval. NaN: an instantaneous sample."""
    clipped: F64 = field(default_factory=_not_said)
    """(N,) what the sensor's driver says of the end of its range: 1 the accelerometers reached it,
    2 the gyros, 3 both; 0.5 a counter of clipped accelerations rose just before it; 0 none of it,
    or it says nothing."""

    def __post_init__(self) -> None:
        _fill(self, "clipped", 0.0)


@dataclass(frozen=True, slots=True)
class GnssSamples(Samples):
    """GNSS fixes. Missing components are NaN; ``fix_type`` < 2 means that there is no fix."""

    lat: F64
    """(N,) geodetic latitude [rad]."""
    lon: F64
    """(N,) longitude [rad]."""
    height: F64
    """(N,) height [m] above the recording's datum (see :attr:`VehicleRecording.height_datum`)."""
    vel_n: F64
    """(N, 3) antenna velocity, NED [m/s]; the down component is NaN where only speed and course
    are known."""
    sd_pos: F64
    """(N, 3) reported position standard deviations, NED [m]; NaN where the source has none."""
    sd_vel: F64
    """(N, 3) reported velocity standard deviations, NED [m/s]; NaN where the source has none."""
    num_sats: I64
    """(N,) satellites used; −1 unknown."""
    fix_type: I64
    """(N,) as MAVLink: 0-1 none, 2 two-dimensional, 3 three-dimensional, 4 differential,
    5 RTK float, 6 RTK fixed."""
    interference: F64 = field(default_factory=_not_said)
    """(N,) how far the receiver says that it is jammed or spoofed, 0 not to 1 wholly; NaN where it
    says nothing."""

    def __post_init__(self) -> None:
        _fill(self, "interference", np.nan)


@dataclass(frozen=True, slots=True)
class BaroSamples(Samples):
    """Static pressure."""

    pressure: F64
    """(N,) [Pa]."""


@dataclass(frozen=True, slots=True)
class MagSamples(Samples):
    """Magnetic field in body axes."""

    field_b: F64
    """(N, 3) [T]; sources without an absolute scale give any consistent one."""


@dataclass(frozen=True, slots=True)
class AttitudeSamples(Samples):
    """Attitude by another estimator, for the one that asks for it: ``direct.attitude``."""

    rpy: F64
    """(N, 3) roll, pitch, yaw [rad]."""


@dataclass(frozen=True, slots=True)
class ReferenceSamples(Samples):
    """A solution by somebody else: simulator truth, RTK, or the autopilot's own estimate.

    For evaluation only. Nothing here is ever an input of an estimator.
    """

    lat: F64
    """(N,) [rad]."""
    lon: F64
    """(N,) [rad]."""
    height: F64
    """(N,) [m], same datum as the recording's GNSS."""
    vel_n: F64
    """(N, 3) NED [m/s], NaN where unknown."""
    rpy: F64
    """(N, 3) roll, pitch, yaw [rad], NaN where unknown."""


@dataclass(frozen=True, slots=True)
class RawGnssSamples(Samples):
    """Raw measurements of a satellite receiver, an epoch a row; K is :data:`SATELLITES`.

    Satellites are numbered as in :mod:`companion.gnss`: 100 · (system + 1) + PRN with GPS 0,
    Galileo 1, BeiDou 2; one signal each: L1 C/A, E1, B1I or B3I.
    """

    week: I64
    """(N,) GPS week of reception, by the receiver's own clock."""
    tow: F64
    """(N,) second of that week, as above: what the pseudoranges refer to."""
    sat: I64
    """(N, K) satellites; 0 where a row has fewer."""
    signal: I64
    """(N, K) 0: L1 C/A, E1 or B1I; 1: B3I."""
    pseudorange: F64
    """(N, K) [m] as measured; NaN without."""
    rate: F64
    """(N, K) its rate [m/s], positive where the range grows; NaN without Doppler."""
    cn0: F64
    """(N, K) carrier to noise density [dB-Hz]."""
    sd_range: F64
    """(N, K) the receiver's own 1σ of the pseudorange [m]; NaN without."""
    sd_rate: F64
    """(N, K) the same for the rate [m/s]."""


@dataclass(frozen=True, slots=True)
class BroadcastSamples(Samples):
    """Navigation messages: an ephemeris, or the coefficients of the ionosphere, a row."""

    sat: I64
    """(N,) whose ephemeris; 0 for an ionosphere."""
    values: F64
    """(N, 28) the columns of :mod:`companion.gnss.orbit`; of an ionosphere α0…α3, β0…β3 first."""


AidingSamples = (
    GnssSamples
    | BaroSamples
    | MagSamples
    | AttitudeSamples
    | RawGnssSamples
    | BroadcastSamples
    | ImuSamples
)
"""What may come late; inertial samples only of units beside the first (``further_imu``)."""
AnySamples = AidingSamples
