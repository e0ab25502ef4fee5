"""One receiver's stream: ephemerides and raw epochs in, corrected satellites and points out.

Everything that a measurement needs before a filter may have it: its ephemeris, the correction of
satellite clock and ionosphere, elevation mask, choice of satellites, exclusion of faults, steps of
the receiver's clock. A pure function of the stream in its own order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Protocol

import numpy as np

from companion.config import DEG, RawGnss
from companion.gnss.broadcast import Ephemerides
from companion.gnss.clock_noise import SCALE, interrupt, learn_clock, new_learner
from companion.gnss.clock_steps import ClockSteps
from companion.gnss.corrected import (
    NOISE_SIZE,
    ROW_SIZE,
    S_RANGE,
    S_RANGE_VAR,
    S_RATE_VAR,
    S_SAT,
    S_SYSTEM,
    V_CN0,
    V_IONO,
    V_MASK,
    V_RANGE_SD,
    V_RATE_SD,
    correct,
    expected_range,
)
from companion.gnss.geometry import NO_DOP, best_set, dilution, geodetic, lines_of_sight
from companion.gnss.scatter import scatter, trimmed_mean
from companion.gnss.single_point import (
    FAULTY,
    P_CLOCK,
    P_POS,
    P_RATE,
    POINT_SIZE,
    SOLVED,
    TOO_FEW,
    solve,
)
from companion.gnss.systems import SYSTEM_NAMES, SYSTEMS, satellite_name
from companion.types import F64, I64, BroadcastSamples, Event, Flags, RawGnssSamples

NAMES = tuple(name.lower() for name in SYSTEM_NAMES)
FAULT_PROBABILITY = 1e-4
"""That the test of an epoch's residuals cries fault where there is none."""
GUESS_S = 600.0
"""A place this old no longer tells elevations or clock steps."""
QUIET_S = 60.0
"""Contradictions that come back sooner are one."""
NO_EPHEMERIS_S = 60.0
"""A satellite repeats its own every 30 s."""
MOST_DOF = 64
FASTEST_MPS = 100.0
_ONES = np.ones(SYSTEMS)


@cache
def _residual_limits() -> F64:
    """(MOST_DOF,) sums of squared residuals that a good epoch exceeds by chance that rarely."""
    # Half a second of start-up, for runs with raw measurements only.
    from scipy.stats import chi2

    limits = chi2.ppf(1.0 - FAULT_PROBABILITY, np.arange(1, MOST_DOF + 1))
    return np.asarray(limits, np.float64)


@dataclass(frozen=True, slots=True)
class Prepared:
    """One epoch, ready for a filter."""

    t_ns: int
    rows: F64
    """(M, 12) satellites in use, columns ``S_`` of :mod:`corrected`, clock offset taken off."""
    sky: F64
    """(M, 2) azimuth, elevation [rad]."""
    point: F64 | None
    """(30,) the epoch's own solution, columns ``P_`` of :mod:`single_point`; None without."""
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
    let_go: bool = False
    """The receiver's clock jumped in front of it, by more than this epoch can tell."""


@dataclass(frozen=True, slots=True)
class _Block:
    """A block of epochs, arranged for kernels."""

    raw: RawGnssSamples
    observed: F64
    """(N, K, 6) as :func:`companion.gnss.corrected.correct` takes it."""
    ours: Flags
    """(N, K) satellites of the systems that are used."""
    whole: bool
    """They have a pseudorange each."""


class Trust(Protocol):
    """Who learns how far the measurements of each system are off what they are taken for."""

    @property
    def factors(self) -> F64:
        """(2, SYSTEMS) on the variances of ranges and of rates, in force now."""
        ...

    def learn(self, t_ns: int, found: F64) -> None:
        """Take in what :func:`companion.gnss.scatter.scatter` found of an epoch."""
        ...


class Receiver:
    """State of one stream of raw measurements."""

    def __init__(self, config: RawGnss, trust: Trust | None = None) -> None:
        self.config = config
        self._trust = trust
        self.ephemerides = Ephemerides()
        self.clock = ClockSteps()
        self._learner = new_learner(config)
        self._clock_system = 0
        self.unsolved = 0
        """Epochs of four satellites and more whose ranges fit no place."""
        self._place = np.zeros(3)
        self._place_s = -math.inf
        self._begun_s: float | None = None
        self._contradicted_s = -math.inf
        self._block: _Block | None = None
        self._set: tuple[int, ...] = ()
        self._seen = b""
        self._blamed: dict[int, str] = {}
        self._systems = {NAMES.index(name) for name in config.systems}
        noise = np.empty(NOISE_SIZE)
        noise[V_RANGE_SD] = math.hypot(config.sd_range_m, config.sd_multipath_m)
        noise[V_RATE_SD] = config.sd_rate_mps
        noise[V_CN0], noise[V_IONO] = config.strong_cn0_dbhz, config.iono_residual
        noise[V_MASK] = config.elevation_mask_deg * DEG
        self._noise = noise

    def listen(self, messages: BroadcastSamples) -> None:
        """Take navigation messages."""
        self.ephemerides.take(messages)

    def take(self, raw: RawGnssSamples, i: int) -> Prepared:
        """Prepare epoch ``i`` of a block."""
        week, tow, t_ns = int(raw.week[i]), float(raw.tow[i]), int(raw.t_ns[i])
        now = week * 604_800.0 + tow
        if abs(now - self._place_s) > GUESS_S:
            self._place[:] = 0.0
        if self._block is None or self._block.raw is not raw:
            self._block = self._arranged(raw)
        at = self._block.ours[i].nonzero()[0]
        sat, observed = raw.sat[i, at], self._block.observed[i, at]
        table, which, without = self.ephemerides.table(sat, week, tow)
        if not self._block.whole:
            which = np.where(np.isfinite(observed[:, 0]), which, -1)
        rows, sky = np.empty((len(sat), ROW_SIZE)), np.empty((len(sat), 2))
        point, used = np.full(POINT_SIZE, np.nan), np.ones(len(sat), np.int64)
        code, m = TOO_FEW, 0
        begun = bool(self._place.any())
        # From nowhere, the first solution only tells what is low and where the ionosphere is.
        for _ in range(2):
            known = bool(self._place.any())
            m = correct(
                table, which, week, tow, observed, self._place,
                self.ephemerides.ionosphere, self._noise, rows, sky,
            )  # fmt: skip
            if self._trust is not None:
                _scale(rows[:m], self._trust.factors)
            code = solve(rows, m, self._place, _residual_limits(), point, used)
            if code == SOLVED:
                self._place, self._place_s = point[P_POS : P_POS + 3].copy(), now
            if known or code != SOLVED:
                break
        if self._trust is not None and known and code in (SOLVED, FAULTY):
            before, found = self._trust.factors.copy(), np.empty((2, SYSTEMS, 2))
            scatter(rows, m, used, point, trimmed_mean(), found)
            self._trust.learn(t_ns, found)
            _scale(rows[:m], self._trust.factors / before)
        if not begun and code != SOLVED:
            self._place[:] = 0.0  # a beginning that led nowhere is none
        return self._finish(t_ns, now, rows[:m], sky[:m], used[:m], code, point, without)

    def _arranged(self, raw: RawGnssSamples) -> _Block:
        """A block's columns as kernels take them, once for all of its epochs."""
        columns = (raw.pseudorange, raw.rate, raw.cn0, raw.sd_range, raw.sd_rate, raw.signal)
        observed: F64 = np.stack(columns, axis=2, dtype=np.float64)
        cn0 = observed[:, :, 2]
        cn0[~np.isfinite(cn0)] = self._noise[V_CN0]
        ours = np.isin(raw.sat // 100 - 1, list(self._systems))
        whole = bool(np.isfinite(raw.pseudorange[ours]).all())
        return _Block(raw, observed, ours, whole)

    def _finish(
        self, t_ns: int, now: float, rows: F64, sky: F64, used: I64, code: int, point: F64,
        without: dict[str, list[int]],
    ) -> Prepared:  # fmt: skip
        solved = code == SOLVED
        self.unsolved += not solved and code != TOO_FEW
        excluded: tuple[int, ...] = ()
        jumps = self.clock.jumps
        offset = self._offset(now, rows, point if solved else None)
        let_go = self.clock.jumps > jumps
        if self.config.clock_noise == "learned" and (solved or let_go):
            self._learn_clock(now, point if solved else None, offset, let_go)
        if self.config.exclude and code != TOO_FEW and not (solved and used.all()):
            keep = np.zeros(len(rows), np.bool_)
            if solved:
                # Judged by the residuals; the only one of its system was left out unjudged.
                systems = rows[:, S_SYSTEM].astype(np.int64)
                keep = (used == 1) | (np.bincount(systems, minlength=3)[systems] == 1)
                excluded = tuple(rows[~keep, S_SAT].astype(np.int64).tolist())
            rows, sky = rows[keep], sky[keep]
        rows, sky = self._choose(rows, sky)
        rows[:, S_RANGE] -= offset
        dop, lines = np.empty(5), np.empty((len(rows), 3))
        lines_of_sight(sky, lines)
        dilution(lines, rows[:, S_SYSTEM].astype(np.int64), len(rows), dop)
        events = self._events(t_ns, rows, dop, excluded, without)
        said = self._troubles(t_ns, now, not solved and code != TOO_FEW, without)
        events = (*said, *events)
        if let_go:
            text = "the receiver's clock jumped: it is found again"
            events = (Event(t_ns, "receiver-clock", text), *events)
        at = point if solved else None
        factors = _ONES if self._trust is None else self._trust.factors[0].copy()
        scale = self._learner[SCALE : SCALE + 3].copy()
        return Prepared(
            t_ns, rows, sky, at, dop, excluded, without, events, factors, scale, let_go
        )  # fmt: skip

    def _troubles(
        self, t_ns: int, now: float, contradicting: bool, without: dict[str, list[int]]
    ) -> tuple[Event, ...]:
        """What keeps the ranges as a whole from being used, when it begins."""
        out = []
        if contradicting and now - self._contradicted_s > QUIET_S:
            text = (
                "too few satellites agree on a place, none is used: the receiver's time, its "
                "ephemerides, or signals that are not the satellites'"
            )
            out.append(Event(t_ns, "ranges-contradict", text, "warning"))
        if contradicting:
            self._contradicted_s = now
        if self._begun_s is None:
            self._begun_s = now
        if "missing" in without and self.ephemerides.empty:
            waited = now - self._begun_s
            if waited >= NO_EPHEMERIS_S:
                self._begun_s = math.inf
                text = f"no ephemeris in {waited:.0f} s: does the receiver send them?"
                out.append(Event(t_ns, "no-ephemerides", text, "warning"))
        return tuple(out)

    def _offset(self, now: float, rows: F64, point: F64 | None) -> float:
        """Clock offset to take off; without a solution, steps are looked for at the last place."""
        if point is not None:
            # Of the first system there is: one clock in all but the systems' biases.
            clocks = point[P_CLOCK : P_CLOCK + 3].tolist()
            bias = next(clock for clock in clocks if clock == clock)
            return self.clock.take(now, bias, float(point[P_RATE]))
        if self.clock.offset is None or not self._place.any() or len(rows) == 0:
            return self.clock.offset or 0.0
        here, u = np.empty(3), np.empty(3)
        geodetic(self._place[0], self._place[1], self._place[2], here)
        seen = [row[S_RANGE] - expected_range(row, self._place, here, u) for row in rows]
        # The vehicle has gone on since it was last known where it is.
        doubt = FASTEST_MPS * (now - self._place_s)
        return self.clock.take(now, float(np.median(seen)), math.nan, doubt)

    def _learn_clock(self, now: float, point: F64 | None, offset: float, jumped: bool) -> None:
        """Let the noise of the clock be learned from an epoch's own solution, if it has one."""
        if jumped:
            interrupt(self._learner)
        if point is None:
            return
        clocks = point[P_CLOCK : P_CLOCK + SYSTEMS]
        system = int(np.flatnonzero(np.isfinite(clocks))[0])
        if system != self._clock_system:
            interrupt(self._learner)
            self._clock_system = system
        learn_clock(self._learner, now, float(clocks[system]) - offset, float(point[P_RATE]))

    def _choose(self, rows: F64, sky: F64) -> tuple[F64, F64]:
        """The satellites to use: all, or the best set of the configured size."""
        count = self.config.best_of
        if self.config.choice == "all" or len(rows) <= count:
            return rows, sky
        best = np.empty(count, np.int64)
        systems = rows[:, S_SYSTEM].astype(np.int64)
        lines = np.empty((len(rows), 3))
        lines_of_sight(sky, lines)
        found = best_set(lines, systems, len(rows), count, best)
        if found >= NO_DOP:
            return rows, sky
        old = np.flatnonzero(np.isin(rows[:, S_SAT], self._set))
        if len(old) == count:
            dop = np.empty(5)
            dilution(lines[old], systems[old], count, dop)
            if dop[0] <= found * (1.0 + self.config.best_margin):
                best = old
        return rows[best], sky[best]

    def _events(
        self, t_ns: int, rows: F64, dop: F64, excluded: tuple[int, ...],
        without: dict[str, list[int]],
    ) -> tuple[Event, ...]:  # fmt: skip
        asked = rows[:, S_SAT].tobytes()
        if asked == self._seen and not (excluded or self._blamed or without.keys() - {"missing"}):
            return ()
        self._seen = asked
        events = []
        sats = tuple(sorted(rows[:, S_SAT].astype(np.int64).tolist()))
        if sats != self._set:
            gained = [satellite_name(s) for s in sats if s not in self._set]
            lost = [satellite_name(s) for s in self._set if s not in sats]
            text = f"{len(sats)} satellites, GDOP {dop[0]:.1f}" + "".join(
                f"; {word} {' '.join(names)}"
                for word, names in (("new", gained), ("gone", lost))
                if names
            )
            events.append(Event(t_ns, "satellite-set", text))
            self._set = sats
        blamed = dict.fromkeys(excluded, "its range contradicts the others")
        for why, who in without.items():
            if why != "missing":
                blamed |= dict.fromkeys(who, f"ephemeris {why}")
        for s, why in blamed.items():
            if self._blamed.get(s) != why:
                name = satellite_name(s)
                events.append(Event(t_ns, "satellite-refused", f"{name}: {why}", "warning"))
        # What went out of sight is not news when it comes back.
        self._blamed = {s: why for s, why in (self._blamed | blamed).items() if s not in sats}
        return tuple(events)


def _scale(rows: F64, factors: F64) -> None:
    """Variances of corrected satellites times their systems' ``factors`` (2, SYSTEMS)."""
    if (factors != 1.0).any():
        system = rows[:, S_SYSTEM].astype(np.int64)
        rows[:, S_RANGE_VAR] *= factors[0, system]
        rows[:, S_RATE_VAR] *= factors[1, system]
