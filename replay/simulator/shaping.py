"""Smooth motion from piecewise-linear commands.

A plan is written as commands that a driver or an autopilot would give (reach this speed in so many
seconds, hold, turn), then smoothed by a compact kernel. Smoothing a command keeps constants and
ramps exact away from corners, keeps integrals over a manoeuvre and never overshoots, so a stop
stays a stop and a distance stays a distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from companion.types import F64

LEAD_S = 1.0
"""Plans are laid from this long before the start to this long after the end [s], so that splines
and latencies have room on both sides."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Velocity and attitude of the IMU at evenly spaced knots, before exact kinematics."""

    t: F64
    """(K,) [s] from the start of the recording."""
    vel_n: F64
    """(K, 3) velocity over the Earth, NED [m/s]."""
    rpy: F64
    """(K, 3) roll, pitch, continuous yaw [rad]."""


class Schedule:
    """Piecewise-linear commands of several channels, appended in time.

    Channels are whatever the plan needs (speed, course, …); units are the caller's.
    """

    def __init__(self, *start: float) -> None:
        self._t: list[float] = [-LEAD_S]
        self._values: list[tuple[float, ...]] = [start]
        self.stay(LEAD_S)

    @property
    def now(self) -> float:
        """Time reached so far [s]."""
        return self._t[-1]

    @property
    def values(self) -> tuple[float, ...]:
        """Commands at :attr:`now`."""
        return self._values[-1]

    def go(self, seconds: float, *values: float) -> None:
        """Change linearly to ``values`` over ``seconds``; nothing for no time."""
        if seconds > 0:
            self._t.append(self.now + seconds)
            self._values.append(values)

    def stay(self, seconds: float) -> None:
        """Hold the commands for ``seconds``."""
        self.go(seconds, *self.values)

    def at(self, t: F64) -> F64:
        """Commands (K, channels) at times ``t`` (K,); the last ones are held."""
        table = np.array(self._values)
        return np.stack([np.interp(t, self._t, column) for column in table.T], axis=-1)


def knots(duration_s: float, step_s: float) -> F64:
    """Knot times [s] of a plan, from −LEAD_S to at least ``duration_s`` + LEAD_S."""
    before = int(np.ceil(LEAD_S / step_s))
    after = int(np.ceil((duration_s + LEAD_S) / step_s))
    return np.asarray(np.arange(-before, after + 1) * step_s, dtype=np.float64)


def smooth(values: F64, width_s: float, step_s: float) -> F64:
    """``values`` (K, …) smoothed along the first axis by a cubic B-spline of support ``width_s``.

    Four equal boxes, the discrete cubic B-spline: corners of a command become C3. Symmetric (no
    delay) and of unit sum; the ends are extended by their own value.
    """
    box = max(1, round(width_s / 4.0 / step_s))
    kernel = np.ones(1)
    for _ in range(4):
        kernel = np.convolve(kernel, np.full(box, 1.0 / box))
    half = (len(kernel) - 1) // 2
    columns = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
    padded = np.pad(columns, ((half, half), (0, 0)), mode="edge")
    out = np.stack([np.convolve(c, kernel, mode="valid") for c in padded.T], axis=-1)
    return np.asarray(out.reshape(np.shape(values)), dtype=np.float64)


def spline(t: F64, values: F64) -> BSpline[np.float64]:
    """Quintic interpolating spline (C4) through ``values`` (K, …) at ``t`` (K,)."""
    return make_interp_spline(t, np.asarray(values, dtype=np.float64), k=5)


def rate(t: F64, values: F64) -> F64:
    """Time derivative of ``values`` (K, …) at their knots, through :func:`spline`."""
    return np.asarray(spline(t, values).derivative()(t))


def integral(t: F64, values: F64) -> F64:
    """Running integral of ``values`` (K, …) over ``t``, zero at the first knot."""
    return np.asarray(spline(t, values).antiderivative()(t))
