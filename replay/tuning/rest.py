"""The longest stretch of a recording in which the vehicle stood."""

from __future__ import annotations

import numpy as np

from companion.types import NS, ImuSamples, VehicleRecording

_WINDOW_S = 1.0
_SPEED_MPS = 0.3
_QUIET = 3.0
"""A second counts as quiet up to this many times the spread of the quietest tenth."""
_GYRO_MEAN_RADPS, _ACCEL_MEAN_MPS2 = 0.01, 0.15
"""Means of a stretch stay within this of their median: turning and tilting are motion."""


def longest_rest(vehicle: VehicleRecording, imu: ImuSamples) -> ImuSamples:
    """The longest run of quiet seconds, empty where there is none.

    Quiet: spread of rate and force near the smallest seen, their means steady, and no receiver
    whose mean velocity over the second exceeds 0.3 m/s.
    """
    if len(imu) < 3:
        return imu.take(slice(0, 0))
    cell = ((imu.t_ns - imu.t_ns[0]) / (_WINDOW_S * NS)).astype(np.int64)
    starts = np.flatnonzero(np.diff(cell, prepend=-1))
    values = np.hstack([imu.gyro_b, imu.accel_b])
    count = np.diff(np.append(starts, len(cell)))[:, None]
    mean = np.add.reduceat(values, starts) / count
    square = np.add.reduceat(values * values, starts) / count
    sd = np.sqrt(np.maximum(square - mean * mean, 0.0))
    spread = np.column_stack([sd[:, :3].max(axis=1), sd[:, 3:].max(axis=1)])
    quiet = np.all(spread <= _QUIET * np.quantile(spread, 0.1, axis=0) + 1e-9, axis=1)
    middle = np.median(mean[quiet], axis=0)
    off = np.abs(mean - middle)
    quiet &= np.all(off[:, :3] < _GYRO_MEAN_RADPS, axis=1)
    quiet &= np.all(off[:, 3:] < _ACCEL_MEAN_MPS2, axis=1)
    quiet &= ~_moving(vehicle, imu.t_ns[starts])
    # A second that is missing ends a stretch.
    breaks = ~quiet | (np.diff(cell[starts], prepend=cell[0]) > 1)
    group = np.cumsum(breaks)
    lengths = np.bincount(group[quiet], minlength=int(group[-1]) + 1)
    if not lengths.any():
        return imu.take(slice(0, 0))
    inside = np.flatnonzero(quiet & (group == np.argmax(lengths)))
    ends = np.append(starts[1:], len(cell))
    return imu.take(slice(int(starts[inside[0]]), int(ends[inside[-1]])))


def _moving(vehicle: VehicleRecording, t_ns: np.ndarray) -> np.ndarray:
    """For each second from ``t_ns`` on: whether the receiver saw a speed."""
    moving = np.zeros(len(t_ns), bool)
    for gnss in vehicle.gnss[:1]:
        known = np.isfinite(gnss.vel_n[:, :2]).all(axis=1)
        at = np.searchsorted(t_ns, gnss.t_ns[known], side="right") - 1
        north, east = (
            np.bincount(at[at >= 0], gnss.vel_n[known, axis][at >= 0], len(t_ns)) for axis in (0, 1)
        )
        # The mean of a second's velocities: one noisy fix is no motion.
        count = np.maximum(np.bincount(at[at >= 0], minlength=len(t_ns)), 1)
        moving |= np.hypot(north, east) / count > _SPEED_MPS
    return moving
