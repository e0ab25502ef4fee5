"""The simulated vehicle as a process: real time, standard input and output, the end."""

from __future__ import annotations

import json
import os
import select
import signal
import sys
import time
from pathlib import Path
from typing import Any

import msgspec

from companion.gnss.systems import GPS
from companion.types import NS, CompanionError, ImuSamples, VehicleRecording
from replay.sensor_folder_writer import write_truth
from replay.simulator.live.autopilot import BootClock, SimulatedAutopilot
from replay.simulator.live.can_unit import Encoder, SimulatedCanImu
from replay.simulator.live.faults import parse_order
from replay.simulator.live.links import Plug, UdpLink
from replay.simulator.live.receiver import Protocol, SimulatedReceiver, TcpServer
from replay.simulator.live.vehicle import CAN_SOURCE, LiveVehicle, moved
from replay.simulator.raw_gnss import with_raw_gnss
from replay.simulator.scenarios import Scenario
from replay.simulator.simulation import run as simulated

_BOOTED_BEFORE_NS = 20 * NS
"""The autopilot has been on for this long when the flight begins."""
UART_BYTES = 1024
"""A receiver has no memory for what nobody reads."""
_PATIENCE_S = 0.5
"""Longest wait: the control stream's end must be noticed."""


class Options(msgspec.Struct, frozen=True, kw_only=True):
    """How a vehicle is started."""

    scenario: Scenario
    seed: int = 1
    mavlink: str = "udpin:127.0.0.1:0"
    can: Path | None = None
    """Where the adapter's device appears; None: no CAN bus, the autopilot's IMU only."""
    protocol: str = "dronecan"
    encoder_options: dict[str, Any] = {}
    drift_ppm: float = 20.0
    """Of the autopilot's crystal."""
    receiver: str = ""
    """Of raw GNSS: ``tcp``, or the path at which a serial device appears; empty: none."""
    receiver_protocol: Protocol = "ublox"
    truth: Path | None = None
    """Where the true flight is written, on this machine's clock."""


def _encoder(options: Options) -> Encoder:
    from drivers.can_imu import make_encoder

    return make_encoder(options.protocol, **options.encoder_options).encode


def _unit(options: Options, recording: VehicleRecording) -> SimulatedCanImu | None:
    if options.can is None:
        return None
    for imu in recording.imu:
        if imu.source == CAN_SOURCE:
            return SimulatedCanImu(imu, _encoder(options), options.seed)
    raise CompanionError(f"scenario {recording.name}: no IMU with source '{CAN_SOURCE}'")


def _warm(encode: Encoder, samples: ImuSamples) -> None:
    """The first call imports and compiles; that must not be in flight."""
    encode(samples.take(slice(0, 1)))


class _Clock:
    """The run's clock: UTC at the start, then as the monotonic clock goes."""

    def __init__(self) -> None:
        self.start_unix_ns, self.start_monotonic_ns = time.time_ns(), time.monotonic_ns()

    def now(self) -> int:
        return self.start_unix_ns + time.monotonic_ns() - self.start_monotonic_ns


def _say(**what: Any) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def run(options: Options) -> None:
    """Fly the scenario in real time; ends with the flight, the control stream, or a signal.

    Says ``{"ready": …}`` with its links and clock, answers orders, and closes with its counts.
    """
    simulation = simulated(options.scenario, options.seed)
    recording = simulation.recording
    sky = with_raw_gnss(simulation, options.seed, systems=(GPS,)).sky if options.receiver else None
    if options.can is not None:
        for imu in recording.imu:
            _warm(_encoder(options), imu)
    stop = _stop_on_signal()
    clock = _Clock()
    shift_ns = clock.start_unix_ns - options.scenario.start_unix_s * NS
    recording = moved(recording, shift_ns)
    if options.truth is not None and recording.truth is not None:
        write_truth(recording.truth, options.truth)
    boot = BootClock(clock.start_unix_ns - _BOOTED_BEFORE_NS, options.drift_ppm)
    link = UdpLink(options.mavlink)
    plug = None if options.can is None else Plug(options.can)
    receiver = None if sky is None else SimulatedReceiver(sky, shift_ns, options.receiver_protocol)
    line = _line(options.receiver)
    try:
        vehicle = LiveVehicle(
            SimulatedAutopilot(recording, boot),
            link,
            _unit(options, recording),
            plug,
            options.seed,
            receiver,
            line,
        )
        _say(
            ready=True,
            mavlink=link.endpoint,
            can=None if options.can is None else str(options.can),
            receiver=line.endpoint if isinstance(line, TcpServer) else options.receiver,
            start_unix_ns=clock.start_unix_ns,
            start_monotonic_ns=clock.start_monotonic_ns,
        )
        _fly(vehicle, clock, stop)
        _say(ended=True, counts=vehicle.counts())
    finally:
        if plug is not None:
            plug.pull()
        link.close()
        if isinstance(line, TcpServer):
            line.close()
        elif line is not None:
            line.pull()


def _line(receiver: str) -> Plug | TcpServer | None:
    if receiver == "tcp":
        return TcpServer()
    return Plug(Path(receiver), UART_BYTES) if receiver else None


def _stop_on_signal() -> int:
    """A descriptor that becomes readable with SIGTERM or SIGINT."""
    wake, told = os.pipe()
    os.set_blocking(told, False)
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(told)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: None)
    return wake


def _fly(vehicle: LiveVehicle, clock: _Clock, stop: int) -> None:
    control = _Control()
    while (due := vehicle.next_ns) is not None:
        wait = min(max((due - clock.now()) / NS, 0.0), _PATIENCE_S)
        links = [link.fileno() for link in (vehicle.link, vehicle.plug) if link is not None]
        watched = [control.fileno, stop, *(fd for fd in links if fd is not None)]
        # select, because it waits in microseconds where poll and epoll wait in milliseconds.
        readable, _, _ = select.select(watched, [], [], wait)
        if stop in readable:
            return
        if control.fileno in readable and not control.serve(vehicle, clock):
            return
        vehicle.advance(clock.now())


class _Control:
    """Orders from standard input, answers to standard output."""

    def __init__(self) -> None:
        self.fileno = sys.stdin.fileno()
        self._rest = b""

    def serve(self, vehicle: LiveVehicle, clock: _Clock) -> bool:
        """Take the orders that are there; False at the end of the stream."""
        data = os.read(self.fileno, 65_536)
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            if not line.strip():
                continue
            try:
                order = parse_order(line)
            except CompanionError as error:
                _say(error=str(error))
                continue
            now = clock.now()
            if order.ask is not None:
                _say(counts=vehicle.counts(), t_ns=now)
            else:
                vehicle.order(order, now)
                _say(done=order.fault, on=order.on, t_ns=now)
        return bool(data)
