"""An autopilot without sockets: a drifting clock, sensors, TIMESYNC, requests, and slow links.

Everything is scheduled on true time; frames carry the autopilot's time since boot. Bytes come out
with their time of arrival at the companion, and what the companion sends goes in with its own.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.types import NS
from drivers.mavlink.packer import Packer
from drivers.mavlink.session import MavlinkSession
from drivers.mavlink.signing import Signing

START_NS = 1_750_000_000 * NS
"""Run clock when the tests begin."""
ACCEL, GYRO = (0.1, -0.2, -9.8), (0.01, -0.02, 0.1)
LAT_E7, LON_E7, ALT_MM = 474_000_000, 85_000_000, 500_000

Delay = Callable[[np.random.Generator], float]


def jitter(least_s: float, mean_s: float) -> Delay:
    """A delay [s] that is at least the one and exponential above it."""
    return lambda rng: least_s + float(rng.exponential(mean_s))


PROMPT = jitter(0.0005, 0.0005)


class OldPacker(Packer):
    """Packs as MAVLink 1."""

    def pack(self, message: Any) -> bytes:
        """The frame of a message."""
        frame = bytes(message.pack(self._link, force_mavlink1=True))
        self._link.seq = (self._link.seq + 1) % 256
        return frame


class Autopilot:
    """Sends at the rates it was asked for; what it refuses and how it fails is set from outside."""

    def __init__(
        self,
        *,
        system: int = 1,
        drift_ppm: float = 0.0,
        boot_s: float = 20.0,
        to_us: Delay = PROMPT,
        to_it: Delay = PROMPT,
        timesync: bool = True,
        signing: Signing | None = None,
        seed: int = 1,
    ) -> None:
        self.rng = np.random.default_rng(seed)
        self.packer = Packer(system, 1, signing)
        self.system = system
        self.drift = drift_ppm * 1e-6
        self.boot_at_ns = START_NS - round(boot_s * NS)
        self.to_us, self.to_it, self.timesync = to_us, to_it, timesync
        self.rates: dict[str, float] = {}
        self.next_ns: dict[str, int] = {}
        self.refused: set[str] = set()
        self.limit_hz = 400.0
        self.silent: set[str] = set()
        self.knows_intervals = True
        self.asked: list[tuple[str, float]] = []
        self.streams: list[tuple[int, int]] = []
        self.answers: list[tuple[int, int]] = []
        self.on = True
        self.sampled_ns: list[int] = []
        """True times of the inertial samples sent."""

    # ---------------------------------------------------------------- clock

    def boot_ns(self, true_ns: int) -> int:
        """Its time since boot at a true time."""
        since = true_ns - self.boot_at_ns
        return since + round(since * self.drift)

    def reboot(self, true_ns: int) -> None:
        """Power cut: the clock begins at two seconds, requests are forgotten."""
        self.boot_at_ns = true_ns - 2 * NS
        self.rates.clear()
        self.next_ns.clear()

    # ---------------------------------------------------------------- what it sends

    def next_due(self, now_ns: int) -> int:
        """When it has something to send next."""
        return min(self.next_ns.get(name, now_ns) for name in ("HEARTBEAT", *self.rates))

    def due(self, true_ns: int) -> list[bytes]:
        """Frames of this moment."""
        frames = []
        for name, rate in {"HEARTBEAT": 1.0, **self.rates}.items():
            at = self.next_ns.setdefault(name, true_ns)
            if true_ns >= at:
                # After a pause it does not catch up.
                self.next_ns[name] = max(at + round(NS / rate), true_ns + 1)
                if name in self.silent:
                    continue
                if name == "HIGHRES_IMU":
                    self.sampled_ns.append(true_ns)
                frames.append(self.packer.pack(self.message(name, self.boot_ns(true_ns))))
        return frames

    def message(self, name: str, boot_ns: int) -> Any:
        """One message, stamped."""
        us, ms = boot_ns // 1000, boot_ns // 1_000_000
        raw = [round(a / 9.80665e-3) for a in ACCEL] + [round(g * 1e3) for g in GYRO]
        match name:
            case "HEARTBEAT":
                return mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 4, 3)
            case "HIGHRES_IMU":
                rest = (0.2, -0.05, 0.43, 950.0, 0.0, 540.0, 30.0, 0x1FFF)
                return mavlink.MAVLink_highres_imu_message(us, *ACCEL, *GYRO, *rest)
            case "RAW_IMU":
                return mavlink.MAVLink_raw_imu_message(us, *raw, 200, -50, 430)
            case "SCALED_IMU":
                return mavlink.MAVLink_scaled_imu_message(ms, *raw, 200, -50, 430)
            case "SCALED_PRESSURE":
                return mavlink.MAVLink_scaled_pressure_message(ms, 950.25, 0.0, 3000)
            case "SYSTEM_TIME":
                return mavlink.MAVLink_system_time_message(0, ms)
            case "ATTITUDE":
                return mavlink.MAVLink_attitude_message(ms, 0.1, -0.05, 1.0, 0.0, 0.0, 0.1)
            case "GLOBAL_POSITION_INT":
                place = (LAT_E7, LON_E7, ALT_MM, 0)
                return mavlink.MAVLink_global_position_int_message(ms, *place, 10, -20, 30, 0)
            case "GPS_RAW_INT" | "GPS2_RAW":
                # An epoch each 200 ms, stamped when it came, however often it is sent.
                fix_us = us // 200_000 * 200_000
                return self._fix(name, fix_us)
        raise KeyError(name)

    @staticmethod
    def _fix(name: str, fix_us: int) -> Any:
        accuracy = (1200, 2500, 300)
        if name == "GPS_RAW_INT":
            return mavlink.MAVLink_gps_raw_int_message(
                fix_us, 3, LAT_E7, LON_E7, ALT_MM, 80, 120, 500, 9000, 14, 547_500, *accuracy
            )
        return mavlink.MAVLink_gps2_raw_message(
            fix_us, 3, LAT_E7, LON_E7, ALT_MM, 80, 120, 500, 9000, 9, 0, 0, 0, 547_500, *accuracy
        )

    # ---------------------------------------------------------------- what it is sent

    def take(self, frame: bytes, true_ns: int) -> list[bytes]:
        """Answer one frame of the companion."""
        decoder = mavlink.MAVLink(None)
        message = decoder.parse_char(frame)
        if message is None:
            return []
        kind = message.get_type()
        if kind == "TIMESYNC":
            return self._timesync(message, true_ns)
        if kind == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            return self._interval(message)
        if kind == "REQUEST_DATA_STREAM":
            self.streams.append((message.req_stream_id, message.req_message_rate))
            if message.req_stream_id == mavlink.MAV_DATA_STREAM_RAW_SENSORS:
                self.rates.update(
                    RAW_IMU=message.req_message_rate, SCALED_PRESSURE=message.req_message_rate
                )
            elif message.req_stream_id == mavlink.MAV_DATA_STREAM_EXTENDED_STATUS:
                self.rates["GPS_RAW_INT"] = message.req_message_rate
        return []

    def _timesync(self, message: Any, true_ns: int) -> list[bytes]:
        if message.tc1:
            self.answers.append((message.ts1, message.tc1))
            return []
        if not self.timesync:
            return []
        reply = mavlink.MAVLink_timesync_message(self.boot_ns(true_ns), message.ts1)
        return [self.packer.pack(reply)]

    def _interval(self, message: Any) -> list[bytes]:
        if not self.knows_intervals:
            return []
        name = mavlink.mavlink_map[int(message.param1)].msgname
        rate = 1e6 / message.param2
        self.asked.append((name, rate))
        result = mavlink.MAV_RESULT_ACCEPTED
        if name in self.refused or rate > self.limit_hz:
            result = mavlink.MAV_RESULT_DENIED
        else:
            self.rates[name] = rate
            self.next_ns.pop(name, None)
        ack = mavlink.MAVLink_command_ack_message(
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, result, 0, 0, self.system, 191
        )
        return [self.packer.pack(ack)]


class Air:
    """Session and autopilot with the links between them, stepped on true time."""

    def __init__(self, session: MavlinkSession, autopilot: Autopilot) -> None:
        self.session, self.autopilot = session, autopilot
        self.now_ns = self._tick_ns = START_NS
        self.seq = 0
        self.samples: list[Any] = []
        self.references: list[Any] = []
        self.events: list[Any] = []
        self._flying: list[tuple[int, int, bool, bytes]] = []
        self._sent = 0
        self._last = {True: 0, False: 0}

    def _send(self, data: bytes, to_us: bool, now_ns: int) -> None:
        """Put a frame on its way; a link does not change the order."""
        delay = self.autopilot.to_us if to_us else self.autopilot.to_it
        arrival = now_ns + round(delay(self.autopilot.rng) * NS)
        arrival = self._last[to_us] = max(arrival, self._last[to_us] + 1)
        self._sent += 1
        heapq.heappush(self._flying, (arrival, self._sent, to_us, data))

    def run(self, seconds: float) -> None:
        """Let that much time pass, from one thing that happens to the next."""
        stop = self.now_ns + round(seconds * NS)
        while True:
            landing = self._flying[0][0] if self._flying else stop
            due = self.autopilot.next_due(self.now_ns) if self.autopilot.on else stop
            at = min(landing, due, self._tick_ns)
            if at >= stop:
                self.now_ns = stop
                return
            self.now_ns = max(at, self.now_ns)
            if at == landing:
                _, _, to_us, data = heapq.heappop(self._flying)
                self._arrive(self.now_ns, to_us, data)
            elif at == self._tick_ns:
                self._tick_ns += NS // 10
                self.session.tick(self.now_ns)
            else:
                for frame in self.autopilot.due(self.now_ns):
                    self._send(frame, True, self.now_ns)
            self._flush(self.now_ns)

    def _arrive(self, arrival_ns: int, to_us: bool, data: bytes) -> None:
        if not to_us:
            if self.autopilot.on:
                for frame in self.autopilot.take(data, arrival_ns):
                    self._send(frame, True, arrival_ns)
            return
        self.seq += 1
        self.session.feed(self.seq, arrival_ns, data)

    def _flush(self, now_ns: int) -> None:
        for frame in self.session.outgoing():
            self._send(frame, False, now_ns)
        self.samples += self.session.take()
        self.references += self.session.references()
        self.events += self.session.events()

    def of(self, source: str, kind: type) -> Any:
        """All samples of one stream, joined."""
        found = [s for s in self.samples if s.source == source and isinstance(s, kind)]
        names = [n for n in kind.__dataclass_fields__ if n != "source"]  # type: ignore[attr-defined]
        return kind(source, *(np.concatenate([getattr(s, n) for s in found]) for n in names))

    def kinds(self) -> list[str]:
        """Names of the events so far."""
        return [e.kind for e in self.events]
