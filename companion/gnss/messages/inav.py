"""Galileo I/NAV, as E1-B and E5b-I send it: word types 1 to 5.

OS SIS ICD, sections 4.3.2 to 4.3.5 and 5.1. A page has an even and an odd half under one CRC-24Q.
"""

from __future__ import annotations

from companion.gnss import orbit as ob
from companion.gnss.messages.bits import SEMICIRCLE, Bits, blank, nearest_week, same_week
from companion.gnss.messages.crc import crc24q
from companion.types import F64

WORDS = 8
WEEK_0 = 1024
"""GPS week in which Galileo's week 0 began."""


def page_word(words: list[int]) -> Bits | None:
    """The 128 bits of a page's word; None for alerts, halves in the wrong order and a bad CRC.

    ``words``: eight of 32 bits, each half page of 114 bits in four of them.
    """
    even, odd = Bits(words[:4], 32), Bits(words[4:8], 32)
    if even.u(0, 1) != 0 or odd.u(0, 1) != 1 or even.u(1, 1) or odd.u(1, 1):
        return None
    # Both halves up to the CRC, with four zeros before them to fill the first byte.
    covered = even.u(0, 114) << 82 | odd.u(0, 82)
    if crc24q(covered.to_bytes(25, "big")) != odd.u(82, 24):
        return None
    value = even.u(2, 112) << 16 | odd.u(2, 16)
    return Bits([value >> 64, value & (1 << 64) - 1], 64)


class Inav:
    """Collects the words of one satellite until they make an ephemeris."""

    def __init__(self, sat: int) -> None:
        self.sat = sat
        self._words: dict[int, Bits] = {}

    def take(self, words: list[int], week: int, tow: float) -> tuple[int, F64] | None:
        """A page, received at ``week`` and ``tow``; (satellite, row) once one is whole."""
        word = page_word(words)
        if word is None:
            return None
        kind = word.u(0, 6)
        if not 1 <= kind <= 5:
            return None
        self._words[kind] = word
        if len(self._words) < 5 or len({self._words[k].u(6, 10) for k in (1, 2, 3, 4)}) > 1:
            return None
        if not same_week(self._words[5].u(73, 12) + WEEK_0, 4096, week):
            return None
        return self.sat, self._row(week, tow)

    def _row(self, week: int, tow: float) -> F64:
        one, two, three, four, five = (self._words[k] for k in range(1, 6))
        row, pi = blank(self.sat), SEMICIRCLE
        row[ob.E_ISSUE] = one.u(6, 10)
        row[ob.E_TOE] = row[ob.E_TOE_OWN] = one.u(16, 14) * 60.0
        row[ob.E_M0] = one.s(30, 32) * 2.0**-31 * pi
        row[ob.E_ECC] = one.u(62, 32) * 2.0**-33
        row[ob.E_SQRT_A] = one.u(94, 32) * 2.0**-19
        row[ob.E_OMEGA0] = two.s(16, 32) * 2.0**-31 * pi
        row[ob.E_I0] = two.s(48, 32) * 2.0**-31 * pi
        row[ob.E_OMEGA] = two.s(80, 32) * 2.0**-31 * pi
        row[ob.E_IDOT] = two.s(112, 14) * 2.0**-43 * pi
        row[ob.E_OMEGA_DOT] = three.s(16, 24) * 2.0**-43 * pi
        row[ob.E_DELTA_N] = three.s(40, 16) * 2.0**-43 * pi
        row[ob.E_CUC] = three.s(56, 16) * 2.0**-29
        row[ob.E_CUS] = three.s(72, 16) * 2.0**-29
        row[ob.E_CRC] = three.s(88, 16) * 2.0**-5
        row[ob.E_CRS] = three.s(104, 16) * 2.0**-5
        accuracy = three.u(120, 8)
        row[ob.E_ACCURACY] = accuracy_m(accuracy)
        row[ob.E_CIC] = four.s(22, 16) * 2.0**-29
        row[ob.E_CIS] = four.s(38, 16) * 2.0**-29
        row[ob.E_TOC] = four.u(54, 14) * 60.0
        row[ob.E_AF0] = four.s(68, 31) * 2.0**-34
        row[ob.E_AF1] = four.s(99, 21) * 2.0**-46
        row[ob.E_AF2] = four.s(120, 6) * 2.0**-59
        # Of the pair E1 and E5b, which is what the clock of I/NAV belongs to.
        row[ob.E_GROUP_DELAY] = five.s(57, 10) * 2.0**-32
        healthy = five.u(69, 2) == 0 and five.u(72, 1) == 0 and accuracy < 255
        row[ob.E_HEALTH] = 0 if healthy else 1
        row[ob.E_WEEK] = nearest_week(row[ob.E_TOE], week, tow)
        row[ob.E_TOC_WEEK] = nearest_week(row[ob.E_TOC], week, tow)
        return row


def accuracy_m(index: int) -> float:
    """Signal-in-space accuracy [m], ICD table 89; 0 where there is no prediction."""
    if index < 50:
        return 0.01 * index
    if index < 75:
        return 0.5 + 0.02 * (index - 50)
    if index < 100:
        return 1.0 + 0.04 * (index - 75)
    return 2.0 + 0.16 * (index - 100) if index <= 125 else 0.0
