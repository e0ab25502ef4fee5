"""ArduPilot DataFlash (.BIN) as a pure codec: records indexed by a kernel, columns by dtype.

A record is A3 95, a type byte, and a body whose length and layout an FMT record (type 0x80) of
the same file declares. There is no checksum: a record counts if another one, or the end of the
data, follows it. Format: ardupilot.org/dev/docs/code-overview-adding-a-new-log-message.html.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion._jit import njit
from companion.types import F64, I64

U8 = NDArray[np.uint8]

_FMT = 0x80
_FMT_LENGTH = 89
_BATCH = 1 << 16

_WIRE: dict[str, tuple[str, float]] = {
    "b": ("i1", 1.0),
    "B": ("u1", 1.0),
    "M": ("u1", 1.0),
    "h": ("<i2", 1.0),
    "H": ("<u2", 1.0),
    "i": ("<i4", 1.0),
    "I": ("<u4", 1.0),
    "q": ("<i8", 1.0),
    "Q": ("<u8", 1.0),
    "g": ("<f2", 1.0),
    "f": ("<f4", 1.0),
    "d": ("<f8", 1.0),
    "n": ("S4", 1.0),
    "N": ("S16", 1.0),
    "Z": ("S64", 1.0),
    "a": ("S64", 1.0),
    "c": ("<i2", 0.01),
    "C": ("<u2", 0.01),
    "e": ("<i4", 0.01),
    "E": ("<u4", 0.01),
    "L": ("<i4", 1e-7),
}
"""Wire type and multiplier of each format letter; ``L`` is degrees · 1e7."""


@njit(
    "UniTuple(i8, 2)(Array(u1, 1, 'C', readonly=True), i8, i8[::1], u1[::1], i8[::1], i8[::1])",
    cache=True,
    entry=True,
)
def _scan(
    buf: U8, start: int, lengths: I64, kinds: U8, offsets: I64, counts: I64
) -> tuple[int, int]:
    """Index records from ``start`` on: (where it stopped, records found).

    ``lengths`` (256,) is filled from FMT records as they come; the first definition of a type
    holds. ``counts[0]`` adds up the bytes that belong to no record.
    """
    size = buf.shape[0]
    pos = start
    found = 0
    while pos + 3 <= size and found < kinds.shape[0]:
        if buf[pos] == 0xA3 and buf[pos + 1] == 0x95:
            length = lengths[buf[pos + 2]]
            end = pos + length
            if length > 0 and end <= size:
                follows = end + 2 > size or (buf[end] == 0xA3 and buf[end + 1] == 0x95)
                if follows:
                    if buf[pos + 2] == _FMT and lengths[buf[pos + 3]] == 0 and buf[pos + 4] > 3:
                        lengths[buf[pos + 3]] = buf[pos + 4]
                    kinds[found] = buf[pos + 2]
                    offsets[found] = pos
                    found += 1
                    pos = end
                    continue
        counts[0] += 1
        pos += 1
    if found < kinds.shape[0]:
        counts[0] += size - pos
        pos = size
    return pos, found


@njit("void(Array(u1, 1, 'C', readonly=True), i8[::1], u1[:, ::1])", cache=True, entry=True)
def _gather(buf: U8, offsets: I64, out: NDArray[np.uint8]) -> None:
    """Copy the record at each offset into its row."""
    for i in range(offsets.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = buf[offsets[i] + j]


@dataclass(frozen=True, slots=True)
class Columns:
    """All records of one message: physical values by label, and where they stood."""

    name: str
    values: dict[str, F64]
    """(N,) each, multipliers applied; text fields are left out."""
    integers: dict[str, I64]
    """(N,) the raw whole numbers of integer fields, for stamps that a float would round."""
    order: I64
    """(N,) record number within the file: the order of logging."""

    def __len__(self) -> int:
        return int(self.order.shape[0])

    def has(self, *labels: str) -> bool:
        """Whether there are records and they carry all of ``labels``."""
        return len(self) > 0 and all(label in self.values for label in labels)

    def take(self, index: NDArray[np.bool_]) -> Columns:
        """The same columns, restricted to the rows of ``index``."""
        return Columns(
            self.name,
            {k: v[index] for k, v in self.values.items()},
            {k: v[index] for k, v in self.integers.items()},
            self.order[index],
        )


@dataclass(frozen=True, slots=True)
class DataFlash:
    """An indexed log; columns are decoded when asked for."""

    buf: U8
    kinds: U8
    """(R,) type of each record, in order of logging."""
    offsets: I64
    """(R,) where it starts."""
    formats: dict[str, tuple[int, np.dtype[np.void], str]]
    """Message name → type, dtype of the whole record, format letters."""
    bad_bytes: int

    def __len__(self) -> int:
        return int(self.kinds.shape[0])

    def columns(self, name: str) -> Columns:
        """The records of message ``name``; empty columns where there are none."""
        if name not in self.formats:
            return Columns(name, {}, {}, np.zeros(0, np.int64))
        kind, dtype, letters = self.formats[name]
        order = np.flatnonzero(self.kinds == kind)
        raw = np.zeros((order.shape[0], dtype.itemsize), np.uint8)
        _gather(self.buf, self.offsets[order], raw)
        table = raw.view(dtype)[:, 0]
        values: dict[str, F64] = {}
        integers: dict[str, I64] = {}
        labels = [label for label in dtype.names or () if label != "_head"]
        for label, letter in zip(labels, letters, strict=True):
            wire, scale = _WIRE[letter]
            if wire.startswith("S"):
                continue
            with np.errstate(invalid="ignore"):  # corrupt floats may be signalling NaN
                values[label] = table[label].astype(np.float64) * scale
            if table[label].dtype.kind in "iu":
                integers[label] = table[label].astype(np.int64)
        return Columns(name, values, integers, order)


def _text(raw: U8) -> str:
    return bytes(raw).split(b"\0")[0].decode("ascii", "replace").strip()


def _format(body: U8) -> tuple[str, np.dtype[np.void], str] | None:
    """Name, record dtype and letters of an FMT body; None if it contradicts itself."""
    name, letters = _text(body[2:6]), _text(body[6:22])
    labels = _text(body[22:86]).split(",")
    if not name or len(labels) != len(letters) or len(set(labels)) != len(labels):
        return None
    if not all(letter in _WIRE for letter in letters) or not all(labels):
        return None
    fields = [
        ("_head", "V3"),
        *((lb, _WIRE[le][0]) for lb, le in zip(labels, letters, strict=True)),
    ]
    dtype: np.dtype[np.void] = np.dtype(fields)
    return (name, dtype, letters) if dtype.itemsize == int(body[1]) else None


def index_dataflash(buf: U8) -> DataFlash:
    """Index a whole log; ``buf`` is (N,) uint8. Never raises for its content."""
    lengths = np.zeros(256, np.int64)
    lengths[_FMT] = _FMT_LENGTH
    counts = np.zeros(1, np.int64)
    capacity = min(_BATCH, buf.shape[0] // 4 + 1)
    kinds, offsets = np.empty(capacity, np.uint8), np.empty(capacity, np.int64)
    parts: list[tuple[U8, I64]] = []
    pos, found = 0, capacity
    while found == capacity:
        pos, found = _scan(buf, pos, lengths, kinds, offsets, counts)
        parts.append((kinds[:found].copy(), offsets[:found].copy()))
    all_kinds = np.concatenate([k for k, _ in parts])
    all_offsets = np.concatenate([o for _, o in parts])
    formats: dict[str, tuple[int, np.dtype[np.void], str]] = {}
    for at in all_offsets[all_kinds == _FMT]:
        body = buf[at + 3 : at + _FMT_LENGTH]
        parsed = _format(body)
        kind = int(body[0])
        if parsed and parsed[0] not in formats and lengths[kind] == parsed[1].itemsize:
            formats[parsed[0]] = (kind, parsed[1], parsed[2])
    return DataFlash(buf, all_kinds, all_offsets, formats, int(counts[0]))
