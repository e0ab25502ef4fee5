"""A recording through the engine in order of validity, leaving tapes for a smoother.

The settled solution is the same, to the bit, as that of the run in order of arrival: what came too
late for the delay ring is left out here too.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import msgspec
import numpy as np

from companion.config import Config
from companion.engine import CLOCK_BACK_NS, Engine
from companion.estimation.recording import Recording, Tape
from companion.estimation.stretch import Stretch
from companion.intake.counters import Counters
from companion.intake.fusion.fusion import ImuFusion, fuses
from companion.types import (
    I64,
    NS,
    AidingReports,
    AidingSamples,
    AnySamples,
    BaroSamples,
    BroadcastSamples,
    ConfigError,
    Event,
    GnssSamples,
    ImuSamples,
    MagSamples,
    RawGnssSamples,
    Solution,
    VehicleRecording,
)
from replay.player import choose_aids, choose_imu

BLOCK_S = 60.0


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """A forward run with what a smoother needs of it."""

    config: Config
    """As run: with the rate of the smoothed output."""
    tapes: list[Tape]
    stretches: list[Stretch]
    """The inputs, where they were kept."""
    solution: Solution
    """The settled forward solution."""
    reports: AidingReports
    events: tuple[Event, ...]
    digest: str

    @property
    def history_bytes(self) -> int:
        """Memory of all that was kept: tapes, and inputs with their marks."""
        return self.tape_bytes + sum(stretch.bytes for stretch in self.stretches)

    @property
    def tape_bytes(self) -> int:
        """Memory of the tapes."""
        return sum(
            sum(x.nbytes for x in (c.s, c.kinds, c.coarse, c.fine, c.nominal, c.t_ns))
            for tape in self.tapes
            for c in tape.chunks
        )


def record(
    vehicle: VehicleRecording,
    config: Config,
    *,
    rate_hz: float | None = None,
    covariance: bool = True,
    tape: bool = True,
    inputs: bool = False,
    progress: Callable[[float], None] | None = None,
) -> RecordedRun:
    """Run ``vehicle`` forward; rows, and so the smoothed epochs, come at ``rate_hz``.

    Without ``rate_hz`` at the configured output rate. ``tape`` and ``inputs`` both off: the
    forward run alone. ``inputs`` are what the two-filter smoothers go back over; without ``tape``
    there are rows with P beside them.
    """
    if rate_hz is not None:
        engine_config = msgspec.structs.replace(config.engine, output_rate_hz=rate_hz)
        config = msgspec.structs.replace(config, engine=engine_config)
    events: list[Event] = []
    imu, others = _inputs(vehicle, config, events)
    ring_ns = round(config.engine.delay_ring_s * NS)
    aids = [_in_time(a, imu, config, ring_ns) for a in others]
    if inputs and config.raw_gnss.coupling == "tight":
        raise ConfigError(
            "key 'raw_gnss.coupling': a 'tight' run does not go backwards in time, as two-filter "
            "smoothing does: its satellites do not; take bryson-frazier or rts"
        )
    sessions = _sessions(imu)
    engine = Engine(config, _recording(covariance, tape, inputs))
    settled: list[Solution] = []
    reports: list[AidingReports] = []
    for samples in _in_order(imu, aids, sessions, config):
        out = engine.step(samples)
        settled.append(out.settled)
        reports.append(out.reports)
        events.extend(out.events)
        if progress is not None and isinstance(samples, ImuSamples):
            progress(float(np.searchsorted(imu.seq, samples.seq[-1])) / len(imu))
    out = engine.finish()
    settled.append(out.settled)
    reports.append(out.reports)
    events.extend(out.events)
    return RecordedRun(
        config=config,
        tapes=engine.tapes(),
        stretches=engine.stretches(),
        solution=Solution.concatenate([s for s in settled if len(s)]),
        reports=AidingReports.concatenate([r for r in reports if len(r)]),
        events=tuple(events),
        digest=engine.digest,
    )


def _inputs(
    vehicle: VehicleRecording, config: Config, events: list[Event]
) -> tuple[ImuSamples, list[AidingSamples]]:
    """Inertial samples, of several units made one as the engine does, and the aiding streams."""
    imu, aids = choose_imu(vehicle, config), choose_aids(vehicle, config)
    if not fuses(config):
        return imu, aids
    further = [a for a in aids if isinstance(a, ImuSamples)]
    fused, told = ImuFusion(config, Counters()).take([imu, *further])
    events.extend(told)
    return fused, [a for a in aids if not isinstance(a, ImuSamples)]


def _recording(covariance: bool, tape: bool, inputs: bool) -> Recording:
    if inputs:
        return "all" if tape else "inputs"
    return ("covariance" if covariance else "states") if tape else "no"


def _sessions(imu: ImuSamples) -> list[tuple[int, int]]:
    """Ranges of ``imu`` between restarts of its clock."""
    cuts = np.flatnonzero(np.diff(imu.t_ns) < -CLOCK_BACK_NS) + 1
    edges = [0, *cuts.tolist(), len(imu)]
    return list(itertools.pairwise(edges))


def _imu_latency_ns(config: Config) -> int:
    return round(config.imu.latency_ms * 1e6)


def _validity(aids: AidingSamples, config: Config) -> I64:
    """(N,) when samples are valid: their stamps less the sensor's latency."""
    latency_ms = {
        GnssSamples: config.gnss.latency_ms,
        BaroSamples: config.baro.latency_ms,
        MagSamples: config.mag.latency_ms,
        RawGnssSamples: config.raw_gnss.latency_ms,
        BroadcastSamples: 0.0,
    }
    valid: I64 = aids.t_ns - round(latency_ms[type(aids)] * 1e6)
    return valid


def _in_time(aids: AidingSamples, imu: ImuSamples, config: Config, ring_ns: int) -> AidingSamples:
    """``aids`` without those that arrived too late for the delay ring."""
    valid = _validity(aids, config)
    place = np.searchsorted(imu.seq, aids.seq)
    newest = np.empty(len(imu), np.int64)
    for a, b in _sessions(imu):
        newest[a:b] = np.maximum.accumulate(imu.t_ns[a:b])
    newest -= _imu_latency_ns(config)
    good = place == 0
    behind = ~good
    good[behind] = valid[behind] >= newest[place[behind] - 1] - ring_ns
    return aids.take(good)


def _in_order(
    imu: ImuSamples,
    aids: list[AidingSamples],
    sessions: list[tuple[int, int]],
    config: Config,
) -> Iterator[AnySamples]:
    """Blocks of a minute, each behind the aids that are valid up to its end."""
    step = max(1, int(BLOCK_S * NS / max(float(np.median(np.diff(imu.t_ns))), 1.0)))
    for number, (first, last) in enumerate(sessions):
        until = imu.seq[last] if number + 1 < len(sessions) else np.iinfo(np.int64).max
        since = imu.seq[first] if number else np.iinfo(np.int64).min
        waiting = []
        for stream in aids:
            own = stream.take((stream.seq >= since) & (stream.seq < until))
            waiting.append(own.take(np.argsort(own.t_ns, kind="stable")))
        for begin in range(first, last, step):
            block = imu.take(slice(begin, min(begin + step, last)))
            newest = int(block.t_ns.max()) - _imu_latency_ns(config)
            due: list[AidingSamples] = []
            for index, stream in enumerate(waiting):
                ready = int(np.searchsorted(_validity(stream, config), newest, side="right"))
                if ready:
                    due.append(stream.take(slice(0, ready)))
                    waiting[index] = stream.take(slice(ready, None))
            yield from _in_turn(due)
            yield block


def _in_turn(due: list[AidingSamples]) -> Iterator[AidingSamples]:
    """Streams as they are, but a receiver's epochs and messages in turn, as they arrived.

    An epoch must find the ephemerides that were there then, no later ones.
    """
    raw = [s for s in due if isinstance(s, RawGnssSamples | BroadcastSamples)]
    yield from (s for s in due if not isinstance(s, RawGnssSamples | BroadcastSamples))
    arrivals = sorted((int(seq), k) for k, s in enumerate(raw) for seq in s.seq.tolist())
    at = [0] * len(raw)
    for k, run in itertools.groupby(arrivals, key=lambda one: one[1]):
        count = len(list(run))
        yield raw[k].take(slice(at[k], at[k] + count))
        at[k] += count
