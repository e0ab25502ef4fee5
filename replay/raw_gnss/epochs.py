"""What the readers of raw GNSS share: epochs of unequal length as columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from companion.gnss.gps_time import gps_ns
from companion.gnss.orbit import EPHEMERIS_SIZE
from companion.gnss.systems import SYSTEMS
from companion.types import F64, SATELLITES, BroadcastSamples, RawGnssSamples

RANGE_LIMIT_M = (1.5e7, 6.0e7)
"""No satellite is nearer or further, receiver clock included (±50 ms)."""
RATE_LIMIT_MPS = 2e4


@dataclass(slots=True)
class Observation:
    """One satellite of one epoch."""

    sat: int
    pseudorange: float
    rate: float = float("nan")
    cn0: float = float("nan")
    sd_range: float = float("nan")
    sd_rate: float = float("nan")
    signal: int = 0


@dataclass(slots=True)
class Epoch:
    """Measurements of one moment, by the receiver's clock."""

    week: int
    tow: float
    satellites: list[Observation] = field(default_factory=list)


def possible(o: Observation) -> bool:
    """Whether the numbers are those of a satellite. NaN in the pseudorange is none."""
    rate_fits = not abs(o.rate) > RATE_LIMIT_MPS
    return (
        100 < o.sat < 100 * (SYSTEMS + 1)
        and RANGE_LIMIT_M[0] < o.pseudorange < RANGE_LIMIT_M[1]
        and rate_fits
    )


def one_epoch(raw: RawGnssSamples) -> Epoch:
    """A block of one epoch as a driver makes it."""
    columns = (raw.pseudorange, raw.rate, raw.cn0, raw.sd_range, raw.sd_rate)
    rows = zip(raw.sat[0].tolist(), *(c[0].tolist() for c in columns), raw.signal[0].tolist(),
               strict=True)  # fmt: skip
    satellites = [Observation(*row) for row in rows if row[0]]
    return Epoch(int(raw.week[0]), float(raw.tow[0]), satellites)


def in_order(epochs: Sequence[Epoch]) -> tuple[list[Epoch], int]:
    """Those that go on in time, and how many do not: an earlier stamp than before is broken."""
    ordered: list[Epoch] = []
    for e in epochs:
        if not ordered or (e.week, e.tow) > (ordered[-1].week, ordered[-1].tow):
            ordered.append(e)
    return ordered, len(epochs) - len(ordered)


def raw_samples(source: str, epochs: Sequence[Epoch]) -> RawGnssSamples:
    """Epochs as columns; ``t_ns`` and ``t_rx_ns`` are nanoseconds of GPS time."""
    sat = np.zeros((len(epochs), SATELLITES), np.int64)
    signal = np.zeros_like(sat)
    columns = np.full((5, len(epochs), SATELLITES), np.nan)
    for i, epoch in enumerate(epochs):
        for j, o in enumerate(epoch.satellites[:SATELLITES]):
            sat[i, j], signal[i, j] = o.sat, o.signal
            columns[:, i, j] = o.pseudorange, o.rate, o.cn0, o.sd_range, o.sd_rate
    t = np.array([gps_ns(e.week, e.tow) for e in epochs], np.int64)
    return RawGnssSamples(
        source,
        t,
        np.maximum.accumulate(t) if len(t) else t,
        np.arange(len(t), dtype=np.int64),
        np.array([e.week for e in epochs], np.int64),
        np.array([e.tow for e in epochs], np.float64),
        sat,
        signal,
        *columns,
    )


def broadcast_samples(
    source: str, messages: Sequence[tuple[int, F64]], t_ns: Sequence[int] | None = None
) -> BroadcastSamples:
    """Messages (satellite or 0, values) as columns, at GPS times ``t_ns`` or at 0."""
    values = np.zeros((len(messages), EPHEMERIS_SIZE))
    for row, (_, v) in zip(values, messages, strict=True):
        row[: len(v)] = v
    t = np.zeros(len(messages), np.int64) if t_ns is None else np.array(t_ns, np.int64)
    return BroadcastSamples(
        source,
        t,
        np.maximum.accumulate(t) if len(t) else t,
        np.arange(len(t), dtype=np.int64),
        np.array([sat for sat, _ in messages], np.int64),
        values,
    )
