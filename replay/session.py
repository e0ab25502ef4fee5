"""One recording through the engine: what the commands, tests and benchmarks share.

recording → withheld windows → engine (:func:`replay.player.play`) → log and collected columns
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from companion import __version__
from companion.config import Config
from companion.estimation.gnss_latency import GnssLatencyEstimator
from companion.logbook import LogWriter
from companion.outputs.publisher import Publisher
from companion.types import (
    NO_SATELLITES,
    NS,
    AdaptationTrace,
    AidingReports,
    AnySamples,
    Event,
    Outputs,
    Recording,
    Satellites,
    Solution,
    VehicleRecording,
)
from replay.configuration import ChosenConfig
from replay.player import BLOCK_S, play
from replay.preparation import start_ns, withhold_gnss
from replay.publication import Publication
from replay.window import Window

PACED_S = 0.04
"""Longest wait between outputs of a paced replay: two epochs at the usual 50 Hz."""

Progress = Callable[[float], None]
"""Told how much of the recording is done, 0 to 1."""


@dataclass(frozen=True, slots=True)
class SessionResult:
    """What the engine made of one vehicle."""

    vehicle: VehicleRecording
    """As the engine saw it: fixes inside withheld windows are gone."""
    chosen: ChosenConfig
    solution: Solution
    """What was published, in order."""
    reports: AidingReports
    events: tuple[Event, ...]
    digest: str
    digest_published: str
    digest_smoothed: str | None
    """Of what was smoothed on line; None where nothing was."""
    cpu_s: float
    """CPU time of engine and log writing together [s]."""
    wall_s: float
    adaptation: AdaptationTrace = field(default_factory=AdaptationTrace.empty)
    satellites: Satellites = NO_SATELLITES


class _Collector:
    """Receives each engine step: keeps the outputs, logs, paces and reports progress."""

    def __init__(
        self,
        vehicle: VehicleRecording,
        config: Config,
        writer: LogWriter | None,
        speed: float | None,
        progress: Progress | None,
        publication: Publication | None,
    ) -> None:
        self.published: list[Solution] = []
        self.reports: list[AidingReports] = []
        self.adaptation: list[AdaptationTrace] = []
        self.satellites: list[Satellites] = []
        self.events: list[Event] = []
        self._latency = GnssLatencyEstimator(config)
        self._name = vehicle.name
        self._writer = writer
        self._speed = speed
        self._progress = progress
        self._publication = publication
        self._origin_ns = start_ns(vehicle)
        last = [int(s.t_ns[-1]) for s in (*vehicle.imu, *vehicle.gnss) if len(s)]
        self._span_ns = max(1, max(last) - self._origin_ns)
        self._begin = time.monotonic()

    def __call__(self, samples: AnySamples, outputs: Outputs) -> None:
        if len(samples):
            self._arrived(int(samples.t_rx_ns[-1]) - self._origin_ns)
        if self._publication is not None:
            self._publication.step(samples, outputs)
        if len(outputs.published):
            self.published.append(outputs.published)
        if len(outputs.reports):
            self.reports.append(outputs.reports)
        if len(outputs.adaptation):
            self.adaptation.append(outputs.adaptation)
        if len(outputs.satellites):
            self.satellites.append(outputs.satellites)
        self.events.extend(outputs.events)
        if self._writer is not None:
            self._writer.samples(samples, self._name)
            self._writer.outputs(outputs, self._name)
        self._latency.add(samples, outputs)
        for event in self._latency.events():
            self.events.append(event)
            if self._writer is not None:
                self._writer.event(event, self._name)

    def _arrived(self, elapsed_ns: int) -> None:
        if self._speed is not None:
            ahead = elapsed_ns / NS / self._speed - (time.monotonic() - self._begin)
            if ahead > 0:
                time.sleep(ahead)
        if self._progress is not None:
            self._progress(min(1.0, max(0.0, elapsed_ns / self._span_ns)))


def run_session(
    vehicle: VehicleRecording,
    chosen: ChosenConfig,
    *,
    writer: LogWriter | None = None,
    outages: Sequence[Window] = (),
    speed: float | None = None,
    progress: Progress | None = None,
    publisher: Publisher | None = None,
) -> SessionResult:
    """Run one vehicle's recording through the engine.

    ``outages`` are windows without GNSS; ``speed`` is a factor on real time, None for as fast as
    it goes: the solution does not depend on it. ``publisher`` gets everything as from a live run.
    Errors of the log's disk come from ``writer``.
    """
    flown = withhold_gnss(vehicle, outages)
    publication = None
    if publisher is not None:
        publication = Publication(publisher, flown.name, chosen.config, start_ns(flown))
    collector = _Collector(flown, chosen.config, writer, speed, progress, publication)
    wall, cpu = time.monotonic(), time.process_time()
    if writer is not None:
        writer.describe(flown)
    block_s = BLOCK_S if speed is None else min(BLOCK_S, PACED_S * speed)
    engine = play(flown, chosen.config, collector, block_s)
    if writer is not None:
        if flown.truth is not None:
            writer.reference(flown.truth, flown.name, "truth")
        if flown.autopilot is not None:
            writer.reference(flown.autopilot, flown.name, "autopilot")
    return SessionResult(
        vehicle=flown,
        chosen=chosen,
        solution=Solution.concatenate(collector.published),
        reports=AidingReports.concatenate(collector.reports),
        events=tuple(collector.events),
        digest=engine.digest,
        digest_published=engine.digest_published,
        digest_smoothed=engine.digest_smoothed,
        cpu_s=time.process_time() - cpu,
        wall_s=time.monotonic() - wall,
        adaptation=AdaptationTrace.concatenate(collector.adaptation),
        satellites=Satellites.concatenate(collector.satellites),
    )


@contextmanager
def run_log(
    path: Path, recording: Recording, chosen: ChosenConfig, outages: Sequence[Window] = ()
) -> Iterator[LogWriter]:
    """A run log to hand to :func:`run_session`; what was written is kept when a run fails."""
    metadata = {
        "companion_version": __version__,
        "source": recording.path,
        "source_format": recording.format,
        "config_origin": chosen.origin,
        "outages": " ".join(map(str, outages)),
    }
    with LogWriter(path, config_toml=chosen.toml, metadata=metadata) as writer:
        yield writer


def closing_summary(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What a run log is closed with: digests, counters and errors of each vehicle."""
    kept = ("digest", "digest_published", "start", "gates", "accuracy")
    return {"vehicles": {run["vehicle"]: {key: run[key] for key in kept} for run in runs}}
