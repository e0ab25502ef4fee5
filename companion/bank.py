"""Unlike estimators on one stream of events, of which one is published. Pure, as the engine is.

Each member is an engine with a configuration of its own and sees every arrival. Decisions fall
between the samples of the first inertial unit on a grid of its stamps, so that they do not depend
on how arrivals are cut into calls: live, replay and any block length publish the same.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np

from companion.config import Config
from companion.config.settings import alone, smoothable
from companion.engine import Engine
from companion.estimation.digest import RowDigest
from companion.intake.counters import Counters
from companion.intake.fusion.fusion import ImuFusion
from companion.outlet import NOTHING, join
from companion.selector import DECIDE_NS, Selector
from companion.smoothing.on_line import OnLine
from companion.types import (
    F64,
    AidingReports,
    AidingSamples,
    AnySamples,
    ImuSamples,
    Outputs,
    Solution,
)

_NEVER = int(np.iinfo(np.int64).min)
_EMPTY = Solution.empty()


def navigator(config: Config) -> Engine | Bank:
    """The engine of a configuration, or the bank of several that it asks for."""
    return Bank(config) if config.bank.estimators else Engine(config)


class Bank:
    """Several engines behind the calls of one."""

    def __init__(self, config: Config) -> None:
        self.config = config
        names = config.bank.estimators
        smoothed = smoothable(config) if config.smoothing.enabled else None
        self.members = [(name, Engine(_member(config, name, name == smoothed))) for name in names]
        self._smoothed = dict(self.members)[smoothed] if smoothed else None
        """The member that is smoothed on line, whichever is published: going from one to another
        would break the intervals that a smoother looks back over."""
        self.selector = Selector(names)
        self._further = {unit.source for unit in config.further_imu}
        self._cell: int | None = None
        self._published_ns = self._settled_ns = _NEVER
        self._digest = RowDigest()

    @property
    def on_line(self) -> OnLine:
        """The smoother on line: that of the first member that can have one, or one that is off."""
        return (self._smoothed or self.members[0][1]).on_line

    @property
    def selected(self) -> tuple[str, Engine]:
        """The member that is published."""
        return self.members[self.selector.current]

    @property
    def counters(self) -> Counters:
        """Of the member that is published."""
        return self.selected[1].counters

    @property
    def fusion(self) -> ImuFusion | None:
        """Of the first member that fuses several inertial units."""
        return next((e.fusion for _, e in self.members if e.fusion is not None), None)

    @property
    def reached_ns(self) -> int | None:
        """Time of validity of the last inertial sample that the published member has taken."""
        return self.selected[1].reached_ns

    @property
    def digest(self) -> str:
        """Hash over the settled solutions of all members."""
        said = "\n".join(f"{name} {engine.digest}" for name, engine in self.members)
        return hashlib.blake2b(said.encode(), digest_size=20).hexdigest()

    @property
    def digest_published(self) -> str:
        """Hash over everything published, in order."""
        return self._digest.hexdigest()

    @property
    def digest_smoothed(self) -> str | None:
        """Hash over everything smoothed on line, in order; None without a smoother."""
        return self._smoothed.digest_smoothed if self._smoothed else None

    def step(self, samples: AnySamples) -> Outputs:
        """Take one arrival, as :meth:`companion.engine.Engine.step`."""
        if not isinstance(samples, ImuSamples) or samples.source in self._further:
            outs = [e.step(samples) if _wants(e, samples) else NOTHING for _, e in self.members]
            return self._given(outs)
        parts: list[Outputs] = []
        begin = 0
        for end in (*self._cuts(samples), len(samples)):
            part = samples.take(slice(begin, end))
            if len(part):
                parts.append(self._given([engine.step(part) for _, engine in self.members]))
            if end < len(samples):
                parts.append(self._decide(int(samples.t_ns[end])))
            begin = end
        return join_bank(parts)

    def step_block(self, imu: ImuSamples, aids: Sequence[AidingSamples]) -> Outputs:
        """Take inertial samples and what arrived among them, as the engine's."""
        parts: list[Outputs] = []
        begin = 0
        done = [0] * len(aids)
        for end in (*self._cuts(imu), len(imu)):
            among: list[AidingSamples] = []
            for at, stream in enumerate(aids):
                until = len(stream)
                if end < len(imu):
                    until = int(np.searchsorted(stream.seq, imu.seq[end]))
                if until > done[at]:
                    among.append(stream.take(slice(done[at], until)))
                    done[at] = until
            part = imu.take(slice(begin, end))
            if len(part) or among:
                outs = [
                    engine.step_block(part, [a for a in among if _wants(engine, a)])
                    for _, engine in self.members
                ]
                parts.append(self._given(outs))
            if end < len(imu):
                parts.append(self._decide(int(imu.t_ns[end])))
            begin = end
        return join_bank(parts)

    def finish(self) -> Outputs:
        """Settle everything: the run has ended."""
        return self._given([engine.finish() for _, engine in self.members])

    def smooth(self) -> Outputs:
        """Smoothed epochs that are due by now, as the engine's."""
        return self._smoothed.smooth() if self._smoothed else NOTHING

    # ------------------------------------------------------------------ decisions

    def _cuts(self, imu: ImuSamples) -> list[int]:
        """Samples before which a decision falls: the first of each cell of the grid."""
        if not len(imu):
            return []
        # A clock that goes back begins a new cell too.
        cells = imu.t_ns // DECIDE_NS
        before = int(cells[0]) if self._cell is None else self._cell
        self._cell = int(cells[-1])
        found: list[int] = np.flatnonzero(np.diff(cells, prepend=before)).tolist()
        return found

    def _decide(self, t_ns: int) -> Outputs:
        event = self.selector.decide(t_ns)
        if event is None:
            return NOTHING
        return Outputs(_EMPTY, _EMPTY, AidingReports.empty(), (event,))

    def _given(self, outs: list[Outputs]) -> Outputs:
        """What the published member gave out, and under their names what all did."""
        if all(out is NOTHING for out in outs):
            return NOTHING
        names = [name for name, _ in self.members]
        for standing, out in zip(self.selector.standings, outs, strict=True):
            standing.note(out)
        mine = outs[self.selector.current]
        published = self._later(mine.published, self._published_ns)
        if len(published):
            self._published_ns = int(published.t_ns[-1])
            self._digest.update(published.t_ns, rows_of(published))
        settled = self._later(mine.settled, self._settled_ns)
        if len(settled):
            self._settled_ns = int(settled.t_ns[-1])
        events = list(mine.events)
        for at, (name, out) in enumerate(zip(names, outs, strict=True)):
            if at != self.selector.current:
                events += [replace(e, text=f"{name}: {e.text}") for e in out.events]
        return replace(
            mine,
            published=published,
            settled=settled,
            events=tuple(events),
            members=tuple(
                (name, out.published)
                for name, out in zip(names, outs, strict=True)
                if len(out.published)
            ),
        )

    @staticmethod
    def _later(solution: Solution, than_ns: int) -> Solution:
        """Epochs behind those given out by another member; a clock that began anew is one."""
        if not len(solution) or solution.t_ns[0] > than_ns:
            return solution
        if than_ns - int(solution.t_ns[-1]) > 2 * DECIDE_NS:
            return solution
        return solution.take(np.flatnonzero(solution.t_ns > than_ns))


def _member(config: Config, name: str, smoothed: bool) -> Config:
    """The configuration of one member; only the one that is smoothed on line keeps tapes."""
    smoothing = msgspec.structs.replace(config.smoothing, enabled=smoothed)
    return msgspec.structs.replace(alone(config, name), smoothing=smoothing)


def _wants(engine: Engine, samples: AnySamples) -> bool:
    """Whether a member has a use for samples that are not of the first inertial unit."""
    return not isinstance(samples, ImuSamples) or bool(engine.config.further_imu)


def rows_of(solution: Solution) -> F64:
    """(N, 48) every value of the epochs, one row each, for a digest."""
    n = len(solution)
    return np.ascontiguousarray(
        np.column_stack([
            solution.lat, solution.lon, solution.height, solution.vel_n, solution.q_nb,
            solution.accel_bias_b, solution.gyro_bias_b, solution.cov.reshape(n, 30),
            solution.mode.astype(np.float64), solution.resets.astype(np.float64),
        ])
    )  # fmt: skip


def join_bank(parts: list[Outputs]) -> Outputs:
    """What several pieces gave out, as one."""
    parts = [part for part in parts if part is not NOTHING]
    if len(parts) < 2:
        return parts[0] if parts else NOTHING
    every: dict[str, list[Solution]] = {}
    for part in parts:
        for name, solution in part.members:
            every.setdefault(name, []).append(solution)
    members = tuple((name, Solution.concatenate(found)) for name, found in every.items())
    return replace(join(parts), members=members)
