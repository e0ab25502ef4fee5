"""Live runs on simulated time: arrivals of a simulated flight through the runtime's core."""

from __future__ import annotations

import heapq
import pickle
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from companion.config import CanBus, CanImu, Config, parse, to_toml
from companion.logbook import LogWriter
from companion.runtime.clock import Reading
from companion.runtime.core import CanArrival, Core
from companion.types import (
    NS,
    AnySamples,
    Event,
    ImuSamples,
    LinkState,
    Outputs,
    ReferenceSamples,
    VehicleRecording,
)
from drivers.can_imu import make_decoder, make_encoder
from replay.simulator import load_scenario, matching_config, simulate

PREFERRED = {"imu": ("HIGHRES_IMU", "RAW_IMU"), "gnss": ("GPS_RAW_INT", "GPS2_RAW")}
SECONDS = 12.0
TICK_NS = NS // 10


@dataclass(slots=True)
class FakeCounters:
    frames: int = 0
    bad_crc: int = 0


class FakeSession:
    """Stands in for the MAVLink driver: a piece of bytes is a pickled list of samples."""

    height_datum: Literal["hae", "msl"] | None = "msl"
    signing_counters = None

    def __init__(self) -> None:
        self.counters = FakeCounters()
        self._samples: list[AnySamples] = []

    def feed(self, seq: int, t_rx_ns: int, data: bytes) -> None:
        self.counters.frames += 1
        for block in pickle.loads(data):
            n = len(block)
            self._samples.append(
                replace(block, seq=np.full(n, seq), t_rx_ns=np.full(n, t_rx_ns, np.int64))
            )

    def tick(self, now_ns: int) -> None:
        pass

    @property
    def vehicle(self) -> tuple[int, int] | None:
        return None

    def take(self) -> list[AnySamples]:
        out, self._samples = self._samples, []
        return sorted(out, key=lambda s: isinstance(s, ImuSamples))

    def references(self) -> list[ReferenceSamples]:
        return []

    def events(self) -> list[Event]:
        return []


@dataclass(frozen=True, slots=True)
class Piece:
    """A chunk on the MAVLink link."""

    t_ns: int
    samples: tuple[AnySamples, ...]


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame on bus ``can0``."""

    t_ns: int
    can_id: int
    data: bytes


@dataclass(frozen=True, slots=True)
class LinkChange:
    t_ns: int
    name: str
    state: LinkState


Arrival = Piece | Frame | LinkChange


def vehicle(name: str = "multirotor-mission", seed: int = 3) -> tuple[VehicleRecording, Config]:
    """The first seconds of a simulated flight, and the configuration that fits."""
    scenario = load_scenario(name)
    flown = simulate(scenario, seed)
    start = int(flown.imu[0].t_ns[0])
    end = start + round(SECONDS * NS)

    def cut(streams: Iterable[Any]) -> tuple[Any, ...]:
        return tuple(s.take(s.t_ns < end) for s in streams)

    flown = replace(
        flown,
        imu=cut(flown.imu),
        gnss=cut(flown.gnss),
        baro=cut(flown.baro),
        mag=cut(flown.mag),
        truth=None,
        autopilot=None,
    )
    return flown, matching_config(scenario)


def with_can(config: Config, *names: str) -> Config:
    """``config`` with DroneCAN units on one bus, node ids 50, 51, …"""
    units = tuple(
        CanImu(name=name, protocol="dronecan", node_id=50 + i) for i, name in enumerate(names)
    )
    bus = CanBus(channel="test", interface="virtual", imu=units)
    return msgspec.structs.replace(config, can=(bus,))


def can_frames(imu: ImuSamples, node_id: int = 50) -> list[Frame]:
    """Frames of an inertial stream, 0.1 ms apart from its arrivals on."""
    every = np.full(len(imu), 1.0 / 200.0)
    encoder = make_encoder("dronecan", node_id=node_id)
    frames = encoder.encode(replace(imu, interval_s=every))
    each = len(frames) // len(imu)
    return [
        Frame(int(imu.t_rx_ns[i // each]) + (i % each) * 100_000, f.can_id, f.data)
        for i, f in enumerate(frames)
    ]


def pieces(stream: AnySamples, delay: Callable[[int], int] = lambda _: 0) -> list[Piece]:
    """One datagram a sample; ``delay`` [ns] by its row."""
    return [
        Piece(int(stream.t_rx_ns[i]) + delay(i), (stream.take(slice(i, i + 1)),))
        for i in range(len(stream))
    ]


@dataclass(slots=True)
class Flown:
    """What a live run left."""

    path: Path
    digest: str
    digest_published: str
    summary: dict[str, Any]
    core: Core
    events: list[Event] = field(default_factory=list)
    outputs: list[Outputs] = field(default_factory=list)

    def kinds(self) -> list[str]:
        return [e.kind for e in self.events]


def fly(
    arrivals: Iterable[Arrival],
    config: Config,
    path: Path,
    *,
    close: bool = True,
    stopwatch: Callable[[], int] = lambda: 0,
) -> Flown:
    """Put arrivals, in order of their time, and ticks through a core with a log."""
    toml = to_toml(config)
    effective = parse(toml)
    ordered = list(heapq.merge(sorted(arrivals, key=lambda a: a.t_ns), key=lambda a: a.t_ns))
    start = ordered[0].t_ns
    events: list[Event] = []
    outputs: list[Outputs] = []
    writer = LogWriter(path, config_toml=toml, metadata={})
    decoders = {
        "can0": [
            make_decoder(unit.name, unit.protocol, node_id=unit.node_id)
            for bus in effective.can
            for unit in bus.imu
        ]
    }
    core = Core(
        effective,
        writer,
        start_ns=start,
        decoders=decoders,
        session=FakeSession(),
        preferred=PREFERRED,
        publish=outputs.append,
        announce=events.append,
        stopwatch=stopwatch,
    )
    for item in _with_ticks(ordered, start):
        _arrive(core, item)
    summary: dict[str, Any] = {}
    if close:
        summary = core.finish()
        writer.close({"vehicles": {core.vehicle: summary}})
    else:
        writer.flush()  # what a killed process has handed over
    engine = core.engine
    return Flown(path, engine.digest, engine.digest_published, summary, core, events, outputs)


def _with_ticks(ordered: list[Arrival], start: int) -> Iterator[Arrival | int]:
    due = start + TICK_NS
    for item in ordered:
        while due <= item.t_ns:
            yield due
            due += TICK_NS
        yield item


def _arrive(core: Core, item: Arrival | int) -> None:
    if isinstance(item, int):
        core.tick(Reading(item, item - 10**18, item))
    elif isinstance(item, Piece):
        core.mavlink(item.t_ns, pickle.dumps(item.samples))
    elif isinstance(item, Frame):
        core.can("can0", [CanArrival(item.t_ns, item.can_id, True, item.data)])
    else:
        core.link(item.name, item.state, "gone" if item.state != "up" else "", item.t_ns)
