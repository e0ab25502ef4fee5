"""DroneCAN ``uavcan.equipment.ahrs.RawIMU`` (data type 1003) over classic CAN.

A message of 47 bytes and more comes as one transfer of several frames. Frame: up to 7 bytes of
payload, then a tail byte: 0x80 start, 0x40 end, 0x20 toggle, 0x1F transfer number. The payload
begins with a CRC-16-CCITT (0x1021, from 0xFFFF) over the type's signature and the body. Identifier,
29 bits: priority (5), data type (16), 0 for a message (1), node (7).
Specification: dronecan.github.io, "CAN bus transport layer" and "1003.RawIMU.uavcan".

AP_Periph never sets the message's timestamp. Its integration intervals follow on one another
without a gap, so their sum is the sensor's clock, free of the jitter of arrival; where they do not
(or are not sent), validity is the arrival of a transfer's first frame.
"""

from __future__ import annotations

import binascii
import math
import struct

import numpy as np

from companion.types import ImuSamples
from drivers.can_imu.clock import NS, Counter, SensorClock
from drivers.can_imu.decoder import CanFrame, CanImuDecoder, CanImuEncoder, Unit

RAW_IMU = 1003
SIGNATURE = 0x8280632C40E574B5
_CRC_OF_SIGNATURE = binascii.crc_hqx(SIGNATURE.to_bytes(8, "little"), 0xFFFF)

_TYPE_MASK = 0xFFFF80
_TYPE = RAW_IMU << 8
_BODY = struct.Struct("<f3e3f3e3f")
"""Integration interval [s]; rate [rad/s], its integral; specific force [m/s²], its integral."""
_BODY_AT = 2 + 7
_PAYLOAD = _BODY_AT + _BODY.size
_LONGEST = _PAYLOAD + 1 + 36 * 2
"""With the longest covariance, which is not used."""

_START, _END, _TOGGLE, _NUMBER = 0x80, 0x40, 0x20, 0x1F
_IDLE = -1

_LONGEST_INTERVAL_S = 1.0
_TILING_NS = 2 * NS
_TILING_TOLERANCE = 0.05
"""Of a window: intervals that add up to it within this are a clock. Arrivals scatter by some 10 ms;
a unit that integrates over every other sample only is off by half."""


def crc16(body: bytes) -> int:
    """Transfer CRC of a RawIMU body."""
    return binascii.crc_hqx(body, _CRC_OF_SIGNATURE)


class DroneCanDecoder(CanImuDecoder):
    """RawIMU of one node."""

    def __init__(self, unit: Unit, node_id: int = 0) -> None:
        """``node_id`` 0: the first node that sends a RawIMU frame."""
        super().__init__(unit)
        self.node_id = node_id
        self._payload = bytearray()
        self._expected = _IDLE
        """Toggle and number that the next frame must have; idle: wait for a start."""
        self._last_frame = b""
        self._first_rx = 0
        self._number = Counter(5, unit.rate_hz)
        self._validity = _Validity()

    def wants(self, can_id: int, extended: bool) -> bool:
        """RawIMU messages of the node, or of any."""
        node = can_id & 0x7F
        ours = node == self.node_id if self.node_id else node > 0
        return extended and can_id & _TYPE_MASK == _TYPE and ours

    def feed(self, seq: int, t_rx_ns: int, can_id: int, extended: bool, data: bytes) -> bool:
        """One frame; see :meth:`CanImuDecoder.feed`."""
        if not extended or can_id & _TYPE_MASK != _TYPE:
            return False
        node = can_id & 0x7F
        if node != self.node_id:
            if self.node_id or not node:
                return False
            self.node_id = node
        counters = self.counters
        counters.frames += 1
        if not data:
            counters.malformed += 1
            return True
        tail = data[-1]
        if tail & _START:
            self._begin(t_rx_ns, tail, data)
        elif self._expected == _IDLE:
            return True
        elif tail & (_TOGGLE | _NUMBER) != self._expected:
            if data == self._last_frame:
                counters.repeated += 1
            else:
                self._give_up()
            return True
        else:
            self._payload += data[:-1]
            self._expected ^= _TOGGLE
        self._last_frame = data
        if tail & _END:
            if self._expected != _IDLE:
                self._expected = _IDLE
                self._complete(seq, t_rx_ns, tail & _NUMBER)
        elif len(self._payload) > _LONGEST:
            self._give_up()
        return True

    def _begin(self, t_rx_ns: int, tail: int, data: bytes) -> None:
        if self._expected != _IDLE:
            if data == self._last_frame:
                self.counters.repeated += 1
                return
            self.counters.incomplete += 1
        if tail & _TOGGLE:
            self._give_up()
            return
        self._payload = bytearray(data[:-1])
        self._expected = (tail & _NUMBER) | _TOGGLE
        self._first_rx = t_rx_ns

    def _give_up(self) -> None:
        self.counters.malformed += 1
        self._expected = _IDLE

    def _complete(self, seq: int, t_rx_ns: int, number: int) -> None:
        payload = bytes(self._payload)
        counters = self.counters
        if (
            len(payload) < _PAYLOAD
            or binascii.crc_hqx(payload[2:], _CRC_OF_SIGNATURE) != payload[0] | payload[1] << 8
        ):
            counters.malformed += 1
            return
        steps = self._number.advance(number, self._first_rx)
        if steps == 0:
            counters.repeated += 1
            return
        lost = max(steps - 1, 0)
        counters.lost += lost
        values = _BODY.unpack_from(payload, _BODY_AT)
        interval = values[0]
        rate, force = values[1:4], values[7:10]
        if 0.0 < interval <= _LONGEST_INTERVAL_S:
            gx, gy, gz = (x / interval for x in values[4:7])
            ax, ay, az = (x / interval for x in values[10:13])
        else:
            interval = math.nan
            (gx, gy, gz), (ax, ay, az) = rate, force
        stamp_us = int.from_bytes(payload[2:9], "little")
        t_ns = self._validity.at(stamp_us, interval, lost, self._first_rx)
        counters.restarts = self._validity.restarts
        sample = gx, gy, gz, ax, ay, az
        # A mean hides an axis that was at its end for part of the interval; the latest may show it.
        peak = None
        if self._limited:
            peak = tuple(max(abs(a), abs(b)) for a, b in zip(sample, rate + force, strict=True))
        self._add(seq, t_ns, t_rx_ns, sample, interval, peak)


class _Validity:
    """Time of validity: from the message's stamp, its intervals, or its arrival."""

    def __init__(self) -> None:
        self.restarts = 0
        self._clock = SensorClock()
        self._by_stamp = False
        self._sensor_ns = 0
        self._last_rx = 0
        self._last_t = -1
        self._tiles = True
        self._window_ns = 0
        self._window_begin = 0

    def at(self, stamp_us: int, interval_s: float, lost: int, rx_ns: int) -> int:
        """Time of validity [ns]; ``rx_ns``: arrival of the transfer's first frame.

        ``lost``: samples before this one that never came.
        """
        if self._last_t < 0:
            self._last_rx = self._window_begin = rx_ns
        elapsed = rx_ns - self._last_rx
        self._last_rx = rx_ns
        if (stamp_us > 0) != self._by_stamp:
            self._by_stamp = stamp_us > 0
            self._clock = SensorClock()
        # What was lost had an interval too. Arrival is no measure of it: a reader that is held up
        # loses frames and finds a backlog at once.
        own = interval_s == interval_s
        self._sensor_ns += round(interval_s * NS) * (1 + lost) if own else elapsed
        self._judge(self._sensor_ns, rx_ns)
        if self._by_stamp:
            t_ns = self._clock.at(stamp_us * 1000, rx_ns)
        elif self._tiles:
            t_ns = self._clock.at(self._sensor_ns, rx_ns)
        else:
            t_ns = rx_ns
        self.restarts = self._clock.restarts
        self._last_t = max(t_ns, self._last_t + 1)
        return self._last_t

    def _judge(self, sensor_ns: int, rx_ns: int) -> None:
        """Every two seconds: whether the intervals still add up to the time that went by."""
        elapsed = rx_ns - self._window_begin
        if elapsed < _TILING_NS:
            return
        tiles = abs(sensor_ns - self._window_ns - elapsed) < _TILING_TOLERANCE * elapsed
        if tiles and not self._tiles:
            self._clock = SensorClock()
        self._tiles = tiles
        self._window_ns, self._window_begin = sensor_ns, rx_ns


class DroneCanEncoder(CanImuEncoder):
    """RawIMU as AP_Periph sends it, without covariance.

    An instantaneous sample has interval 0 and only the float16 of the latest values.
    """

    def __init__(self, node_id: int = 50, *, priority: int = 8, stamped: bool = False) -> None:
        """``stamped``: send ``t_ns`` as the message's timestamp, to the microsecond."""
        self._id = (priority << 24) | _TYPE | (node_id & 0x7F)
        self._number = 0
        self._stamped = stamped

    def encode(self, samples: ImuSamples) -> list[CanFrame]:
        """Seven frames a sample."""
        stamps = samples.t_ns // 1000 if self._stamped else np.zeros(len(samples), np.int64)
        interval = np.where(np.isfinite(samples.interval_s), samples.interval_s, 0.0)
        columns = (
            interval[:, None],
            np.clip(samples.gyro_b, -65504.0, 65504.0),
            samples.gyro_b * interval[:, None],
            np.clip(samples.accel_b, -65504.0, 65504.0),
            samples.accel_b * interval[:, None],
        )
        frames: list[CanFrame] = []
        for stamp, row in zip(stamps.tolist(), np.hstack(columns).tolist(), strict=True):
            frames += self.transfer(stamp.to_bytes(7, "little") + _BODY.pack(*row))
        return frames

    def transfer(self, body: bytes) -> list[CanFrame]:
        """One transfer of ``body``; its number goes up by one with each."""
        payload = crc16(body).to_bytes(2, "little") + body
        parts = [payload[i : i + 7] for i in range(0, len(payload), 7)]
        frames = []
        for i, part in enumerate(parts):
            tail = (_TOGGLE if i & 1 else 0) | self._number
            tail |= (_START if i == 0 else 0) | (_END if i == len(parts) - 1 else 0)
            frames.append(CanFrame(self._id, True, part + bytes([tail])))
        self._number = (self._number + 1) & _NUMBER
        return frames
