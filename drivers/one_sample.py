"""Blocks of one: what a satellite receiver's decoder makes of an epoch or a message."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from companion.gnss.gps_time import gps_ns
from companion.gnss.orbit import EPHEMERIS_SIZE
from companion.types import F64, I64, SATELLITES, BroadcastSamples, RawGnssSamples

Stamps: TypeAlias = tuple[I64, I64, I64]


def stamps(week: int, tow: float, seq: int) -> Stamps:
    """``t_ns``, ``t_rx_ns`` and ``seq`` of one sample, GPS time."""
    t = np.array([gps_ns(week, tow)], np.int64)
    return t, t, np.array([seq], np.int64)


def raw_sample(
    source: str, at: Stamps, week: int, tow: float, sat: I64, signal: I64, columns: F64
) -> RawGnssSamples:
    """One epoch. ``sat``, ``signal`` (K,); ``columns`` (5, K): pseudorange … 1σ of the rate."""
    count = min(len(sat), SATELLITES)
    sats, signals = np.zeros((2, 1, SATELLITES), np.int64)
    sats[0, :count], signals[0, :count] = sat[:count], signal[:count]
    wide = np.full((5, 1, SATELLITES), np.nan)
    wide[:, 0, :count] = columns[:, :count]
    return RawGnssSamples(
        source, *at, np.array([week], np.int64), np.array([tow]), sats, signals, *wide
    )


def broadcast_sample(source: str, at: Stamps, sat: int, values: F64) -> BroadcastSamples:
    """One ephemeris, or with ``sat`` 0 the ionosphere's coefficients."""
    row = np.zeros((1, EPHEMERIS_SIZE))
    row[0, : len(values)] = values
    return BroadcastSamples(source, *at, np.array([sat], np.int64), row)
