"""What leaves the engine: each epoch once as published and once as settled, reports, events.

Going back in time rewrites rows and takes events back; what has been said stays said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from companion.estimation import update as up
from companion.estimation.adaptation import layout as al
from companion.estimation.buffers import SampleBuffer
from companion.estimation.choice import Estimator
from companion.estimation.digest import RowDigest
from companion.estimation.output_row import (
    O_ACCEL_BIAS,
    O_COV,
    O_GYRO_BIAS,
    O_LAT,
    O_MODE,
    O_Q,
    O_RESETS,
    O_VEL,
)
from companion.types import (
    F64,
    I64,
    AdaptationTrace,
    AidingReports,
    Event,
    Outputs,
    Satellites,
    Solution,
)

_NEVER = int(np.iinfo(np.int64).min)

NO_SOLUTION = Solution.empty()
NO_REPORTS = AidingReports.empty()
NO_TRACE = AdaptationTrace.empty()
NOTHING = Outputs(NO_SOLUTION, NO_SOLUTION, NO_REPORTS, ())
"""What a step gives out that leaves nothing to say."""


UNHASHED = 64
"""Parts that wait for the hash: one sample a call, a kernel for each epoch costs more than its
rows."""


class Outlet:
    """Remembers what has been published, settled and said, and hashes the first two."""

    def __init__(self) -> None:
        self._published_t = self._settled_t = self._hashed_t = _NEVER
        self._fresh: list[tuple[I64, F64]] = []
        self._unhashed: list[tuple[I64, F64]] = []
        self._unhashed_settled: list[tuple[I64, F64]] = []
        self._said: dict[tuple[int, str], None] = {}
        self._unsaid: list[Event] = []
        self._settled = RowDigest()
        self._published = RowDigest()

    def digest(self, rows: SampleBuffer, horizon: int) -> str:
        """Hash over the bits of what has settled: the output rows up to ``horizon``.

        Whether it has been given out yet is no matter, so that a hash in the middle of a run
        depends on what had arrived and not on the calls it arrived in.
        """
        self._keep_settled(rows, rows.after(horizon))
        _absorb(self._unhashed_settled, self._settled)
        return self._settled.hexdigest()

    @property
    def digest_published(self) -> str:
        """Hash over everything reached for the first time, in order, given out yet or not."""
        _absorb(self._unhashed, self._published)
        return self._published.hexdigest()

    def _keep_settled(self, rows: SampleBuffer, end: int) -> tuple[I64, F64] | None:
        """Set aside for hashing the rows up to index ``end`` that were not yet."""
        begin = rows.after(self._hashed_t)
        if begin >= end:
            return None
        self._hashed_t = int(rows.t[end - 1])
        part = rows.t[begin:end].copy(), rows.rows[begin:end].copy()
        self._unhashed_settled.append(part)
        if len(self._unhashed_settled) > UNHASHED:
            _absorb(self._unhashed_settled, self._settled)
        return part

    def restart(self) -> None:
        """The clock began anew: its times may be earlier than those given out before."""
        self._published_t = self._settled_t = self._hashed_t = _NEVER

    def publish(self, estimator: Estimator) -> None:
        """Set aside the epochs reached for the first time: going back may rewrite them."""
        rows = estimator.rows
        a, b = rows.after(self._published_t), rows.end
        if a < b:
            self._published_t = int(rows.t[b - 1])
            part = rows.t[a:b].copy(), rows.rows[a:b].copy()
            self._fresh.append(part)
            self._unhashed.append(part)
        if estimator.events:
            self._note(estimator.events)

    @property
    def silent(self) -> bool:
        """Whether there is neither an epoch nor an event to give out."""
        return not (self._fresh or self._unsaid)

    def published(self) -> Solution:
        """The epochs set aside since the last call."""
        fresh, self._fresh = self._fresh, []
        if len(self._unhashed) > UNHASHED:
            _absorb(self._unhashed, self._published)
        return solution_of(fresh)

    def settled(self, rows: SampleBuffer, horizon: int) -> Solution:
        """Output rows up to ``horizon``, which nothing can change any more; they leave ``rows``."""
        b = rows.after(horizon)
        if b <= rows.start:
            return NO_SOLUTION
        settled = NO_SOLUTION
        # A snapshot may lie before the ring: from there, settled epochs are walked once more.
        a = rows.after(self._settled_t)
        if a < b:
            part = self._keep_settled(rows, b)
            if part is None or len(part[0]) != b - a:
                # A hash was asked for meanwhile, and has taken some of them.
                part = rows.t[a:b].copy(), rows.rows[a:b].copy()
            self._settled_t = int(rows.t[b - 1])
            settled = solution_of([part])
        rows.start = b
        return settled

    def events(self, estimator: Estimator, horizon: int = _NEVER) -> tuple[Event, ...]:
        """Events not said before; those up to ``horizon`` can be forgotten."""
        self._note(estimator.events)
        fresh, self._unsaid = tuple(self._unsaid), []
        if estimator.events:
            estimator.events = [e for e in estimator.events if e.t_ns > horizon]
        if self._said:
            for key in [key for key in self._said if key[0] <= horizon]:
                del self._said[key]
        return fresh

    def _note(self, events: list[Event]) -> None:
        """Set aside events that were not said before: going back may take them back."""
        for event in events:
            if (event.t_ns, event.kind) not in self._said:
                self._said[(event.t_ns, event.kind)] = None
                self._unsaid.append(event)


def _absorb(parts: list[tuple[I64, F64]], digest: RowDigest) -> None:
    """Hash rows that waited, in order; none wait afterwards."""
    if len(parts) > 1:
        columns = zip(*parts, strict=True)
        digest.update(*(np.concatenate(column) for column in columns))
    elif parts:
        digest.update(*parts[0])
    parts.clear()


def trace(buffer: SampleBuffer) -> AdaptationTrace:
    """What the adaptation says in the report rows of ``buffer``, as columns."""
    if not len(buffer):
        return NO_TRACE
    rows = buffer.rows[buffer.start : buffer.end]
    at = np.flatnonzero(rows[:, up.R_TRACE + al.TRACED])
    if not len(at):
        return NO_TRACE
    r = rows[at]
    x = r[:, up.R_TRACE :]
    return AdaptationTrace(
        buffer.t[buffer.start : buffer.end][at],
        r[:, up.R_CHANNEL].astype(np.int64),
        r[:, up.R_SOURCE].astype(np.int64),
        x[:, al.IN_MEAN],
        x[:, al.IN_SPREAD],
        x[:, al.IN_CORRELATION],
        x[:, al.TO_MODEL],
        x[:, al.TO_SOURCE],
        x[:, al.FIRING : al.FIRING + 9],
        x[:, al.OUT_R],
        x[:, al.OUT_Q],
        x[:, al.OUT_ALPHA],
    )


def reports(buffer: SampleBuffer, refusals: list[AidingReports]) -> AidingReports:
    """``refusals`` and the report rows of ``buffer``, which is empty afterwards, as columns."""
    parts = refusals
    if len(buffer):
        t, r = buffer.t[buffer.start : buffer.end], buffer.rows[buffer.start : buffer.end]
        parts = [
            *parts,
            AidingReports(
                t.copy(),
                r[:, up.R_CHANNEL].astype(np.int64),
                r[:, up.R_SOURCE].astype(np.int64),
                r[:, up.R_DOF].astype(np.int64),
                r[:, up.R_INNOVATION : up.R_INNOVATION + 3].copy(),
                r[:, up.R_SD : up.R_SD + 3].copy(),
                r[:, up.R_NIS].copy(),
                r[:, up.R_GATE].copy(),
                r[:, up.R_SCALE_USED].copy(),
                r[:, up.R_VERDICT].astype(np.int64),
            ),
        ]
        buffer.start = buffer.end = 0
    return AidingReports.concatenate(parts) if parts else NO_REPORTS


def with_smoothed(out: Outputs, late: Outputs) -> Outputs:
    """What a step gave out, and what :meth:`companion.engine.Engine.smooth` did after it."""
    if late is NOTHING:
        return out
    return replace(out, events=(*out.events, *late.events), smoothed=late.smoothed)


def also(out: Outputs, events: Sequence[Event]) -> Outputs:
    """What a step gave out, and events that are not the estimator's."""
    return replace(out, events=(*out.events, *events)) if events else out


def join(parts: list[Outputs]) -> Outputs:
    """What several steps gave out, as one."""
    if len(parts) == 1:
        return parts[0]
    return Outputs(
        Solution.concatenate([p.published for p in parts]),
        Solution.concatenate([p.settled for p in parts]),
        AidingReports.concatenate([p.reports for p in parts]),
        tuple(e for p in parts for e in p.events),
        adaptation=AdaptationTrace.concatenate([p.adaptation for p in parts if len(p.adaptation)]),
        satellites=Satellites.concatenate([p.satellites for p in parts if len(p.satellites)]),
    )


def solution_of(parts: list[tuple[I64, F64]]) -> Solution:
    """Output rows, times and values of their own, as columns that are views of them."""
    if not parts:
        return NO_SOLUTION
    t, r = parts[0]
    if len(parts) > 1:
        t = np.concatenate([part[0] for part in parts])
        r = np.concatenate([part[1] for part in parts])
    return Solution(
        t,
        r[:, O_LAT],
        r[:, O_LAT + 1],
        r[:, O_LAT + 2],
        r[:, O_VEL : O_VEL + 3],
        r[:, O_Q : O_Q + 4],
        r[:, O_ACCEL_BIAS : O_ACCEL_BIAS + 3],
        r[:, O_GYRO_BIAS : O_GYRO_BIAS + 3],
        r[:, O_COV : O_COV + 30].reshape(-1, 5, 6),
        r[:, O_MODE].astype(np.int64),
        r[:, O_RESETS].astype(np.int64),
    )
