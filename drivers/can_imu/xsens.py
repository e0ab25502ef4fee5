"""Xsens MTi-600 series and Avior: big-endian, one 11-bit identifier a quantity.

0x005 time, uint32 in 100 µs; 0x006 counter, uint16; 0x032 rate of turn, 3 × int16 of 2⁻⁹ rad/s;
0x034 acceleration, 3 × int16 of 2⁻⁸ m/s². 0x061 and 0x062 are the high-rate twins, whose validity
is arrival: time and counter belong to the slower group. The identifiers are the unit's defaults;
axes are x forward, y left, z up unless set otherwise. Xsens "MTi 600-series Datasheet" and
low-level communication protocol (MT1604P), section 6.
"""

from __future__ import annotations

import struct

import numpy as np

from companion.types import ImuSamples
from drivers.can_imu.clock import Counter, Unwrapped
from drivers.can_imu.decoder import CanFrame, CanImuEncoder, Unit
from drivers.can_imu.grouping import GroupedDecoder

SAMPLE_TIME, GROUP_COUNTER = 0x005, 0x006
RATE_OF_TURN, ACCELERATION = 0x032, 0x034
RATE_OF_TURN_HR, ACCELERATION_HR = 0x061, 0x062

GYRO_STEP = 2.0**-9
"""[rad/s]"""
ACCEL_STEP = 2.0**-8
"""[m/s²]"""
GYRO_RANGE, ACCEL_RANGE = 35.0, 100.0
"""Of the messages, as documented; the sensor's own may be less."""
_TICK_NS = 100_000

_U32, _U16, _VECTOR = struct.Struct(">I"), struct.Struct(">H"), struct.Struct(">3h")
_LENGTH = {
    SAMPLE_TIME: 4,
    GROUP_COUNTER: 2,
    RATE_OF_TURN: 6,
    ACCELERATION: 6,
    RATE_OF_TURN_HR: 6,
    ACCELERATION_HR: 6,
}


class XsensDecoder(GroupedDecoder):
    """One MTi; a pair of either rate, the high-rate one once it was heard."""

    steps = (GYRO_STEP, ACCEL_STEP)

    def __init__(self, unit: Unit) -> None:
        super().__init__(
            unit,
            (GYRO_RANGE,) * 3 + (ACCEL_RANGE,) * 3,
            clock=Unwrapped(32, _TICK_NS),
            counter=Counter(16, unit.rate_hz),
        )
        self._high_rate = False

    def wants(self, can_id: int, extended: bool) -> bool:
        """Time, counter and inertial messages of both rates."""
        return not extended and can_id in _LENGTH

    def feed(self, seq: int, t_rx_ns: int, can_id: int, extended: bool, data: bytes) -> bool:
        """One frame; see :meth:`CanImuDecoder.feed`."""
        length = _LENGTH.get(can_id)
        if length is None or extended:
            return False
        self.counters.frames += 1
        if len(data) != length:
            self.counters.malformed += 1
            return True
        if can_id == SAMPLE_TIME:
            # Time and counter are of the slow group; high-rate samples are between them.
            if not self._high_rate:
                self._lead(t_rx_ns, stamp=_U32.unpack(data)[0])
        elif can_id == GROUP_COUNTER:
            if not self._high_rate:
                self._lead(t_rx_ns, count=_U16.unpack(data)[0])
        else:
            self._inertial(seq, t_rx_ns, can_id, data)
        return True

    def _inertial(self, seq: int, t_rx_ns: int, can_id: int, data: bytes) -> None:
        high_rate = can_id in (RATE_OF_TURN_HR, ACCELERATION_HR)
        if high_rate != self._high_rate:
            if not high_rate:
                return
            self._high_rate = True
            self._clear()
        x, y, z = _VECTOR.unpack(data)
        if can_id in (RATE_OF_TURN, RATE_OF_TURN_HR):
            self._gyro(seq, t_rx_ns, (x * GYRO_STEP, y * GYRO_STEP, z * GYRO_STEP))
        else:
            self._accel(seq, t_rx_ns, (x * ACCEL_STEP, y * ACCEL_STEP, z * ACCEL_STEP))


class XsensEncoder(CanImuEncoder):
    """Time, counter, rate of turn, acceleration, in the order that the unit sends them."""

    def __init__(self, *, stamped: bool = True, counted: bool = True) -> None:
        self._stamped, self._counted = stamped, counted
        self._count = 0

    def encode(self, samples: ImuSamples) -> list[CanFrame]:
        """Four frames a sample, fewer without time or counter."""
        gyro = quantised(samples.gyro_b, GYRO_STEP, GYRO_RANGE)
        accel = quantised(samples.accel_b, ACCEL_STEP, ACCEL_RANGE)
        frames = []
        for tick, g, a in zip((samples.t_ns // _TICK_NS).tolist(), gyro, accel, strict=True):
            if self._stamped:
                frames.append(CanFrame(SAMPLE_TIME, False, _U32.pack(tick & 0xFFFFFFFF)))
            if self._counted:
                frames.append(CanFrame(GROUP_COUNTER, False, _U16.pack(self._count)))
                self._count = (self._count + 1) & 0xFFFF
            frames.append(CanFrame(RATE_OF_TURN, False, _VECTOR.pack(*g)))
            frames.append(CanFrame(ACCELERATION, False, _VECTOR.pack(*a)))
        return frames


def quantised(values: np.ndarray, step: float, limit: float) -> list[list[int]]:
    """(N, 3) as whole steps, to the nearest, kept within ``limit`` and int16."""
    most = min(int(limit / step), 32767)
    steps: list[list[int]] = np.clip(np.rint(values / step), -most, most).astype(int).tolist()
    return steps
