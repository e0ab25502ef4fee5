"""UBX messages as a receiver sends them: raw epochs, GPS subframes, its own fix."""

from __future__ import annotations

import math
import struct

import numpy as np

from companion.gnss import orbit as ob
from companion.gnss.gps_time import GPS_EPOCH_POSIX_S, leap_seconds
from companion.gnss.systems import CARRIER_HZ, C
from companion.types import F64, I64
from drivers.ublox.framer import pack
from drivers.ublox.messages import NAV_PVT, RXM_RAWX, RXM_SFRBX

_GNSS_ID = (0, 2, 3)
"""u-blox numbers of GPS, Galileo, BeiDou."""
_ROW = struct.Struct("<ddfBBBBHBBBBBB")
_SEMI = 1.0 / math.pi


def rawx(week: int, tow: float, sat: I64, pseudorange: F64, rate: F64) -> bytes:
    """RXM-RAWX of an epoch: (K,) satellites, pseudoranges [m] and their rates [m/s]."""
    rows = []
    for s, pr, v in zip(sat.tolist(), pseudorange.tolist(), rate.tolist(), strict=True):
        system, prn = s // 100 - 1, s % 100
        doppler = -v * CARRIER_HZ[system] / C
        # C/N0 45, 0.64 m and 0.008 Hz · 2^…: what an F9 says of itself in the open.
        rows.append(_ROW.pack(pr, 0.0, doppler, _GNSS_ID[system], prn, 0, 0, 0, 45, 6, 15, 5, 1, 0))
    head = struct.pack("<dHbBBBH", tow, week, 18, len(rows), 1, 1, 0)
    return pack(RXM_RAWX, head + b"".join(rows))


class _Words:
    """Bits of ten words of 24, filled by place."""

    def __init__(self) -> None:
        self._value = 0

    def put(self, at: int, size: int, value: float) -> None:
        self._value |= (round(value) & ((1 << size) - 1)) << (240 - at - size)

    def words(self) -> list[int]:
        """Each with six bits of parity behind it, which the receiver has checked."""
        return [(self._value >> (216 - 24 * k) & 0xFFFFFF) << 6 for k in range(10)]


def lnav(row: F64) -> list[bytes]:
    """RXM-SFRBX of subframes 1 to 3 of a GPS ephemeris, to the message's resolution."""
    one, two, three = _Words(), _Words(), _Words()
    for number, part in enumerate((one, two, three), 1):
        part.put(43, 3, number)
    issue = row[ob.E_ISSUE]
    for at, size, value in (
        (48, 10, int(row[ob.E_WEEK]) % 1024), (168, 8, issue),
        (160, 8, row[ob.E_GROUP_DELAY] * 2.0**31), (176, 16, row[ob.E_TOC] / 16.0),
        (192, 8, row[ob.E_AF2] * 2.0**55), (200, 16, row[ob.E_AF1] * 2.0**43),
        (216, 22, row[ob.E_AF0] * 2.0**31),
    ):  # fmt: skip
        one.put(at, size, value)
    for at, size, value in (
        (48, 8, issue), (56, 16, row[ob.E_CRS] * 2.0**5),
        (72, 16, row[ob.E_DELTA_N] * _SEMI * 2.0**43), (88, 32, _half(row[ob.E_M0])),
        (120, 16, row[ob.E_CUC] * 2.0**29), (136, 32, row[ob.E_ECC] * 2.0**33),
        (168, 16, row[ob.E_CUS] * 2.0**29), (184, 32, row[ob.E_SQRT_A] * 2.0**19),
        (216, 16, row[ob.E_TOE] / 16.0),
    ):  # fmt: skip
        two.put(at, size, value)
    for at, size, value in (
        (48, 16, row[ob.E_CIC] * 2.0**29), (64, 32, _half(row[ob.E_OMEGA0])),
        (96, 16, row[ob.E_CIS] * 2.0**29), (112, 32, _half(row[ob.E_I0])),
        (144, 16, row[ob.E_CRC] * 2.0**5), (160, 32, _half(row[ob.E_OMEGA])),
        (192, 24, row[ob.E_OMEGA_DOT] * _SEMI * 2.0**43), (216, 8, issue),
        (224, 14, row[ob.E_IDOT] * _SEMI * 2.0**43),
    ):  # fmt: skip
        three.put(at, size, value)
    prn = int(row[ob.E_SAT]) % 100
    head = struct.pack("<BBBBBBBB", 0, prn, 0, 0, 10, 0, 2, 0)
    return [
        pack(RXM_SFRBX, head + struct.pack("<10I", *part.words())) for part in (one, two, three)
    ]


def _half(angle: float) -> float:
    """An angle in units of 2⁻³¹ semicircles, within ±1."""
    return (math.remainder(angle, 2.0 * math.pi) * _SEMI) * 2.0**31


def nav_pvt(week: int, tow: float, place: F64, vel_n: F64, sd: tuple[float, float, float]) -> bytes:
    """NAV-PVT: latitude, longitude [rad], height [m]; NED [m/s]; 1σ horizontal, vertical, speed."""
    utc = np.datetime64(0, "s") + np.timedelta64(
        GPS_EPOCH_POSIX_S + week * 604_800 + int(tow) - leap_seconds(week * 604_800 + tow), "s"
    )
    when = utc.astype(object)
    lat, lon = math.degrees(place[0]) * 1e7, math.degrees(place[1]) * 1e7
    mm = [round(x * 1e3) for x in (place[2], place[2], sd[0], sd[1], *vel_n)]
    speed = round(math.hypot(vel_n[0], vel_n[1]) * 1e3)
    payload = struct.pack(
        "<IHBBBBBBIiBBBBiiiiIIiiiiiII", round(tow * 1e3), when.year, when.month, when.day,
        when.hour, when.minute, when.second, 7, 20, 0, 3, 1, 0, 12, round(lon), round(lat),
        mm[0], mm[1], mm[2], mm[3], mm[4], mm[5], mm[6], speed, 0, round(sd[2] * 1e3), 0,
    )  # fmt: skip
    return pack(NAV_PVT, payload.ljust(92, b"\0"))
