"""Multiple signal messages (MSM4 to MSM7): pseudoranges, their rates and C/N0 of one system.

RTCM 10403.3, tables 3.5-78 to 3.5-91. A satellite's rough range and rate stand once, each signal
adds its fine part; a mask of cells says which signals of which satellites are there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.gnss.systems import (
    B3I,
    BDT_BEHIND_GPST_S,
    BEIDOU,
    GALILEO,
    GPS,
    PRIMARY,
    C,
    satellite,
)
from companion.types import F64, I64

_SYSTEM_OF = {107: GPS, 109: GALILEO, 112: BEIDOU}
_FAMILIES = (107, 108, 109, 110, 111, 112, 113)
"""GPS, GLONASS, Galileo, SBAS, QZSS, BeiDou, NavIC: numbers of messages without the last digit."""
_SIGNALS = {
    GPS: {2: (0, PRIMARY)},
    GALILEO: {2: (0, PRIMARY), 5: (1, PRIMARY), 4: (2, PRIMARY)},
    BEIDOU: {2: (0, PRIMARY), 8: (1, B3I)},
}
"""Number in the mask → place in the order of preference, and our signal: L1 C/A; E1 C, B+C, B;
B1I, B3I."""
_HEAD_BITS = 169
_WEEK_S = 604_800.0
_MILLISECOND_M = 1e-3 * C
_LIMITS_M = (1.5e7, 6.0e7)
_RATE_LIMIT_MPS = 2e4

Bits = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class _Layout:
    """Widths in bits of what stands for each satellite and for each cell."""

    satellite: tuple[int, ...]
    cell: tuple[int, ...]
    fine_ms: float
    """Of the fine pseudorange's last bit."""
    cn0: float


_ROUGH, _ROUGH_AND_RATE = (8, 10), (8, 4, 10, 14)
_LAYOUTS = {
    4: _Layout(_ROUGH, (15, 22, 4, 1, 6), 2.0**-24, 1.0),
    5: _Layout(_ROUGH_AND_RATE, (15, 22, 4, 1, 6, 15), 2.0**-24, 1.0),
    6: _Layout(_ROUGH, (20, 24, 10, 1, 10), 2.0**-29, 2.0**-4),
    7: _Layout(_ROUGH_AND_RATE, (20, 24, 10, 1, 10, 15), 2.0**-29, 2.0**-4),
}


@dataclass(frozen=True, slots=True)
class Msm:
    """One message; of a system that is not used only ``station`` and ``last`` are told."""

    station: int
    tow: float | None
    """Second of the GPS week; None of a system that is not used."""
    last: bool
    """No other message of this epoch follows."""
    sat: I64
    """(K,)"""
    signal: I64
    columns: F64
    """(5, K) pseudorange [m], rate [m/s], C/N0 [dB-Hz], and NaN for 1σ of both: none is sent."""


def is_msm(number: int) -> bool:
    """Whether a message of this number is one that :func:`msm` reads."""
    return number // 10 in _FAMILIES and number % 10 in _LAYOUTS


def msm(payload: bytes) -> Msm | None:
    """Decode a message; None where its length does not fit what it says, or its time cannot be."""
    bits = np.unpackbits(np.frombuffer(payload, np.uint8))
    if len(bits) < _HEAD_BITS:
        return None
    number, station = _number(bits, 0, 12), _number(bits, 12, 12)
    last = not bits[54]
    system = _SYSTEM_OF.get(number // 10)
    if system is None:
        none = np.zeros(0, np.int64)
        return Msm(station, None, last, none, none, np.zeros((5, 0)))
    second = _number(bits, 24, 30) * 1e-3
    if second >= _WEEK_S:
        return None
    tow = (second + (BDT_BEHIND_GPST_S if system == BEIDOU else 0.0)) % _WEEK_S
    cells = _cells(bits, _LAYOUTS[number % 10])
    if cells is None:
        return None
    return Msm(station, tow, last, *_chosen(system, *cells))


def _number(bits: Bits, at: int, size: int) -> int:
    return int("".join(map(str, bits[at : at + size].tolist())), 2)


def _column(bits: Bits, at: int, count: int, size: int) -> I64:
    """(count,) unsigned numbers of ``size`` bits, one behind the other."""
    weights = 1 << np.arange(size - 1, -1, -1, dtype=np.int64)
    out: I64 = bits[at : at + count * size].reshape(count, size).astype(np.int64) @ weights
    return out


def _signed(values: I64, size: int) -> F64:
    """Two's complement; NaN for the lowest number, which says that there is none."""
    out = np.where(values >> (size - 1), values - (1 << size), values).astype(np.float64)
    out[values == 1 << (size - 1)] = np.nan
    return out


def _cells(bits: Bits, layout: _Layout) -> tuple[I64, I64, F64] | None:
    """Satellite and signal of each cell, by their numbers in the masks, and its columns (3, X)."""
    satellites = np.flatnonzero(bits[73:137]) + 1
    signals = np.flatnonzero(bits[137:169]) + 1
    n = len(satellites)
    if n * len(signals) > 64 or len(bits) < _HEAD_BITS + n * len(signals):
        return None
    at = _HEAD_BITS + n * len(signals)
    whose, which = np.nonzero(bits[_HEAD_BITS:at].reshape(n, len(signals)))
    x = len(whose)
    if len(bits) < at + n * sum(layout.satellite) + x * sum(layout.cell):
        return None
    rough: list[I64] = []
    fine: list[I64] = []
    for into, count, widths in ((rough, n, layout.satellite), (fine, x, layout.cell)):
        for size in widths:
            into.append(_column(bits, at, count, size))
            at += count * size
    with_rate = len(layout.satellite) == 4
    whole = np.where(rough[0] == 255, np.nan, rough[0])
    part = rough[2 if with_rate else 1] / 1024.0
    ms = (whole + part)[whose] + _signed(fine[0], layout.cell[0]) * layout.fine_ms
    rate = np.full(x, np.nan)
    if with_rate:
        rate = _signed(rough[3], 14)[whose] + 1e-4 * _signed(fine[5], 15)
    cn0 = np.where(fine[4] == 0, np.nan, fine[4] * layout.cn0)
    return satellites[whose], signals[which], np.stack([ms * _MILLISECOND_M, rate, cn0])


def _chosen(system: int, number: I64, signal: I64, columns: F64) -> tuple[I64, I64, F64]:
    """One signal a satellite, with a pseudorange that can be; as in :class:`Msm`."""
    best: dict[int, tuple[int, int, int]] = {}
    for k, (prn, one) in enumerate(zip(number.tolist(), signal.tolist(), strict=True)):
        rank, ours = _SIGNALS[system].get(one, (-1, 0))
        sat = satellite(system, prn)
        good = _LIMITS_M[0] < columns[0, k] < _LIMITS_M[1]
        good = good and not abs(columns[1, k]) > _RATE_LIMIT_MPS
        if rank >= 0 and sat and good and (sat not in best or rank < best[sat][0]):
            best[sat] = (rank, ours, k)
    take = np.array([k for _, _, k in best.values()], np.int64)
    out = np.full((5, len(take)), np.nan)
    out[:3] = columns[:, take]
    kept = np.array([s for _, s, _ in best.values()], np.int64)
    return np.array(list(best), np.int64), kept, out
