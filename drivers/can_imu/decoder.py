"""What all CAN IMU decoders share: counters, the unit's mounting, samples collected as columns."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from companion.types import ImuSamples

Vec3 = tuple[float, float, float]
Axes = tuple[Vec3, Vec3, Vec3]

IDENTITY: Axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
AXIS_NAMES = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")


class CanFrame(NamedTuple):
    """One data frame."""

    can_id: int
    extended: bool
    """29-bit identifier."""
    data: bytes
    """0 to 8 bytes; to 64 with CAN FD."""


@dataclass(slots=True)
class CanCounters:
    """What became of the frames of one unit."""

    frames: int = 0
    """Frames that belong to the unit's inertial messages."""
    samples: int = 0
    lost: int = 0
    """Samples that the unit sent and that never came, by its own counter."""
    repeated: int = 0
    """Frames or samples that came twice."""
    malformed: int = 0
    """Frames and transfers that break the protocol, and values that are no numbers."""
    incomplete: int = 0
    """Samples given up because one of their frames was missing."""
    saturated: int = 0
    """Samples with an axis at the end of its range."""
    restarts: int = 0
    """Times that the unit's clock or counter began again."""


@dataclass(frozen=True, slots=True)
class Unit:
    """One inertial unit, whatever its protocol."""

    source: str
    """Name of the stream."""
    axes: Axes = IDENTITY
    """Rotation from the unit's axes to those of the vehicle's first IMU, row by row."""
    gyro_range: float = math.inf
    """[rad/s] an axis at it is saturated."""
    accel_range: float = math.inf
    """[m/s²]"""
    rate_hz: float = 0.0
    """Expected sample rate; 0: learned."""


class CanImuDecoder(ABC):
    """Frames of a bus in, inertial samples out. Pure: time is what the caller says.

    Other traffic is left alone, bad frames are counted and dropped; nothing raises.
    """

    steps: tuple[float, float] = (0.0, 0.0)
    """Last place of the wire format [rad/s, m/s²]; 0 for floats. See :func:`rounding_density`."""

    def __init__(self, unit: Unit, full_scale: tuple[float, ...] = (math.inf,) * 6) -> None:
        """``full_scale`` (6,) [rad/s, m/s²]: the wire format's own."""
        self.source = unit.source
        self.counters = CanCounters()
        self.saturated: tuple[str, ...] = ()
        """Axes of the latest sample at the end of their range, named in the unit's own frame."""
        self._unit = unit
        self._turned = unit.axes != IDENTITY
        own = (unit.gyro_range,) * 3 + (unit.accel_range,) * 3
        # A little less, so that rounding in a unit's scale does not hide the last step.
        self._limits = tuple(min(a, b) * (1.0 - 1e-9) for a, b in zip(own, full_scale, strict=True))
        self._limited = min(self._limits) < math.inf
        self._times: list[tuple[int, int, int]] = []
        self._values: list[tuple[float, ...]] = []

    @abstractmethod
    def wants(self, can_id: int, extended: bool) -> bool:
        """Whether frames of this identifier can be this unit's: to route traffic beforehand."""

    @abstractmethod
    def feed(self, seq: int, t_rx_ns: int, can_id: int, extended: bool, data: bytes) -> bool:
        """Take one data frame; whether it was one of this unit's.

        ``seq``: arrival number; ``t_rx_ns``: arrival on the run's clock, never decreasing.
        """

    def take(self) -> ImuSamples | None:
        """The samples completed since the last call; each has the ``seq`` of its last frame."""
        if not self._times:
            return None
        times = np.array(self._times, np.int64)
        values = np.array(self._values, np.float64)
        self._times, self._values = [], []
        return ImuSamples(
            self.source,
            np.ascontiguousarray(times[:, 0]),
            np.ascontiguousarray(times[:, 1]),
            np.ascontiguousarray(times[:, 2]),
            np.ascontiguousarray(values[:, 0:3]),
            np.ascontiguousarray(values[:, 3:6]),
            np.ascontiguousarray(values[:, 6]),
            np.ascontiguousarray(values[:, 7]),
        )

    def _add(
        self,
        seq: int,
        t_ns: int,
        t_rx_ns: int,
        sample: tuple[float, float, float, float, float, float],
        interval_s: float = math.nan,
        peak: tuple[float, ...] | None = None,
    ) -> None:
        """Keep a sample in the unit's axes [rad/s, m/s²].

        ``peak``: what saturation is judged by, where the sample is a mean.
        """
        gx, gy, gz, ax, ay, az = sample
        if not math.isfinite(gx + gy + gz + ax + ay + az):
            self.counters.malformed += 1
            return
        self.counters.samples += 1
        clipped = self._note_saturation(sample if peak is None else peak) if self._limited else 0.0
        if self._turned:
            x, y, z = self._unit.axes
            gx, gy, gz = (r[0] * gx + r[1] * gy + r[2] * gz for r in (x, y, z))
            ax, ay, az = (r[0] * ax + r[1] * ay + r[2] * az for r in (x, y, z))
        self._times.append((t_ns, t_rx_ns, seq))
        self._values.append((gx, gy, gz, ax, ay, az, interval_s, clipped))

    def _note_saturation(self, sample: tuple[float, ...]) -> float:
        """Which axes are at their end, and the same as :attr:`ImuSamples.clipped`."""
        a, b, c, d, e, f = sample
        i, j, k, m, n, o = self._limits
        if -i < a < i and -j < b < j and -k < c < k and -m < d < m and -n < e < n and -o < f < o:
            # Nearly always: this is on the hot path.
            self.saturated = ()
            return 0.0
        self.saturated = tuple(
            name
            for name, value, limit in zip(AXIS_NAMES, sample, self._limits, strict=True)
            if abs(value) >= limit
        )
        if not self.saturated:
            return 0.0
        self.counters.saturated += 1
        accel = max(abs(d) - m, abs(e) - n, abs(f) - o) >= 0.0
        gyro = max(abs(a) - i, abs(b) - j, abs(c) - k) >= 0.0
        return (1.0 if accel else 0.0) + (2.0 if gyro else 0.0)


def rounding_density(step: float, rate_hz: float) -> float:
    """Noise density that rounding to ``step`` adds, in its unit per √Hz: step / √(12 rate).

    A rounding error is uniform over a step, so its variance is step²/12, and white as long as the
    signal moves by more than a step from sample to sample. Add it to the sensor's own by squares.
    """
    return step / math.sqrt(12.0 * rate_hz)


class CanImuEncoder(ABC):
    """Inertial samples in the unit's wire format: for simulators and tests."""

    @abstractmethod
    def encode(self, samples: ImuSamples) -> list[CanFrame]:
        """The frames of all ``samples``, in the order a unit sends them.

        Values beyond the format's range are sent as its end, as a saturated sensor does.
        """
