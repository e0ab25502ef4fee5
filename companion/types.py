"""The vocabulary that every package shares: samples, solutions, reports, events, errors.

Conventions (the contract of the whole project)
-----------------------------------------------
- Frames: ``e`` ECEF (WGS-84), ``n`` local north-east-down at the vehicle, ``b`` body
  forward-right-down. ``C_nb`` and ``q_nb`` (Hamilton, scalar first) take body vectors to ``n``.
- Units are SI and radians. Names that carry another unit say so (``_deg``, ``_ms``) and live only
  in drivers, configuration keys and what people read.
- Time is int64 nanoseconds on one clock per recording. ``t_ns`` is the time of validity,
  ``t_rx_ns`` the time of arrival, ``seq`` the arrival number across all sensors of a vehicle.
- Samples are columns: one frozen object holds many samples of one sensor. A missing value is NaN.
  A single live sample is a block of length one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from enum import IntEnum
from functools import cache
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Flags = NDArray[np.bool_]

NS = 1_000_000_000
"""Nanoseconds in a second."""


SATELLITES = 64
"""Columns of an epoch of raw GNSS measurements: more satellites than are ever seen at once."""


# --------------------------------------------------------------------------- errors


class CompanionError(Exception):
    """Base of every error that the project raises on purpose; its text is one line for a user."""


class ConfigError(CompanionError):
    """A configuration that cannot be used; names the key, its unit and what would be right."""


class LogFormatError(CompanionError):
    """A log that cannot be read at all, or that holds nothing which can be navigated with."""


class ImuTooSlowError(LogFormatError):
    """The best inertial source is slower than a strapdown filter can use; names the rate."""


class LinkLost(CompanionError):
    """A device or connection that was open is gone: the owner closes it and opens it again."""


# --------------------------------------------------------------------------- samples


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


@dataclass(frozen=True, slots=True)
class StreamInfo:
    """What a reader found out about one stream."""

    source: str
    kind: Literal["imu", "gnss", "baro", "mag", "attitude", "raw", "truth", "autopilot"]
    count: int
    rate_hz: float
    """Median rate; 0 with fewer than two samples."""
    longest_gap_s: float
    gaps: int
    """Intervals longer than five median ones and longer than 0.5 s."""
    note: str = ""


@dataclass(frozen=True, slots=True)
class VehicleRecording:
    """Everything recorded of one vehicle, in columns."""

    name: str
    imu: tuple[ImuSamples, ...] = ()
    """Best source first; the engine uses the first one unless the configuration names another."""
    gnss: tuple[GnssSamples, ...] = ()
    baro: tuple[BaroSamples, ...] = ()
    mag: tuple[MagSamples, ...] = ()
    truth: ReferenceSamples | None = None
    autopilot: ReferenceSamples | None = None
    height_datum: Literal["hae", "msl"] = "hae"
    streams: tuple[StreamInfo, ...] = ()
    raw: tuple[RawGnssSamples, ...] = ()
    broadcast: tuple[BroadcastSamples, ...] = ()
    """Navigation messages for the receiver at the same place in ``raw``."""
    smoothing_gaps: tuple[tuple[int, int], ...] = ()
    """Spans [ns] in which the smoother of a live run gave way to its filter."""
    attitude: tuple[AttitudeSamples, ...] = ()
    """Of other estimators, the autopilot's; used only where the configuration asks for it."""


@dataclass(frozen=True, slots=True)
class Recording:
    """One run as read from a log: one entry a vehicle, and what was wrong with the file."""

    path: str
    format: str
    """``tlog``, ``dataflash``, ``ulog``, ``folder`` or ``mcap``."""
    vehicles: tuple[VehicleRecording, ...]
    notes: tuple[str, ...] = ()
    """One line for each oddity a person should know: bad bytes, clock jumps, truncation."""
    config_toml: str | None = None
    """Configuration that came with the data (``vehicle.toml``, or the one in our own log)."""
    metadata: dict[str, str] = field(default_factory=dict)


# --------------------------------------------------------------------------- solutions


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
class Solution:
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

    def __len__(self) -> int:
        return int(self.t_ns.shape[0])

    @property
    def sd(self) -> F64:
        """(N, 5, 3) standard deviations of the blocks of :attr:`cov`."""
        out: F64 = np.sqrt(self.cov[:, :, [0, 3, 5]])
        return out

    def take(self, index: slice | Sequence[int] | I64) -> Solution:
        """The epochs of ``index``."""
        return Solution(*(getattr(self, f.name)[index] for f in fields(self)))

    @classmethod
    def empty(cls) -> Solution:
        z = np.zeros
        i = np.zeros(0, np.int64)
        return cls(
            i, z(0), z(0), z(0), z((0, 3)), z((0, 4)), z((0, 3)), z((0, 3)), z((0, 5, 6)), i, i
        )

    @classmethod
    def concatenate(cls, parts: list[Solution]) -> Solution:
        """Join in order; empty for an empty list."""
        if not parts:
            return cls.empty()
        if len(parts) == 1:
            return parts[0]
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)))


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
class AidingReports:
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

    def __len__(self) -> int:
        return int(self.t_ns.shape[0])

    @classmethod
    def empty(cls) -> AidingReports:
        i, z = np.zeros(0, np.int64), np.zeros(0)
        return cls(i, i, i, i, np.zeros((0, 3)), np.zeros((0, 3)), z, z, z, i)

    @classmethod
    def concatenate(cls, parts: list[AidingReports]) -> AidingReports:
        """Join in order; empty for an empty list."""
        if not parts:
            return cls.empty()
        if len(parts) == 1:
            return parts[0]
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)))


SMOOTHING_GAVE_WAY, SMOOTHING_RESUMED = "smoothing-gave-way", "smoothing-resumed"
"""Kinds of event that a replay follows: their times say which windows a live run left out."""


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
class AdaptationTrace:
    """Why a measurement was trusted as it was: one row an adapted update, as columns."""

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
    """(N,) factor on the noise of the inertial unit from here on."""
    alpha: F64
    """(N,) exponential weight of the epoch (FLAC); 1 without."""

    def __len__(self) -> int:
        return int(self.t_ns.shape[0])

    @property
    def rule(self) -> I64:
        """(N,) the :class:`Rule` that fired most, or −1 where none did."""
        winner: I64 = np.argmax(self.firing, axis=1)
        return np.where(self.firing.any(axis=1), winner, -1)

    @classmethod
    def empty(cls) -> AdaptationTrace:
        i, z = np.zeros(0, np.int64), np.zeros(0)
        return cls(i, i, i, z, z, z, z, z, np.zeros((0, 9)), z, z, z)

    @classmethod
    def concatenate(cls, parts: list[AdaptationTrace]) -> AdaptationTrace:
        """Join in order; empty for an empty list."""
        if not parts:
            return cls.empty()
        if len(parts) == 1:
            return parts[0]
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)))


@dataclass(frozen=True, slots=True)
class Event:
    """Something that a person or a program downstream should know, at its time."""

    t_ns: int
    kind: str
    """Stable kebab-case name: ``aligned``, ``heading-found``, ``imu-gap``, ``reset``, …"""
    text: str
    """One line for people."""
    level: Literal["info", "warning", "error"] = "info"


NO_SMOOTHED = Smoothed.empty()


@dataclass(frozen=True, slots=True)
class Satellites:
    """The satellites that epochs of raw measurements were fused of, as columns."""

    t_ns: I64
    used: I64
    excluded: I64
    """(N,) whose range contradicted the others."""
    dop: F64
    """(N, 5) GDOP, PDOP, HDOP, VDOP, TDOP of those in use; 1000 where there are too few."""

    def __len__(self) -> int:
        return int(self.t_ns.shape[0])

    @classmethod
    def empty(cls) -> Satellites:
        i = np.zeros(0, np.int64)
        return cls(i, i, i, np.zeros((0, 5)))

    @classmethod
    def concatenate(cls, parts: list[Satellites]) -> Satellites:
        """Join in order; empty for an empty list."""
        if len(parts) == 1:
            return parts[0]
        if not parts:
            return cls.empty()
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)))


NO_SATELLITES = Satellites.empty()


@dataclass(frozen=True, slots=True)
class Outputs:
    """What one engine step gave out."""

    published: Solution
    """Epochs reached for the first time: the causal solution, as a user had it at the time."""
    settled: Solution
    """Epochs that nothing arriving inside the delay ring can change any more."""
    reports: AidingReports
    events: tuple[Event, ...]
    smoothed: Smoothed = NO_SMOOTHED
    """Only from :meth:`companion.engine.Engine.smooth`."""
    adaptation: AdaptationTrace = field(default_factory=AdaptationTrace.empty)
    members: tuple[tuple[str, Solution], ...] = ()
    """Of a bank: what each estimator would have published, under its name."""
    satellites: Satellites = NO_SATELLITES
    """One row an epoch of raw GNSS, as it arrived."""


# --------------------------------------------------------------------------- health

SensorState = Literal["waiting", "ok", "slow", "silent", "back", "no-fix"]
"""``waiting``: nothing came yet; ``slow``: well below its rate; ``silent``: longer than its
time-out; ``back``: came back a moment ago, not yet held for steady; ``no-fix``: a receiver that
talks, and has had no fix for as long as would make it silent."""
LinkState = Literal["up", "lost", "retrying"]
"""``lost``: gone just now; ``retrying``: at least one attempt to open it (again) failed."""
LogState = Literal["off", "writing", "stopped"]
"""``stopped``: the disk does not take it (full?); writing resumes when it does."""


@dataclass(frozen=True, slots=True)
class SensorHealth:
    """How one stream of samples is doing."""

    kind: Literal["imu", "gnss", "baro", "mag", "raw"]
    source: str
    state: SensorState
    used: bool
    """The engine is fed with it; others are only logged."""
    rate_hz: float
    """Samples over the last seconds; 0 while silent."""
    age_s: float
    """Since the last arrival; NaN before the first."""
    samples: int
    lost: int = 0
    """Missing by the sensor's own counter, where it sends one."""
    saturated: int = 0
    """Samples with an axis at the end of its range."""


@dataclass(frozen=True, slots=True)
class LinkHealth:
    """One bus or connection."""

    name: str
    state: LinkState
    received: int
    """Frames or datagrams so far."""
    malformed: int = 0
    """Of them, or bytes among them, what was no message; counted and dropped."""
    reopened: int = 0
    note: str = ""
    """Why it is not up."""


@dataclass(frozen=True, slots=True)
class LoopHealth:
    """How busy the process is, over the time since the last report."""

    load: float
    """CPU time of the process per second, in cores."""
    latency_p50_ms: float
    """From the arrival of a sample to the hand-over of what came of it; NaN without any."""
    latency_p99_ms: float
    latency_max_ms: float
    stall_ms: float
    """Longest time for which no link was looked at: what a latency cannot see."""


@dataclass(frozen=True, slots=True)
class LogHealth:
    """The run log on its way to the disk."""

    state: LogState
    path: str = ""
    written_bytes: int = 0
    queued_bytes: int = 0
    dropped_bytes: int = 0
    """Never reached the disk: the queue was full, or writing had stopped."""


@dataclass(frozen=True, slots=True)
class Health:
    """State of the live process as a whole, about once a second."""

    vehicle: str
    t_ns: int
    uptime_s: float
    mode: Mode
    level: Literal["ok", "warning", "error"]
    """The worst of all parts; ``error``: there is no solution to rely on."""
    text: str
    """One line for people: what is wrong, worst first, or that all is well."""
    sensors: tuple[SensorHealth, ...]
    links: tuple[LinkHealth, ...]
    loop: LoopHealth
    log: LogHealth
    counters: dict[str, int] = field(default_factory=dict)
    """Everything else that is counted, by a stable name (``engine.late_fused``)."""
