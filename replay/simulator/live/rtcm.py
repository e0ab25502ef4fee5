"""RTCM 3 messages as a receiver sends them: MSM4 to MSM7 epochs and broadcast ephemerides."""

from __future__ import annotations

import math

import numpy as np

from companion.gnss import orbit as ob
from companion.gnss.messages.rtcm import BEIDOU_D1, GALILEO_INAV, GPS_LNAV
from companion.gnss.systems import BDS_WEEK_0, BDT_BEHIND_GPST_S, BEIDOU, GALILEO, GPS, C
from companion.types import F64, I64
from drivers.rtcm.framer import pack

FAMILY = {GPS: 1070, GALILEO: 1090, BEIDOU: 1120}
_FIRST_SIGNAL, _B3I = 2, 8
_WEEK_MS = 604_800_000
_SEMI = 1.0 / math.pi
_FINE = {
    4: (15, 2**24, 22, 4),
    5: (15, 2**24, 22, 4),
    6: (20, 2**29, 24, 10),
    7: (20, 2**29, 24, 10),
}


class _Writer:
    """Fields one behind the other."""

    def __init__(self) -> None:
        self._value, self._size = 0, 0

    def put(self, size: int, value: float) -> None:
        """A whole number, negative ones as two's complement."""
        self._value = self._value << size | round(value) & ((1 << size) - 1)
        self._size += size

    def frame(self) -> bytes:
        """The whole of it, filled up with zeros to the byte."""
        spare = -self._size % 8
        return pack((self._value << spare).to_bytes((self._size + spare) // 8, "big"))


def epoch(
    tow: float,
    sat: I64,
    pseudorange: F64,
    rate: F64,
    *,
    kind: int = 7,
    station: int = 1,
    b3i: bool = False,
    cn0: F64 | None = None,
) -> list[bytes]:
    """MSM4 to MSM7 (``kind``) of one epoch, a message a system.

    (K,) satellites, pseudoranges [m] and their rates [m/s], NaN for a rate that is not there;
    ``cn0`` [dB-Hz], 45 where it is left out. ``b3i``: BeiDou on its other signal.
    """  # fmt: skip
    columns = np.stack([pseudorange, rate, np.full(len(sat), 45.0) if cn0 is None else cn0])
    systems = sorted({s // 100 - 1 for s in sat.tolist()})
    out = []
    for system in systems:
        mine = np.flatnonzero(sat // 100 - 1 == system)
        mine = mine[np.argsort(sat[mine])]
        late = BDT_BEHIND_GPST_S if system == BEIDOU else 0.0
        w = _Writer()
        w.put(12, FAMILY[system] + kind)
        w.put(12, station)
        w.put(30, (round(tow * 1e3) - round(late * 1e3)) % _WEEK_MS)
        w.put(1, system != systems[-1])
        w.put(18, 0)
        prns = {int(s) % 100 for s in sat[mine]}
        for prn in range(1, 65):
            w.put(1, prn in prns)
        signal = _B3I if b3i and system == BEIDOU else _FIRST_SIGNAL
        for number in range(1, 33):
            w.put(1, number == signal)
        w.put(len(mine), -1)  # every cell is there
        _measurements(w, kind, *columns[:, mine])
        out.append(w.frame())
    return out


def _measurements(w: _Writer, kind: int, pseudorange: F64, rate: F64, cn0: F64) -> None:
    """Rough parts of all satellites, then fine parts of all cells."""
    ms = pseudorange / (1e-3 * C)
    rough = np.round(ms * 1024.0)
    with_rate = kind in (5, 7)
    for value in rough:
        w.put(8, int(value) >> 10)
    if with_rate:
        for _ in rough:
            w.put(4, 0)
    for value in rough:
        w.put(10, int(value) & 1023)
    whole = np.round(np.nan_to_num(rate))
    if with_rate:
        for value, there in zip(whole, np.isfinite(rate), strict=True):
            w.put(14, value if there else -(1 << 13))
    size, scale, phase, lock = _FINE[kind]
    for fine in ms - rough / 1024.0:
        w.put(size, fine * scale)
    for width, value in ((phase, 1 << (phase - 1)), (lock, 0), (1, 0)):
        for _ in rough:
            w.put(width, value)
    for value in cn0:
        w.put(6 if kind < 6 else 10, value if kind < 6 else value * 16.0)
    if with_rate:
        for fine in rate - whole:
            w.put(15, fine * 1e4 if fine == fine else -(1 << 14))


def ephemeris(row: F64) -> bytes:
    """1019, 1042 or 1046 of an ephemeris, to the message's resolution."""
    w = _Writer()
    system = int(row[ob.E_SAT]) // 100 - 1
    {GPS: _gps, GALILEO: _galileo, BEIDOU: _beidou}[system](w, row)
    return w.frame()


def _gps(w: _Writer, row: F64) -> None:
    issue = row[ob.E_ISSUE]
    for size, value in (
        (12, GPS_LNAV), (6, int(row[ob.E_SAT]) % 100), (10, row[ob.E_WEEK] % 1024), (4, 0), (2, 1),
        (14, row[ob.E_IDOT] * _SEMI * 2.0**43), (8, issue), (16, row[ob.E_TOC] / 16.0),
        (8, row[ob.E_AF2] * 2.0**55), (16, row[ob.E_AF1] * 2.0**43), (22, row[ob.E_AF0] * 2.0**31),
        (10, issue), *_kepler(row, 16, 2.0**5, 2.0**29, 16, 16.0),
        (8, row[ob.E_GROUP_DELAY] * 2.0**31), (6, row[ob.E_HEALTH]), (2, 0),
    ):  # fmt: skip
        w.put(size, value)


def _galileo(w: _Writer, row: F64) -> None:
    for size, value in (
        (12, GALILEO_INAV), (6, int(row[ob.E_SAT]) % 100), (12, (row[ob.E_WEEK] - 1024) % 4096),
        (10, row[ob.E_ISSUE]), (8, 107), (14, row[ob.E_IDOT] * _SEMI * 2.0**43),
        (14, row[ob.E_TOC] / 60.0), (6, row[ob.E_AF2] * 2.0**59), (21, row[ob.E_AF1] * 2.0**46),
        (31, row[ob.E_AF0] * 2.0**34), *_kepler(row, 16, 2.0**5, 2.0**29, 14, 60.0),
        (10, 0), (10, row[ob.E_GROUP_DELAY] * 2.0**32), (3, 0), (2, row[ob.E_HEALTH]), (3, 0),
    ):  # fmt: skip
        w.put(size, value)


def _beidou(w: _Writer, row: F64) -> None:
    own_toc = (row[ob.E_TOC] - BDT_BEHIND_GPST_S) % (_WEEK_MS / 1e3)
    # The week of the own time: GPS second 5 is in the week before there.
    week = row[ob.E_WEEK] - BDS_WEEK_0 - (row[ob.E_TOE] < BDT_BEHIND_GPST_S)
    for size, value in (
        (12, BEIDOU_D1), (6, int(row[ob.E_SAT]) % 100), (13, week), (4, 0),
        (14, row[ob.E_IDOT] * _SEMI * 2.0**43), (5, row[ob.E_ISSUE]), (17, own_toc / 8.0),
        (11, row[ob.E_AF2] * 2.0**66), (22, row[ob.E_AF1] * 2.0**50),
        (24, row[ob.E_AF0] * 2.0**33), (5, 0), *_kepler(row, 18, 2.0**6, 2.0**31, 17, 8.0),
        (10, row[ob.E_GROUP_DELAY] * 1e10), (10, 0), (1, row[ob.E_HEALTH]),
    ):  # fmt: skip
        w.put(size, value)


def _kepler(
    row: F64, harmonics: int, metres: float, angles: float, toe: int, toe_s: float
) -> list[tuple[int, float]]:
    """The orbit's fields, whose order is one for all systems."""
    return [
        (harmonics, row[ob.E_CRS] * metres), (16, row[ob.E_DELTA_N] * _SEMI * 2.0**43),
        (32, _half(row[ob.E_M0])), (harmonics, row[ob.E_CUC] * angles),
        (32, row[ob.E_ECC] * 2.0**33), (harmonics, row[ob.E_CUS] * angles),
        (32, row[ob.E_SQRT_A] * 2.0**19), (toe, row[ob.E_TOE_OWN] / toe_s),
        (harmonics, row[ob.E_CIC] * angles), (32, _half(row[ob.E_OMEGA0])),
        (harmonics, row[ob.E_CIS] * angles), (32, _half(row[ob.E_I0])),
        (harmonics, row[ob.E_CRC] * metres), (32, _half(row[ob.E_OMEGA])),
        (24, row[ob.E_OMEGA_DOT] * _SEMI * 2.0**43),
    ]  # fmt: skip


def _half(angle: float) -> float:
    """An angle in units of 2⁻³¹ semicircles, within ±1."""
    return math.remainder(angle, 2.0 * math.pi) * _SEMI * 2.0**31
