"""Payloads of the UBX messages that are used, u-blox interface description F9 HPG and X20."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from companion.gnss.gps_time import MOST_WEEKS, gps_from_calendar
from companion.gnss.systems import B3_HZ, B3I, CARRIER_HZ, PRIMARY, C, satellite
from companion.types import F64, I64

RXM_RAWX, RXM_SFRBX, NAV_PVT = 0x0215, 0x0213, 0x0107

_RAWX_HEAD = struct.Struct("<dHbBBBH")
_RAWX_ROW = np.dtype(
    [("pseudorange", "<f8"), ("phase", "<f8"), ("doppler", "<f4"), ("gnss", "u1"), ("sv", "u1"),
     ("signal", "u1"), ("freq", "u1"), ("lock", "<u2"), ("cn0", "u1"), ("sd_range", "u1"),
     ("sd_phase", "u1"), ("sd_doppler", "u1"), ("status", "u1"), ("reserved", "u1")]
)  # fmt: skip
_SFRBX_HEAD = struct.Struct("<BBBBBBBB")
_PVT = struct.Struct("<IHBBBBBBIiBBBBiiiiIIiiiiiII")

_SYSTEM_OF = {0: 0, 2: 1, 3: 2}
"""u-blox: 0 GPS, 2 Galileo, 3 BeiDou."""
_SIGNAL_OF = {(0, 0): PRIMARY, (2, 0): PRIMARY, (3, 0): PRIMARY, (3, 1): PRIMARY, (3, 4): B3I,
              (3, 10): B3I}  # fmt: skip
"""L1 C/A; E1 C; B1I of D1 and D2; B3I of D1 and D2."""
_VALID_RANGE = 1
_LIMITS_M = (1.5e7, 6.0e7)


@dataclass(frozen=True, slots=True)
class RawEpoch:
    """RXM-RAWX: one epoch, one signal a satellite."""

    week: int
    tow: float
    leap_s: int | None
    """GPS − UTC [s] where the receiver knows it."""
    sat: I64
    signal: I64
    columns: F64
    """(5, K) pseudorange, rate, C/N0, 1σ of pseudorange and rate."""


def raw_epoch(payload: bytes) -> RawEpoch | None:
    """Decode RXM-RAWX; None where the length does not fit or the time cannot be."""
    if len(payload) < _RAWX_HEAD.size:
        return None
    tow, week, leap, count, status, _, _ = _RAWX_HEAD.unpack_from(payload)
    if len(payload) != _RAWX_HEAD.size + _RAWX_ROW.itemsize * count:
        return None
    if not 0.0 <= tow < 604_801.0 or week >= MOST_WEEKS:
        return None
    rows = np.frombuffer(payload, _RAWX_ROW, count, _RAWX_HEAD.size)
    chosen: dict[int, tuple[int, int]] = {}
    for i, (gnss, sv, sig) in enumerate(
        zip(rows["gnss"].tolist(), rows["sv"].tolist(), rows["signal"].tolist(), strict=True)
    ):
        signal = _SIGNAL_OF.get((gnss, sig))
        if signal is None or not rows["status"][i] & _VALID_RANGE:
            continue
        sat = satellite(_SYSTEM_OF[gnss], sv)
        if not (sat and _LIMITS_M[0] < rows["pseudorange"][i] < _LIMITS_M[1]):
            continue
        if sat not in chosen or signal < chosen[sat][1]:
            chosen[sat] = (i, signal)
    used = rows[[i for i, _ in chosen.values()]]
    sats = np.array(list(chosen), np.int64)
    signals = np.array([signal for _, signal in chosen.values()], np.int64)
    carrier = np.array(
        [B3_HZ if s == B3I else CARRIER_HZ[n // 100 - 1] for n, (_, s) in chosen.items()]
    )
    wave = C / carrier if len(carrier) else np.zeros(0)
    columns = np.stack(
        [
            used["pseudorange"],
            -used["doppler"].astype(np.float64) * wave,
            used["cn0"].astype(np.float64),
            0.01 * 2.0 ** (used["sd_range"] & 15),
            0.002 * 2.0 ** (used["sd_doppler"] & 15) * wave,
        ]
    )
    return RawEpoch(week, tow, leap if status & 1 else None, sats, signals, columns)


@dataclass(frozen=True, slots=True)
class Subframe:
    """RXM-SFRBX: a piece of a navigation message."""

    sat: int
    signal: int
    """u-blox's number of the signal that it came on."""
    words: tuple[int, ...]


def subframe(payload: bytes) -> Subframe | None:
    """Decode RXM-SFRBX; None where the length does not fit or the system is not used."""
    if len(payload) < _SFRBX_HEAD.size:
        return None
    gnss, sv, signal, _, count, _, _, _ = _SFRBX_HEAD.unpack_from(payload)
    if len(payload) != _SFRBX_HEAD.size + 4 * count or gnss not in _SYSTEM_OF:
        return None
    sat = satellite(_SYSTEM_OF[gnss], sv)
    words = struct.unpack_from(f"<{count}I", payload, _SFRBX_HEAD.size)
    return Subframe(sat, signal, words) if sat else None


@dataclass(frozen=True, slots=True)
class Pvt:
    """NAV-PVT: the receiver's own solution. Radians, metres above the ellipsoid, NED m/s."""

    week: int | None
    """By its date; None where the receiver does not know it yet."""
    tow: float
    lat: float
    lon: float
    height: float
    vel_n: tuple[float, float, float]
    sd_h: float
    sd_v: float
    sd_vel: float
    num_sats: int
    fix_type: int
    """As MAVLink: 0-1 none, 2 and 3 dimensional, 4 differential, 5 RTK float, 6 RTK fixed."""


def pvt(payload: bytes) -> Pvt | None:
    """Decode NAV-PVT; None where the length does not fit or the place cannot be."""
    if len(payload) < 84:
        return None
    f = _PVT.unpack_from(payload)
    fix, flags, satellites = f[10], f[11], f[13]
    lon, lat, height, _, sd_h, sd_v = f[14:20]
    north, east, down, _, _, sd_vel, _ = f[20:27]
    if abs(lat) > 900_000_000 or abs(lon) > 1_800_000_000:
        return None
    # Dead reckoning (1) and combinations of it (4) are no fixes of the satellites.
    kind = fix if fix in (2, 3) and flags & 1 else 0
    if kind == 3:
        kind = {1: 5, 2: 6}.get(flags >> 6, 4 if flags & 2 else 3)
    to_rad = 1e-7 * np.pi / 180.0
    return Pvt(
        _week(f[0] * 1e-3, f[1:7], f[7]), f[0] * 1e-3, lat * to_rad, lon * to_rad, height * 1e-3,
        (north * 1e-3, east * 1e-3, down * 1e-3), sd_h * 1e-3, sd_v * 1e-3, sd_vel * 1e-3,
        satellites, kind,
    )  # fmt: skip


def _week(tow: float, utc: tuple[int, ...], valid: int) -> int | None:
    """GPS week from a date in UTC, which leap seconds put off by less than half a minute."""
    if valid & 3 != 3:
        return None
    year, month, day, hour, minute, second = utc
    try:
        week, rough = gps_from_calendar(year, month, day, 3600.0 * hour + 60.0 * minute + second)
    except ValueError:
        return None
    return week + round((rough - tow) / 604_800.0)
