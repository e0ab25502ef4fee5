"""Columns made small enough for a page: decimated so that extremes survive, packed as float32.

A series of N samples over at most :data:`BUCKETS` spans of equal time becomes two samples a span,
its smallest and its largest value: a spike of one sample stays as high as it was.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.types import F64, I64, NS

BUCKETS = 2500
"""Spans of a decimated series: more than the columns of pixels that a page is wide."""

Indices = NDArray[np.intp]


class Spans:
    """One time axis cut into spans; every column over it is decimated alike.

    ``t_ns`` (N,) rising; axes of up to two samples a span are kept whole. A span without samples
    is left out, unless it is a gap: then one empty sample stands for it and the line is broken.
    """

    def __init__(self, t_ns: I64, origin_ns: int, buckets: int = BUCKETS) -> None:
        self.count = len(t_ns)
        self.whole = self.count <= 2 * buckets
        self._t = (t_ns - origin_ns) / NS
        step = np.diff(self._t)
        self._break_s = 5.0 * float(np.median(step)) + 0.5 if len(step) else np.inf
        if self.whole:
            self._starts: Indices = np.arange(self.count)
        else:
            edges = np.linspace(self._t[0], self._t[-1], buckets, endpoint=False)
            self._starts = np.unique(np.searchsorted(self._t, edges))
        self._ends: Indices = np.append(self._starts[1:], self.count) - 1

    def _after_gaps(self) -> Indices:
        """Positions in the decimated axis before which the line breaks."""
        gap = self._t[self._starts[1:]] - self._t[self._ends[:-1]] > self._break_s
        per = 1 if self.whole else 2
        found: Indices = per * (np.flatnonzero(gap) + 1)
        return found

    def times(self) -> F64:
        """Seconds since the origin of the decimated samples."""
        first, last = self._t[self._starts], self._t[self._ends]
        t = first if self.whole else np.column_stack([first, last]).ravel()
        gaps = self._after_gaps()
        return np.insert(t, gaps, 0.5 * (t[gaps - 1] + t[gaps])) if len(gaps) else t

    def values(self, column: F64) -> F64:
        """The column at :meth:`times`; NaN where the line is broken."""
        return self._broken(column, column)

    def envelope(self, low: F64, high: F64) -> tuple[F64, F64]:
        """Lower and upper edge of a band: what neither edge inside the span exceeds."""
        if self.whole:
            return self.values(low), self.values(high)
        bottom = np.repeat(np.fmin.reduceat(low, self._starts), 2)
        top = np.repeat(np.fmax.reduceat(high, self._starts), 2)
        gaps = self._after_gaps()
        return np.insert(bottom, gaps, np.nan), np.insert(top, gaps, np.nan)

    def _broken(self, low: F64, high: F64) -> F64:
        if self.whole:
            values = np.asarray(low, np.float64)
        else:
            small, large = (
                np.fmin.reduceat(low, self._starts),
                np.fmax.reduceat(high, self._starts),
            )
            # In the order of a rise or a fall, so that a slope does not look like a saw.
            falling = low[self._ends] < low[self._starts]
            values = np.column_stack(
                [np.where(falling, large, small), np.where(falling, small, large)]
            ).ravel()
        return np.insert(values, self._after_gaps(), np.nan)


def pack(values: F64 | Sequence[float]) -> str:
    """Little-endian float32 in base64: what the page's script unpacks."""
    return base64.b64encode(np.asarray(values, "<f4").tobytes()).decode("ascii")


def thin_track(north: F64, east: F64, limit: int = 2 * BUCKETS) -> Indices:
    """Indices of a track's samples that keep its extremes in both directions, in order of time."""
    count = len(north)
    if count <= limit:
        return np.arange(count)
    edges = np.linspace(0, count, limit // 4 + 1).astype(np.intp)
    kept: list[Any] = [0, count - 1]
    for start, end in pairwise(edges):
        for column in (north[start:end], east[start:end]):
            known = np.flatnonzero(np.isfinite(column))
            if len(known):
                kept.append(start + known[np.argmin(column[known])])
                kept.append(start + known[np.argmax(column[known])])
    return np.unique(np.array(kept, np.intp))
