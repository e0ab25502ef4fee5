"""Fields of a message's bits, and times of reference."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from companion.gnss.orbit import EPHEMERIS_SIZE
from companion.types import F64

SEMICIRCLE = math.pi
WEEK_S = 604_800.0


class Bits:
    """Bits counted from the first one sent."""

    def __init__(self, words: Sequence[int], width: int, drop: int = 0) -> None:
        """The low ``width`` bits of each word without its last ``drop``, one behind the other."""
        value, keep = 0, width - drop
        for word in words:
            value = value << keep | (word & ((1 << width) - 1)) >> drop
        self._value, self._size = value, keep * len(words)

    def u(self, *parts: int) -> int:
        """Unsigned: first bit and length, of each part of a divided field."""
        out = 0
        for at, n in zip(parts[::2], parts[1::2], strict=True):
            out = out << n | (self._value >> (self._size - at - n)) & ((1 << n) - 1)
        return out

    def s(self, *parts: int) -> int:
        """Two's complement."""
        n = sum(parts[1::2])
        value = self.u(*parts)
        return value - (1 << n) if value >> (n - 1) else value

    def bytes(self, at: int, count: int) -> bytes:
        """``count`` bytes from bit ``at`` on."""
        return self.u(at, 8 * count).to_bytes(count, "big")


def blank(sat: int) -> F64:
    """A row with nothing but the satellite in it."""
    row = np.zeros(EPHEMERIS_SIZE)
    row[0] = sat
    return row


def nearest_week(second: float, week: int, tow: float) -> int:
    """The week in which ``second`` of week is nearest to ``week`` and ``tow``."""
    return week + round((tow - second) / WEEK_S)


def same_week(truncated: int, modulus: int, week: int) -> bool:
    """Whether a message's week can be that of its reception, or a neighbour at its turn."""
    return (truncated - week + 1) % modulus <= 2
