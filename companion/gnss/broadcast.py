"""Broadcast ephemerides as they come in: which of them a measurement may be corrected with.

Refused are those that are too old, that say of themselves that the satellite is unhealthy, that no
satellite can have, and pairs that contradict each other, until a third tells which is right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

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
from companion.gnss.systems import BEIDOU, GALILEO, GPS, satellite_name
from companion.types import F64, I64, BroadcastSamples

MOST_AGE_S = {GPS: 7_200.0, GALILEO: 14_400.0, BEIDOU: 7_200.0}
"""From the time of reference: GPS fits over 4 h around it; Galileo is not to be used past 4 h;
BeiDou's come every hour, twice that still errs by metres only."""
CONTRADICTION_M = 200.0
"""Neighbouring ephemerides of a satellite agree to metres; a flipped bit makes kilometres."""
NEIGHBOURS_S = 3 * 3_600.0
KEPT = 64
"""Ephemerides kept of a satellite: a day of files with half-hourly ones."""
_SEMI_AXIS = (4_500.0, 7_000.0)
_CHOICE_S = 30.0

MISSING, STALE, UNHEALTHY, CONTRADICTORY = "missing", "stale", "unhealthy", "contradictory"


@dataclass(slots=True)
class _Known:
    """One ephemeris and what is thought of it."""

    row: F64
    doubted: bool = False
    received: int = 1


@dataclass(frozen=True, slots=True)
class _Table:
    """What :meth:`Ephemerides.table` answered, and the times within which it would so again."""

    sats: bytes
    begin: float
    end: float
    rows: F64
    which: I64
    without: dict[str, list[int]]


@dataclass(slots=True)
class Ephemerides:
    """All that was received, by satellite."""

    ionosphere: F64 = field(default_factory=lambda: np.zeros(8))
    refused: dict[str, int] = field(default_factory=dict)
    """Messages refused when they came, by reason."""
    _of: dict[int, list[_Known]] = field(default_factory=dict)
    _chosen: dict[int, tuple[float, F64 | None, str]] = field(default_factory=dict)
    _held: _Table | None = None

    def take(self, samples: BroadcastSamples) -> None:
        """Add what a receiver or a file broadcast; what cannot be is counted and dropped."""
        for sat, values in zip(samples.sat.tolist(), samples.values, strict=True):
            if sat == 0:
                if np.isfinite(values[:8]).all():
                    self.ionosphere = values[:8].copy()
                else:
                    self._refuse("impossible")
            else:
                self._add(sat, values)

    def _refuse(self, reason: str) -> None:
        self.refused[reason] = self.refused.get(reason, 0) + 1

    def _add(self, sat: int, row: F64) -> None:
        self._held = None
        if not possible(row) or int(row[E_SAT]) != sat:
            self._refuse("impossible")
            return
        known = self._of.setdefault(sat, [])
        self._chosen.pop(sat, None)
        for old in known:
            if np.array_equal(old.row, row):
                old.received += 1
                if old.doubted:
                    self._settle(known, old)
                return
        new = _Known(row.copy())
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
        now = week * 604_800.0 + tow
        held = self._chosen.get(sat)
        if held is not None and 0.0 <= now - held[0] < _CHOICE_S:
            return held[1], held[2]
        row, why = self._choose(sat, week, tow)
        self._chosen[sat] = (now, row, why)
        return row, why

    def _choose(self, sat: int, week: int, tow: float) -> tuple[F64 | None, str]:
        known = self._of.get(sat)
        if not known:
            return None, MISSING
        best = min(known, key=lambda k: abs(since(week, tow, k.row[E_WEEK], k.row[E_TOE])))
        if abs(since(week, tow, best.row[E_WEEK], best.row[E_TOE])) > MOST_AGE_S[sat // 100 - 1]:
            return None, STALE
        if best.row[E_HEALTH] != 0:
            return None, UNHEALTHY
        if best.doubted:
            return None, CONTRADICTORY
        return best.row, ""

    def table(self, sats: I64, week: int, tow: float) -> tuple[F64, I64, dict[str, list[int]]]:
        """Ephemerides (M, 28) of satellites, the row of each or −1, and who has none for what.

        They are held: not to be written to.
        """
        now, asked = week * 604_800.0 + tow, sats.tobytes()
        held = self._held
        if held is None or held.sats != asked or not held.begin <= now < held.end:
            held = self._held = self._table(asked, sats, week, tow)
        return held.rows, held.which, held.without

    def _table(self, asked: bytes, sats: I64, week: int, tow: float) -> _Table:
        which = np.full(len(sats), -1, np.int64)
        rows: list[F64] = []
        without: dict[str, list[int]] = {}
        begin, end = -math.inf, math.inf
        for m, sat in enumerate(sats.tolist()):
            if sat == 0:
                continue
            row, why = self.choose(sat, week, tow)
            since_s = self._chosen[sat][0]
            begin, end = max(begin, since_s), min(end, since_s + _CHOICE_S)
            if row is None:
                without.setdefault(why, []).append(sat)
            else:
                which[m] = len(rows)
                rows.append(row)
        table = np.array(rows) if rows else np.zeros((0, EPHEMERIS_SIZE))
        return _Table(asked, begin, end, table, which, without)

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
