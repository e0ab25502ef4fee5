"""Protobuf messages of a fixed size, encoded many at a time.

Serialising one message in Python costs microseconds, and a run has one for each epoch. Here a
message whose fields all have a fixed width on the wire is a structured numpy row: the tags are
constants in a template, the values are columns. Every field is written, also when it is zero;
protobuf allows that, and any reader decodes the rows as it decodes its own.

Protocol Buffers, "Encoding": wire types 0 (varint), 1 (64-bit), 2 (length-delimited), 5 (32-bit).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.types import I64, NS

U8 = NDArray[np.uint8]

_WIRE = {"double": (1, "<f8"), "sfixed64": (1, "<i8"), "float": (5, "<f4"), "fixed32": (5, "<u4")}
_WIRE["sfixed32"] = (5, "<i4")
_WIRE["enum"] = (0, "u1")  # a varint below 128 is one byte


@dataclass(frozen=True, slots=True)
class Slot:
    """Where a column goes in the row."""

    name: str
    dtype: str
    width: int


Piece = bytes | Slot


def varint(value: int) -> bytes:
    """Base-128 encoding of a non-negative integer."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def scalar(number: int, kind: str, name: str) -> list[Piece]:
    """A single field of fixed width."""
    wire, dtype = _WIRE[kind]
    return [varint(number << 3 | wire), Slot(name, dtype, 1)]


def packed(number: int, kind: str, name: str, width: int) -> list[Piece]:
    """A repeated field of always ``width`` values, packed."""
    dtype = _WIRE[kind][1]
    return [varint(number << 3 | 2) + varint(np.dtype(dtype).itemsize * width),
            Slot(name, dtype, width)]  # fmt: skip


def nested(number: int, pieces: Sequence[Piece]) -> list[Piece]:
    """A message inside the message."""
    length = sum(
        len(p) if isinstance(p, bytes) else np.dtype(p.dtype).itemsize * p.width for p in pieces
    )
    return [varint(number << 3 | 2) + varint(length), *pieces]


def text(number: int, value: str) -> list[Piece]:
    """A constant string."""
    data = value.encode()
    return [varint(number << 3 | 2) + varint(len(data)) + data]


def timestamp(number: int) -> list[Piece]:
    """A ``google.protobuf.Timestamp`` in slots ``seconds`` and ``nanos``.

    Both are varints padded to five bytes, which holds any time that int64 nanoseconds can.
    """
    return nested(number, [b"\x08", Slot("seconds", "u1", 5), b"\x10", Slot("nanos", "u1", 5)])


def timestamp_columns(t_ns: I64) -> dict[str, U8]:
    """Values for the slots of :func:`timestamp`; a time before zero is given as zero."""
    seconds, nanos = np.divmod(np.maximum(t_ns, 0), NS)
    return {"seconds": _padded_varint(seconds), "nanos": _padded_varint(nanos)}


def _padded_varint(value: I64) -> U8:
    """(N, 5) bytes, continuation bits set on the first four."""
    groups = (value[:, None] >> np.array([0, 7, 14, 21, 28])) & 0x7F
    groups[:, :4] |= 0x80
    padded: U8 = groups.astype(np.uint8)
    return padded


class RowTemplate:
    """Layout of one message type as rows of equal length."""

    def __init__(self, *groups: Sequence[Piece]) -> None:
        layout: list[tuple[str, Any, Any]] = []
        constants: dict[str, bytes] = {}
        for i, piece in enumerate(p for group in groups for p in group):
            if isinstance(piece, Slot):
                layout.append((piece.name, piece.dtype, (piece.width,) if piece.width > 1 else ()))
            else:
                constants[f"#{i}"] = piece
                layout.append((f"#{i}", "u1", (len(piece),)))
        self._dtype = np.dtype(layout)
        row = np.zeros(1, self._dtype)
        fixed = np.zeros(1, self._dtype)
        for name, data in constants.items():
            row[name] = np.frombuffer(data, np.uint8)
            fixed[name] = 0xFF
        self._row = row
        self._constant_bytes = np.flatnonzero(fixed.view(np.uint8))
        self._constants = row.view(np.uint8)[self._constant_bytes]
        self.size = self._dtype.itemsize
        """Length of one message [bytes]."""

    def encode(self, columns: Mapping[str, Any], n: int) -> U8:
        """Messages (n, size) of ``columns``, one for each slot, each (n,) or (n, width)."""
        rows: NDArray[Any] = np.repeat(self._row, n)
        for name, column in columns.items():
            rows[name] = column
        data: U8 = rows.view(np.uint8).reshape(n, self.size)
        return data

    def decode(self, payloads: Sequence[bytes]) -> NDArray[Any] | None:
        """Structured rows of messages that have this layout; None where one has not.

        Another program may lay the same message out differently: then the caller parses it.
        """
        if any(len(p) != self.size for p in payloads):
            return None
        rows = np.frombuffer(b"".join(payloads), np.uint8).reshape(-1, self.size)
        if not np.array_equal(
            rows[:, self._constant_bytes],
            np.broadcast_to(self._constants, (len(rows), self._constants.size)),
        ):
            return None
        decoded: NDArray[Any] = rows.view(self._dtype)[:, 0]
        return decoded
