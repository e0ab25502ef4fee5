"""The autopilot's clock against ours by TIMESYNC: the shortest ways there and back, a line.

    there_i = tc1 − ts1 = −offset + delay      back_i = now − tc1 = offset + delay

(ts1, now: our clock at both ends; tc1: theirs in between.) Queueing makes a delay many milliseconds
at times, and not the same both ways; but it never is below the shortest, so the lower edges of both
series have the offset between them, whatever lies above. Only a difference of the *shortest* delays
remains, which no exchange can tell from an offset. Protocol: mavlink.io/en/services/timesync.html.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from companion.types import F64, NS

WINDOW_NS = 60 * NS
_AT_LEAST = 6
_FLOOR_NS = 20_000.0
"""Deviation below which no claim is made: stamps and scheduling."""
_DRIFT_SD = 50e-6
"""Prior of the drift: what two crystals differ by."""
_COARSE: F64 = np.linspace(-200e-6, 200e-6, 41)
"""Drifts that are tried first …"""
_FINE: F64 = np.linspace(-10e-6, 10e-6, 21)
"""… and then around the best of them."""
_BURST_NS, _BURST_STEP_NS = 3 * NS // 2, NS // 40
_STEP_NS = NS // 4
"""Interval of requests: up to 40 Hz at first, then 4 Hz."""
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
    asked_ns: int
    answered_ns: int
    theirs_ns: int

    @property
    def round_trip_ns(self) -> int:
        return self.answered_ns - self.asked_ns


class TimeSync:
    """Asks at the right times, keeps the exchanges of the last minute, fits the line."""

    def __init__(self) -> None:
        self._exchanges: deque[_Exchange] = deque()
        self._asked: deque[int] = deque(maxlen=64)
        self._begun_ns: int | None = None
        self._stale = False
        self.last_line: Line | None = None
        """As of the last :meth:`line`."""
        self.refused = 0
        """Answers to nothing that we asked, or too late."""

    def __len__(self) -> int:
        return len(self._exchanges)

    def reset(self) -> None:
        """Their clock started anew: forget everything, ask often again."""
        self._exchanges.clear()
        self._asked.clear()
        self._begun_ns = None
        self._stale = False
        self.last_line = None

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
        self._exchanges.append(_Exchange(ts1_ns, now_ns, tc1_ns))
        while now_ns - self._exchanges[0].answered_ns > WINDOW_NS:
            self._exchanges.popleft()
        self._stale = True
        return True

    @property
    def round_trip_ns(self) -> int | None:
        """Fastest round trip of the window."""
        return min((e.round_trip_ns for e in self._exchanges), default=None)

    def line(self) -> Line | None:
        """Offset and drift by the exchanges of the window; None before there are a few."""
        if self._stale and len(self._exchanges) >= _AT_LEAST:
            self.last_line = _fit(self._exchanges)
            self._stale = False
        return self.last_line


def _fit(exchanges: deque[_Exchange]) -> Line:
    """Offset and drift of greatest likelihood for delays that are a shortest one + exponential.

    For a drift b the residuals are there_i + b τ_i and back_i − b τ_i above their smallest. With
    unknown mean delays, b minimises  n ln(mean there) + n ln(mean back) + b² / 2σ_b²;  the smallest
    of n exponential values exceeds the shortest delay by mean / (n − 1), which is taken off.
    """
    n = len(exchanges)
    first = exchanges[0]
    # Differences in integers before floats: nanoseconds of Unix time do not fit a float.
    raw = np.array(
        [
            (
                (e.asked_ns + e.answered_ns) // 2 - first.asked_ns,
                (e.theirs_ns - first.theirs_ns) - (e.asked_ns - first.asked_ns),
                (e.answered_ns - first.asked_ns) - (e.theirs_ns - first.theirs_ns),
            )
            for e in exchanges
        ],
        np.float64,
    )
    middle = float(raw[:, 0].mean())
    raw[:, 0] -= middle
    coarse = _most_likely(raw, _COARSE)[0]
    drift, least, over = _most_likely(raw, coarse + _FINE)
    offset = (least[1] - least[0] - (over[1] - over[0]) / (n - 1)) / 2
    spread_ns = math.hypot(*over) / (n - 1)
    span_ns = float(np.ptp(raw[:, 0])) + 1.0
    return Line(
        at_ns=first.asked_ns + round(middle),
        offset_ns=first.asked_ns - first.theirs_ns + round(offset),
        drift=drift,
        sd_ns=math.hypot(spread_ns / 2, _FLOOR_NS),
        drift_sd=min(_DRIFT_SD, 4 * spread_ns / span_ns + 1e-6),
    )


def _most_likely(raw: F64, drifts: F64) -> tuple[float, list[float], list[float]]:
    """Best of ``drifts`` for exchanges (N, 3) of [τ, there, back]; with it the least of both
    delays and their means above that, the floor included [ns]."""
    turn = drifts[:, np.newaxis] * raw[:, 0]
    delays = raw[:, 1] + turn, raw[:, 2] - turn
    least = [d.min(axis=1) for d in delays]
    over = [d.mean(axis=1) - low + _FLOOR_NS for d, low in zip(delays, least, strict=True)]
    cost = raw.shape[0] * np.log(over[0] * over[1]) + 0.5 * (drifts / _DRIFT_SD) ** 2
    best = int(np.argmin(cost))
    return float(drifts[best]), [float(x[best]) for x in least], [float(x[best]) for x in over]
