"""Appending to an MCAP file, many messages in one call.

The records are the ``mcap`` package's own; what is ours is the chunk: it takes whole arrays of
equally long messages, closes at a size or at an age, and is on its way to the disk in one write.
So a process that dies loses the open chunk and nothing before it, and a disk that fills up leaves
a file that ends with a whole chunk.

MCAP specification 0, https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from bisect import bisect_right
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from companion.logbook.sink import DirectFile, Hole, LogWriteError, Sink
from companion.types import I64

_HEAD = np.dtype(
    [("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"),
     ("log_time", "<u8"), ("publish_time", "<u8")]
)  # fmt: skip
"""What stands before the data of a Message record."""

_ONE_HEAD = struct.Struct("<BQHIQQ")
_ONE_INDEX = struct.Struct("<QQ")

_NEVER = 2**63 - 1
"""Later than every time."""

_INDEX = np.dtype([("log_time", "<u8"), ("offset", "<u8")])


class _Written(NamedTuple):
    """A chunk's place in the file and its messages by channel."""

    place: ChunkIndex
    counts: dict[int, int]


class McapFile:
    """An MCAP file being written. Not thread-safe; any failing write ends it.

    ``chunk_bytes`` and ``chunk_span_ns`` (of log time) bound what a power loss can take.
    """

    def __init__(
        self,
        path: Path,
        *,
        chunk_bytes: int = 128 * 1024,
        chunk_span_ns: int = 1_000_000_000,
        sink: Sink | None = None,
    ) -> None:
        self._path = path
        self._chunk_bytes = chunk_bytes
        self._chunk_span_ns = chunk_span_ns
        self._zstd = zstandard.ZstdCompressor(level=1)
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[_Written] = []
        self._counts: dict[int, int] = defaultdict(int)
        self._offset = 0
        self._pieces: list[bytes] = []
        self._index: dict[int, list[bytes]] = {}
        self._size = 0
        self._chunk_first = _NEVER
        self._chunk_last = 0
        self._sink: Sink = DirectFile(path) if sink is None else sink
        self.closed = False
        self._write(MCAP0_MAGIC + _record(Header(profile="", library="companion")), needed=True)

    def schema(self, name: str, data: bytes) -> int:
        """Declare a protobuf message type by its descriptor set; its id."""
        schema = Schema(len(self._schemas) + 1, data, "protobuf", name)
        self._schemas.append(schema)
        self._write(_record(schema), needed=True)
        return schema.id

    def channel(self, topic: str, schema_id: int, metadata: dict[str, str] | None = None) -> int:
        """Declare a topic; its id.

        Declarations stand between the chunks, not in them, so that a damaged chunk costs its own
        messages only.
        """
        channel = Channel(len(self._channels) + 1, topic, "protobuf", metadata or {}, schema_id)
        self._channels.append(channel)
        self._write(_record(channel), needed=True)
        return channel.id

    def message(self, channel: int, log_time_ns: int, data: bytes) -> None:
        """Append one message.

        MCAP times are unsigned: a time before zero is logged as zero.
        """
        time = max(log_time_ns, 0)
        self._make_room(time, time)
        self._counts[channel] += 1
        sequence = self._counts[channel] & 0xFFFFFFFF
        head = _ONE_HEAD.pack(
            Opcode.MESSAGE, len(data) + _HEAD.itemsize - 9, channel, sequence, time, time
        )
        self._append(channel, _ONE_INDEX.pack(time, self._size), head + data, time, time)

    def rows(self, channel: int, log_time_ns: I64, data: NDArray[np.uint8]) -> None:
        """Append messages (N, length) of one channel with their times (N,)."""
        n, length = data.shape
        if n == 0:
            return
        times = np.maximum(log_time_ns, 0)
        records = np.empty((n, _HEAD.itemsize + length), np.uint8)
        head = np.empty(n, _HEAD)
        head["op"] = Opcode.MESSAGE
        head["length"] = length + _HEAD.itemsize - 9
        head["channel"] = channel
        head["sequence"] = np.arange(self._counts[channel] + 1, self._counts[channel] + n + 1)
        head["log_time"] = times
        head["publish_time"] = times
        records[:, : _HEAD.itemsize] = head.view(np.uint8).reshape(n, -1)
        records[:, _HEAD.itemsize :] = data
        self._counts[channel] += n
        step = max(1, self._chunk_bytes // records.shape[1])
        for at in range(0, n, step):
            cut = times[at : at + step]
            first, last = int(cut.min()), int(cut.max())
            self._make_room(first, last)
            index = np.empty(len(cut), _INDEX)
            index["log_time"] = cut
            index["offset"] = self._size + records.shape[1] * np.arange(len(cut))
            piece = records[at : at + step].tobytes()
            self._append(channel, index.tobytes(), piece, first, last)

    def _make_room(self, first: int, last: int) -> None:
        """Close the open chunk where these times would stretch it too far."""
        if self.closed:
            raise LogWriteError(f"{self._path}: the log is closed")
        span = max(last, self._chunk_last) - min(first, self._chunk_first)
        if self._size and span > self._chunk_span_ns:
            self.flush()

    def _append(self, channel: int, index: bytes, records: bytes, first: int, last: int) -> None:
        self._index.setdefault(channel, []).append(index)
        self._pieces.append(records)
        self._size += len(records)
        self._chunk_first = min(self._chunk_first, first)
        self._chunk_last = max(self._chunk_last, last)
        if self._size >= self._chunk_bytes:
            self.flush()

    def flush(self) -> None:
        """Close the open chunk and hand it to the operating system."""
        if not self._size or self.closed:
            return
        data = b"".join(self._pieces)
        packed = self._zstd.compress(data)
        chunk = _record(
            Chunk(
                compression="zstd",
                data=packed,
                message_start_time=self._chunk_first,
                message_end_time=self._chunk_last,
                uncompressed_crc=zlib.crc32(data),
                uncompressed_size=len(data),
            )
        )
        start = self._offset
        indexes, offsets, counts = [], {}, {}
        at = start + len(chunk)
        for channel, parts in self._index.items():
            offsets[channel] = at
            entries = b"".join(parts)
            counts[channel] = len(entries) // _INDEX.itemsize
            body = struct.pack("<HI", channel, len(entries)) + entries
            indexes.append(struct.pack("<BQ", Opcode.MESSAGE_INDEX, len(body)) + body)
            at += len(indexes[-1])
        self._write(b"".join([chunk, *indexes]), whole=len(chunk))
        place = ChunkIndex(
            message_start_time=self._chunk_first,
            message_end_time=self._chunk_last,
            chunk_start_offset=start,
            chunk_length=len(chunk),
            message_index_offsets=offsets,
            message_index_length=at - start - len(chunk),
            compression="zstd",
            compressed_size=len(packed),
            uncompressed_size=len(data),
        )
        self._chunks.append(_Written(place, counts))
        self._clear_chunk()

    def close(self) -> None:
        """Finish with the summary that lets indexed readers open the file; once is enough.

        After a failed write there is no summary: the file opens as one that was cut.
        """
        if self.closed:
            return
        self.flush()
        self._write(_record(DataEnd(0)))
        chunks, missing = _placed(self._chunks, self._sink.settle())
        start = self._offset - missing
        groups: list[tuple[int, list[McapRecord]]] = [
            (Opcode.SCHEMA, list(self._schemas)),
            (Opcode.CHANNEL, list(self._channels)),
            (Opcode.STATISTICS, [self._statistics(chunks)]),
            (Opcode.CHUNK_INDEX, [c.place for c in chunks]),
        ]
        summary, offsets = b"", b""
        for opcode, records in groups:
            data = b"".join(_record(r) for r in records)
            if data:
                offsets += _record(SummaryOffset(opcode, start + len(summary), len(data)))
                summary += data
        offset_start = start + len(summary)
        tail = summary + offsets + struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
        footer = _record(Footer(start, offset_start, zlib.crc32(tail)))
        self._write(summary + offsets + footer + MCAP0_MAGIC)
        self.closed = True
        self._sink.close()

    def _statistics(self, chunks: list[_Written]) -> Statistics:
        counts: dict[int, int] = defaultdict(int)
        for chunk in chunks:
            for channel, n in chunk.counts.items():
                counts[channel] += n
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(counts),
            chunk_count=len(chunks),
            message_count=sum(counts.values()),
            metadata_count=0,
            message_start_time=min((c.place.message_start_time for c in chunks), default=0),
            message_end_time=max((c.place.message_end_time for c in chunks), default=0),
            schema_count=len(self._schemas),
        )

    def _clear_chunk(self) -> None:
        self._pieces, self._index, self._size = [], {}, 0
        self._chunk_first, self._chunk_last = _NEVER, 0

    def _write(self, data: bytes, *, whole: int = 0, needed: bool = False) -> None:
        """Hand a piece to the sink; a failure ends the file."""
        if self.closed:
            raise LogWriteError(f"{self._path}: the log is closed")
        try:
            self._sink.append(data, whole=whole, needed=needed)
        except LogWriteError:
            self.closed = True
            raise
        self._offset += len(data)


def _placed(chunks: list[_Written], holes: list[Hole]) -> tuple[list[_Written], int]:
    """The chunks that are in the file, at their true offsets, and the bytes that are not."""
    if not holes:
        return chunks, 0
    starts = [hole.start for hole in holes]
    before = np.concatenate([[0], np.cumsum([hole.length for hole in holes])]).tolist()
    kept = []
    for chunk, counts in chunks:
        at = bisect_right(starts, chunk.chunk_start_offset)
        if at and chunk.chunk_start_offset < holes[at - 1].start + holes[at - 1].length:
            continue
        moved = replace(
            chunk,
            chunk_start_offset=chunk.chunk_start_offset - before[at],
            message_index_offsets={
                channel: offset - before[at]
                for channel, offset in chunk.message_index_offsets.items()
            },
        )
        kept.append(_Written(moved, counts))
    return kept, before[-1]


def _record(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
