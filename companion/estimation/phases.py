"""Filters and phases: what the estimator consists of at a time, and what it goes back to."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from companion.config import Config
from companion.estimation import parameters as par
from companion.estimation.recording import Recording, Tape
from companion.estimation.running_tape import RunningTape
from companion.navigation import layout as lo
from companion.types import F64, I64, NS, Mode

_NEVER = int(np.iinfo(np.int64).min)


@dataclass(slots=True)
class Filter:
    """One error-state filter: state, its snapshots, and the state it began with."""

    s: F64
    k: I64
    snaps: F64
    snaps_k: I64
    first: tuple[F64, I64]
    tape: Tape | RunningTape | None = None
    """What a smoother reads. A :class:`Tape` goes one way: only in a run without late aiding."""

    @classmethod
    def start(cls, s: F64, k: I64, slots: int, tape: Tape | RunningTape | None = None) -> Filter:
        if tape is not None:
            tape.begin(s, k)
        return cls(
            s,
            k,
            np.zeros((slots, len(s))),
            np.full((slots, len(k)), _NEVER),
            (s.copy(), k.copy()),
            tape,
        )

    def restore(self, before: int) -> None:
        """Back to the newest snapshot older than ``before``, or to the beginning."""
        times = self.snaps_k[:, lo.T_NOW].tolist()
        newest = max((t for t in times if t < before), default=_NEVER)
        if newest > _NEVER:
            slot = times.index(newest)
            self.s[:], self.k[:] = self.snaps[slot], self.snaps_k[slot]
        else:
            self.s[:], self.k[:] = self.first
        for slot, t in enumerate(times):
            if t >= before:
                self.snaps_k[slot, lo.T_NOW] = _NEVER


@dataclass(frozen=True, slots=True)
class Check:
    """A decision on the grid and, in the bank, what it published from then on."""

    t_ns: int
    best: int = 0
    """Likeliest hypothesis."""
    heading_sd: float = 0.0
    """Standard deviation of the heading over all hypotheses [rad]."""
    weights: tuple[float, ...] = (1.0,)
    """Of the hypotheses; together 1."""


@dataclass(slots=True)
class Phase:
    """A stretch of time in one mode; ``filters`` is empty while aligning, several in the bank."""

    start_ns: int
    mode: Mode
    filters: list[Filter] = field(default_factory=list)
    prior: Filter | None = None
    """The filter before a declared reset: its biases are still the best known."""
    resets: int = 0
    checks: list[Check] = field(default_factory=list)
    """Decisions taken so far, newest last; the first is the start of the phase."""
    reached: int = 0
    """Aligning only: time of the last sample taken."""


class Setup:
    """A configuration as kernels and phases take it: layout, parameter vectors, snapshots."""

    def __init__(self, config: Config, record: Recording = "no") -> None:
        self.config = config
        self.layout = par.layout(config)
        self.lay = self.layout.vector()
        self.par = par.parameter_vector(config)
        self.ipar = par.integer_vector(config)
        """Of a single filter."""
        self.ipar_bank = self.ipar.copy()
        """Of the filters of the bank over headings."""
        self.ipar[par.BASE_MODE] = Mode.NAVIGATING
        self.ipar_bank[par.BANK] = 1
        self.ipar_bank[par.BASE_MODE] = Mode.HEADING_UNKNOWN
        # As Python's numbers: asked at every call, and live that is at every sample.
        self.output_ns = int(self.ipar[par.OUTPUT_NS])
        self.still_ns = int(self.ipar[par.STILL_NS])
        self.covariance_ns = int(self.ipar[par.COVARIANCE_NS])
        self.constraint_ns = int(self.ipar[par.CONSTRAINT_NS])
        """0: no constraint on a grid."""
        ring_ns = round(config.engine.delay_ring_s * NS)
        self.slots = ring_ns // int(self.ipar[par.SNAPSHOT_NS]) + 3
        self._record = record
        self.recorded = record != "no"
        self.keeps_inputs = record in ("inputs", "all")

    def covariance(self, s: F64) -> F64:
        """P (n, n) inside a float state, as a view."""
        n = self.layout.n
        return s[lo.P :].reshape(n, n)

    def new_filter(self, s: F64, k: I64, *, alone: bool = True) -> Filter:
        """A filter that begins at a state, with a tape of its own where there is a smoother.

        One of several (``alone`` false) has none to be smoothed on line: which of them counts is
        known only when the heading is found.
        """
        return Filter.start(s, k, self.slots, self._new_tape(alone))

    def _new_tape(self, alone: bool) -> Tape | RunningTape | None:
        if self.recorded:
            return Tape(self.layout.n, self._record != "states", self._record == "inputs")
        smoothing = self.config.smoothing
        if smoothing.enabled and alone:
            every_ns = round(NS / smoothing.rate_hz)
            return RunningTape(self.layout.n, every_ns, smoothing.mixed)
        return None
