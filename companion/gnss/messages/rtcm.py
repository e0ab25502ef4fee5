"""Ephemerides in RTCM 3: 1019 (GPS), 1042 (BeiDou), 1045 and 1046 (Galileo F/NAV and I/NAV).

RTCM 10403.3, tables 3.5-21, 3.5-105, 3.5-107 and 3.5-108. The fields are those of the satellites'
own messages, in one piece. What is not among them is the ionosphere: RTCM 3 has no message for it.
"""

from __future__ import annotations

from companion.gnss import orbit as ob
from companion.gnss.gps_time import whole_week
from companion.gnss.messages import d1, inav, lnav
from companion.gnss.messages.bits import SEMICIRCLE, WEEK_S, Bits, blank, nearest_week
from companion.gnss.systems import BDS_WEEK_0, BDT_BEHIND_GPST_S, BEIDOU, GALILEO, GPS, satellite
from companion.types import F64

GPS_LNAV, BEIDOU_D1, GALILEO_FNAV, GALILEO_INAV = 1019, 1042, 1045, 1046
LENGTHS = {GPS_LNAV: 61, BEIDOU_D1: 64, GALILEO_FNAV: 62, GALILEO_INAV: 63}
"""Bytes of each message."""
_PI = SEMICIRCLE


class _Fields:
    """Fields one behind the other."""

    def __init__(self, payload: bytes) -> None:
        self._bits = Bits(list(payload), 8)
        self._at = 12

    def u(self, size: int) -> int:
        self._at += size
        return self._bits.u(self._at - size, size)

    def s(self, size: int) -> int:
        self._at += size
        return self._bits.s(self._at - size, size)

    def into(self, row: F64, *parts: tuple[int, int, float]) -> None:
        """Column, bits (negative: two's complement), scale, for each field."""
        for column, size, scale in parts:
            row[column] = (self.u(size) if size > 0 else self.s(-size)) * scale


def ephemeris(payload: bytes, near: tuple[int, float]) -> tuple[F64, bool] | None:
    """One message as a row of :mod:`companion.gnss.orbit`, and whether its week fits ``near``.

    ``near``: GPS week and second of it, about now. A week that is within one of it is taken for the
    one whose time of reference is nearest: at its turn, messages carry either. None where the
    message is none of these, is cut short, or its satellite is none.
    """
    number = payload[0] << 4 | payload[1] >> 4 if len(payload) > 1 else 0
    if len(payload) < LENGTHS.get(number, len(payload) + 1):
        return None
    fields = _Fields(payload)
    read = {GPS_LNAV: _gps, BEIDOU_D1: _beidou}.get(number, _galileo)
    row = blank(0)
    late, truncated, modulus = read(row, fields, number)
    if row[ob.E_SAT] == 0:
        return None
    row[ob.E_TOE] = (row[ob.E_TOE_OWN] + late) % WEEK_S
    row[ob.E_TOC] = (row[ob.E_TOC] + late) % WEEK_S
    week, likely = whole_week(truncated, modulus, near[0]), nearest_week(row[ob.E_TOE], *near)
    fits = abs(week - likely) <= 1
    row[ob.E_WEEK] = likely if fits else week
    row[ob.E_TOC_WEEK] = nearest_week(row[ob.E_TOC], int(row[ob.E_WEEK]), row[ob.E_TOE])
    return row, fits


def _gps(row: F64, f: _Fields, _: int) -> tuple[float, int, int]:
    """Fill ``row``; what its time is behind GPS time [s], its week and what that counts to."""
    row[ob.E_SAT] = satellite(GPS, f.u(6))
    week, accuracy = f.u(10), f.u(4)
    row[ob.E_ACCURACY] = lnav.ACCURACY_M[accuracy] if accuracy < 15 else 9999.0
    f.u(2)  # codes on L2
    f.into(
        row,
        (ob.E_IDOT, -14, 2.0**-43 * _PI), (ob.E_ISSUE, 8, 1.0), (ob.E_TOC, 16, 16.0),
        (ob.E_AF2, -8, 2.0**-55), (ob.E_AF1, -16, 2.0**-43), (ob.E_AF0, -22, 2.0**-31),
    )  # fmt: skip
    f.u(10)  # issue of the clock
    f.into(row, *_kepler(-16, 2.0**-5, 2.0**-29, 16, 16.0))
    row[ob.E_GROUP_DELAY] = f.s(8) * 2.0**-31
    row[ob.E_HEALTH] = f.u(6) or accuracy == 15
    return 0.0, week, 1024


def _galileo(row: F64, f: _Fields, number: int) -> tuple[float, int, int]:
    """The same; of F/NAV the clock is that of E1 and E5a, and so is the delay that E1 takes off."""
    row[ob.E_SAT] = satellite(GALILEO, f.u(6))
    week = f.u(12) + inav.WEEK_0
    row[ob.E_ISSUE], accuracy = f.u(10), f.u(8)
    row[ob.E_ACCURACY] = inav.accuracy_m(accuracy)
    f.into(
        row,
        (ob.E_IDOT, -14, 2.0**-43 * _PI), (ob.E_TOC, 14, 60.0), (ob.E_AF2, -6, 2.0**-59),
        (ob.E_AF1, -21, 2.0**-46), (ob.E_AF0, -31, 2.0**-34),
        *_kepler(-16, 2.0**-5, 2.0**-29, 14, 60.0),
    )  # fmt: skip
    delay_e5a = f.s(10) * 2.0**-32
    if number == GALILEO_FNAV:
        row[ob.E_GROUP_DELAY] = delay_e5a
        healthy = f.u(2) == 0 and f.u(1) == 0
    else:
        row[ob.E_GROUP_DELAY] = f.s(10) * 2.0**-32
        f.u(3)  # E5b
        healthy = f.u(2) == 0 and f.u(1) == 0
    row[ob.E_HEALTH] = not (healthy and accuracy < 255)
    return 0.0, week, 4096


def _beidou(row: F64, f: _Fields, _: int) -> tuple[float, int, int]:
    row[ob.E_SAT] = satellite(BEIDOU, f.u(6))
    week = f.u(13) + BDS_WEEK_0
    row[ob.E_ACCURACY] = d1.ACCURACY_M[f.u(4)]
    f.into(
        row,
        (ob.E_IDOT, -14, 2.0**-43 * _PI), (ob.E_ISSUE, 5, 1.0), (ob.E_TOC, 17, 8.0),
        (ob.E_AF2, -11, 2.0**-66), (ob.E_AF1, -22, 2.0**-50), (ob.E_AF0, -24, 2.0**-33),
    )  # fmt: skip
    f.u(5)  # age of the clock's data
    f.into(row, *_kepler(-18, 2.0**-6, 2.0**-31, 17, 8.0))
    row[ob.E_GROUP_DELAY] = f.s(10) * 1e-10
    f.u(10)  # of B2I
    row[ob.E_HEALTH] = f.u(1)
    return BDT_BEHIND_GPST_S, week, 8192


def _kepler(
    harmonics: int, metres: float, angles: float, toe: int, toe_s: float
) -> tuple[tuple[int, int, float], ...]:
    """The orbit's fields, whose order is one for all systems."""
    return (
        (ob.E_CRS, harmonics, metres), (ob.E_DELTA_N, -16, 2.0**-43 * _PI),
        (ob.E_M0, -32, 2.0**-31 * _PI), (ob.E_CUC, harmonics, angles), (ob.E_ECC, 32, 2.0**-33),
        (ob.E_CUS, harmonics, angles), (ob.E_SQRT_A, 32, 2.0**-19), (ob.E_TOE_OWN, toe, toe_s),
        (ob.E_CIC, harmonics, angles), (ob.E_OMEGA0, -32, 2.0**-31 * _PI),
        (ob.E_CIS, harmonics, angles), (ob.E_I0, -32, 2.0**-31 * _PI),
        (ob.E_CRC, harmonics, metres), (ob.E_OMEGA, -32, 2.0**-31 * _PI),
        (ob.E_OMEGA_DOT, -24, 2.0**-43 * _PI),
    )  # fmt: skip
