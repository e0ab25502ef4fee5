"""One autopilot on one link, as a pure state machine: bytes and time in, samples and bytes out.

The owner of the link feeds what arrived with its arrival number and time on the run's clock, ticks
about ten times a second, and takes samples, events and frames to send. Nothing here waits, and
nothing that arrives raises: what cannot be used is counted in :attr:`MavlinkSession.counters`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.types import I64, NS, AnySamples, Event, ReferenceSamples
from drivers.mavlink.boot_clock import BootClock
from drivers.mavlink.boot_clock import Source as ClockSource
from drivers.mavlink.columns import decode
from drivers.mavlink.converter import Converter
from drivers.mavlink.counters import SessionCounters
from drivers.mavlink.dialect import message_id, message_name
from drivers.mavlink.framer import U8, FrameIndex, StreamFramer, index_frames
from drivers.mavlink.packer import ONBOARD_COMPUTER, Packer
from drivers.mavlink.rates import RateKeeper, RateReport, Wish
from drivers.mavlink.samples import Table, boot_us
from drivers.mavlink.signing import Signing, SigningCounters

HEARTBEAT_NS = NS
SILENT_NS = 5 * NS
"""Without a heartbeat for this long, the autopilot is gone."""
_STANDBY = 3
"""MAV_STATE from which on an autopilot takes requests."""
_OUTGOING = 256
"""Frames waiting for the link; more would be stale anyway."""

_HEARTBEAT = message_id("HEARTBEAT")
_TIMESYNC = message_id("TIMESYNC")
_COMMAND_ACK = message_id("COMMAND_ACK")
_ORIGIN = message_id("GPS_GLOBAL_ORIGIN")


@dataclass(frozen=True, slots=True)
class SessionSettings:
    """What we want of a link; rates of 0 are not asked for."""

    system: int = 0
    """System id of the vehicle; 0: the first autopilot that is heard."""
    known: tuple[int, int] | None = None
    """(system, component) of the autopilot of an earlier run: any message of it will do, where
    one that is new is waited for until its heartbeat."""
    component: int = ONBOARD_COMPUTER
    """Our own component id, in the vehicle's system."""
    imu: bool = True
    imu_rate_hz: float = 100.0
    gnss_rate_hz: float = 10.0
    baro_rate_hz: float = 10.0
    mag_rate_hz: float = 10.0
    reference_rate_hz: float = 5.0
    """GLOBAL_POSITION_INT and ATTITUDE, for comparison only."""
    request_rates: bool = True
    datagrams: bool = True
    """Pieces are whole datagrams (UDP), not parts of a stream."""
    signing_key: bytes | None = None
    link_id: int = 0


@dataclass(frozen=True, slots=True)
class SessionStatus:
    """The link as people and the health report see it."""

    vehicle: tuple[int, int] | None
    """(system, component) of the autopilot; None before its first heartbeat."""
    alive: bool
    """A heartbeat within the last seconds."""
    clock: ClockSource
    clock_sd_ms: float
    """Of the match of clocks by TIMESYNC; NaN without."""
    drift_ppm: float
    round_trip_ms: float
    restarts: int
    """How often the autopilot's clock began anew."""
    rates: tuple[RateReport, ...]
    signing: SigningCounters | None


def wishes(settings: SessionSettings) -> tuple[Wish, ...]:
    """What to ask the autopilot for."""
    inertial = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU")
    # The inertial messages carry the magnetic field as well.
    first = (
        Wish(inertial, settings.imu_rate_hz)
        if settings.imu
        else Wish(("RAW_IMU", "SCALED_IMU", "HIGHRES_IMU"), settings.mag_rate_hz)
    )
    return (
        first,
        Wish(("GPS_RAW_INT",), settings.gnss_rate_hz),
        Wish(("GPS2_RAW",), settings.gnss_rate_hz, needed=False),
        Wish(("SCALED_PRESSURE",), settings.baro_rate_hz),
        Wish(("SYSTEM_TIME",), 1.0, needed=False),
        Wish(("GLOBAL_POSITION_INT",), settings.reference_rate_hz, needed=False),
        Wish(("ATTITUDE",), settings.reference_rate_hz, needed=False),
    )


class MavlinkSession:
    """The vehicle behind one link; see the module's text for how to drive it."""

    def __init__(self, settings: SessionSettings) -> None:
        self.settings = settings
        self.counters = SessionCounters()
        self.clock = BootClock()
        self.rates = RateKeeper(wishes(settings))
        self.state: int = mavlink.MAV_STATE_ACTIVE
        """Our own state, as the heartbeat tells it."""
        key = settings.signing_key
        self._signing = Signing(key, settings.link_id) if key is not None else None
        self._packer = Packer(settings.system or 1, settings.component, self._signing)
        self._framer = StreamFramer()
        self._converter = Converter(self.clock, self.counters)
        self._vehicle: tuple[int, int] | None = None
        self._status = 0
        self._heard_ns = 0
        self._alive = False
        self._last_frame: int | None = None
        self._beat_ns: int | None = None
        self._out: deque[bytes] = deque(maxlen=_OUTGOING)
        self._events: list[Event] = []
        self._origin: tuple[int, int, int] | None = None

    # ------------------------------------------------------------------ in

    def reopened(self) -> None:
        """The link was opened (again): half a frame from before belongs to nothing."""
        self._framer = StreamFramer()
        self._last_frame = None
        self.rates.restart()

    def feed(self, seq: int, t_rx_ns: int, data: bytes) -> None:
        """Take one datagram, or one piece of a stream, that arrived under number ``seq``."""
        counters = self.counters
        counters.pieces += 1
        counters.bytes += len(data)
        if self.settings.datagrams:
            buf = np.frombuffer(data, np.uint8)
            index = index_frames(buf)
        else:
            buf, index = self._framer.feed(data)
        counters.frames += len(index)
        counters.bad_bytes += index.bad_bytes
        counters.bad_crc += index.bad_crc
        if len(index):
            self._frames(seq, t_rx_ns, buf, index)
        # Not only at ticks: the first samples wait for the clocks to be matched.
        self._ask_time(t_rx_ns)

    def _frames(self, seq: int, t_rx_ns: int, buf: U8, index: FrameIndex) -> None:
        rows = np.flatnonzero(index.checked)
        self.counters.unknown += len(index) - len(rows)
        if self._signing is not None:
            rows = self._authentic(self._signing, t_rx_ns, buf, index, rows)
        beats = rows[index.msgid[rows] == _HEARTBEAT]
        if self._vehicle is None:
            self._recognise(t_rx_ns, index, rows)
        if len(beats):
            self._heartbeats(t_rx_ns, buf, index, beats)
        if self._vehicle is None:
            self.counters.foreign += len(rows)
            return
        system, component = self._vehicle
        ours = rows[(index.system[rows] == system) & (index.component[rows] == component)]
        self.counters.foreign += len(rows) - len(ours)
        if len(ours):
            self._count_lost(index.seq[ours])
            self._messages(seq, t_rx_ns, buf, index, ours)

    def _authentic(
        self, signing: Signing, t_rx_ns: int, buf: U8, index: FrameIndex, rows: I64
    ) -> I64:
        """Of the frames ``rows``, those whose signature holds; the others are counted there."""
        signing.set_time(t_rx_ns)
        whole = buf.tobytes()
        keep = []
        for row in rows.tolist():
            start, signed = int(index.start[row]), bool(index.signed[row])
            end = int(index.payload[row]) + int(index.length[row]) + (15 if signed else 2)
            keep.append(signing.verify(whole[start:end], signed=signed) is None)
        return rows[np.array(keep, np.bool_)]

    def _count_lost(self, numbers: NDArray[np.uint8]) -> None:
        for number in numbers.tolist():
            if self._last_frame is not None:
                # A large step is a frame that was overtaken, or a new start.
                missing = (number - self._last_frame - 1) % 256
                self.counters.lost += missing if missing < 128 else 0
            self._last_frame = number

    def _heartbeats(self, t_rx_ns: int, buf: U8, index: FrameIndex, rows: I64) -> None:
        table = decode(buf, index, _HEARTBEAT, rows)
        for row, beat in zip(rows.tolist(), table, strict=True):
            sender = int(index.system[row]), int(index.component[row])
            if beat["autopilot"] == mavlink.MAV_AUTOPILOT_INVALID:
                continue
            if self._vehicle is None and self.settings.system in (0, sender[0]):
                self._adopt(sender, t_rx_ns)
            if sender == self._vehicle:
                self._beat(int(beat["system_status"]), t_rx_ns)

    def _recognise(self, t_rx_ns: int, index: FrameIndex, rows: I64) -> None:
        known = self.settings.known
        if known is None or self.settings.system not in (0, known[0]):
            return
        if np.any((index.system[rows] == known[0]) & (index.component[rows] == known[1])):
            self._adopt(known, t_rx_ns)
            self._heard_ns, self._alive = t_rx_ns, True

    def _adopt(self, vehicle: tuple[int, int], now_ns: int) -> None:
        self._vehicle = vehicle
        self._packer.system = vehicle[0]
        text = f"autopilot found: system {vehicle[0]}, component {vehicle[1]}"
        self._say(now_ns, "autopilot-found", text)

    def _beat(self, status: int, now_ns: int) -> None:
        if self._heard_ns and not self._alive:
            self._say(now_ns, "autopilot-back", "heartbeat of the autopilot is back")
            self.rates.restart()
        self._status, self._heard_ns, self._alive = status, now_ns, True

    def _messages(self, seq: int, t_rx_ns: int, buf: U8, index: FrameIndex, rows: I64) -> None:
        """Every frame of the vehicle, message by message.

        Clocks first: stamps and TIMESYNC of this piece count for its samples.
        """
        kinds = index.msgid[rows]
        tables: list[tuple[str, Table, I64]] = []
        for msgid in dict.fromkeys(kinds.tolist()):
            these = rows[kinds == msgid] if len(rows) > 1 else rows
            if msgid == _TIMESYNC:
                self._timesync(t_rx_ns, decode(buf, index, msgid, these))
            elif msgid == _COMMAND_ACK:
                self._acknowledged(t_rx_ns, decode(buf, index, msgid, these))
            elif msgid == _ORIGIN:
                told = decode(buf, index, msgid, these)[-1]
                self._origin = int(told["latitude"]), int(told["longitude"]), int(told["altitude"])
            elif msgid != _HEARTBEAT:
                name = message_name(msgid)
                self.rates.count(name, len(these))
                if self._converter.wants(name):
                    table = decode(buf, index, msgid, these)
                    tables.append((name, table, boot_us(table)))
        for name, _, stamps_us in tables:
            if self._converter.observe(name, stamps_us, t_rx_ns):
                self._restarted(t_rx_ns)
        self.clock.update(t_rx_ns)
        for name, table, stamps_us in tables:
            self._converter.convert(name, table, stamps_us, seq, t_rx_ns)

    def _timesync(self, t_rx_ns: int, table: Table) -> None:
        for tc1, ts1 in zip(table["tc1"].tolist(), table["ts1"].tolist(), strict=True):
            if tc1 == 0:
                self.send(mavlink.MAVLink_timesync_message(t_rx_ns, ts1))
            elif self.clock.answered(tc1, ts1, t_rx_ns):
                self._restarted(t_rx_ns)

    def _restarted(self, now_ns: int) -> None:
        self._converter.restart()
        self.rates.restart()
        self._origin = None
        self._say(
            now_ns,
            "autopilot-restarted",
            "the autopilot's clock began anew: clocks are matched again, messages asked for again",
            "warning",
        )

    def _acknowledged(self, t_rx_ns: int, table: Table) -> None:
        us = self._packer.system, self.settings.component
        for ack in table:
            to = int(ack["target_system"]), int(ack["target_component"])
            # MAVLink 1, and some autopilots, leave the address out.
            if to in (us, (0, 0)):
                self.rates.acknowledge(int(ack["command"]), int(ack["result"]), t_rx_ns)

    # ------------------------------------------------------------------ time

    def tick(self, now_ns: int) -> None:
        """Heartbeat, TIMESYNC, requests and time-outs; about ten times a second or more often."""
        if self._signing is not None:
            self._signing.set_time(now_ns)
        if self._beat_ns is None or now_ns - self._beat_ns >= HEARTBEAT_NS:
            self._beat_ns = now_ns
            kind, none = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
            self.send(mavlink.MAVLink_heartbeat_message(kind, none, 0, 0, self.state, 3))
        if self._vehicle is None:
            return
        if self._alive and now_ns - self._heard_ns > SILENT_NS:
            self._alive = False
            self._say(
                now_ns,
                "autopilot-silent",
                f"no heartbeat of the autopilot for {SILENT_NS / NS:g} s",
                "warning",
            )
        if not self._alive:
            return
        self._ask_time(now_ns)
        self.clock.update(now_ns)
        if self.settings.request_rates and self._status >= _STANDBY:
            for message in self.rates.tick(now_ns, *self._vehicle):
                self.send(message)

    def _ask_time(self, now_ns: int) -> None:
        if not self._alive:
            return
        asked_ns = self.clock.sync.request(now_ns)
        if asked_ns is not None:
            self.send(mavlink.MAVLink_timesync_message(0, asked_ns))

    # ------------------------------------------------------------------ out

    def send(self, message: Any) -> None:
        """Queue a pymavlink message, as our component in the vehicle's system."""
        if len(self._out) == _OUTGOING:
            self.counters.not_sent += 1  # the oldest gives way
        self._out.append(self._packer.pack(message))

    def outgoing(self) -> list[bytes]:
        """Frames to write now, one a datagram."""
        out = list(self._out)
        self._out.clear()
        return out

    def take(self) -> list[AnySamples]:
        """Samples since the last call: fixes, pressure, field, then inertial.

        All that came with one piece carry its number; in this order they go to the engine, and in
        this order a replay, which knows the number only, takes them too.
        """
        return self._converter.take()

    def references(self) -> list[ReferenceSamples]:
        """The autopilot's own solution since the last call; for comparison, never an input."""
        return self._converter.references()

    def events(self) -> list[Event]:
        """What happened since the last call."""
        out = [*self._events, *self.rates.events()]
        self._events = []
        return out

    def _say(
        self, now_ns: int, kind: str, text: str, level: Literal["info", "warning"] = "info"
    ) -> None:
        self._events.append(Event(now_ns, kind, text, level))

    @property
    def signing_counters(self) -> SigningCounters | None:
        """What verifying signatures did; None without a key."""
        return self._signing.counters if self._signing is not None else None

    @property
    def vehicle(self) -> tuple[int, int] | None:
        """(system, component) of the autopilot; None before it is heard."""
        return self._vehicle

    @property
    def system(self) -> int:
        """System id of the vehicle; 0 before it is heard."""
        return self._vehicle[0] if self._vehicle is not None else 0

    @property
    def origin(self) -> tuple[int, int, int] | None:
        """Its GPS_GLOBAL_ORIGIN since it started: 1e-7 degrees twice, mm above mean sea level."""
        return self._origin

    @property
    def undulation_m(self) -> float | None:
        """The run's datum of heights above mean sea level [m]; None before a fix has decided it."""
        return self._converter.undulation_m

    @property
    def height_datum(self) -> Literal["hae", "msl"] | None:
        """Datum of all heights of this run; None before the first fix has decided it."""
        return self._converter.height_datum

    def status(self, now_ns: int) -> SessionStatus:
        """How the link is doing."""
        line, trip = self.clock.sync.last_line, self.clock.sync.round_trip_ns
        nan = float("nan")
        return SessionStatus(
            vehicle=self._vehicle,
            alive=self._alive,
            clock=self.clock.source,
            clock_sd_ms=line.sd_at(now_ns) * 1e-6 if line is not None else nan,
            drift_ppm=line.drift * 1e6 if line is not None else nan,
            round_trip_ms=trip * 1e-6 if trip is not None else nan,
            restarts=self.clock.restarts,
            rates=self.rates.report(),
            signing=self.signing_counters,
        )
