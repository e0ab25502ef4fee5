"""Inertial samples that stand for several units."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from companion.types import F64, ImuSamples


@dataclass(frozen=True, slots=True)
class FusedImu(ImuSamples):
    """Means of several units over the intervals that end at the first one's epochs, in its axes.

    ``seq`` and ``t_rx_ns`` are those of the arrival that completed each.
    """

    excess: F64 = field(default_factory=lambda: np.zeros((0, 2)))
    """(N, 2) noise densities, squared, on top of the configured ones, while two units disagree:
    gyro [rad²/s], accelerometer [m²/s³]."""
