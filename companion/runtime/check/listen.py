"""Opens what a configuration names, listens for a while, and closes it again."""

from __future__ import annotations

import os
import selectors
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from companion.config import CanBus, Config, Zenoh
from companion.runtime.check.heard import (
    CanHeard,
    Heard,
    MavlinkHeard,
    OutputHeard,
    RateHeard,
)
from companion.runtime.check.receiver import ReceiverTally
from companion.runtime.check.tally import MavlinkTally, SampleTally
from companion.runtime.drivers import can_decoders, mavlink_session
from companion.types import CompanionError, ConfigError, LinkLost
from drivers.can_imu import CanTransport, open_can
from drivers.can_imu.decoder import CanImuDecoder
from drivers.mavlink.endpoint import Endpoint, open_endpoint
from drivers.mavlink.session import wishes

TICK_S = 0.1
SETTLE_S = 3.0
"""Requests go out one after the other; the rates that came of them count from then on."""
LOG_BYTES_PER_HOUR = 0.25e9
"""A 1 kHz IMU with raw frames."""


@dataclass(slots=True)
class _Bus:
    """A bus while it is listened to."""

    settings: CanBus
    decoders: list[CanImuDecoder]
    transport: CanTransport | None = None
    refused: str = ""
    frames: int = 0
    malformed: int = 0
    ids: Counter[tuple[int, bool]] = field(default_factory=Counter)

    @property
    def name(self) -> str:
        return f"{self.settings.interface}:{self.settings.channel}"


def listen(
    config: Config, directory: Path, seconds: float, progress: Callable[[float], None]
) -> Heard:
    """Everything that is heard in ``seconds``; links that do not open are part of it.

    ``directory`` is the configuration's own. Raises :class:`~companion.types.ConfigError` for what
    no link could make work: a DBC file or a key that is not there.
    """
    return _Listener(config, directory).listen(seconds, progress)


class _Listener:
    """One check of one configuration."""

    def __init__(self, config: Config, directory: Path) -> None:
        self._config = config
        self._buses = [_Bus(bus, can_decoders(bus, directory)) for bus in config.can]
        mavlink = config.mavlink
        self._session = mavlink_session(mavlink, directory) if mavlink.endpoint else None
        self._endpoint: Endpoint | None = None
        self._mavlink_refused = ""
        self._receiver = ReceiverTally(config.raw_gnss) if config.raw_gnss.endpoint else None
        self._receiver_line: Endpoint | None = None
        self._receiver_refused = ""
        self._samples = SampleTally()
        self._traffic = MavlinkTally()
        self._seq = 0
        self._settled_s = 0.0
        self._selector = selectors.DefaultSelector()

    def listen(self, seconds: float, progress: Callable[[float], None]) -> Heard:
        try:
            self._open()
            zenoh = _zenoh(self._config.zenoh)
            self._loop(seconds, progress)
            return self._heard(seconds, zenoh)
        finally:
            self._close()

    # ------------------------------------------------------------------ links

    def _open(self) -> None:
        for bus in self._buses:
            settings = bus.settings
            try:
                bus.transport = open_can(
                    settings.interface, settings.channel, settings.bitrate, settings.options
                )
            except CompanionError as error:
                bus.refused = _reason(error, bus.name)
                continue
            self._watch(bus.transport.fileno(), partial(self._read_bus, bus))
        if self._session is not None:
            mavlink = self._config.mavlink
            try:
                self._endpoint = open_endpoint(mavlink.endpoint, mavlink.baud)
                self._watch(self._endpoint.fileno(), self._read_mavlink)
            except CompanionError as error:
                self._mavlink_refused = _reason(error, mavlink.endpoint)
        if self._receiver is not None:
            raw_gnss = self._config.raw_gnss
            try:
                self._receiver_line = open_endpoint(raw_gnss.endpoint, raw_gnss.baud)
                self._watch(self._receiver_line.fileno(), self._read_receiver)
            except CompanionError as error:
                self._receiver_refused = _reason(error, raw_gnss.endpoint)

    def _watch(self, fileno: int, read: Callable[[], None]) -> None:
        self._selector.register(fileno, selectors.EVENT_READ, read)

    def _close(self) -> None:
        self._selector.close()
        for bus in self._buses:
            if bus.transport is not None:
                bus.transport.close()
        for endpoint in (self._endpoint, self._receiver_line):
            if endpoint is not None:
                endpoint.close()

    # ------------------------------------------------------------------ time

    def _loop(self, seconds: float, progress: Callable[[float], None]) -> None:
        begin = tick = time.monotonic()
        settle = min(SETTLE_S, seconds / 2)
        while (now := time.monotonic()) < begin + seconds:
            if now >= tick:
                tick = now + TICK_S
                if not self._settled_s and now - begin >= settle:
                    self._settled_s = now - begin
                    self._traffic.mark()
                progress((now - begin) / seconds)
                self._tick()
            for key, _ in self._selector.select(max(tick - now, 0.0)):
                key.data()

    def _tick(self) -> None:
        if self._session is None or self._endpoint is None:
            return
        self._session.tick(time.time_ns())
        for frame in self._session.outgoing():
            self._endpoint.write(frame)

    # ------------------------------------------------------------------ arrivals

    def _read_bus(self, bus: _Bus) -> None:
        assert bus.transport is not None
        try:
            frames = bus.transport.receive()
        except LinkLost as error:
            self._selector.unregister(bus.transport.fileno())
            bus.refused = _reason(error, bus.name)
            return
        now = time.time_ns()
        bus.frames += len(frames)
        bus.malformed = bus.transport.malformed
        for frame in frames:
            bus.ids[frame.can_id, frame.extended] += 1
            self._seq += 1
            for decoder in bus.decoders:
                if decoder.feed(self._seq, now, frame.can_id, frame.extended, frame.data):
                    break
        for decoder in bus.decoders:
            samples = decoder.take()
            if samples is not None:
                self._samples.add(bus.name, samples)

    def _read_mavlink(self) -> None:
        assert self._endpoint is not None
        assert self._session is not None
        try:
            pieces = self._endpoint.read()
        except LinkLost as error:
            self._selector.unregister(self._endpoint.fileno())
            self._mavlink_refused = _reason(error, self._config.mavlink.endpoint)
            return
        now = time.time_ns()
        for data in pieces:
            self._seq += 1
            self._traffic.feed(data)
            self._session.feed(self._seq, now, data)
        for samples in self._session.take():
            self._samples.add(self._endpoint.name, samples)

    def _read_receiver(self) -> None:
        assert self._receiver is not None
        assert self._receiver_line is not None
        try:
            pieces = self._receiver_line.read()
        except LinkLost as error:
            self._selector.unregister(self._receiver_line.fileno())
            self._receiver_refused = _reason(error, self._config.raw_gnss.endpoint)
            return
        now = time.time_ns()
        for data in pieces:
            self._seq += 1
            for fix in self._receiver.feed(self._seq, now, data):
                self._samples.add(self._receiver_line.name, fix)

    # ------------------------------------------------------------------ what came of it

    def _heard(self, seconds: float, zenoh: OutputHeard | None) -> Heard:
        counters = {d.source: d.counters for bus in self._buses for d in bus.decoders}
        buses = tuple(
            CanHeard(
                bus.name,
                bus.refused,
                bus.frames,
                bus.malformed,
                {key: n / seconds for key, n in sorted(bus.ids.items())},
            )
            for bus in self._buses
        )
        return Heard(
            seconds=seconds,
            buses=buses,
            mavlink=self._mavlink_heard(seconds),
            imus=self._samples.imus(np.array(self._config.imu.axes), counters),
            streams=self._samples.streams(),
            zenoh=zenoh,
            log=log_directory(Path(self._config.log.directory)),
            receiver=self._receiver.heard(self._receiver_refused) if self._receiver else None,
        )

    def _mavlink_heard(self, seconds: float) -> MavlinkHeard | None:
        if self._session is None:
            return None
        status = self._session.status(time.time_ns())
        signing = status.signing
        asked = wishes(self._session.settings)
        needed = {message for wish in asked if wish.needed for message in wish.messages}
        later = self._traffic.since_mark(status.vehicle)
        counted_s = seconds - self._settled_s
        return MavlinkHeard(
            name=self._config.mavlink.endpoint,
            refused=self._mavlink_refused,
            bytes=self._traffic.bytes,
            bad_bytes=self._traffic.bad_bytes,
            systems=self._traffic.systems(seconds),
            vehicle=status.vehicle,
            rates=tuple(
                RateHeard(
                    r.message,
                    r.asked_hz,
                    r.granted,
                    later[r.message] / counted_s,
                    r.message in needed,
                )
                for r in status.rates
            ),
            clock=status.clock,
            round_trip_ms=status.round_trip_ms,
            unsigned=0 if signing is None else signing.unsigned + signing.bad_signature,
        )


def _reason(error: CompanionError, name: str) -> str:
    """What went wrong, without the name that stands beside it."""
    return str(error).removeprefix(f"{name}: ").removeprefix("endpoint ")


def _zenoh(settings: Zenoh) -> OutputHeard | None:
    """Whether the session opens as the publisher would open it; None where it is off."""
    if not settings.enabled:
        return None
    import zenoh

    from companion.outputs.zenoh_settings import complaint, session_settings

    where = settings.config_file or ", ".join((*settings.listen, *settings.connect))
    name = f"zenoh {where}"
    try:
        with zenoh.open(session_settings(settings)):
            return OutputHeard(name, note="opens")
    except ConfigError as error:
        return OutputHeard(name, str(error), "see the keys of [zenoh]")
    except zenoh.ZError as error:
        advice = "another program (a companion that runs?) has the port; zenoh.listen"
        return OutputHeard(name, complaint(error), advice)


def log_directory(directory: Path) -> OutputHeard:
    """Whether a run log can be written there, and how much of it."""
    name = f"log in {directory}"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory) as file:
            file.write(b"companion")
            os.fsync(file.fileno())
        free = shutil.disk_usage(directory).free
    except OSError as error:
        advice = "log.directory: another place, free space, permissions"
        return OutputHeard(name, f"cannot be written: {error.strerror}", advice)
    hours = free / LOG_BYTES_PER_HOUR
    if hours < 1.0:
        text = f"room for {60 * hours:.0f} minutes only ({free / 1e6:.0f} MB free)"
        return OutputHeard(name, text, "delete old runs, or another log.directory")
    return OutputHeard(name, note=f"room for {hours:.0f} hours")
