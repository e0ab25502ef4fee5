"""Aceinna OpenIMU300RI over SAE J1939: little-endian, 29-bit identifiers, no time and no counter.

PGN 61482 (ARI) rate of turn, 3 × uint16 of 1/128 deg/s from −250 deg/s; PGN 61485 (ACCS)
acceleration, 3 × uint16 of 0.01 m/s² from −320 m/s². The identifier ends in the unit's source
address. Raw values from 0xFE00 on mean "error" or "not available". Firmware with other scales is
read through a DBC file. Aceinna, "CAN J1939 Data Messages"; SAE J1939-71.
"""

from __future__ import annotations

import math
import struct

import numpy as np

from companion.types import F64, ImuSamples
from drivers.can_imu.decoder import CanFrame, CanImuEncoder, Unit
from drivers.can_imu.grouping import GroupedDecoder

_PGN_MASK = 0x03FFFF00
_ARI, _ACCS = 61482 << 8, 61485 << 8
ARI_ID, ACCS_ID = 0x0CF02A00, 0x08F02D00
"""With the priorities that the unit uses, less the source address."""

_GYRO_STEP = math.radians(1.0 / 128.0)
_GYRO_FROM = math.radians(-250.0)
_ACCEL_STEP = 0.01
_ACCEL_FROM = -320.0
_LARGEST = 0xFAFF
"""Largest raw value of a measurement; what lies between it and errors is reserved."""
_ERROR = 0xFE00
_VECTOR = struct.Struct("<3H")
_FULL_SCALE = (
    *(min(-_GYRO_FROM, _LARGEST * _GYRO_STEP + _GYRO_FROM),) * 3,
    *(min(-_ACCEL_FROM, _LARGEST * _ACCEL_STEP + _ACCEL_FROM),) * 3,
)


class OpenImuDecoder(GroupedDecoder):
    """One OpenIMU by its source address; validity is the arrival of the first frame of a pair."""

    steps = (_GYRO_STEP, _ACCEL_STEP)

    def __init__(self, unit: Unit, node_id: int = 0) -> None:
        """``node_id``: source address; 0: the first unit heard."""
        super().__init__(unit, _FULL_SCALE)
        self.node_id = node_id

    def wants(self, can_id: int, extended: bool) -> bool:
        """Angular rate and acceleration of the address, or of any."""
        ours = not self.node_id or can_id & 0xFF == self.node_id
        return extended and can_id & _PGN_MASK in (_ARI, _ACCS) and ours

    def feed(self, seq: int, t_rx_ns: int, can_id: int, extended: bool, data: bytes) -> bool:
        """One frame; see :meth:`CanImuDecoder.feed`."""
        pgn = can_id & _PGN_MASK
        if not extended or (pgn != _ARI and pgn != _ACCS):
            return False
        address = can_id & 0xFF
        if address != self.node_id:
            if self.node_id:
                return False
            self.node_id = address
        self.counters.frames += 1
        if len(data) != 8:
            self.counters.malformed += 1
            return True
        x, y, z = _VECTOR.unpack_from(data)
        if x >= _ERROR or y >= _ERROR or z >= _ERROR:
            self.counters.malformed += 1
        elif pgn == _ARI:
            s, o = _GYRO_STEP, _GYRO_FROM
            self._gyro(seq, t_rx_ns, (x * s + o, y * s + o, z * s + o))
        else:
            s, o = _ACCEL_STEP, _ACCEL_FROM
            self._accel(seq, t_rx_ns, (x * s + o, y * s + o, z * s + o))
        return True


class OpenImuEncoder(CanImuEncoder):
    """Rate of turn, then acceleration."""

    def __init__(self, node_id: int = 0x80) -> None:
        self._address = node_id

    def encode(self, samples: ImuSamples) -> list[CanFrame]:
        """Two frames a sample; the last two bytes are "not available"."""
        gyro = _raw(samples.gyro_b, _GYRO_STEP, _GYRO_FROM)
        accel = _raw(samples.accel_b, _ACCEL_STEP, _ACCEL_FROM)
        frames = []
        for g, a in zip(gyro, accel, strict=True):
            frames.append(CanFrame(ARI_ID | self._address, True, _VECTOR.pack(*g) + b"\xff\xff"))
            frames.append(CanFrame(ACCS_ID | self._address, True, _VECTOR.pack(*a) + b"\xff\xff"))
        return frames


def _raw(values: F64, step: float, start: float) -> list[list[int]]:
    raw: list[list[int]] = (
        np.clip(np.rint((values - start) / step), 0, _LARGEST).astype(int).tolist()
    )
    return raw
