"""Which streams feed the engine: one rule, live and replayed.

The engine takes one inertial unit, those that are configured beside it (``further_imu``), and the
best sensor of each other kind; everything else that arrives is only logged. Live the choice is made
while the streams come up, from what they have shown so far, and is kept for the run. The log says
from which arrival on each was used, so that a replay feeds the same samples.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np

from companion.config import Config
from companion.types import (
    NS,
    AnySamples,
    BaroSamples,
    GnssSamples,
    ImuSamples,
    MagSamples,
    RawGnssSamples,
)

Kind = Literal["imu", "gnss", "baro", "mag", "raw"]
KINDS: dict[type, Kind] = {
    ImuSamples: "imu",
    GnssSamples: "gnss",
    BaroSamples: "baro",
    MagSamples: "mag",
    RawGnssSamples: "raw",
}

USABLE_IMU_HZ = 20.0
"""Slower is no input of a strapdown filter."""
TRIAL_NS = 2 * NS
"""For how long inertial streams and receivers are compared before one is taken."""
AID_TRIAL_NS = NS
"""The same for the others: the magnetometer has to be there when the first fix begins the run."""
KNOWN_TRIAL_NS = NS // 4
"""How long an inertial stream that was used before has to show that it still is fast enough."""


class Chosen(NamedTuple):
    """A stream that feeds the engine, from an arrival number on."""

    kind: Kind
    source: str
    first_seq: int


def in_turn(blocks: Sequence[AnySamples]) -> Iterator[AnySamples]:
    """Every arrival at its place, runs of a stream together; of one number, in the order given."""
    of = np.repeat(np.arange(len(blocks)), [len(b) for b in blocks])
    order = np.lexsort((of, np.concatenate([b.seq for b in blocks])))
    turn = of[order]
    begins = np.flatnonzero(np.diff(turn, prepend=-1))
    done = [0] * len(blocks)
    for begin, end in itertools.pairwise([*begins.tolist(), len(turn)]):
        index = int(turn[begin])
        yield blocks[index].take(slice(done[index], done[index] + end - begin))
        done[index] += end - begin


class Thinner:
    """One magnetometer sample per period, whatever the blocks in which they come.

    Telemetry repeats a slow sensor's value at the rate of the message.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = round(NS / rate_hz)
        self._last: int | None = None

    def __call__(self, samples: MagSamples) -> MagSamples:
        """The first of each period that has not begun before."""
        if not len(samples):
            return samples
        cell = samples.t_ns // self._period_ns
        first = np.ones(len(cell), np.bool_)
        first[0] = cell[0] != self._last
        first[1:] = cell[1:] != cell[:-1]
        self._last = int(cell[-1])
        return samples.take(first)


class Selection:
    """Chooses streams as they arrive, and passes on what the engine is to get. Pure."""

    def __init__(
        self,
        config: Config,
        *,
        imu: str = "",
        preferred: Mapping[Kind, Sequence[str]],
        known: Mapping[Kind, str] | None = None,
    ) -> None:
        """``imu``: the inertial stream that is configured, if one is; it is used whatever comes.

        ``preferred``: names of streams that may come, best first; others count after them, in the
        order in which they are heard. A source that the configuration names is used at once, and so
        is one that an earlier run has compared with others (``known``), if it is good.
        """
        named = {
            "imu": config.imu.source,
            "gnss": config.gnss.source,
            "raw": config.raw_gnss.source,
        }
        self._named: dict[str, str] = {k: v for k, v in named.items() if v != "auto"}
        if imu:
            self._named.setdefault("imu", imu)
        self._further = {unit.source: at for at, unit in enumerate(config.further_imu)}
        self._ignored = {
            kind
            for kind, use in (
                ("baro", config.baro.use),
                ("mag", config.mag.use),
                ("raw", config.raw_gnss.coupling != "off"),
            )
            if not use
        }
        self._preferred = preferred
        self._known = known or {}
        self._trials: dict[Kind, _Trial] = {}
        self._source: dict[Kind, str] = {}
        self._thin = Thinner(config.mag.max_rate_hz)
        self.chosen: list[Chosen] = []

    def uses(self, kind: Kind, source: str) -> bool:
        """Whether this stream feeds the engine."""
        return self._source.get(kind) == source or (kind == "imu" and source in self._further)

    def ordered(self, blocks: Sequence[AnySamples]) -> Sequence[AnySamples]:
        """Blocks that came together, as the engine is to get them.

        Units that are fused are held against each other as they come in: their samples go in by
        number of arrival, and of one number further units first, as in a replay.
        """
        units = [b for b in blocks if isinstance(b, ImuSamples)]
        if not self._further or len(units) < 2:
            return blocks
        last = len(self._further)
        units.sort(key=lambda b: self._further.get(b.source, last))
        return [*(b for b in blocks if not isinstance(b, ImuSamples)), *in_turn(units)]

    def offer(self, samples: AnySamples) -> AnySamples | None:
        """What the engine gets of these samples: all, some, or None."""
        kind = KINDS[type(samples)]
        if kind == "imu" and samples.source in self._further:
            return samples if len(samples) else None
        source = self._source.get(kind)
        if source is None:
            if kind in self._ignored or not len(samples) or not self._passes(kind, samples):
                return None
            self._source[kind] = samples.source
            self.chosen.append(Chosen(kind, samples.source, int(samples.seq[0])))
        elif source != samples.source:
            return None
        if isinstance(samples, MagSamples):
            samples = self._thin(samples)
        return samples if len(samples) else None

    def _passes(self, kind: Kind, samples: AnySamples) -> bool:
        """Whether this stream is the one to use from these samples on."""
        if kind in self._named:
            return self._named[kind] == samples.source
        if kind == "raw":
            return True  # there is one such link
        trial = self._trials.get(kind)
        if trial is None:
            length_ns = TRIAL_NS if kind in ("imu", "gnss") else AID_TRIAL_NS
            preferred, known = self._preferred.get(kind, ()), self._known.get(kind)
            trial = self._trials[kind] = _Trial(length_ns, preferred, known)
        return trial.best(samples) == samples.source


class _Trial:
    """Compares the streams of one kind for a while."""

    def __init__(self, length_ns: int, preferred: Sequence[str], known: str | None) -> None:
        self._length_ns = length_ns
        self._preferred = preferred
        self._known = known
        self._recent: dict[str, deque[int]] = {}
        self._began: int | None = None

    def best(self, samples: AnySamples) -> str | None:
        """The stream to use, once the trial is over and one is good enough."""
        good = samples.t_rx_ns
        if isinstance(samples, GnssSamples):
            good = good[samples.fix_type >= 2]
        recent = self._recent.setdefault(samples.source, deque())
        recent.extend(good.tolist())
        now = int(samples.t_rx_ns[-1])
        if self._began is None and len(good):
            self._began = int(good[0])
        if self._began is None:
            return None
        inertial = isinstance(samples, ImuSamples)
        if samples.source == self._known:
            since = now - KNOWN_TRIAL_NS
            wanted = USABLE_IMU_HZ * KNOWN_TRIAL_NS / NS if inertial else 1
            if sum(t > since for t in recent) >= wanted:
                return samples.source
        if now - self._began < self._length_ns:
            return None
        for times in self._recent.values():
            while times and times[0] <= now - self._length_ns:
                times.popleft()
        enough = USABLE_IMU_HZ * self._length_ns / NS if inertial else 1
        names = [name for name, times in self._recent.items() if len(times) >= enough]
        return min(names, key=self._rank, default=None)

    def _rank(self, source: str) -> int:
        names = self._preferred
        return names.index(source) if source in names else len(names)
