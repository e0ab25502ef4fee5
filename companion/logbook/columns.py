"""Samples in columns to protobuf batches and back, bit for bit.

A column is a packed repeated field of 64-bit values, and that is, on the wire, the array's own
little-endian memory. So a batch is written by joining buffers and read by viewing them, and a NaN
keeps its payload.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.logbook.rows import varint
from companion.types import (
    SATELLITES,
    AnySamples,
    AttitudeSamples,
    BaroSamples,
    BroadcastSamples,
    GnssSamples,
    ImuSamples,
    LogFormatError,
    MagSamples,
    RawGnssSamples,
    ReferenceSamples,
    Solution,
)

AnyColumns = AnySamples | ReferenceSamples | Solution


@dataclass(frozen=True, slots=True)
class Column:
    """One field of a batch: attribute of the sample type, wire number, shape of a row.

    With a ``default`` it is left out where every row has that value, as in logs from before it.
    """

    name: str
    number: int
    dtype: str
    shape: tuple[int, ...] = ()
    default: float | None = None


@dataclass(frozen=True, slots=True)
class Batch:
    """How one sample type is laid out in its protobuf message."""

    message: str
    type: type[AnyColumns]
    columns: tuple[Column, ...]


_I, _F = "<i8", "<f8"
_ROWS = 2  # number of the column that every batch has: its times
_COMMON = (Column("t_ns", 2, _I), Column("t_rx_ns", 3, _I), Column("seq", 4, _I))

IMU = Batch(
    "companion.ImuBatch",
    ImuSamples,
    (
        *_COMMON,
        Column("gyro_b", 5, _F, (3,)),
        Column("accel_b", 6, _F, (3,)),
        Column("interval_s", 7, _F),
        Column("clipped", 8, _F, default=0.0),
    ),
)
GNSS = Batch(
    "companion.GnssBatch",
    GnssSamples,
    (
        *_COMMON,
        Column("lat", 5, _F),
        Column("lon", 6, _F),
        Column("height", 7, _F),
        Column("vel_n", 8, _F, (3,)),
        Column("sd_pos", 9, _F, (3,)),
        Column("sd_vel", 10, _F, (3,)),
        Column("num_sats", 11, _I),
        Column("fix_type", 12, _I),
        Column("interference", 13, _F, default=math.nan),
    ),
)
BARO = Batch("companion.BaroBatch", BaroSamples, (*_COMMON, Column("pressure", 5, _F)))
MAG = Batch("companion.MagBatch", MagSamples, (*_COMMON, Column("field_b", 5, _F, (3,))))
ATTITUDE = Batch("companion.AttitudeBatch", AttitudeSamples, (*_COMMON, Column("rpy", 5, _F, (3,))))
_SATS = (SATELLITES,)
RAW = Batch(
    "companion.RawGnssBatch",
    RawGnssSamples,
    (
        *_COMMON,
        Column("week", 5, _I),
        Column("tow", 6, _F),
        Column("sat", 7, _I, _SATS),
        Column("signal", 8, _I, _SATS),
        *(
            Column(name, number, _F, _SATS)
            for number, name in enumerate(
                ("pseudorange", "rate", "cn0", "sd_range", "sd_rate"), start=9
            )
        ),
    ),
)
BROADCAST = Batch(
    "companion.BroadcastBatch",
    BroadcastSamples,
    (*_COMMON, Column("sat", 5, _I), Column("values", 6, _F, (28,))),
)
REFERENCE = Batch(
    "companion.ReferenceBatch",
    ReferenceSamples,
    (
        *_COMMON,
        Column("lat", 5, _F),
        Column("lon", 6, _F),
        Column("height", 7, _F),
        Column("vel_n", 8, _F, (3,)),
        Column("rpy", 9, _F, (3,)),
    ),
)
SOLUTION = Batch(
    "companion.SolutionBatch",
    Solution,
    (
        Column("t_ns", 2, _I),
        Column("lat", 3, _F),
        Column("lon", 4, _F),
        Column("height", 5, _F),
        Column("vel_n", 6, _F, (3,)),
        Column("q_nb", 7, _F, (4,)),
        Column("accel_bias_b", 8, _F, (3,)),
        Column("gyro_bias_b", 9, _F, (3,)),
        Column("cov", 10, _F, (5, 6)),
        Column("mode", 11, _I),
        Column("resets", 12, _I),
    ),
)


def join(batch: Batch, parts: Sequence[AnyColumns]) -> dict[str, NDArray[Any]]:
    """Columns of all ``parts``, one after the other, in wire form."""
    if len(parts) == 1:
        return {
            c.name: np.ascontiguousarray(getattr(parts[0], c.name), c.dtype) for c in batch.columns
        }
    return {
        c.name: np.concatenate([getattr(p, c.name) for p in parts]).astype(c.dtype, copy=False)
        for c in batch.columns
    }


def encode(
    batch: Batch, source: str, columns: dict[str, NDArray[Any]], start: int, stop: int
) -> bytes:
    """The message of rows ``start`` to ``stop`` of :func:`join`'s columns."""
    name = source.encode()
    pieces: list[bytes] = [b"\x0a", varint(len(name)), name]
    for c in batch.columns:
        rows = columns[c.name][start:stop]
        if c.default is not None and _all(rows, c.default):
            continue
        data = rows.tobytes()
        pieces += (varint(c.number << 3 | 2), varint(len(data)), data)
    return b"".join(pieces)


def _all(rows: NDArray[Any], value: float) -> bool:
    """Whether every one of ``rows`` is ``value``, bit for bit."""
    return bool(rows.tobytes() == np.full(len(rows), value, rows.dtype).tobytes())


def source_of(payload: bytes) -> str:
    """The stream's name, field 1 of every batch; LogFormatError where it is not readable."""
    found = [value for number, value in fields(payload) if number == 1]
    try:
        return found[-1].decode() if found else ""
    except UnicodeDecodeError:
        raise LogFormatError("a batch names its stream in bytes that are not UTF-8") from None


def decode(batch: Batch, payloads: Sequence[bytes]) -> dict[str, NDArray[Any]]:
    """Columns of many messages of one stream, in the order given.

    Raises :class:`LogFormatError` when a message is not a batch of this type.
    """
    by_number: dict[int, list[bytes]] = {c.number: [] for c in batch.columns}
    for payload in payloads:
        rows = set()
        found = dict.fromkeys(by_number, b"")
        for number, value in fields(payload):
            if number in found:
                found[number] += value
        for c in batch.columns:
            if c.default is not None and not found[c.number]:
                found[c.number] = np.full(len(found[_ROWS]) // 8, c.default, c.dtype).tobytes()
            count, rest = divmod(len(found[c.number]), 8 * int(np.prod(c.shape, dtype=int)))
            rows.add(count if rest == 0 else -1)
            by_number[c.number].append(found[c.number])
        if len(rows) != 1 or -1 in rows:
            raise LogFormatError(f"{batch.message}: columns of unequal length")
    return {
        c.name: np.frombuffer(bytearray(b"".join(by_number[c.number])), c.dtype).reshape(
            -1, *c.shape
        )
        for c in batch.columns
    }


def fields(payload: bytes) -> list[tuple[int, bytes]]:
    """Length-delimited fields of a protobuf message; others are skipped.

    Raises :class:`LogFormatError` when the bytes are not a protobuf message.
    """
    out: list[tuple[int, bytes]] = []
    at, end = 0, len(payload)
    while at < end:
        key, at = _read_varint(payload, at)
        wire = key & 7
        if wire == 0:
            _, at = _read_varint(payload, at)
            continue
        if wire == 2:
            length, at = _read_varint(payload, at)
        elif wire in (1, 5):
            length = 8 if wire == 1 else 4
        else:
            raise LogFormatError("not a protobuf message")
        if at + length > end:
            raise LogFormatError("a protobuf field reaches past the end of its message")
        if wire == 2:
            out.append((key >> 3, payload[at : at + length]))
        at += length
    return out


def _read_varint(payload: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while at < len(payload) and shift < 70:
        byte = payload[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
    raise LogFormatError("a protobuf number does not end")
