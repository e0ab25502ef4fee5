"""BeiDou D1 message of the medium and inclined orbits (B1I, B3I): subframes 1 to 3.

BeiDou B1I ICD, section 5.2. D2, which the geostationary satellites send, is not decoded: their
ephemerides come from RINEX or RTCM.
"""

from __future__ import annotations

from companion.gnss import orbit as ob
from companion.gnss.messages.bits import (
    SEMICIRCLE,
    WEEK_S,
    Bits,
    blank,
    nearest_week,
    same_week,
)
from companion.gnss.systems import BDS_WEEK_0, BDT_BEHIND_GPST_S
from companion.types import F64

WORDS = 10
ACCURACY_M = (2.4, 3.4, 4.85, 6.85, 9.65, 13.65, 24.0, 48.0, 96.0, 192.0, 384.0, 768.0, 1536.0,
              3072.0, 6144.0, 9999.0)  # fmt: skip
_SUBFRAME_S = 6


class D1:
    """Collects the subframes of one satellite until they make an ephemeris."""

    def __init__(self, sat: int) -> None:
        self.sat = sat
        self._parts: dict[int, Bits] = {}

    def take(self, words: list[int], week: int, tow: float) -> tuple[int, F64] | None:
        """A subframe, received at ``week`` and ``tow``; (satellite, row) once one is whole.

        ``words``: ten of 30 bits, parity checked by the receiver.
        """
        bits = Bits(words, 30)
        number = bits.u(15, 3)
        if number not in (1, 2, 3):
            return None
        self._parts[number] = bits
        # There is no issue in 2 and 3: only subframes that came one behind the other belong.
        begin = [self._parts[k].u(18, 8, 30, 12) for k in (1, 2, 3) if k in self._parts]
        if begin != [begin[0] + _SUBFRAME_S * k for k in range(3)]:
            return None
        if not same_week(self._parts[1].u(60, 13) + BDS_WEEK_0, 8192, week):
            return None
        return self.sat, self._row(week, tow)

    def _row(self, week: int, tow: float) -> F64:
        one, two, three = self._parts[1], self._parts[2], self._parts[3]
        row, pi = blank(self.sat), SEMICIRCLE
        row[ob.E_HEALTH] = one.u(42, 1)
        row[ob.E_ACCURACY] = ACCURACY_M[one.u(48, 4)]
        toc = one.u(73, 9, 90, 8) * 8.0
        row[ob.E_GROUP_DELAY] = one.s(98, 10) * 1e-10
        row[ob.E_AF2] = one.s(214, 11) * 2.0**-66
        row[ob.E_AF0] = one.s(225, 7, 240, 17) * 2.0**-33
        row[ob.E_AF1] = one.s(257, 5, 270, 17) * 2.0**-50
        row[ob.E_ISSUE] = one.u(287, 5)
        row[ob.E_DELTA_N] = two.s(42, 10, 60, 6) * 2.0**-43 * pi
        row[ob.E_CUC] = two.s(66, 16, 90, 2) * 2.0**-31
        row[ob.E_M0] = two.s(92, 20, 120, 12) * 2.0**-31 * pi
        row[ob.E_ECC] = two.u(132, 10, 150, 22) * 2.0**-33
        row[ob.E_CUS] = two.s(180, 18) * 2.0**-31
        row[ob.E_CRC] = two.s(198, 4, 210, 14) * 2.0**-6
        row[ob.E_CRS] = two.s(224, 8, 240, 10) * 2.0**-6
        row[ob.E_SQRT_A] = two.u(250, 12, 270, 20) * 2.0**-19
        toe = (two.u(290, 2) << 15 | three.u(42, 10, 60, 5)) * 8.0
        row[ob.E_I0] = three.s(65, 17, 90, 15) * 2.0**-31 * pi
        row[ob.E_CIC] = three.s(105, 7, 120, 11) * 2.0**-31
        row[ob.E_OMEGA_DOT] = three.s(131, 11, 150, 13) * 2.0**-43 * pi
        row[ob.E_CIS] = three.s(163, 9, 180, 9) * 2.0**-31
        row[ob.E_IDOT] = three.s(189, 13, 210, 1) * 2.0**-43 * pi
        row[ob.E_OMEGA0] = three.s(211, 21, 240, 11) * 2.0**-31 * pi
        row[ob.E_OMEGA] = three.s(251, 11, 270, 21) * 2.0**-31 * pi
        row[ob.E_TOE_OWN] = toe
        row[ob.E_TOE] = (toe + BDT_BEHIND_GPST_S) % WEEK_S
        row[ob.E_TOC] = (toc + BDT_BEHIND_GPST_S) % WEEK_S
        row[ob.E_WEEK] = nearest_week(row[ob.E_TOE], week, tow)
        row[ob.E_TOC_WEEK] = nearest_week(row[ob.E_TOC], week, tow)
        return row
