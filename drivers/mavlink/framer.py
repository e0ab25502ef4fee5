"""Find and check MAVLink 1 and 2 frames in bytes, whole files at once or as they arrive.

A frame counts only if its CRC (X.25 over everything after the magic byte, then the message's seed)
holds. What is not a frame is skipped byte by byte, counted, and never raises. Frames of unknown
messages cannot be checked: they are kept, marked, only where the stream is in step before and
after them. Format: mavlink.io/en/guide/serialization.html; signatures are located, not verified.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion._jit import njit
from drivers.mavlink.dialect import crc_table

U8 = NDArray[np.uint8]
Int = int | np.int64

(
    _STAMP,
    _START,
    _VERSION,
    _MSGID,
    _SYSTEM,
    _COMPONENT,
    _SEQ,
    _PAYLOAD,
    _LENGTH,
    _CHECKED,
    _SIGNED,
) = range(11)
_COLUMNS = 11
_BATCH = 1 << 16
_BAD_BYTES, _BAD_CRC = range(2)

MAX_FRAME = 10 + 255 + 2 + 13
"""Longest frame on the wire [bytes]: MAVLink 2 with a signature."""
STAMP_BYTES = 8
"""A tlog has 8 bytes, big-endian microseconds of Unix time, before each frame."""


@njit("i8(Array(u1, 1, 'C', readonly=True), i8, i8, i8)", cache=True, entry=True)
def checksum(buf: U8, start: Int, end: Int, seed: Int) -> Int:
    """CRC-16/MCRF4XX of ``buf[start:end]`` followed by the byte ``seed``: a frame's checksum.

    ``start`` is the byte after the magic, ``end`` the end of the payload, ``seed`` the message's.
    """
    crc = np.int64(0xFFFF)
    for i in range(start, end + 1):
        byte = np.int64(buf[i]) if i < end else np.int64(seed)
        t = byte ^ (crc & 0xFF)
        t = (t ^ (t << 4)) & 0xFF
        crc = (crc >> 8) ^ (t << 8) ^ (t << 3) ^ (t >> 4)
    return crc


@njit(
    "i8(Array(u1, 1, 'C', readonly=True), i8, Array(i2, 2, 'C', readonly=True), i8[::1])",
    cache=True,
)
def _parse(buf: U8, at: Int, table: NDArray[np.int16], row: NDArray[np.int64]) -> Int:
    """Try a frame at ``at``; fill ``row``. Its end; 0 no frame; −1 cut short; −2 bad CRC."""
    size = buf.shape[0]
    if at >= size:
        return -1
    magic = buf[at]
    if magic != 0xFD and magic != 0xFE:
        return 0
    head = 10 if magic == 0xFD else 6
    if at + head > size:
        return -1
    length = np.int64(buf[at + 1])
    signed = np.int64(0)
    if magic == 0xFD:
        # Any incompatibility flag but "signed" means a layout that we do not know.
        if buf[at + 2] > 1:
            return 0
        signed = np.int64(buf[at + 2])
        msgid = np.int64(buf[at + 7]) | (np.int64(buf[at + 8]) << 8) | (np.int64(buf[at + 9]) << 16)
        ids = at + 4
    else:
        msgid = np.int64(buf[at + 5])
        ids = at + 2
    seed = np.int64(-1)
    if msgid < table.shape[0]:
        seed = np.int64(table[msgid, 0])
        # Newer firmware may append extension fields, hence the margin; without a bound, long
        # runs of magic bytes would cost a full CRC for each byte.
        if seed >= 0 and length > table[msgid, 1] + 32:
            return 0
    body = at + head + length
    end = body + 2 + 13 * signed
    if end > size:
        return -1
    if seed >= 0:
        crc = np.int64(buf[body]) | (np.int64(buf[body + 1]) << 8)
        if checksum(buf, at + 1, body, seed) != crc:
            return -2
    row[_START] = at
    row[_VERSION] = 2 if magic == 0xFD else 1
    row[_MSGID] = msgid
    row[_SEQ] = buf[ids]
    row[_SYSTEM] = buf[ids + 1]
    row[_COMPONENT] = buf[ids + 2]
    row[_PAYLOAD] = at + head
    row[_LENGTH] = length
    row[_CHECKED] = 1 if seed >= 0 else 0
    row[_SIGNED] = signed
    return end


@njit("b1(Array(u1, 1, 'C', readonly=True), i8, b1)", cache=True)
def _in_step(buf: U8, at: Int, final: bool) -> bool:
    """Whether the next frame starts at ``at``, or the data end there."""
    if at >= buf.shape[0]:
        return final
    return bool(buf[at] == 0xFD or buf[at] == 0xFE)


@njit(
    "UniTuple(i8, 2)(Array(u1, 1, 'C', readonly=True), i8, b1, b1, i8,"
    " Array(i2, 2, 'C', readonly=True), i8[:, ::1], i8[::1])",
    cache=True,
    entry=True,
)
def _scan(
    buf: U8,
    start: Int,
    final: bool,
    strict: bool,
    stamp: int,
    table: NDArray[np.int16],
    out: NDArray[np.int64],
    counts: NDArray[np.int64],
) -> tuple[Int, int]:
    """Fill ``out`` from ``start`` on: (bytes settled, frames found).

    ``strict``: frames of unknown messages, which nobody can check, are none.
    Stops when ``out`` is full, at the end of the data, or, unless ``final``, where a frame may
    be waiting for its rest.
    """
    size = buf.shape[0]
    pos: Int = start  # everything before is settled: frames or counted garbage
    at: Int = start + stamp
    found = 0
    expected = True  # at the place where the last frame says that the next one is
    while found < out.shape[0] and pos < size:
        end = _parse(buf, at, table, out[found])
        known = end > 0 and out[found, _CHECKED] == 1
        if known or (not strict and end > 0 and expected and _in_step(buf, end + stamp, final)):
            when = np.int64(0)
            if stamp > 0 and at >= stamp:
                for i in range(at - stamp, at):
                    when = (when << 8) | np.int64(buf[i])
            out[found, _STAMP] = when
            counts[_BAD_BYTES] += max(at - stamp - pos, 0)
            found += 1
            pos = end
            at = end + stamp
            expected = True
            continue
        if end == -1 and not final:
            break
        if end == -2 and expected:
            counts[_BAD_CRC] += 1
        # After a frame that is not where it should be, bytes may be missing as well as extra:
        # search from the first byte that is not settled.
        at = pos if expected and stamp > 0 else at + 1
        expected = False
        if at >= size:
            if final:
                counts[_BAD_BYTES] += size - pos
                pos = size
            break
    if not final and stamp == 0 and found < out.shape[0]:
        # No frame begins before ``at``: noise must not be searched again with every piece.
        counts[_BAD_BYTES] += at - pos
        pos = at
    return pos, found


@dataclass(frozen=True, slots=True)
class FrameIndex:
    """Where the frames of a buffer are; all columns have one entry a frame, in stream order."""

    stamp_us: NDArray[np.int64]
    """Wall stamp as found in a tlog [µs of Unix time], unrepaired; 0 without stamps."""
    start: NDArray[np.int64]
    """Offset of the magic byte."""
    version: NDArray[np.uint8]
    """1 or 2."""
    msgid: NDArray[np.int32]
    system: NDArray[np.uint8]
    component: NDArray[np.uint8]
    seq: NDArray[np.uint8]
    payload: NDArray[np.int64]
    """Offset of the payload."""
    length: NDArray[np.uint8]
    """Payload bytes on the wire; MAVLink 2 cuts trailing zeros off."""
    checked: NDArray[np.bool_]
    """True where the CRC was checked (and held); False for messages outside the dialect."""
    signed: NDArray[np.bool_]
    """A 13-byte signature follows; it is not verified here."""
    bad_bytes: int = 0
    """Bytes that belong to no frame."""
    bad_crc: int = 0
    """Frames in their place whose CRC did not hold (their bytes are among ``bad_bytes``)."""

    def __len__(self) -> int:
        return int(self.start.shape[0])


_TYPES = (
    np.int64,
    np.int64,
    np.uint8,
    np.int32,
    np.uint8,
    np.uint8,
    np.uint8,
    np.int64,
    np.uint8,
    np.bool_,
    np.bool_,
)


_NAMES = tuple(f.name for f in fields(FrameIndex))[:_COLUMNS]


def _index(buf: U8, *, final: bool, stamped: bool, strict: bool = False) -> tuple[FrameIndex, Int]:
    """Frames of ``buf`` and how many of its bytes are settled."""
    counts = np.zeros(2, np.int64)
    stamp = STAMP_BYTES if stamped else 0
    batches: list[list[NDArray[np.generic]]] = []
    out = np.empty((min(_BATCH, buf.shape[0] // 8 + 1), _COLUMNS), np.int64)
    pos: Int = 0
    found: Int = out.shape[0]
    while found == out.shape[0]:
        pos, found = _scan(buf, pos, final, strict, stamp, crc_table(), out, counts)
        # Narrow columns batch by batch: the wide table never grows with the file.
        batches.append([out[:found, i].astype(kind) for i, kind in enumerate(_TYPES)])
    columns: dict[str, NDArray[Any]] = {
        name: batches[0][i] if len(batches) == 1 else np.concatenate([b[i] for b in batches])
        for i, name in enumerate(_NAMES)
    }
    index = FrameIndex(**columns, bad_bytes=int(counts[_BAD_BYTES]), bad_crc=int(counts[_BAD_CRC]))
    return index, pos


def index_frames(buf: U8, *, stamped: bool = False) -> FrameIndex:
    """All frames of a whole buffer.

    ``buf`` is (N,) uint8, read-only allowed. ``stamped``: a tlog, with 8 bytes of big-endian
    microseconds before each frame. Never raises for its content.
    """
    return _index(np.ascontiguousarray(buf), final=True, stamped=stamped)[0]


class StreamFramer:
    """Frames out of a byte stream that arrives in pieces; bad bytes are counted and dropped.

    Frames of unknown messages count as bad bytes: noise that looks like one could otherwise
    swallow the good frames that it claims to be made of.
    """

    def __init__(self) -> None:
        self._rest = b""
        self.bad_bytes = 0
        self.bad_crc = 0

    def feed(self, data: bytes) -> tuple[U8, FrameIndex]:
        """Add bytes; the buffer and the index of the frames completed by them.

        The offsets of the index refer to the returned buffer, which is this call's own.
        """
        joined = self._rest + data
        buf = np.frombuffer(joined, np.uint8)
        index, settled = _index(buf, final=False, stamped=False, strict=True)
        self._rest = joined[settled:]
        self.bad_bytes += index.bad_bytes
        self.bad_crc += index.bad_crc
        return buf, index
