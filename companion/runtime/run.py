"""A live run from its configuration to its summary."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from companion import __version__
from companion.config import Config, parse, to_toml
from companion.engine import Engine
from companion.logbook import LogWriter
from companion.outputs.publisher import Publisher
from companion.runtime import saved_state
from companion.runtime.background import BackgroundFile
from companion.runtime.clock import RunClock
from companion.runtime.core import Core
from companion.runtime.drivers import can_decoders, mavlink_session
from companion.runtime.links import CanLink
from companion.runtime.loop import Loop, Parts, Stop
from companion.runtime.systemd import Notifier
from companion.selection import Kind
from companion.types import (
    NS,
    BaroSamples,
    CompanionError,
    ConfigError,
    Event,
    GnssSamples,
    ImuSamples,
)
from drivers.mavlink import samples as mavlink_samples
from drivers.mavlink.link import ReopeningLink

PREFERRED: dict[Kind, Sequence[str]] = {
    "imu": mavlink_samples.IMU,
    "gnss": mavlink_samples.GNSS,
    "baro": mavlink_samples.BARO,
    "mag": mavlink_samples.MAG,
}
"""Streams of an autopilot, best first."""
LOG_HOLD_S = 0.25
"""Rows wait this long for their batch: short pauses in the loop rather than few long ones."""


@dataclass(frozen=True, slots=True)
class Start:
    """What a run begins with."""

    config: Config
    """Effective: with biases of an earlier run, where there are any. The log keeps it."""
    toml: str
    notes: tuple[str, ...]
    """What was found on the way, for people and as events."""
    log: Path
    state: Path


def prepare(config: Config, log: Path | None) -> Start:
    """Settle configuration and files of a run.

    Raises :class:`ConfigError` for a configuration with nothing to listen to, and
    :class:`CompanionError` where the log's directory cannot be made.
    """
    if not config.mavlink.endpoint and not any(bus.imu for bus in config.can):
        raise ConfigError("nothing to listen to: give [[can]] with an imu, or mavlink.endpoint")
    channels = [bus.channel for bus in config.can]
    if len(set(channels)) != len(channels):
        raise ConfigError("key 'can': two buses have the same channel")
    vehicle = "".join(c if c.isalnum() or c in "-_." else "_" for c in config.vehicle.name)
    directory = Path(config.log.directory)
    if log is None:
        log = directory / f"{vehicle}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.mcap"
    state_file = config.log.state_file
    state = Path(state_file) if state_file else directory / f"{vehicle}.state.toml"
    for folder in (log.parent, state.parent):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CompanionError(f"{folder}: {error.strerror or error}") from None
    notes: list[str] = []
    if config.live.warm_start:
        config = _warmed(config, state, notes)
    # What a replay will read: not one bit of the configuration may be lost in spelling.
    toml = to_toml(config)
    return Start(parse(toml), toml, tuple(notes), log, state)


def known_imu(config: Config) -> str:
    """The inertial unit that the configuration settles; empty where the autopilot decides.

    An autopilot calibrates its gyros anew at each start, so what an earlier run knew of them is
    worth nothing; a unit of our own is the same one again.
    """
    if config.imu.source != "auto":
        return config.imu.source
    return next((unit.name for bus in config.can for unit in bus.imu), "")


def _warmed(config: Config, state: Path, notes: list[str]) -> Config:
    source = known_imu(config)
    if not source:
        return config
    try:
        saved = saved_state.read(state)
        if saved is None:
            return config
        config = saved_state.warmed(config, source, saved, time.time_ns())
    except saved_state.StateError as error:
        notes.append(f"cold start: {error}")
        return config
    age_s = max(0, time.time_ns() - saved.saved_ns) / NS
    notes.append(f"warm start: biases of '{source}' as they were {age_s:.0f} s ago")
    return config


def warm_up(config: Config) -> None:
    """Run everything that a sample goes through once, so that none in flight is the first."""
    engine = Engine(config)
    n = 300
    t = NS * 1_700_000_000 + np.arange(n) * (NS // 100)
    still = np.tile([0.0, 0.0, -9.80665], (n, 1))
    at_rest = ImuSamples("imu", t, t, np.arange(n), np.zeros((n, 3)), still, np.full(n, np.nan))
    for i in range(n):
        one = slice(i, i + 1)
        engine.step(at_rest.take(one))
        if i % 20 == 0:
            late = t[one] - NS // 10
            three = np.full((1, 3), 1.0)
            place = np.array([0.8]), np.array([0.2]), np.array([100.0])
            sky = np.array([12]), np.array([3])
            fix = GnssSamples("gnss", late, t[one], t[one], *place, 0 * three, three, three, *sky)
            engine.step(fix)
            engine.step(BaroSamples("baro", t[one], t[one], t[one], np.array([1e5])))
    engine.finish()


def run(
    start: Start,
    directory: Path,
    *,
    seconds: float | None = None,
    publishers: Sequence[Publisher] = (),
    stop: Stop | None = None,
) -> dict[str, Any]:
    """Run until a signal, or for ``seconds``; the summary that ``companion run --json`` prints.

    ``directory``: what paths in the configuration are relative to. ``publishers`` are closed at the
    end. Raises :class:`CompanionError` where the run cannot begin.
    """
    config = start.config
    clock = RunClock()
    stop = Stop() if stop is None else stop
    session = mavlink_session(config.mavlink, directory) if config.mavlink.endpoint else None
    decoders = {bus.channel: can_decoders(bus, directory) for bus in config.can}
    sink = BackgroundFile(start.log)
    writer = LogWriter(
        start.log,
        config_toml=start.toml,
        metadata={"companion_version": __version__, "source": "live"},
        hold_s=LOG_HOLD_S,
        sink=sink,
    )
    notifier = Notifier()
    keeper = _Keeper(start.state)
    parts = Parts(
        clock=clock,
        buses=[CanLink(bus) for bus in config.can],
        autopilot=ReopeningLink(config.mavlink.endpoint, config.mavlink.baud) if session else None,
        session=session,
        publishers=publishers,
        log=sink,
        notifier=notifier,
        stop=stop,
        save=lambda: keeper.keep(core),
    )
    loop = Loop(parts, config.live.tick_hz)
    begun = clock.read()
    core = Core(
        config,
        writer,
        start_ns=begun.run,
        decoders=decoders,
        session=session,
        preferred=PREFERRED,
        publish=loop.publish,
        announce=loop.announce,
    )
    cpu_s = time.process_time()
    try:
        with stop.on_signals():
            _open(parts, core, start, begun.run)
            # Everything that lives for the whole run is never looked at by the collector again.
            gc.collect()
            gc.freeze()
            loop.run(core, seconds)
            notifier.stopping()
            summary = core.finish()
            writer.close({"vehicles": {core.vehicle: summary}})
            keeper.keep(core)
            keeper.wait()
    finally:
        gc.unfreeze()
        _close(parts)
    end = clock.read()
    duration_s = (end.monotonic - begun.monotonic) / NS
    return _summary(core, loop, sink, start, summary, duration_s, time.process_time() - cpu_s)


def _open(parts: Parts, core: Core, start: Start, now_ns: int) -> None:
    """Open every link once, and say how the run begins."""
    for note in start.notes:
        core.event(Event(now_ns, note.split(":")[0].replace(" ", "-"), note))
    for bus in parts.buses:
        bus.open_first(now_ns)
    for publisher in parts.publishers:
        publisher.config(start.toml)


def _close(parts: Parts) -> None:
    for bus in parts.buses:
        bus.close()
    if parts.autopilot is not None:
        parts.autopilot.close()
    for publisher in parts.publishers:
        publisher.close()
    parts.log.close()
    parts.notifier.close()


class _Keeper:
    """Writes the state file in a thread: a disk that is slow must not hold up the loop."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._thread: threading.Thread | None = None
        self._trouble = ""
        self._said = False

    def keep(self, core: Core) -> None:
        """Keep what the run has learned, if it has learned anything."""
        if self._trouble and not self._said:
            self._said = True
            core.event(Event(core.now_ns, "state-not-kept", self._trouble, "warning"))
        source = known_imu(core.config)
        biases = saved_state.learned(core.config, source, core.last) if source else None
        if biases is None or (self._thread is not None and self._thread.is_alive()):
            return
        self._thread = threading.Thread(target=self._write, args=(biases,), daemon=True)
        self._thread.start()

    def wait(self) -> None:
        """Let a write finish, for a few seconds."""
        if self._thread is not None:
            self._thread.join(5.0)

    def _write(self, biases: saved_state.SavedBiases) -> None:
        try:
            saved_state.save(self._path, biases)
        except saved_state.StateError as error:
            self._trouble = str(error)


def _summary(
    core: Core,
    loop: Loop,
    sink: BackgroundFile,
    start: Start,
    closing: dict[str, Any],
    duration_s: float,
    cpu_s: float,
) -> dict[str, Any]:
    p50, p99, worst = loop.latencies.of_run_ms()
    log = sink.health()
    return {
        "vehicle": core.vehicle,
        "duration_s": duration_s,
        "mode": core.mode.name.lower(),
        "inputs": closing["inputs"],
        "latency_ms": {"p50": p50, "p99": p99, "max": worst},
        "stall_ms": loop.longest_stall_ns / 1e6,
        "load": cpu_s / duration_s if duration_s > 0 else 0.0,
        "log": str(start.log),
        "log_bytes": log.written_bytes,
        "log_dropped_bytes": log.dropped_bytes,
        "digest": closing["digest"],
        "digest_published": closing["digest_published"],
        "counters": closing["counters"],
    }
