"""Epochs of raw measurements, ready for a filter: as columns, or one by one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from companion.estimation.adaptation.constellations import CHANNELS
from companion.estimation.adaptation.layout import TRACE_SIZE
from companion.gnss.corrected import ROW_SIZE
from companion.gnss.single_point import POINT_SIZE, SOLVED
from companion.gnss.systems import SYSTEMS
from companion.intake.raw_gnss.state import (
    E_CLOCK,
    E_DOP,
    E_TRUST,
    EPOCH_SIZE,
    FIGURES_SIZE,
    Z_CODE,
    Z_EXCLUDED,
    Z_LET_GO,
    Z_USED,
)
from companion.types import F64, I64, Event, Flags, RawGnssSamples


@dataclass(frozen=True, slots=True)
class Prepared:
    """One epoch, ready for a filter."""

    t_ns: int
    rows: F64
    """(M, 12) satellites in use, columns ``S_`` of :mod:`companion.gnss.corrected`, clock offset
    taken off."""
    lines: F64
    """(M, 3) unit vectors towards them, NED."""
    point: F64 | None
    """(30,) the epoch's own solution, columns ``P_`` of :mod:`companion.gnss.single_point`; None
    without."""
    dop: F64
    """(5,) GDOP, PDOP, HDOP, VDOP, TDOP of the satellites in use."""
    excluded: tuple[int, ...]
    """Satellites whose range contradicted the others."""
    without: dict[str, list[int]]
    """Satellites that could not be used, by reason."""
    events: tuple[Event, ...]
    factors: F64
    """(SYSTEMS,) on the variances of its ranges, by how far their systems are trusted."""
    clock_scale: F64
    """(3,) on the noise of the receiver's clock, as learned up to it: bias, drift, ramp."""
    let_go: bool
    """The receiver's clock jumped in front of it, by more than this epoch can tell."""

    @property
    def sky(self) -> F64:
        """(M, 2) azimuth, elevation [rad]."""
        north, east, down = self.lines.T
        return np.stack([np.arctan2(east, north), np.arcsin(-down)], axis=1)


@dataclass(frozen=True, slots=True)
class Epochs:
    """N epochs of one stream, as columns; the rows of their satellites one behind the other."""

    source: str
    t_ns: I64
    t_rx_ns: I64
    seq: I64
    """(N,) as they came."""
    state: I64
    """(N, ·) columns ``Z_`` of :mod:`companion.intake.raw_gnss.state`."""
    rows: F64
    lines: F64
    excluded: I64
    """(N, K) of which the first ``Z_EXCLUDED`` count."""
    points: F64
    """(N, 30) and the rows (M, ·): as :class:`Prepared` says."""
    figures: F64
    """(N, ·) columns ``E_`` of :mod:`companion.intake.raw_gnss.state`."""
    found: F64
    """(N, 2, SYSTEMS, 2) as :func:`companion.gnss.scatter.scatter` says; zeros without."""
    traces: F64
    """(N, CHANNELS, TRACE_SIZE) of trust in the systems."""
    events: list[Event]

    @classmethod
    def blank(cls, raw: RawGnssSamples, columns: int, learns: bool) -> Epochs:
        """To be filled with the epochs of ``raw``, each of at most so many satellites."""
        n = len(raw)
        learned = n if learns else 0
        return cls(
            raw.source,
            raw.t_ns,
            raw.t_rx_ns,
            raw.seq,
            np.empty((n, EPOCH_SIZE), np.int64),
            np.empty((n * columns, ROW_SIZE)),
            np.empty((n * columns, 3)),
            np.empty((n, columns), np.int64),
            np.full((n, POINT_SIZE), np.nan),
            np.empty((n, FIGURES_SIZE)),
            np.zeros((learned, 2, SYSTEMS, 2)),
            np.zeros((learned, CHANNELS, TRACE_SIZE)),
            [],
        )

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def counts(self) -> I64:
        """(N,) satellites in use."""
        return self.state[:, Z_USED]

    @property
    def blamed(self) -> I64:
        """(N,) how many satellites' range contradicted the others."""
        return self.state[:, Z_EXCLUDED]

    @property
    def dops(self) -> F64:
        """(N, 5) GDOP, PDOP, HDOP, VDOP, TDOP of the satellites in use."""
        return self.figures[:, E_DOP:E_TRUST]

    @property
    def trusted(self) -> F64:
        """(N, SYSTEMS) factors on the variances of ranges."""
        return self.figures[:, E_TRUST:E_CLOCK]

    @property
    def clock_scales(self) -> F64:
        """(N, 3) factors on the noise of the receiver's clock."""
        return self.figures[:, E_CLOCK:]

    @property
    def solved(self) -> Flags:
        """(N,) whether there is a point."""
        return np.asarray(self.state[:, Z_CODE] == SOLVED)

    @property
    def let_go(self) -> Flags:
        """(N,) whether the receiver's clock jumped in front of it."""
        return np.asarray(self.state[:, Z_LET_GO] == 1)

    def one(self, i: int, without: dict[str, list[int]]) -> Prepared:
        """Epoch ``i`` by itself, ``without`` satellites that could not be used."""
        end = int(self.counts[: i + 1].sum())
        begin = end - int(self.counts[i])
        gone = self.excluded[i, : self.state[i, Z_EXCLUDED]]
        return Prepared(
            int(self.t_ns[i]),
            self.rows[begin:end],
            self.lines[begin:end],
            self.points[i] if self.solved[i] else None,
            self.dops[i],
            tuple(gone.tolist()),
            without,
            tuple(self.events),
            self.trusted[i],
            self.clock_scales[i],
            bool(self.let_go[i]),
        )

    def up_to(self, filled: int) -> Epochs:
        """With as many rows as are filled."""
        return replace(self, rows=self.rows[:filled], lines=self.lines[:filled])
