"""Raw GNSS on its way in: what a receiver measured, as fixes and as corrected satellites.

Ephemerides and epochs are taken in the receiver's own order, whatever else arrives between them:
the corrections depend on its stream alone, and a block gives what its arrivals give one by one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from companion.config import Config
from companion.estimation.adaptation.constellations import Constellations
from companion.gnss.corrected import S_RANGE_VAR, S_SAT, S_SYSTEM
from companion.gnss.receiver import Prepared, Receiver
from companion.gnss.single_point import FIX_SIZE, as_fixes
from companion.types import (
    F64,
    I64,
    NO_SATELLITES,
    NS,
    AdaptationTrace,
    AidingSamples,
    BroadcastSamples,
    Event,
    GnssSamples,
    RawGnssSamples,
    Samples,
    Satellites,
)

SINGLE_POINT = "single point"
"""Source of the fixes that are made of the ranges here."""
SHORTEST_S, LONE_S = 0.01, 1.0
"""Between epochs: the least that is believed; what is taken for the first one."""


NO_ADAPTATION = AdaptationTrace.empty()


class Said(NamedTuple):
    """What a receiver's stream has to say beside its measurements."""

    events: tuple[Event, ...]
    satellites: Satellites
    adaptation: AdaptationTrace = NO_ADAPTATION


SILENT = Said((), NO_SATELLITES)


def _said(prepared: list[Prepared]) -> Said:
    if not prepared:
        return SILENT
    return Said(
        tuple(event for p in prepared for event in p.events),
        Satellites(
            np.array([p.t_ns for p in prepared], np.int64),
            np.array([len(p.rows) for p in prepared], np.int64),
            np.array([len(p.excluded) for p in prepared], np.int64),
            np.stack([p.dop for p in prepared]),
        ),
    )


@dataclass(frozen=True, slots=True)
class RangeSamples(Samples):
    """Corrected satellites: rows of an epoch one behind the other, with its time and number."""

    rows: F64
    """(N, 12) columns ``S_`` of :mod:`companion.gnss.corrected`."""
    let_go: F64
    """(N,) 1 at the first row of an epoch in front of which the receiver's clock jumped, else 0."""
    clock_scale: F64
    """(N, 3) factors on the noise of the receiver's clock: bias, drift, ramp."""

    @property
    def sat(self) -> I64:
        """(N,) which satellite."""
        return self.rows[:, S_SAT].astype(np.int64)


class RangeIntake:
    """Turns one receiver's raw stream into what the aid table takes."""

    def __init__(self, config: Config) -> None:
        fuzzy = config.adaptation.method == "fuzzy"
        self._trust = Constellations(config) if fuzzy else None
        self.receiver = Receiver(config.raw_gnss, self._trust)
        self._coupling = config.raw_gnss.coupling
        raw = config.raw_gnss
        total = raw.sd_range_m**2 + raw.sd_multipath_m**2
        self._slow_share, self._slow_tau_s = raw.sd_multipath_m**2 / total, raw.multipath_tau_s
        self._last_ns: int | None = None

    @property
    def on(self) -> bool:
        """Whether raw measurements are used; other fixes are not, then: they are the same news."""
        return self._coupling != "off"

    def _inflation(self, t_ns: int) -> float:
        """Factor on the variance of ranges for what of their error lasts from epoch to epoch.

        Errors that follow each other by φ = exp(−Δt/τ) tell, in the mean of many, as much as white
        ones of (1 + φ) / (1 − φ) times their variance. A filter that took them for white would
        believe the mean of 20 s a hundred times too much.
        """
        dt = LONE_S if self._last_ns is None else abs(t_ns - self._last_ns) / NS
        self._last_ns = t_ns
        phi = math.exp(-max(dt, SHORTEST_S) / self._slow_tau_s)
        return 1.0 + self._slow_share * ((1.0 + phi) / (1.0 - phi) - 1.0)

    def take(
        self, arrivals: Sequence[AidingSamples]
    ) -> tuple[list[AidingSamples | RangeSamples], Said]:
        """``arrivals`` with fixes and ranges in place of raw measurements, and what to say."""
        raw = [a for a in arrivals if isinstance(a, RawGnssSamples | BroadcastSamples)]
        others = [a for a in arrivals if not isinstance(a, RawGnssSamples | BroadcastSamples)]
        if not self.on:
            return [*others], SILENT
        prepared: list[tuple[Prepared, RawGnssSamples, int]] = []
        order = [(int(seq), n, m) for n, a in enumerate(raw) for m, seq in enumerate(a.seq)]
        for _, n, m in sorted(order):
            arrival = raw[n]
            if isinstance(arrival, BroadcastSamples):
                self.receiver.listen(arrival.take(slice(m, m + 1)))
            else:
                prepared.append((self.receiver.take(arrival, m), arrival, m))
        others = [a for a in others if not isinstance(a, GnssSamples)]
        made: list[AidingSamples | RangeSamples] = [*others]
        tight = self._coupling == "tight"
        # The clock is let go by the first row of its epoch, which a fix must not precede.
        fixes = [
            (p.point, a, m)
            for p, a, m in prepared
            if p.point is not None and not (tight and p.let_go)
        ]
        if fixes:
            made.append(_fixes(fixes))
        if tight and any(len(p.rows) for p, _, _ in prepared):
            made.append(_ranges(prepared, [self._inflation(p.t_ns) for p, _, _ in prepared]))
        said = _said([p for p, _, _ in prepared])
        if self._trust is None or not prepared:
            return made, said
        return made, said._replace(adaptation=self._trust.take_trace())


def _stamps(arrival: RawGnssSamples, m: int) -> tuple[int, int, int]:
    return int(arrival.t_ns[m]), int(arrival.t_rx_ns[m]), int(arrival.seq[m])


def _ranges(
    prepared: list[tuple[Prepared, RawGnssSamples, int]], inflation: list[float]
) -> RangeSamples:
    """Satellites of each epoch by number, the order in which they are fused."""
    counts = np.array([len(p.rows) for p, _, _ in prepared])
    rows = np.concatenate([p.rows for p, _, _ in prepared])
    epoch = np.repeat(np.arange(len(prepared)), counts)
    rows = rows[np.lexsort((rows[:, S_SAT], epoch))]
    # What a system scatters more than configured is taken for white: it is not inflated.
    factors = np.stack([p.factors for p, _, _ in prepared])[epoch, rows[:, S_SYSTEM].astype(int)]
    rows[:, S_RANGE_VAR] *= (np.array(inflation)[epoch] + factors - 1.0) / factors
    let_go = np.zeros(len(rows))
    first = np.cumsum(counts) - counts
    let_go[first[[p.let_go and n > 0 for (p, _, _), n in zip(prepared, counts, strict=True)]]] = 1.0
    t, rx, seq = np.array([_stamps(a, m) for _, a, m in prepared], np.int64)[epoch].T
    source = prepared[0][1].source
    clock_scale = np.stack([p.clock_scale for p, _, _ in prepared])[epoch]
    return RangeSamples(source, t.copy(), rx.copy(), seq.copy(), rows, let_go, clock_scale)


def _fixes(points: list[tuple[F64, RawGnssSamples, int]]) -> GnssSamples:
    """Least-squares solutions as fixes, with the deviations that they state."""
    n = len(points)
    fixes = np.empty((n, FIX_SIZE))
    as_fixes(np.stack([point for point, _, _ in points]), fixes)
    stamps = np.array([_stamps(a, m) for _, a, m in points], np.int64).T
    lat, lon, height = fixes[:, :3].T.copy()
    return GnssSamples(
        SINGLE_POINT, stamps[0].copy(), stamps[1].copy(), stamps[2].copy(), lat, lon, height,
        fixes[:, 3:6].copy(), fixes[:, 6:9].copy(), fixes[:, 9:].copy(),
        np.full(n, -1, np.int64), np.full(n, 3, np.int64),
    )  # fmt: skip
