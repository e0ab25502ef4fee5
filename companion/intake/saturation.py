"""Inertial samples at the end of a sensor's range: flagged for the filter, told to people."""

from __future__ import annotations

import numpy as np

from companion.config import DEG, Config
from companion.estimation.saturation import ACCEL, COUNTED, GYRO
from companion.types import F64, I64, NS, Event, ImuSamples

ROUNDING = 1e-3
"""Share of the range that its end may be off by: a converter's last code, a unit's conversion."""
QUIET_NS = 10 * NS
"""Without a saturated sample for this long an episode is over."""


class SaturationWatch:
    """Finds the samples at the end of a range, and says so once an episode.

    A sample is there by the configured range, or because its driver says so.
    """

    def __init__(self, config: Config) -> None:
        gyro, accel = config.imu.gyro_range_dps * DEG, config.imu.accel_range_mps2
        self._gyro = (gyro or np.inf) * (1.0 - ROUNDING)
        self._accel = (accel or np.inf) * (1.0 - ROUNDING)
        self._ranges = gyro > 0.0 or accel > 0.0
        self._first_ns = self._last_ns = 0
        self._counts, self._counted = [0, 0], False
        self._events: list[Event] = []

    @property
    def begun(self) -> bool:
        """Whether an episode is running, which time alone may end."""
        return self._counted or any(self._counts)

    def reached(self, gyro: list[float], accel: list[float]) -> bool:
        """Whether one sample (3 + 3 finite values, in the sensor's own axes) is at an end."""
        return self._ranges and (
            max(map(abs, gyro)) >= self._gyro or max(map(abs, accel)) >= self._accel
        )

    def flags(self, block: ImuSamples) -> F64:
        """(N,) what is at its end, as the walk's column says it; in the sensor's own axes."""
        if not self._ranges:
            return block.clipped
        gyro_most = np.abs(block.gyro_b).max(initial=0.0)
        accel_most = np.abs(block.accel_b).max(initial=0.0)
        # Nearly always; what is no number is looked at sample by sample.
        if gyro_most < self._gyro and accel_most < self._accel:
            return block.clipped
        gyro = np.abs(block.gyro_b).max(axis=1) >= self._gyro
        gyro |= block.clipped >= GYRO
        accel = np.abs(block.accel_b).max(axis=1) >= self._accel
        accel |= (block.clipped == ACCEL) | (block.clipped > GYRO)
        own = np.where(accel, ACCEL, 0.0) + np.where(gyro, GYRO, 0.0)
        return np.where(own > 0.0, own, block.clipped)

    def note(self, t: I64, flags: F64) -> int:
        """Take in the times (N,) [ns] and flags (N,) of samples; how many are saturated."""
        at = np.flatnonzero(flags)
        for now, which in zip(t[at].tolist(), flags[at].tolist(), strict=True):
            self._close(now)
            if not self.begun:
                self._first_ns = now
                self._events.append(
                    Event(now, "imu-saturated", f"{_names(which)} at the end of the range: "
                          "trusted less from here on", "warning")
                )  # fmt: skip
            self._last_ns = now
            self._counted |= which == COUNTED
            self._counts[0] += which == ACCEL or which > GYRO
            self._counts[1] += which >= GYRO
        if len(t):
            self._close(int(t[-1]))
        return len(at)

    def take_events(self, final: bool = False) -> tuple[Event, ...]:
        """What there is to say since the last call; ``final``: no sample comes any more."""
        if final:
            self._close(self._last_ns + QUIET_NS + 1)
        if not self._events:
            return ()
        events, self._events = tuple(self._events), []
        return events

    def _close(self, now: int) -> None:
        """End an episode that has been quiet for long enough at ``now``."""
        if not self.begun or now - self._last_ns <= QUIET_NS:
            return
        told = [
            f"{name} {count} time{'s' * (count > 1)}"
            for name, count in zip(("accelerometer", "gyro"), self._counts, strict=True)
            if count
        ]
        if self._counted:
            told.append("by the autopilot's counter of clipped accelerations")
        said = " and ".join(told)
        seconds = (self._last_ns - self._first_ns) / NS
        text = f"the range was left: {said} within {seconds:.1f} s"
        self._events.append(Event(self._last_ns + QUIET_NS, "imu-in-range", text))
        self._counts, self._counted = [0, 0], False


def _names(which: float) -> str:
    if which <= ACCEL:
        return "accelerometer"
    return "gyro" if which == GYRO else "accelerometer and gyro"
