"""Raw GNSS on its way in: what a receiver measured, as fixes and as corrected satellites.

Ephemerides and epochs are taken in the receiver's own order, whatever else arrives between them:
the corrections depend on its stream alone, and a block gives what its arrivals give one by one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from companion.config import Config
from companion.estimation.adaptation.constellations import Constellations
from companion.gnss.broadcast import NUMBERS
from companion.gnss.corrected import S_RANGE_VAR, S_SAT, S_SYSTEM
from companion.gnss.single_point import FIX_SIZE, as_fixes
from companion.intake.raw_gnss.epochs import Epochs
from companion.intake.raw_gnss.receiver import Receiver
from companion.types import (
    F64,
    I64,
    NO_SATELLITES,
    NS,
    AdaptationTrace,
    AidingSamples,
    BroadcastSamples,
    Event,
    Flags,
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
_RAW = RawGnssSamples | BroadcastSamples


class Said(NamedTuple):
    """What a receiver's stream has to say beside its measurements."""

    events: tuple[Event, ...]
    satellites: Satellites
    adaptation: AdaptationTrace = NO_ADAPTATION


SILENT = Said((), NO_SATELLITES)


def _all(made: list[Epochs], name: str) -> Any:
    """A column of all epochs; not to be written to."""
    columns = [getattr(epochs, name) for epochs in made]
    return columns[0] if len(columns) == 1 else np.concatenate(columns)


def _said(made: list[Epochs]) -> Said:
    if not made:
        return SILENT
    return Said(
        tuple(event for epochs in made for event in epochs.events),
        Satellites(
            _all(made, "t_ns"), _all(made, "counts"), _all(made, "blamed"), _all(made, "dops")
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

    def _inflation(self, t_ns: I64) -> F64:
        """(N,) factors on the variance of ranges for what of their error lasts from epoch to epoch.

        Errors that follow each other by φ = exp(−Δt/τ) tell, in the mean of many, as much as white
        ones of (1 + φ) / (1 − φ) times their variance. A filter that took them for white would
        believe the mean of 20 s a hundred times too much.
        """
        found = np.empty(len(t_ns))
        for i, t in enumerate(t_ns.tolist()):
            dt = LONE_S if self._last_ns is None else abs(t - self._last_ns) / NS
            self._last_ns = t
            phi = math.exp(-max(dt, SHORTEST_S) / self._slow_tau_s)
            found[i] = 1.0 + self._slow_share * ((1.0 + phi) / (1.0 - phi) - 1.0)
        return found

    def take(
        self, arrivals: Sequence[AidingSamples]
    ) -> tuple[list[AidingSamples | RangeSamples], Said]:
        """``arrivals`` with fixes and ranges in place of raw measurements, and what to say."""
        if not self.on:
            return [a for a in arrivals if not isinstance(a, _RAW)], SILENT
        epochs = self._epochs([a for a in arrivals if isinstance(a, _RAW)])
        made: list[AidingSamples | RangeSamples] = [
            a for a in arrivals if not isinstance(a, GnssSamples | _RAW)
        ]
        if not epochs:
            return made, SILENT
        tight = self._coupling == "tight"
        # The clock is let go by the first row of its epoch, which a fix must not precede.
        fixed = [e.solved & ~(e.let_go & tight) for e in epochs]
        if any(some.any() for some in fixed):
            made.append(_fixes(epochs, fixed))
        if tight and any(len(e.rows) for e in epochs):
            made.append(self._ranges(epochs))
        said = _said(epochs)
        if self._trust is None:
            return made, said
        return made, said._replace(adaptation=self._trust.take_trace())

    def _epochs(self, arrivals: list[RawGnssSamples | BroadcastSamples]) -> list[Epochs]:
        """Epochs prepared in the stream's order, in as few runs as its messages allow."""
        if len(arrivals) < 2:
            return [made for arrival in arrivals for made in self._alone(arrival)]
        who = np.repeat(np.arange(len(arrivals)), [len(a) for a in arrivals])
        row = np.concatenate([np.arange(len(a)) for a in arrivals])
        order = np.argsort(np.concatenate([a.seq for a in arrivals]), kind="stable")
        who, row = who[order], row[order]
        spoken = np.array([isinstance(a, BroadcastSamples) for a in arrivals])[who]
        raw = who[~spoken], row[~spoken]
        made: list[Epochs] = []
        done = 0
        for count, at in enumerate(np.flatnonzero(spoken).tolist()):
            message, ahead = arrivals[who[at]].take(slice(row[at], row[at] + 1)), at - count
            # One that repeats what is known does not have to wait for the epochs before it.
            if isinstance(message, BroadcastSamples) and not self.receiver.repeats(message):
                made += self._prepared(arrivals, raw[0][done:ahead], raw[1][done:ahead])
                self.receiver.listen(message)
                done = ahead
        return made + self._prepared(arrivals, raw[0][done:], raw[1][done:])

    def _alone(self, arrival: RawGnssSamples | BroadcastSamples) -> list[Epochs]:
        """An arrival that no other comes between, as all are that come live."""
        if isinstance(arrival, RawGnssSamples):
            return [self.receiver.prepare(arrival)]
        self.receiver.listen(arrival)
        return []

    def _prepared(
        self, arrivals: list[RawGnssSamples | BroadcastSamples], who: I64, row: I64
    ) -> list[Epochs]:
        """Epochs ``row`` of arrivals ``who``, in this order."""
        made: list[Epochs] = []
        if len(who) == 0:
            return made
        for part in np.split(np.arange(len(who)), np.flatnonzero(np.diff(who)) + 1):
            arrival = arrivals[who[part[0]]].take(slice(row[part[0]], row[part[-1]] + 1))
            if isinstance(arrival, RawGnssSamples):
                made.append(self.receiver.prepare(arrival))
        return made

    def _ranges(self, made: list[Epochs]) -> RangeSamples:
        """Satellites of each epoch by number, the order in which they are fused."""
        counts, rows = _all(made, "counts"), np.concatenate([e.rows for e in made])
        epoch = np.repeat(np.arange(len(counts)), counts)
        key = epoch * NUMBERS + rows[:, S_SAT].astype(np.int64)
        if (key[1:] < key[:-1]).any():
            rows = rows[np.argsort(key, kind="stable")]
        # What a system scatters more than configured is taken for white: it is not inflated.
        t_ns, factors = _all(made, "t_ns"), _all(made, "trusted")
        inflation = np.ones(len(counts))
        inflation[counts > 0] = self._inflation(t_ns[counts > 0])
        inflation = (inflation[:, None] + factors - 1.0) / factors
        rows[:, S_RANGE_VAR] *= inflation[epoch, rows[:, S_SYSTEM].astype(np.int64)]
        let_go = np.zeros(len(rows))
        first = np.cumsum(counts) - counts
        jumped = _all(made, "let_go") & (counts > 0)
        let_go[first[jumped]] = 1.0
        rx, seq, scale = (_all(made, n)[epoch] for n in ("t_rx_ns", "seq", "clock_scales"))
        return RangeSamples(made[0].source, t_ns[epoch], rx, seq, rows, let_go, scale)


def _fixes(made: list[Epochs], which: list[Flags]) -> GnssSamples:
    """Least-squares solutions as fixes, with the deviations that they state."""
    points, t_ns, t_rx_ns, seq = (
        np.concatenate([getattr(e, name)[some] for e, some in zip(made, which, strict=True)])
        for name in ("points", "t_ns", "t_rx_ns", "seq")
    )
    n = len(points)
    fixes = np.empty((n, FIX_SIZE))
    as_fixes(points, fixes)
    lat, lon, height = fixes[:, :3].T.copy()
    return GnssSamples(
        SINGLE_POINT, t_ns, t_rx_ns, seq, lat, lon, height,
        fixes[:, 3:6].copy(), fixes[:, 6:9].copy(), fixes[:, 9:].copy(),
        np.full(n, -1, np.int64), np.full(n, 3, np.int64),
    )  # fmt: skip
