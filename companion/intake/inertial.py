"""Inertial samples as rows of the walk: body axes, times of validity, later and later."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.config import Config
from companion.estimation.saturation import SATURATION
from companion.estimation.walk import EXCESS
from companion.intake.counters import Counters
from companion.intake.fused import FusedImu
from companion.intake.saturation import SaturationWatch
from companion.types import F64, I64, NS, Event, ImuSamples

CLOCK_BACK_NS = NS
"""An IMU clock that goes back further than this has been restarted; less is a late sample."""
IMU_SIZE = 10
"""Columns of a row: rate, specific force, interval, what is saturated, excess noise of both (gyro
first)."""
CHUNK = 20_000
"""Inertial samples walked between two drains of the outputs: bounds memory, not results."""


def turned(v: F64, axes: Sequence[Sequence[float]]) -> F64:
    """Vectors (N, 3) by the rows of ``axes``, summed in one order.

    A matrix product may sum otherwise for another N or processor, and the bits with it.
    """
    return np.stack([v[:, 0] * a[0] + v[:, 1] * a[1] + v[:, 2] * a[2] for a in axes], axis=1)


class Mounting:
    """The axes that a sensor's vectors are turned by, body FRD being the result."""

    def __init__(self, config: Config) -> None:
        self._axes = config.imu.axes
        self._identity = bool(np.array_equal(self._axes, np.eye(3)))

    def turn(self, v: F64) -> F64:
        """Vectors (N, 3) in body axes."""
        return v if self._identity else turned(v, self._axes)

    def turn_one(self, v: list[float]) -> list[float]:
        """One vector in body axes, summed in the same order."""
        if self._identity:
            return v
        return [v[0] * a[0] + v[1] * a[1] + v[2] * a[2] for a in self._axes]


@dataclass(frozen=True, slots=True)
class Stretch:
    """Samples later than all before them, and the restart of the clock that ends them."""

    t: I64
    rows: F64
    restart: tuple[int, int] | None
    """Last time on the old clock and first on the new one [ns]."""


class InertialIntake:
    """Turns blocks of inertial samples into rows, and says where the clock is to be believed."""

    def __init__(self, config: Config, counters: Counters) -> None:
        self._mounting = Mounting(config)
        self._saturation = SaturationWatch(config)
        self._latency_ns = round(config.imu.latency_ms * 1e6)
        self._counters = counters

    def rows(self, block: ImuSamples) -> tuple[I64, F64]:
        """Times of validity, and rows (N, IMU_SIZE) in body axes as the walk takes them."""
        if len(block) == 1 and not isinstance(block, FusedImu):
            row = self._one(block)
            if row is not None:
                return block.t_ns - self._latency_ns, row
        rows = np.zeros((len(block), IMU_SIZE))
        rows[:, :3] = self._mounting.turn(block.gyro_b)
        rows[:, 3:6] = self._mounting.turn(block.accel_b)
        np.fmax(block.interval_s, 0.0, out=rows[:, 6])  # NaN, an instantaneous sample: 0
        rows[:, SATURATION] = self._saturation.flags(block)
        if isinstance(block, FusedImu):
            rows[:, EXCESS : EXCESS + 2] = block.excess
        return block.t_ns - self._latency_ns, rows

    def _one(self, block: ImuSamples) -> F64 | None:
        """The row (1, IMU_SIZE) of the one sample in ``block``; None unless it is plain.

        Live, a sample comes alone: for one, a numpy call costs more than all there is to compute.
        What is not finite, or at the end of the range, is left to the way that blocks take.
        """
        gyro, accel = block.gyro_b[0].tolist(), block.accel_b[0].tolist()
        interval = float(block.interval_s[0])
        row = [*self._mounting.turn_one(gyro), *self._mounting.turn_one(accel)]
        clipped = block.clipped[0] != 0.0
        if clipped or not math.isfinite(sum(row)) or self._saturation.reached(gyro, accel):
            return None
        row += (interval if interval > 0.0 else 0.0, 0.0, 0.0, 0.0)
        return np.array([row])

    def watch(self, t: I64, rows: F64) -> None:
        """Count what is saturated, each sample once: ``rows`` may be asked for twice."""
        flags = rows[:, SATURATION]
        found = flags[0] > 0.0 if len(flags) == 1 else flags.any()
        if found or self._saturation.begun:
            self._counters.imu_saturated += self._saturation.note(t, flags)

    def events(self, final: bool = False) -> tuple[Event, ...]:
        """What there is to say of saturation since the last call."""
        return self._saturation.take_events(final)

    def finite(self, t: I64, rows: F64) -> tuple[I64, F64]:
        """Without the samples that are no numbers, which are counted."""
        total = sum(rows[0].tolist()) if len(rows) == 1 else rows.sum()
        if math.isfinite(total):
            return t, rows
        good = np.isfinite(rows[:, :6]).all(axis=1)
        self._counters.imu_not_finite += len(t) - int(good.sum())
        return t[good], rows[good]

    def stretch(self, t: I64, rows: F64, head: int | None) -> tuple[Stretch, I64, F64]:
        """The samples up to a restart of the clock, and the times and rows behind it.

        ``head``: time of the last sample taken before. What is not later is counted and dropped.
        """
        peak = np.maximum.accumulate(t if head is None else np.maximum(t, head))
        before = np.concatenate([[t[0] - 1 if head is None else head], peak[:-1]])
        back = np.flatnonzero(before - t > CLOCK_BACK_NS)
        stop = int(back[0]) if len(back) else len(t)
        fresh = t[:stop] > before[:stop]
        self._counters.imu_out_of_order += int(stop - fresh.sum())
        restart = (int(before[stop]), int(t[stop])) if stop < len(t) else None
        return Stretch(t[:stop][fresh], rows[:stop][fresh], restart), t[stop:], rows[stop:]


def in_order(t: I64, head: int | None) -> bool:
    """Whether inertial samples can be taken as they are: some, not too many, each later."""
    if not 0 < len(t) <= CHUNK or (head is not None and t[0] <= head):
        return False
    return len(t) == 1 or bool(np.all(t[1:] > t[:-1]))
