"""Broadcast ephemerides as they come in: which of them a measurement may be corrected with.

Refused are those that are too old, that say of themselves that the satellite is unhealthy, that no
satellite can have, and pairs that contradict each other, until a third tells which is right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from companion.gnss.gps_time import MOST_WEEKS, WEEK_S
from companion.gnss.knots import KNOT_SIZE
from companion.gnss.orbit import (
    E_ACCURACY,
    E_AF0,
    E_AF1,
    E_ECC,
    E_HEALTH,
    E_ISSUE,
    E_SAT,
    E_SQRT_A,
    E_TOC,
    E_TOC_WEEK,
    E_TOE,
    E_WEEK,
    EPHEMERIS_SIZE,
    satellite_at,
    since,
)
from companion.gnss.systems import BEIDOU, GALILEO, GPS, SYSTEMS, satellite_name
from companion.types import F64, I64, BroadcastSamples

MOST_AGE_S = {GPS: 7_200.0, GALILEO: 14_400.0, BEIDOU: 7_200.0}
"""From the time of reference: GPS fits over 4 h around it; Galileo is not to be used past 4 h;
BeiDou's come every hour, twice that still errs by metres only."""
CONTRADICTION_M = 200.0
"""Neighbouring ephemerides of a satellite agree to metres; a flipped bit makes kilometres."""
NEIGHBOURS_S = 3 * 3_600.0
KEPT = 64
"""Ephemerides kept of a satellite: a day of files with half-hourly ones."""
CHOICE_S = 30.0
_SEMI_AXIS = (4_500.0, 7_000.0)
_EVER = int(np.iinfo(np.int64).max)

# --- why a satellite has none: entries of Table.row_of
MISSING, STALE, UNHEALTHY, CONTRADICTORY = "missing", "stale", "unhealthy", "contradictory"
REASONS = (MISSING, STALE, UNHEALTHY, CONTRADICTORY)
NO_ROW = -1
"""And those before it: −1 − the reason's place in :data:`REASONS`."""
NUMBERS = 100 * (SYSTEMS + 1)
"""Satellites are numbered below."""


@dataclass(slots=True)
class _Known:
    """One ephemeris and what is thought of it."""

    row: F64
    reference_s: float
    """Time of reference, seconds since the GPS epoch."""
    doubted: bool = False


@dataclass(frozen=True, slots=True)
class _Choice:
    """What is used of a satellite, and the choices of time from and before which that holds."""

    begin: int
    end: int
    row: F64 | None
    why: str


@dataclass(frozen=True, slots=True)
class Table:
    """The ephemerides in use, from one choice of time on, before another."""

    begin: int
    end: int
    rows: F64
    """(M, 28); not to be written to."""
    row_of: I64
    """(:data:`NUMBERS`,) row of each satellite, or :data:`NO_ROW` and below."""
    knots: F64
    """(M, 2, ·) of :mod:`companion.gnss.knots`, moved on by who uses the table."""

    def without(self, sats: list[int]) -> dict[str, list[int]]:
        """Which of ``sats`` have no ephemeris, by reason."""
        found: dict[str, list[int]] = {}
        for sat, row in zip(sats, self.row_of[sats].tolist(), strict=True):
            if row <= NO_ROW:
                found.setdefault(REASONS[NO_ROW - row], []).append(sat)
        return found


def choice_of(now: F64) -> I64:
    """(N,) which choice of ephemerides counts at GPS times ``now`` [s since the GPS epoch].

    Choices lie on a grid of time, so that who was asked about when changes nothing.
    """
    # Written so that NaN is no time either.
    sane = np.where(np.abs(now) < MOST_WEEKS * WEEK_S, now, 0.0)
    return np.floor(sane / CHOICE_S).astype(np.int64)


@dataclass(slots=True)
class Ephemerides:
    """All that was received, by satellite."""

    ionosphere: F64 = field(default_factory=lambda: np.zeros(8))
    refused: dict[str, int] = field(default_factory=dict)
    """Messages refused when they came, by reason."""
    _of: dict[int, list[_Known]] = field(default_factory=dict)
    _chosen: dict[int, _Choice] = field(default_factory=dict)
    _held: Table | None = None

    def take(self, samples: BroadcastSamples) -> None:
        """Add what a receiver or a file broadcast; what cannot be is counted and dropped."""
        for sat, values in zip(samples.sat.tolist(), samples.values, strict=True):
            if self.repeats(sat, values):
                continue
            if sat == 0:
                self.ionosphere = values[:8].copy()
            else:
                self._add(sat, values)

    def repeats(self, sat: int, values: F64) -> bool:
        """Whether a message changes nothing: it is known already, or was refused just now."""
        if sat == 0:
            if np.array_equal(values[:8], self.ionosphere):
                return True
            fits = bool(np.isfinite(values[:8]).all())
        else:
            known = self._of.get(sat, ())
            if any(not old.doubted and np.array_equal(old.row, values) for old in known):
                return True
            fits = 100 <= sat < NUMBERS and int(values[E_SAT]) == sat and possible(values)
        if not fits:
            self._refuse("impossible")
        return not fits

    def _refuse(self, reason: str) -> None:
        self.refused[reason] = self.refused.get(reason, 0) + 1

    def _add(self, sat: int, row: F64) -> None:
        """Add a possible ephemeris that is not known, or settle one in doubt."""
        self._held = None
        known = self._of.setdefault(sat, [])
        self._chosen.pop(sat, None)
        for old in known:
            if np.array_equal(old.row, row):
                self._settle(known, old)
                return
        new = _Known(row.copy(), float(row[E_WEEK]) * WEEK_S + float(row[E_TOE]))
        near = [old for old in known if abs(_apart(old.row, row)) <= NEIGHBOURS_S]
        if any(not old.doubted and agree(old.row, row) for old in near):
            pass
        elif backing := [old for old in near if old.doubted and agree(old.row, row)]:
            self._settle(known, backing[0])
        elif near:
            new.doubted = True
            for old in near:
                old.doubted = True
            self._refuse(CONTRADICTORY)
        known.append(new)
        del known[:-KEPT]

    @staticmethod
    def _settle(known: list[_Known], right: _Known) -> None:
        """One of several in doubt is confirmed: those that it contradicts go."""
        right.doubted = False
        known[:] = [k for k in known if k is right or not k.doubted or agree(k.row, right.row)]
        for k in known:
            k.doubted = False

    def choose(self, sat: int, week: int, tow: float) -> tuple[F64 | None, str]:
        """The ephemeris to use for a satellite at a GPS time, or None and why not."""
        choice = self._choice(sat, int(choice_of(np.array([week * WEEK_S + tow]))[0]))
        return choice.row, choice.why

    def _choice(self, sat: int, at: int) -> _Choice:
        held = self._chosen.get(sat)
        if held is None or not held.begin <= at < held.end:
            held = self._chosen[sat] = self._choose(sat, at)
        return held

    def _choose(self, sat: int, at: int) -> _Choice:
        known = self._of.get(sat)
        if not known:
            return _Choice(at, at + 1, None, MISSING)
        now, most_age = at * CHOICE_S, MOST_AGE_S[sat // 100 - 1]
        best = min(known, key=lambda k: abs(now - k.reference_s))
        # Another is nearer from the middle between them on; a second before any of these moments it
        # is looked at anew, so that rounding has no say.
        turns = [0.5 * (best.reference_s + k.reference_s) for k in known if k is not best]
        turns += [best.reference_s - most_age, best.reference_s + most_age]
        next_s = min((turn for turn in turns if turn > now - 1.0), default=math.inf)
        end = max(at + 1, math.ceil((next_s - 1.0) / CHOICE_S)) if next_s < math.inf else _EVER
        if abs(now - best.reference_s) > most_age:
            return _Choice(at, end, None, STALE)
        if best.row[E_HEALTH] != 0:
            return _Choice(at, end, None, UNHEALTHY)
        if best.doubted:
            return _Choice(at, end, None, CONTRADICTORY)
        return _Choice(at, end, best.row, "")

    def table(self, at: int) -> Table:
        """The ephemerides in use of all satellites at a choice of time (:func:`choice_of`)."""
        held = self._held
        if held is None or not held.begin <= at < held.end:
            held = self._held = self._table(at)
        return held

    def _table(self, at: int) -> Table:
        row_of = np.full(NUMBERS, NO_ROW)
        rows: list[F64] = []
        end = _EVER
        for sat in self._of:
            choice = self._choice(sat, at)
            end = min(end, choice.end)
            if choice.row is None:
                row_of[sat] = NO_ROW - REASONS.index(choice.why)
            else:
                row_of[sat] = len(rows)
                rows.append(choice.row)
        table = np.array(rows) if rows else np.zeros((0, EPHEMERIS_SIZE))
        return Table(at, end, table, row_of, np.full((len(rows), 2, KNOT_SIZE), np.nan))

    @property
    def empty(self) -> bool:
        """Whether there is none; asked at every epoch."""
        return not self._of

    def __len__(self) -> int:
        return sum(len(known) for known in self._of.values())

    def __str__(self) -> str:
        return f"{len(self)} ephemerides of " + ", ".join(map(satellite_name, sorted(self._of)))


def possible(row: F64) -> bool:
    """Whether this is an orbit that a navigation satellite can have. NaN is none."""
    return bool(
        np.isfinite(row).all()
        and _SEMI_AXIS[0] < row[E_SQRT_A] < _SEMI_AXIS[1]
        and 0.0 <= row[E_ECC] < 0.2
        and 0.0 <= row[E_TOE] < 604_800.0
        and 0.0 <= row[E_TOC] < 604_800.0
        and abs(since(row[E_TOC_WEEK], row[E_TOC], row[E_WEEK], row[E_TOE])) < 86_400.0
        and abs(row[E_AF0]) < 0.1
        and abs(row[E_AF1]) < 1e-6
        and row[E_ACCURACY] >= 0.0
        and row[E_ISSUE] >= 0.0
    )


def _apart(a: F64, b: F64) -> float:
    return since(b[E_WEEK], b[E_TOE], a[E_WEEK], a[E_TOE])


def agree(a: F64, b: F64) -> bool:
    """Whether two ephemerides of a satellite tell the same place and clock half way between."""
    out = np.empty((2, 8))
    half = 0.5 * _apart(a, b)
    for k, row in enumerate((a, b)):
        satellite_at(row, a[E_WEEK], a[E_TOE] + half, out[k])
    difference = np.abs(out[0] - out[1])
    return bool(difference[:3].max() < CONTRADICTION_M and difference[6] < CONTRADICTION_M)
