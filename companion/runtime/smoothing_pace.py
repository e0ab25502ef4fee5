"""Whether the smoother beside the filter keeps up: times in, decisions out. Pure.

The engine has no clock. Whoever has one says here what filter and smoother took; a decision is an
event in the log, by the time of the data, so that a replay does the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

from companion.config import Config
from companion.types import NS

SPAN_NS = 2 * NS
"""Load is judged over spans of this length."""
PAUSE_NS = 10 * NS
"""The smoother gives way for at least this long; it doubles while it helps for no longer."""
LONGEST_PAUSE_NS = 640 * NS

Stopwatch = Callable[[], int]
"""A clock [ns] that nothing but durations are read from."""
Decision = Literal["give-way", "resume"]


class SmoothingPace:
    """Adds up what filter and smoother take, and decides once a span."""

    def __init__(self, config: Config, now_ns: int) -> None:
        self._limit = config.smoothing.load_limit
        self._since_ns = now_ns
        self._filter_ns = self._smooth_ns = 0
        self._pause_ns = PAUSE_NS
        self._until_ns: int | None = None
        self._all = [0, 0, 0, 0]
        self.times_given_way = 0
        self.load = 0.0
        """Share of a core that both took over the last span."""

    @property
    def giving_way(self) -> bool:
        """Whether the smoother is off for a while."""
        return self._until_ns is not None

    def filtered(self, took_ns: int, samples: int) -> None:
        """Note an engine step with inertial samples."""
        self._filter_ns += took_ns
        self._all[0] += took_ns
        self._all[1] += samples

    def smoothed(self, took_ns: int, epochs: int) -> None:
        """Note a call of the smoother, and how many smoothed epochs came of it."""
        self._smooth_ns += took_ns
        if not epochs:
            return
        self._all[2] += took_ns
        self._all[3] += epochs

    def tick(self, now_ns: int) -> Decision | None:
        """Judge a span when it is over."""
        span = now_ns - self._since_ns
        if span < SPAN_NS:
            return None
        self.load = (self._filter_ns + self._smooth_ns) / span
        smoothing = self._smooth_ns > 0
        self._since_ns = now_ns
        self._filter_ns = self._smooth_ns = 0
        if self._until_ns is not None:
            # The filter alone must leave room, or the next span would end the same way.
            if now_ns < self._until_ns or self.load > self._limit:
                return None
            self._until_ns = None
            return "resume"
        if not smoothing or self.load <= self._limit:
            self._pause_ns = max(PAUSE_NS, self._pause_ns - span)
            return None
        self._until_ns = now_ns + self._pause_ns
        self._pause_ns = min(2 * self._pause_ns, LONGEST_PAUSE_NS)
        self.times_given_way += 1
        return "give-way"

    def rate_bound_hz(self, run_ns: int, interval_s: float) -> float:
        """The largest output rate at which smoothing fits into what an inertial epoch leaves.

            d_out ≤ (1/d_s − t_f) / (n_up T t_up)

        d_s: rate of the samples over the run so far, ``run_ns``; t_f: measured time of a filter
        step; n_up T: of a smoothed epoch, which every window passes; t_up: ``interval_s`` between
        updates, where Duong & Chiang 2012 eq. 21 have one second. NaN before there is anything
        measured; 0 where the filter alone takes all the time.
        """
        filter_ns, samples, smooth_ns, epochs = self._all
        if not (samples and smooth_ns and interval_s > 0):
            return math.nan
        left_s = (run_ns - filter_ns) / samples / NS
        return max(0.0, left_s / (smooth_ns / epochs / NS * interval_s))

    def counters(self) -> dict[str, int]:
        """Measured means, for health."""
        filter_ns, samples, smooth_ns, epochs = self._all
        return {
            "smoothing.filter_step_ns": filter_ns // samples if samples else 0,
            "smoothing.epoch_ns": smooth_ns // epochs if epochs else 0,
            "smoothing.load_permille": round(1000 * self.load),
            "smoothing.gave_way": self.times_given_way,
        }
