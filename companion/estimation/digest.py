"""A running hash over the bits of output rows, in a hundredth of the time that the rows took.

Eight lanes of 64 bits take the words of a row in turn, lane ← rotl((lane ⊕ word) · odd, 29): each
step is a bijection of the word and of the lane, so one changed word always changes the digest, and
the order of rows counts. It tells apart runs of one program; it withstands no forger.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray

from companion._jit import njit
from companion.types import F64, I64

U64 = NDArray[np.uint64]

LANES = 8
_ODD = np.uint64(0x9E3779B97F4A7C15)  # 2⁶⁴ over the golden ratio, as in Fibonacci hashing
_LEFT, _RIGHT = np.uint64(29), np.uint64(35)


@njit("void(u8[::1], u8[::1], u8[:, ::1])", cache=True, entry=True)
def absorb(lanes: U64, t: U64, rows: U64) -> None:
    """Take in rows (N, width), each behind its time ``t`` (N,), however they come in calls."""
    width = rows.shape[1]
    for i in range(rows.shape[0]):
        x = (lanes[0] ^ t[i]) * _ODD
        lanes[0] = (x << _LEFT) | (x >> _RIGHT)
        for j in range(width):
            lane = j % LANES
            x = (lanes[lane] ^ rows[i, j]) * _ODD
            lanes[lane] = (x << _LEFT) | (x >> _RIGHT)


class RowDigest:
    """Hash over output rows and their times."""

    def __init__(self) -> None:
        self._lanes: U64 = np.arange(1, LANES + 1, dtype=np.uint64) * _ODD

    def update(self, t_ns: I64, rows: F64) -> None:
        """Take in the next rows: ``t_ns`` (N,), ``rows`` (N, width), both contiguous."""
        absorb(self._lanes, t_ns.view(np.uint64), rows.view(np.uint64))

    def hexdigest(self) -> str:
        """The hash so far, 40 digits, the same on every machine."""
        lanes = self._lanes.astype("<u8").tobytes()
        return hashlib.blake2b(lanes, digest_size=20).hexdigest()
