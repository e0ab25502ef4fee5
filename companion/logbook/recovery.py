"""Reading an MCAP file from front to back, as far as it is whole.

The indexed reader of the ``mcap`` package refuses a file without its summary, and a process that
died leaves none. Here the records are walked in the order in which they were written: a cut ends
the walk, a damaged chunk is left out, and both are said. Memory is bounded by one chunk, whatever
the file claims about its sizes.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Schema
from mcap.writer import MCAP0_MAGIC

from companion.types import LogFormatError

MAX_CHUNK_BYTES = 64 * 1024 * 1024
"""A larger chunk is taken for damage; ours are 128 kB."""

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")


@dataclass(frozen=True, slots=True)
class Topic:
    """A channel of the file: its topic, the full name of its message type, its metadata."""

    name: str
    message: str
    metadata: dict[str, str]


@dataclass(slots=True)
class Condition:
    """What was found out about the file while walking it."""

    complete: bool = False
    """The file ends as a closed one does."""
    damaged_chunks: int = 0
    bytes_read: int = 0
    """End of the last whole record."""
    size: int = 0
    stopped: str = ""
    """Why the walk ended before the end of the file."""
    topics: dict[int, Topic] = field(default_factory=dict)

    def notes(self) -> list[str]:
        """One line for each oddity."""
        out = []
        if self.damaged_chunks:
            out.append(f"{self.damaged_chunks} damaged chunks left out")
        if not self.complete:
            where = f"{self.bytes_read} of {self.size} bytes"
            why = self.stopped or "the log was not closed"
            out.append(f"{why}: read up to the last whole chunk ({where})")
        return out


def walk(
    path: Path, wanted: Callable[[Topic], bool], condition: Condition
) -> Iterator[tuple[Topic, int, bytes]]:
    """Messages on ``wanted`` topics as (topic, log time [ns], data), in file order.

    ``condition`` is filled in as the walk goes. Raises :class:`LogFormatError` when the file
    cannot be opened or is not MCAP.
    """
    try:
        with path.open("rb") as file:
            condition.size = path.stat().st_size
            if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise LogFormatError(f"{path}: not an MCAP file")
            condition.bytes_read = len(MCAP0_MAGIC)
            yield from _walk_records(file, wanted, condition)
    except OSError as error:
        raise LogFormatError(f"{path}: cannot be read: {error.strerror or error}") from None


def _walk_records(
    file: IO[bytes], wanted: Callable[[Topic], bool], condition: Condition
) -> Iterator[tuple[Topic, int, bytes]]:
    reader = _Messages(wanted, condition.topics)
    while True:
        head = file.read(_RECORD.size)
        if len(head) < _RECORD.size:
            condition.stopped = "the log ends without a summary"
            return
        opcode, length = _RECORD.unpack(head)
        if length > condition.size - condition.bytes_read - _RECORD.size:
            condition.stopped = "the log was cut (power loss?) or is damaged"
            return
        if opcode == Opcode.DATA_END:
            condition.complete = _has_end(file, condition)
            return
        if opcode in _KEPT and length <= MAX_CHUNK_BYTES:
            body = file.read(length)
            try:
                yield from reader.record(opcode, body)
            except (LogFormatError, McapError, ValueError, struct.error, EOFError):
                condition.damaged_chunks += 1
        else:
            condition.damaged_chunks += opcode in _KEPT
            file.seek(length, 1)
        condition.bytes_read += _RECORD.size + length


def _has_end(file: IO[bytes], condition: Condition) -> bool:
    file.seek(-len(MCAP0_MAGIC), 2)
    if file.read() == MCAP0_MAGIC:
        return True
    condition.stopped = "the log's summary was cut"
    return False


_KEPT = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK))


class _Messages:
    """Resolves records to messages of wanted topics."""

    def __init__(self, wanted: Callable[[Topic], bool], topics: dict[int, Topic]) -> None:
        self._wanted = wanted
        self._topics = topics
        self._schemas: dict[int, str] = {}
        self._use: dict[int, Topic] = {}

    def record(self, opcode: int, body: bytes) -> list[tuple[Topic, int, bytes]]:
        """Messages of one record at the file's top level."""
        if opcode == Opcode.CHUNK:
            return self._chunk(_decompress(Chunk.read(_stream(body))))
        return self._one(opcode, body, 0, len(body))

    def _chunk(self, data: bytes) -> list[tuple[Topic, int, bytes]]:
        out = []
        at = 0
        while at < len(data):
            opcode, length = _RECORD.unpack_from(data, at)
            at += _RECORD.size
            if at + length > len(data):
                raise LogFormatError("a record reaches past the end of its chunk")
            out += self._one(opcode, data, at, length)
            at += length
        return out

    def _one(
        self, opcode: int, data: bytes, at: int, length: int
    ) -> list[tuple[Topic, int, bytes]]:
        if opcode == Opcode.MESSAGE:
            channel, _, log_time, _ = _MESSAGE.unpack_from(data, at)
            topic = self._use.get(channel)
            if topic is None:
                return []
            return [(topic, log_time, data[at + _MESSAGE.size : at + length])]
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(_stream(data[at : at + length]))
            self._schemas[schema.id] = schema.name
        elif opcode == Opcode.CHANNEL:
            channel_ = Channel.read(_stream(data[at : at + length]))
            message = self._schemas.get(channel_.schema_id, "")
            topic = Topic(channel_.topic, message, channel_.metadata)
            self._topics[channel_.id] = topic
            if self._wanted(topic):
                self._use[channel_.id] = topic
        return []


def _stream(data: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(data))


def _decompress(chunk: Chunk) -> bytes:
    """A chunk's records; LogFormatError where size, checksum or compression do not hold."""
    size = chunk.uncompressed_size
    if size > MAX_CHUNK_BYTES:
        raise LogFormatError("a chunk of unlikely size")
    try:
        if chunk.compression == "zstd":
            # The frame's own claim is checked first: it is what would be allocated.
            if zstandard.frame_content_size(chunk.data) not in (size, -1):
                raise LogFormatError("a chunk's sizes differ")
            data = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=size)
        elif chunk.compression == "":
            data = chunk.data
        else:
            raise LogFormatError(f"compression {chunk.compression!r} is not known")
    except (zstandard.ZstdError, MemoryError) as error:
        raise LogFormatError(f"a chunk does not decompress: {error}") from None
    if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise LogFormatError("a chunk's checksum is wrong")
    return data
