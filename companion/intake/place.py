"""Where about the run is, and the magnetic declination there; what waits until it is known."""

from __future__ import annotations

from collections import deque

import numpy as np

from companion.config import DEG, Config
from companion.measurements.magnetometer import declination
from companion.types import I64, NS, GnssSamples, MagSamples

EARLY_MAG = 4
"""Magnetometer arrivals kept until the first fix tells the place and so the declination."""
_MONTH_NS = 30 * 86_400 * NS


class Place:
    """The run's place to a hundred metres, its declination, and magnetometer arrivals before it."""

    def __init__(self, config: Config) -> None:
        self._configured = config.mag.declination_deg
        self._fix: tuple[float, float, float] | None = None
        self._early: deque[MagSamples] = deque()
        self.declination: float | None = None
        """[rad], east positive; None until it is known."""

    @property
    def waiting(self) -> bool:
        """Whether magnetometer arrivals wait for a first fix."""
        return bool(self._early)

    def note(self, fixes: GnssSamples) -> None:
        """Remember where about the run is: rounded, so that it does not depend on which fix."""
        if self._fix is not None:
            return
        lat, lon = fixes.lat, fixes.lon
        good = np.flatnonzero((fixes.fix_type >= 3) & np.isfinite(lat) & (np.abs(lat) < 1.56))
        if len(good):
            m = int(good[0])
            self._fix = round(float(lat[m]), 3), round(float(lon[m]), 3), 0.0

    def ready(self, t_ns: I64) -> bool:
        """Whether declination is known: configured, or the model's at the place, at ``t_ns[0]``."""
        if self.declination is None:
            if self._configured is not None:
                self.declination = self._configured * DEG
            elif self._fix is not None:
                when = int(t_ns[0]) // _MONTH_NS * _MONTH_NS
                self.declination = declination(*self._fix, when)
        return self.declination is not None

    def hold(self, samples: MagSamples) -> MagSamples | None:
        """Keep ``samples`` until :meth:`released`; returns those that there is no more room for."""
        gone = self._early.popleft() if len(self._early) == EARLY_MAG else None
        self._early.append(samples)
        return gone

    def released(self, fixes: GnssSamples) -> list[MagSamples]:
        """What waited, once ``fixes`` say where the run is; in order of arrival."""
        self.note(fixes)
        if not self._early or not self.ready(self._early[0].t_ns):
            return []
        early = list(self._early)
        self._early.clear()
        return early
