"""A live run from its configuration to its summary."""

from __future__ import annotations

import gc
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from companion import __version__
from companion.logbook import LogWriter
from companion.outputs.publisher import Publisher
from companion.runtime.background import BackgroundFile
from companion.runtime.clock import RunClock
from companion.runtime.core import Core
from companion.runtime.drivers import can_decoders, mavlink_session
from companion.runtime.feeds import make_feeds
from companion.runtime.keeper import Keeper
from companion.runtime.links import CanLink
from companion.runtime.loop import Loop, Parts, Stop
from companion.runtime.start import Start
from companion.runtime.systemd import Notifier
from companion.selection import Kind
from companion.types import (
    NS,
    Event,
)
from drivers.mavlink import samples as mavlink_samples
from drivers.mavlink.link import ReopeningLink
from drivers.receiver_session import receiver_session

PREFERRED: dict[Kind, Sequence[str]] = {
    "imu": mavlink_samples.IMU,
    "gnss": mavlink_samples.GNSS,
    "baro": mavlink_samples.BARO,
    "mag": mavlink_samples.MAG,
}
"""Streams of an autopilot, best first."""
LOG_HOLD_S, LOG_CHUNK_S = 0.05, 1.0
"""Rows wait this long for their batch, batches for their chunk. Encoding costs 10 µs a row: half a
millisecond at a time at 1 kHz, where a second's worth would be a pause of ten."""


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
    clock = RunClock()
    parts, core, loop, writer = _assembled(
        start, directory, clock, publishers, Stop() if stop is None else stop
    )
    begun, cpu_s = clock.read(), time.process_time()
    keeper = Keeper(start.state, start.saved)
    try:
        with parts.stop.on_signals(), writer:
            _open(parts, core, start, begun.run)
            # Everything that lives for the whole run is never looked at by the collector again.
            # What else the start left is hardly worth the tenth of a second to look for it.
            gc.freeze()
            gc.enable()
            loop.run(core, seconds, lambda: keeper.keep(core))
            parts.notifier.stopping()
            closing = core.finish()
            writer.close({"vehicles": {core.vehicle: closing}})
            keeper.keep(core, last=True)
    finally:
        gc.unfreeze()
        _close(parts)
    duration_s = (clock.read().monotonic - begun.monotonic) / NS
    summary = _summary(core, loop, parts.log, closing)
    load = (time.process_time() - cpu_s) / max(duration_s, 1e-9)
    return {**summary, "duration_s": duration_s, "load": load, "log": str(start.log)}


def _assembled(
    start: Start, directory: Path, clock: RunClock, publishers: Sequence[Publisher], stop: Stop
) -> tuple[Parts, Core, Loop, LogWriter]:
    """Everything made and connected, nothing opened but the log."""
    config = start.config
    raw_gnss = config.raw_gnss
    now_ns = clock.read().run
    session = None
    if config.mavlink.endpoint:
        known = start.saved.autopilot if start.saved is not None else None
        session = mavlink_session(config.mavlink, directory, known)
    decoders = {bus.channel: can_decoders(bus, directory) for bus in config.can}
    feeds = make_feeds(config, directory, session, now_ns)
    sink = BackgroundFile(start.log)
    writer = LogWriter(
        start.log,
        config_toml=start.toml,
        metadata={"companion_version": __version__, "source": "live"},
        hold_s=LOG_HOLD_S,
        chunk_s=LOG_CHUNK_S,
        sink=sink,
    )
    parts = Parts(
        clock=clock,
        buses=[CanLink(bus) for bus in config.can],
        autopilot=ReopeningLink(config.mavlink.endpoint, config.mavlink.baud) if session else None,
        session=session,
        receiver=ReopeningLink(raw_gnss.endpoint, raw_gnss.baud) if raw_gnss.endpoint else None,
        publishers=[*publishers, *feeds.publishers],
        ground=feeds.ground,
        log=sink,
        notifier=Notifier(),
        stop=stop,
    )
    loop = Loop(parts, config.live.tick_hz)
    core = Core(
        config,
        writer,
        start_ns=now_ns,
        decoders=decoders,
        session=session,
        receiver=receiver_session(raw_gnss.protocol) if raw_gnss.endpoint else None,
        preferred=PREFERRED,
        known=start.known,
        publish=loop.publish,
        announce=loop.announce,
        stopwatch=time.perf_counter_ns,
    )
    return parts, core, loop, writer


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
    if parts.receiver is not None:
        parts.receiver.close()
    for publisher in parts.publishers:
        publisher.close()
    if parts.ground is not None:
        parts.ground.close()
    parts.log.close()
    parts.notifier.close()


def _summary(
    core: Core, loop: Loop, sink: BackgroundFile, closing: dict[str, Any]
) -> dict[str, Any]:
    p50, p99, worst = loop.latencies.of_run_ms()
    log = sink.health()
    return {
        "vehicle": core.vehicle,
        "mode": core.mode.name.lower(),
        "inputs": closing["inputs"],
        "latency_ms": {"p50": p50, "p99": p99, "max": worst},
        "stall_ms": loop.longest_stall_ns / 1e6,
        "log_bytes": log.written_bytes,
        "log_dropped_bytes": log.dropped_bytes,
        "digest": closing["digest"],
        "digest_published": closing["digest_published"],
        "counters": closing["counters"],
    }
