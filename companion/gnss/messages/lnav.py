"""GPS L1 C/A navigation message (LNAV): subframes 1 to 3 and page 18 of subframe 4.

IS-GPS-200, figure 20-1 and tables 20-I to 20-III and 20-X. Bits without the six of parity.
"""

from __future__ import annotations

import numpy as np

from companion.gnss import orbit as ob
from companion.gnss.messages.bits import SEMICIRCLE, Bits, blank, nearest_week, same_week
from companion.types import F64

WORDS = 10
_IONOSPHERE_PAGE = 56
ACCURACY_M = (2.4, 3.4, 4.85, 6.85, 9.65, 13.65, 24.0, 48.0, 96.0, 192.0, 384.0, 768.0, 1536.0,
              3072.0, 6144.0)  # fmt: skip


class Lnav:
    """Collects the subframes of one satellite until they make an ephemeris."""

    def __init__(self, sat: int) -> None:
        self.sat = sat
        self._parts: dict[int, Bits] = {}

    def take(self, words: list[int], week: int, tow: float) -> tuple[int, F64] | None:
        """A subframe, received at ``week`` and ``tow``; (satellite or 0, row) once one is whole.

        ``words``: ten of 30 bits, checked and turned upright by the receiver.
        """
        bits = Bits(words, 30, drop=6)
        number = bits.u(43, 3)
        if number == 4 and bits.u(48, 2) == 1 and bits.u(50, 6) == _IONOSPHERE_PAGE:
            return 0, _ionosphere(bits)
        if number not in (1, 2, 3):
            return None
        self._parts[number] = bits
        if len(self._parts) < 3:
            return None
        one, two, three = self._parts[1], self._parts[2], self._parts[3]
        issue = two.u(48, 8)
        # Old and new halves meet at a change: they tell by their issues.
        if issue != three.u(216, 8) or issue != one.u(168, 8):
            return None
        if not same_week(one.u(48, 10), 1024, week):
            return None
        return self.sat, self._row(one, two, three, week, tow)

    def _row(self, one: Bits, two: Bits, three: Bits, week: int, tow: float) -> F64:
        row, pi = blank(self.sat), SEMICIRCLE
        accuracy = one.u(60, 4)
        row[ob.E_ACCURACY] = ACCURACY_M[accuracy] if accuracy < 15 else 9999.0
        row[ob.E_HEALTH] = one.u(64, 6) or (accuracy == 15)
        row[ob.E_GROUP_DELAY] = one.s(160, 8) * 2.0**-31
        row[ob.E_TOC] = one.u(176, 16) * 16.0
        row[ob.E_AF2] = one.s(192, 8) * 2.0**-55
        row[ob.E_AF1] = one.s(200, 16) * 2.0**-43
        row[ob.E_AF0] = one.s(216, 22) * 2.0**-31
        row[ob.E_ISSUE] = two.u(48, 8)
        row[ob.E_CRS] = two.s(56, 16) * 2.0**-5
        row[ob.E_DELTA_N] = two.s(72, 16) * 2.0**-43 * pi
        row[ob.E_M0] = two.s(88, 32) * 2.0**-31 * pi
        row[ob.E_CUC] = two.s(120, 16) * 2.0**-29
        row[ob.E_ECC] = two.u(136, 32) * 2.0**-33
        row[ob.E_CUS] = two.s(168, 16) * 2.0**-29
        row[ob.E_SQRT_A] = two.u(184, 32) * 2.0**-19
        row[ob.E_TOE] = row[ob.E_TOE_OWN] = two.u(216, 16) * 16.0
        row[ob.E_CIC] = three.s(48, 16) * 2.0**-29
        row[ob.E_OMEGA0] = three.s(64, 32) * 2.0**-31 * pi
        row[ob.E_CIS] = three.s(96, 16) * 2.0**-29
        row[ob.E_I0] = three.s(112, 32) * 2.0**-31 * pi
        row[ob.E_CRC] = three.s(144, 16) * 2.0**-5
        row[ob.E_OMEGA] = three.s(160, 32) * 2.0**-31 * pi
        row[ob.E_OMEGA_DOT] = three.s(192, 24) * 2.0**-43 * pi
        row[ob.E_IDOT] = three.s(224, 14) * 2.0**-43 * pi
        row[ob.E_WEEK] = nearest_week(row[ob.E_TOE], week, tow)
        row[ob.E_TOC_WEEK] = nearest_week(row[ob.E_TOC], week, tow)
        return row


def _ionosphere(bits: Bits) -> F64:
    """α0…α3, β0…β3."""
    powers = (-30, -27, -24, -24, 11, 14, 16, 16)
    return np.array([bits.s(56 + 8 * k, 8) * 2.0**p for k, p in enumerate(powers)])
