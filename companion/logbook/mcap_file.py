"""Appending to an MCAP file, many messages in one call.

The records are the ``mcap`` package's own; what is ours is the chunk: it takes whole arrays of
equally long messages, closes at a size or at an age, and is on its way to the disk in one write.
So a process that dies loses the open chunk and nothing before it, and a disk that fills up leaves
a file that ends with a whole chunk.

MCAP specification 0, https://mcap.dev/spec.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import defaultdict
from pathlib import Path

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

from companion.types import I64, CompanionError

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


class LogWriteError(CompanionError):
    """The log cannot be written (disk full, no permission); what was written before stays."""


class McapFile:
    """An MCAP file being written. Not thread-safe; any failing write ends it.

    ``chunk_bytes`` and ``chunk_span_ns`` (of log time) bound what a power loss can take.
    """

    def __init__(
        self, path: Path, *, chunk_bytes: int = 128 * 1024, chunk_span_ns: int = 1_000_000_000
    ) -> None:
        self._path = path
        self._chunk_bytes = chunk_bytes
        self._chunk_span_ns = chunk_span_ns
        self._zstd = zstandard.ZstdCompressor(level=1)
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._counts: dict[int, int] = defaultdict(int)
        self._first_ns = _NEVER
        self._last_ns = 0
        self._offset = 0
        self._pieces: list[bytes] = []
        self._index: dict[int, list[bytes]] = {}
        self._size = 0
        self._chunk_first = _NEVER
        self._chunk_last = 0
        try:
            self._file = path.open("wb", buffering=0)
        except OSError as error:
            raise LogWriteError(f"{path}: cannot be opened: {error.strerror or error}") from None
        self.closed = False
        self._write(MCAP0_MAGIC + _record(Header(profile="", library="companion")))

    def schema(self, name: str, data: bytes) -> int:
        """Declare a protobuf message type by its descriptor set; its id."""
        schema = Schema(len(self._schemas) + 1, data, "protobuf", name)
        self._schemas.append(schema)
        self._write(_record(schema))
        return schema.id

    def channel(self, topic: str, schema_id: int, metadata: dict[str, str] | None = None) -> int:
        """Declare a topic; its id.

        Declarations stand between the chunks, not in them, so that a damaged chunk costs its own
        messages only.
        """
        channel = Channel(len(self._channels) + 1, topic, "protobuf", metadata or {}, schema_id)
        self._channels.append(channel)
        self._write(_record(channel))
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
        indexes, offsets = [], {}
        at = start + len(chunk)
        for channel, parts in self._index.items():
            offsets[channel] = at
            entries = b"".join(parts)
            body = struct.pack("<HI", channel, len(entries)) + entries
            indexes.append(struct.pack("<BQ", Opcode.MESSAGE_INDEX, len(body)) + body)
            at += len(indexes[-1])
        self._write(b"".join([chunk, *indexes]), keep=len(chunk))
        self._chunks.append(
            ChunkIndex(
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
        )
        self._first_ns = min(self._first_ns, self._chunk_first)
        self._last_ns = max(self._last_ns, self._chunk_last)
        self._clear_chunk()

    def close(self) -> None:
        """Finish with the summary that lets indexed readers open the file; once is enough.

        After a failed write there is no summary: the file opens as one that was cut.
        """
        if self.closed:
            return
        self.flush()
        self._write(_record(DataEnd(0)))
        start = self._offset
        groups: list[tuple[int, list[McapRecord]]] = [
            (Opcode.SCHEMA, list(self._schemas)),
            (Opcode.CHANNEL, list(self._channels)),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, list(self._chunks)),
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
        self._file.close()

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            metadata_count=0,
            message_start_time=min(self._first_ns, self._last_ns),
            message_end_time=self._last_ns,
            schema_count=len(self._schemas),
        )

    def _clear_chunk(self) -> None:
        self._pieces, self._index, self._size = [], {}, 0
        self._chunk_first, self._chunk_last = _NEVER, 0

    def _write(self, data: bytes, keep: int = 0) -> None:
        """Write all of ``data``; on failure cut back to what is whole and end the file.

        ``keep``: a prefix that is whole by itself.
        """
        if self.closed:
            raise LogWriteError(f"{self._path}: the log is closed")
        view, done = memoryview(data), 0
        try:
            while done < len(data):
                done += self._file.write(view[done:]) or 0
        except OSError as error:
            self.closed = True
            self._abandon(self._offset + (keep if keep and done >= keep else 0))
            raise LogWriteError(
                f"{self._path}: writing stopped after {self._offset} bytes: "
                f"{error.strerror or error}"
            ) from None
        self._offset += done

    def _abandon(self, whole: int) -> None:
        """Best effort: a half-written record at the end is legal, only untidy."""
        try:
            os.ftruncate(self._file.fileno(), whole)
        except (OSError, ValueError):
            pass
        finally:
            self._file.close()


def _record(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
