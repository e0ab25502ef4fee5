"""The simulated vehicle's autopilot: a pure MAVLink 2 endpoint, told the time.

It sends what it has measured at the intervals that were asked of it (slowly until then, as a real
one does), stamped on a boot clock with an offset and a drift; answers TIMESYNC and asks for it,
acknowledges commands, and forgets everything when it is rebooted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.types import F64, I64, NS, ImuSamples, MagSamples, ReferenceSamples, VehicleRecording
from replay.simulator import messages

SYSTEM, COMPONENT = 1, 1
_SECOND = 1_000_000
"""Message intervals are in microseconds."""
_GRAVITY = 9.80665


@dataclass(slots=True)
class BootClock:
    """Time since boot as the autopilot counts it: a crystal that is off by ``drift_ppm``."""

    booted_ns: int
    """Of the run's clock."""
    drift_ppm: float = 0.0

    def at(self, t_ns: int) -> int:
        """Boot time [ns] at ``t_ns`` of the run's clock; negative before boot."""
        return round((t_ns - self.booted_ns) * (1.0 + self.drift_ppm * 1e-6))


class _Stream:
    """One message of the autopilot: its samples in order, thinned to the interval asked for."""

    def __init__(
        self, name: str, field: str, t_ns: I64, t_rx_ns: I64, made: Iterator[Any], default_hz: float
    ) -> None:
        self.name = name
        self.msgid: int = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
        self.default_us = round(_SECOND / default_hz) if default_hz > 0 else -1
        self.interval_us = self.default_us
        self._field = field
        self._t, self._rx, self._made, self._next = t_ns.tolist(), t_rx_ns.tolist(), made, 0
        # The nearest sample to the moment, not the next one behind it.
        self._slack_ns = int(np.median(np.diff(t_rx_ns))) // 2 if len(t_rx_ns) > 1 else 0
        self._due_ns = self._rx[0] if self._rx else 0

    @property
    def next_ns(self) -> int | None:
        """When the next sample is there; None after the last one."""
        return self._rx[self._next] if self._next < len(self._rx) else None

    def due(self, now_ns: int, clock: BootClock) -> Iterator[Any]:
        """Messages to send, of the samples up to ``now_ns``."""
        while (rx := self.next_ns) is not None and rx <= now_ns:
            message, stamp_ns = next(self._made), clock.at(self._t[self._next])
            self._next += 1
            if self.interval_us < 0 or rx + self._slack_ns < self._due_ns or stamp_ns < 0:
                continue
            interval_ns = self.interval_us * 1000
            self._due_ns = max(self._due_ns, rx - interval_ns) + interval_ns
            unit = 1000 if self._field == "time_usec" else 1_000_000
            setattr(message, self._field, stamp_ns // unit)
            yield message

    def ask(self, interval_us: int) -> None:
        """From now on every ``interval_us``; 0: as by default, negative: never."""
        self.interval_us = self.default_us if interval_us == 0 else interval_us
        self._due_ns = self.next_ns or 0


class SimulatedAutopilot:
    """MAVLink of one vehicle; all times are those of the recording's clock."""

    def __init__(
        self, recording: VehicleRecording, clock: BootClock, vehicle_kind: str = "multirotor"
    ) -> None:
        """``recording`` has times of the run's clock; its ``HIGHRES_IMU`` is the autopilot's own.

        Heights of ``recording`` are above the ellipsoid.
        """
        self.clock = clock
        self.sent: Counter[str] = Counter()
        self.received: Counter[str] = Counter()
        self.timesync_answers = 0
        self.bad_received = 0
        self.gnss_silent = False
        self._mav = mavlink.MAVLink(None, srcSystem=SYSTEM, srcComponent=COMPONENT)
        self._kind = messages.MAV_TYPES.get(vehicle_kind, 0)
        self._streams = {stream.msgid: stream for stream in _streams(self._mav, recording)}
        self._second_ns = min(s.next_ns or 0 for s in self._streams.values())
        self._answers: list[bytes] = []
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True

    @property
    def next_ns(self) -> int | None:
        """When something is due next; None when the flight is over."""
        times = [s.next_ns for s in self._streams.values() if s.next_ns is not None]
        return min(min(times), self._second_ns) if times else None

    def advance(self, now_ns: int) -> list[bytes]:
        """Frames to send now: answers, measurements up to ``now_ns``, the beat of the second."""
        out, self._answers = self._answers, []
        for stream in self._streams.values():
            for message in stream.due(now_ns, self.clock):
                if not (self.gnss_silent and stream.name == "GPS_RAW_INT"):
                    out.append(self._pack(message))
        while self._second_ns <= now_ns:
            out += [self._pack(message) for message in self._beat(self._second_ns)]
            self._second_ns += NS
        return out

    def feed(self, now_ns: int, data: bytes) -> None:
        """Bytes from the companion; the answers come with the next :meth:`advance`."""
        for message in self._parser.parse_buffer(data) or []:
            name = message.get_type()
            if name == "BAD_DATA":
                self.bad_received += 1
                continue
            self.received[name] += 1
            if name == "TIMESYNC":
                self._timesync(now_ns, message)
            elif name == "COMMAND_LONG" and message.target_system in (0, SYSTEM):
                self._command(message)

    def reboot(self, now_ns: int) -> None:
        """Start again: boot clock and sequence from zero, intervals as before anybody asked."""
        self.clock.booted_ns = now_ns
        self._mav.seq = 0
        self._answers.clear()
        for stream in self._streams.values():
            stream.ask(0)

    def _pack(self, message: Any) -> bytes:
        self.sent[message.get_type()] += 1
        packed: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return packed

    def _beat(self, t_ns: int) -> Iterator[Any]:
        boot_ns = self.clock.at(t_ns)
        mode, active = mavlink.MAV_MODE_FLAG_SAFETY_ARMED, mavlink.MAV_STATE_ACTIVE
        yield self._mav.heartbeat_encode(
            self._kind, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mode, 0, active
        )
        if boot_ns >= 0:
            yield self._mav.system_time_encode(t_ns // 1000, boot_ns // 1_000_000)
            yield self._mav.timesync_encode(0, boot_ns)

    def _timesync(self, now_ns: int, message: Any) -> None:
        if message.tc1 == 0:
            answer = self._mav.timesync_encode(self.clock.at(now_ns), message.ts1)
            self._answers.append(self._pack(answer))
        else:
            self.timesync_answers += 1

    def _command(self, message: Any) -> None:
        result = mavlink.MAV_RESULT_UNSUPPORTED
        if message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            stream = self._streams.get(round(message.param1))
            result = mavlink.MAV_RESULT_DENIED
            if stream is not None:
                stream.ask(round(message.param2))
                result = mavlink.MAV_RESULT_ACCEPTED
        ack = self._mav.command_ack_encode(
            message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
        )
        self._answers.append(self._pack(ack))


def _streams(mav: Any, recording: VehicleRecording) -> Iterator[_Stream]:
    mag = next(iter(recording.mag), None)
    for imu in recording.imu:
        if imu.source == "HIGHRES_IMU":
            made = messages.imu_messages(mav, imu, mag, 0)
            yield _Stream("HIGHRES_IMU", "time_usec", imu.t_ns, imu.t_rx_ns, made, 0.0)
            made = _raw_imu(mav, imu, mag)
            yield _Stream("RAW_IMU", "time_usec", imu.t_ns, imu.t_rx_ns, made, 2.0)
    for gnss in recording.gnss[:1]:
        made = messages.gnss_messages(mav, gnss, 0)
        yield _Stream("GPS_RAW_INT", "time_usec", gnss.t_ns, gnss.t_rx_ns, made, 2.0)
    for baro in recording.baro[:1]:
        made = messages.baro_messages(mav, baro, 0)
        yield _Stream("SCALED_PRESSURE", "time_boot_ms", baro.t_ns, baro.t_rx_ns, made, 2.0)
    if recording.truth is not None:
        # The autopilot's own estimate: good enough to look at, never an input of ours.
        t, rx = recording.truth.t_ns, recording.truth.t_rx_ns
        made = _attitude(mav, recording.truth)
        yield _Stream("ATTITUDE", "time_boot_ms", t, rx, made, 4.0)
        made = _global_position(mav, recording.truth)
        yield _Stream("GLOBAL_POSITION_INT", "time_boot_ms", t, rx, made, 2.0)


def _whole(values: F64, factor: float) -> I64:
    return np.rint(values * factor).astype(np.int64)


def _raw_imu(mav: Any, imu: ImuSamples, mag: MagSamples | None) -> messages.Messages:
    """RAW_IMU as ArduPilot fills it: mG, mrad/s and milligauss in whole numbers."""
    field, _ = messages.mag_at(imu, mag)
    accel = _whole(imu.accel_b, 1000.0 / _GRAVITY).clip(-32768, 32767)
    gyro = _whole(imu.gyro_b, 1000.0).clip(-32768, 32767)
    for a, g, m in messages.rows_of(accel, gyro, _whole(field, 1000.0)):
        yield mav.raw_imu_encode(0, *a, *g, *m)


def _attitude(mav: Any, truth: ReferenceSamples) -> messages.Messages:
    for (rpy,) in messages.rows_of(truth.rpy):
        yield mav.attitude_encode(0, *rpy, 0.0, 0.0, 0.0)


def _global_position(mav: Any, truth: ReferenceSamples) -> messages.Messages:
    columns = messages.rows_of(
        _whole(np.degrees(truth.lat), 1e7),
        _whole(np.degrees(truth.lon), 1e7),
        _whole(truth.height - messages.UNDULATION_M, 1e3),
        _whole(truth.height - truth.height[0], 1e3),
        _whole(truth.vel_n, 100.0),
        _whole(np.degrees(truth.rpy[:, 2]), 100.0) % 36000,
    )
    for lat, lon, alt, above, vel, heading in columns:
        yield mav.global_position_int_encode(0, lat, lon, alt, above, *vel, heading)
