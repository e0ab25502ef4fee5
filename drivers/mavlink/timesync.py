"""The autopilot's clock against ours by TIMESYNC: round trips, the fastest of them, a line.

    offset = (ts1 + now) / 2 − tc1      ts1, now: our clock at both ends; tc1: theirs in between

The error of one exchange is half the difference between the way there and the way back, which
queueing makes many milliseconds at times; among many exchanges the fastest have it small on both
ways. Their offsets give a line over time, offset and drift, by least squares with the drift held
near zero as far as crystals have it. Protocol: mavlink.io/en/services/timesync.html.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from companion.types import NS

WINDOW_NS = 30 * NS
_FASTEST = 0.15
"""Share of the round trips in the window that is used."""
_AT_LEAST = 6
_FLOOR_NS = 20_000.0
"""Deviation of one exchange below which no claim is made: stamps and scheduling."""
_DRIFT_SD = 100e-6
"""Prior of the drift: crystals are within 50 ppm each, and warm up."""
_BURST_NS, _BURST_STEP_NS = 3 * NS // 2, NS // 20
_STEP_NS = NS // 4
"""Interval of requests: 20 Hz at first, then 4 Hz."""
_ANSWER_WITHIN_NS = NS
"""A slower answer says nothing about the clock."""


@dataclass(frozen=True, slots=True)
class Line:
    """Our clock minus theirs as a function of ours."""

    at_ns: int
    """Time of ours that the offset belongs to."""
    offset_ns: int
    """An integer: nanoseconds of Unix time do not fit a float."""
    drift: float
    """Change of the offset per time."""
    sd_ns: float
    """Of the offset, at ``at_ns``."""
    drift_sd: float

    def offset_at(self, now_ns: int) -> int:
        """Offset [ns] at a time of our clock."""
        return self.offset_ns + round(self.drift * (now_ns - self.at_ns))

    def sd_at(self, now_ns: int) -> float:
        """Standard deviation [ns] of the offset there."""
        return math.hypot(self.sd_ns, self.drift_sd * (now_ns - self.at_ns))


@dataclass(frozen=True, slots=True)
class _Exchange:
    at_ns: int
    offset_ns: int
    round_trip_ns: int


class TimeSync:
    """Asks at the right times, keeps the exchanges of the last half minute, fits the line."""

    def __init__(self) -> None:
        self._exchanges: deque[_Exchange] = deque()
        self._asked: deque[int] = deque(maxlen=64)
        self._begun_ns: int | None = None
        self._line: Line | None = None
        self.refused = 0
        """Answers to nothing that we asked, or too late."""

    def __len__(self) -> int:
        return len(self._exchanges)

    def reset(self) -> None:
        """Their clock started anew: forget everything, ask often again."""
        self._exchanges.clear()
        self._asked.clear()
        self._begun_ns = None
        self._line = None

    def request(self, now_ns: int) -> int | None:
        """``ts1`` of a request to send now, or None if none is due."""
        if self._begun_ns is None:
            self._begun_ns = now_ns
        step = _BURST_STEP_NS if now_ns - self._begun_ns < _BURST_NS else _STEP_NS
        if self._asked and 0 <= now_ns - self._asked[-1] < step:
            return None
        self._asked.append(now_ns)
        return now_ns

    def answer(self, tc1_ns: int, ts1_ns: int, now_ns: int) -> bool:
        """Take an answer that arrived at ``now_ns``; False if it answers no open request."""
        took = now_ns - ts1_ns
        if ts1_ns not in self._asked or not 0 <= took <= _ANSWER_WITHIN_NS:
            self.refused += 1
            return False
        middle = ts1_ns + took // 2
        self._exchanges.append(_Exchange(middle, middle - tc1_ns, took))
        while now_ns - self._exchanges[0].at_ns > WINDOW_NS:
            self._exchanges.popleft()
        self._line = None
        return True

    @property
    def round_trip_ns(self) -> int | None:
        """Fastest round trip of the window."""
        return min((e.round_trip_ns for e in self._exchanges), default=None)

    def line(self) -> Line | None:
        """Offset and drift by the exchanges of the window; None before there are a few."""
        if self._line is None and len(self._exchanges) >= _AT_LEAST:
            self._line = _fit(self._exchanges)
        return self._line


def _fit(exchanges: deque[_Exchange]) -> Line:
    """Least squares over the fastest exchanges, with a prior on the drift.

    o_i = a + b (t_i − t̄) + e_i,   b ~ N(0, σ_b²),   e_i ~ N(0, s²); s is the root mean square of
    what the chosen round trips exceed the fastest by, halved: all of it on one way at worst.
    """
    count = max(_AT_LEAST, round(_FASTEST * len(exchanges)))
    chosen = sorted(exchanges, key=lambda e: e.round_trip_ns)[:count]
    fastest = chosen[0].round_trip_ns
    excess = [(e.round_trip_ns - fastest) / 2 for e in chosen]
    s2 = _FLOOR_NS**2 + sum(x * x for x in excess) / count
    t0, o0 = chosen[0].at_ns, chosen[0].offset_ns
    t = [float(e.at_ns - t0) for e in chosen]
    o = [float(e.offset_ns - o0) for e in chosen]
    t_mean, o_mean = sum(t) / count, sum(o) / count
    s_tt = sum((x - t_mean) ** 2 for x in t) + s2 / _DRIFT_SD**2
    drift = sum((x - t_mean) * (y - o_mean) for x, y in zip(t, o, strict=True)) / s_tt
    return Line(
        at_ns=t0 + round(t_mean),
        offset_ns=o0 + round(o_mean),
        drift=drift,
        sd_ns=math.sqrt(s2 / count),
        drift_sd=math.sqrt(s2 / s_tt),
    )
