"""Latencies of the loop: exact over a second for health, in fine steps over a whole run. Pure."""

from __future__ import annotations

import math

import numpy as np

STEPS = 48
"""Steps of an octave in the run's histogram: 1.5 % wide, finer than what is measured."""
_OCTAVES = 40


class Latencies:
    """Collects latencies [ns]; memory does not grow with the run."""

    def __init__(self) -> None:
        self._recent: list[int] = []
        self._histogram = np.zeros(STEPS * _OCTAVES, np.int64)
        self._max_ns = 0

    def add(self, latency_ns: int) -> None:
        """Take one."""
        self._recent.append(latency_ns)

    def recent_ms(self) -> tuple[float, float, float]:
        """p50, p99 and largest [ms] since the last call; NaN without any."""
        values = np.array(self._recent, np.float64)
        self._recent = []
        if not len(values):
            return math.nan, math.nan, math.nan
        self._max_ns = max(self._max_ns, int(values.max()))
        steps = (np.log2(np.maximum(values, 1.0)) * STEPS).astype(np.int64)
        np.add.at(self._histogram, np.minimum(steps, len(self._histogram) - 1), 1)
        p50, p99 = np.percentile(values, (50, 99))
        return float(p50) / 1e6, float(p99) / 1e6, float(values.max()) / 1e6

    def of_run_ms(self) -> tuple[float, float, float]:
        """p50, p99 and largest [ms] of everything :meth:`recent_ms` has seen."""
        total = np.cumsum(self._histogram)
        if not total[-1]:
            return math.nan, math.nan, math.nan
        at = np.searchsorted(total, np.array([0.5, 0.99]) * total[-1])
        p50, p99 = 2.0 ** ((at + 0.5) / STEPS) / 1e6
        return float(p50), float(p99), self._max_ns / 1e6
