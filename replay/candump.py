"""Recorded CAN traffic as columns: candump's log format, and through python-can all that it reads.

A line of ``candump -l`` is ``(SECONDS.FRACTION) CHANNEL ID#DATA``, the identifier in 3 (11 bit) or
8 (29 bit) hexadecimal digits; ``ID##FDATA`` is CAN FD with a digit of flags, ``ID#R`` a remote
frame; a direction may follow. Remote and error frames carry no samples and are left out. Whatever
is no line of this kind is counted and skipped.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion._jit import njit
from companion.types import I64, LogFormatError

U8 = NDArray[np.uint8]
Int = int | np.int64

READABLE_BY_PYTHON_CAN = (".asc", ".blf", ".csv", ".db", ".mf4", ".trc")
_GZIP = b"\x1f\x8b"
_ERROR_FLAG = 0x20000000
"""Of an identifier in candump's logs: an error frame."""
_TIME, _ID, _EXTENDED, _START, _LENGTH, _NAME_AT, _NAME_LENGTH = range(7)
_COLUMNS = 7


@dataclass(frozen=True, slots=True)
class CanFrames:
    """Data frames of a recording, in its order; all columns have one entry a frame."""

    t_ns: I64
    """Time of arrival as recorded [ns]: Unix time for candump."""
    channel: I64
    """Index into :attr:`channels`."""
    can_id: I64
    extended: NDArray[np.bool_]
    start: I64
    """Where the frame's bytes begin in :attr:`data`."""
    length: I64
    data: bytes
    channels: tuple[str, ...]
    bad_lines: int = 0
    """Lines, or records, that are no frame."""

    def __len__(self) -> int:
        return int(self.t_ns.shape[0])


@njit("i8(u1)", cache=True)
def _hex(c: Int) -> Int:
    """Value of a hexadecimal digit; −1 for anything else."""
    if 48 <= c <= 57:
        return np.int64(c) - 48
    if 65 <= c <= 70:
        return np.int64(c) - 55
    if 97 <= c <= 102:
        return np.int64(c) - 87
    return np.int64(-1)


@njit("i8(Array(u1, 1, 'C', readonly=True), i8, i8, i8[::1])", cache=True)
def _stamp(buf: U8, at: Int, end: Int, row: I64) -> Int:
    """``(SECONDS.FRACTION) `` at ``at`` into ``row``; where it ends, or −1."""
    if at >= end or buf[at] != 40:
        return -1
    at += 1
    seconds, digits = np.int64(0), 0
    while at < end and 48 <= buf[at] <= 57 and digits < 11:
        seconds = seconds * 10 + np.int64(buf[at]) - 48
        at += 1
        digits += 1
    # Beyond 2262, nanoseconds do not fit.
    if digits == 0 or at >= end or buf[at] != 46 or seconds > 9_000_000_000:
        return -1
    at += 1
    unit, nanoseconds = np.int64(100_000_000), np.int64(0)
    while at < end and 48 <= buf[at] <= 57:
        nanoseconds += unit * (np.int64(buf[at]) - 48)
        unit //= 10
        at += 1
    if at + 1 >= end or buf[at] != 41 or buf[at + 1] != 32:
        return -1
    row[_TIME] = seconds * 1_000_000_000 + nanoseconds
    return at + 2


@njit("i8(Array(u1, 1, 'C', readonly=True), i8, i8, u1[::1], i8, i8[::1])", cache=True)
def _frame(buf: U8, at: Int, end: Int, out: U8, used: Int, row: I64) -> Int:
    """``ID#DATA`` at ``at``: bytes to ``out[used:]``, the rest to ``row``.

    Bytes written; −1: no frame; −2: a remote or error frame.
    """
    can_id, digits = np.int64(0), 0
    while at < end and buf[at] != 35:
        value = _hex(buf[at])
        if value < 0 or digits == 8:
            return -1
        can_id = can_id << 4 | value
        at += 1
        digits += 1
    if at >= end or (digits != 3 and digits != 8):
        return -1
    at += 1
    most = 8
    if at < end and buf[at] == 35:  # CAN FD: a digit of flags
        most = 64
        at += 2
        if at > end:
            return -1
    if at < end and (buf[at] == 82 or buf[at] == 114):
        return -2
    if digits == 8 and can_id & 0x20000000:
        return -2
    if can_id > 0x1FFFFFFF or (digits == 3 and can_id > 0x7FF):
        return -1
    length = 0
    while at < end and buf[at] != 32 and buf[at] != 13 and buf[at] != 95:
        if at + 1 >= end or length == most:
            return -1
        high, low = _hex(buf[at]), _hex(buf[at + 1])
        if high < 0 or low < 0:
            return -1
        out[used + length] = high << 4 | low
        length += 1
        at += 2
    row[_ID] = can_id
    row[_EXTENDED] = 1 if digits == 8 else 0
    row[_START] = used
    row[_LENGTH] = length
    return length


@njit(
    "Tuple((i8, i8, i8))(Array(u1, 1, 'C', readonly=True), i8[:, ::1], u1[::1])",
    cache=True,
    entry=True,
)
def _parse(buf: U8, rows: I64, out: U8) -> tuple[Int, Int, Int]:
    """All lines of ``buf``: frames found, bytes written to ``out``, lines that are none."""
    size = buf.shape[0]
    at, used = np.int64(0), np.int64(0)
    found, bad = 0, 0
    while at < size:
        end = at
        while end < size and buf[end] != 10:
            end += 1
        row = rows[found]
        place = np.int64(_stamp(buf, at, end, row))
        wrote = np.int64(-1)
        if place > 0:
            name = place
            while place < end and buf[place] != 32:
                place += 1
            row[_NAME_AT], row[_NAME_LENGTH] = name, place - name
            wrote = np.int64(_frame(buf, place + 1, end, out, used, row))
        if wrote >= 0:
            used += wrote
            found += 1
        elif wrote == -1 and end > at:
            bad += 1
        at = end + 1
    return found, used, bad


def parse_candump(text: bytes) -> CanFrames:
    """The frames of a candump log."""
    buf = np.frombuffer(text, np.uint8)
    lines = int(np.count_nonzero(buf == 10)) + 1
    rows = np.zeros((lines + 1, _COLUMNS), np.int64)
    out = np.zeros(buf.shape[0] // 2 + 64, np.uint8)
    found, used, bad = _parse(buf, rows, out)
    rows = rows[:found]
    channel, names = _channels(text, rows[:, _NAME_AT], rows[:, _NAME_LENGTH])
    return CanFrames(
        np.ascontiguousarray(rows[:, _TIME]),
        channel,
        np.ascontiguousarray(rows[:, _ID]),
        rows[:, _EXTENDED] != 0,
        np.ascontiguousarray(rows[:, _START]),
        np.ascontiguousarray(rows[:, _LENGTH]),
        out[:used].tobytes(),
        names,
        int(bad),
    )


def _channels(text: bytes, at: I64, length: I64) -> tuple[I64, tuple[str, ...]]:
    """Index of each frame's channel, and their names; the first eight bytes tell them apart."""
    buf = np.frombuffer(text + bytes(8), np.uint8)
    key = np.zeros(at.shape[0], np.int64)
    for i in range(8):
        key = key * 256 + np.where(i < length, buf[at + i], 0)
    _, first, index = np.unique(key, return_index=True, return_inverse=True)
    names = [text[a : a + n].decode("ascii", "replace") for a, n in
             zip(at[first].tolist(), length[first].tolist(), strict=True)]  # fmt: skip
    return index.astype(np.int64), tuple(names)


def read_frames(path: Path) -> CanFrames:
    """The frames of a recording by its name: ``.log``, also ``.gz``, else by python-can.

    Raises :class:`LogFormatError` where nothing in it is a CAN frame.
    """
    name = path.name.lower().removesuffix(".gz")
    if name.endswith(READABLE_BY_PYTHON_CAN):
        frames = _by_python_can(path)
    else:
        text = path.read_bytes()
        if text.startswith(_GZIP):
            text = _unpacked(path, text)
        frames = parse_candump(text)
    if not len(frames):
        raise LogFormatError(f"{path}: no CAN frame in it")
    return frames


def _unpacked(path: Path, data: bytes) -> bytes:
    """What a gzip file holds; of one that was cut off, all that can be read."""
    unpacker = zlib.decompressobj(wbits=31)
    try:
        return unpacker.decompress(data)
    except zlib.error as error:
        raise LogFormatError(f"{path}: damaged gzip file: {error}") from None


def _by_python_can(path: Path) -> CanFrames:
    """Formats of other tools (Vector, PEAK, …); slower, frame by frame."""
    import can

    rows: list[tuple[int, int, int, bool, int, int]] = []
    data = bytearray()
    names: dict[str, int] = {}
    bad = 0
    try:
        with can.LogReader(path) as messages:
            for message in messages:
                if message.is_error_frame or message.is_remote_frame:
                    continue
                channel = names.setdefault(str(message.channel), len(names))
                t_ns = round(message.timestamp * 1e6) * 1000
                can_id, extended = message.arbitration_id, bool(message.is_extended_id)
                rows.append((t_ns, channel, can_id, extended, len(data), len(message.data)))
                data += message.data
    except Exception as error:  # readers of formats raise what they like on damaged files
        if not rows:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise LogFormatError(f"{path}: python-can cannot read it: {reason}") from None
        bad = 1
    table = np.array(rows, np.int64).reshape(-1, 6)
    t_ns, channel_of, can_ids, extended_of, start, length = np.ascontiguousarray(table.T)
    return CanFrames(
        t_ns, channel_of, can_ids, extended_of != 0, start, length, bytes(data), tuple(names), bad
    )


def candump_line(t_ns: int, channel: str, can_id: int, extended: bool, data: bytes) -> str:
    """A frame as ``candump -l`` writes it, to the microsecond."""
    seconds, rest = divmod(t_ns, 1_000_000_000)
    name = f"{can_id:08X}" if extended else f"{can_id:03X}"
    return f"({seconds:010d}.{rest // 1000:06d}) {channel} {name}#{data.hex().upper()}\n"


def looks_like_candump(head: bytes) -> bool:
    """Whether the beginning of a file is that of a candump log, packed or not."""
    if head.startswith(_GZIP):
        try:
            head = zlib.decompressobj(wbits=31).decompress(head, 256)
        except zlib.error:
            return False
    return len(parse_candump(head[: head.rfind(b"\n") + 1])) > 0


__all__ = ["CanFrames", "candump_line", "looks_like_candump", "parse_candump", "read_frames"]
