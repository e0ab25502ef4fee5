"""SBG Systems Ellipse and Ekinox: little-endian, 11-bit identifiers.

0x120 time uint32 in µs, status uint16, temperature int16; 0x121 acceleration, 3 × int16 of 0.01
m/s²; 0x122 rate of turn, 3 × int16 of 0.001 rad/s. The identifiers are the unit's defaults. Axes:
x forward, y right, z down. SBG Systems, "sbgCan.dbc" and the CAN chapter of the firmware manual.
"""

from __future__ import annotations

import struct

from companion.types import ImuSamples
from drivers.can_imu.clock import Unwrapped
from drivers.can_imu.decoder import CanFrame, CanImuEncoder, Unit
from drivers.can_imu.grouping import GroupedDecoder
from drivers.can_imu.xsens import quantised

IMU_INFO, IMU_ACCEL, IMU_GYRO = 0x120, 0x121, 0x122
GYRO_STEP = 0.001
"""[rad/s]"""
ACCEL_STEP = 0.01
"""[m/s²]"""
_INFO, _VECTOR = struct.Struct("<IHh"), struct.Struct("<3h")
_FULL_SCALE = (32767 * GYRO_STEP,) * 3 + (32767 * ACCEL_STEP,) * 3


class SbgDecoder(GroupedDecoder):
    """One Ellipse."""

    steps = (GYRO_STEP, ACCEL_STEP)

    def __init__(self, unit: Unit) -> None:
        super().__init__(unit, _FULL_SCALE, clock=Unwrapped(32, 1000))

    def wants(self, can_id: int, extended: bool) -> bool:
        """The three messages of the IMU."""
        return not extended and IMU_INFO <= can_id <= IMU_GYRO

    def feed(self, seq: int, t_rx_ns: int, can_id: int, extended: bool, data: bytes) -> bool:
        """One frame; see :meth:`CanImuDecoder.feed`."""
        if not IMU_INFO <= can_id <= IMU_GYRO or extended:
            return False
        self.counters.frames += 1
        if len(data) != (_INFO.size if can_id == IMU_INFO else _VECTOR.size):
            self.counters.malformed += 1
        elif can_id == IMU_INFO:
            self._lead(t_rx_ns, stamp=_INFO.unpack(data)[0])
        else:
            x, y, z = _VECTOR.unpack(data)
            if can_id == IMU_GYRO:
                self._gyro(seq, t_rx_ns, (x * GYRO_STEP, y * GYRO_STEP, z * GYRO_STEP))
            else:
                self._accel(seq, t_rx_ns, (x * ACCEL_STEP, y * ACCEL_STEP, z * ACCEL_STEP))
        return True


class SbgEncoder(CanImuEncoder):
    """Time, acceleration, rate of turn."""

    def encode(self, samples: ImuSamples) -> list[CanFrame]:
        """Three frames a sample."""
        gyro = quantised(samples.gyro_b, GYRO_STEP, _FULL_SCALE[0])
        accel = quantised(samples.accel_b, ACCEL_STEP, _FULL_SCALE[3])
        frames = []
        for t_us, g, a in zip((samples.t_ns // 1000).tolist(), gyro, accel, strict=True):
            frames.append(CanFrame(IMU_INFO, False, _INFO.pack(t_us & 0xFFFFFFFF, 0x03FF, 2500)))
            frames.append(CanFrame(IMU_ACCEL, False, _VECTOR.pack(*a)))
            frames.append(CanFrame(IMU_GYRO, False, _VECTOR.pack(*g)))
        return frames
