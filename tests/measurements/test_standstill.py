"""The standstill detector's record of vibration, which scales the noise of the inertial sensors."""

from __future__ import annotations

import numpy as np
import pytest

from companion.measurements.standstill import observe
from companion.navigation import layout as lo
from companion.types import NS

RATE_HZ = 100
QUARTER_NS = NS // 4


def test_vibration_of_the_last_quarter_is_kept_axis_by_axis() -> None:
    """Shaken at 20 Hz, five whole periods a quarter: half the square of the amplitude each."""
    s, k = np.zeros(lo.CORE_STATES**2 + lo.P), np.zeros(lo.INT_SIZE, np.int64)
    amplitude = np.array([0.01, 0.12, 0.004, 0.3, 0.2, 1.1])
    mean = np.array([0.001, -0.002, 0.003, 0.1, 0.2, -9.8])
    for i in range(RATE_HZ):
        sample = np.append(mean + amplitude * np.sin(2 * np.pi * 20 * i / RATE_HZ), 0.0)
        observe(s, k, lo.CORE_STATES, sample, i * NS // RATE_HZ, QUARTER_NS, 0.01, 0.1, 0.3)
    assert s[lo.GYRO_VIBRATION : lo.GYRO_VIBRATION + 3] == pytest.approx(amplitude[:3] ** 2 / 2)
    assert s[lo.VIBRATION] == pytest.approx(np.mean(amplitude[3:] ** 2 / 2))
