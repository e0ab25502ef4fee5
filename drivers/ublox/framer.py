"""UBX frames out of bytes as they come: halves wait, what is no frame is counted and dropped.

A frame is B5 62, class, identifier, length (2, little-endian), payload, two check bytes (Fletcher).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

SYNC = b"\xb5\x62"
_HEAD = 6
_LONGEST = 8192
"""Longer payloads than any that is used here: such a length is noise."""


@dataclass(frozen=True, slots=True)
class Frame:
    """A checked frame."""

    kind: int
    """Class · 256 + identifier."""
    payload: bytes


def checksum(data: bytes | bytearray) -> bytes:
    """The two check bytes over class … payload."""
    a = b = 0
    for byte in data:
        a += byte
        b += a
    return bytes((a & 0xFF, b & 0xFF))


def pack(kind: int, payload: bytes) -> bytes:
    """A whole frame."""
    body = bytes((kind >> 8, kind & 0xFF)) + len(payload).to_bytes(2, "little") + payload
    return SYNC + body + checksum(body)


class Framer:
    """Keeps the beginning of a frame until the rest comes."""

    def __init__(self) -> None:
        self.frames = 0
        self.bad = 0
        """Frames with wrong check bytes or an impossible length."""
        self.skipped = 0
        """Bytes of neither: NMEA, RTCM, noise."""
        self._held = bytearray()

    def feed(self, data: bytes) -> Iterator[Frame]:
        """Every frame that ``data`` completes."""
        held = self._held
        held += data
        while True:
            at = held.find(SYNC)
            if at < 0:
                # The last byte may be half of the mark.
                keep = 1 if held[-1:] == SYNC[:1] else 0
                self.skipped += len(held) - keep
                del held[: len(held) - keep]
                return
            self.skipped += at
            del held[:at]
            if len(held) < _HEAD:
                return
            length = int.from_bytes(held[4:6], "little")
            end = _HEAD + length + 2
            if length <= _LONGEST and len(held) < end:
                return
            if length > _LONGEST or checksum(held[2 : end - 2]) != held[end - 2 : end]:
                # Perhaps the mark stood in something else: look again behind it.
                self.bad += 1
                del held[:2]
                continue
            self.frames += 1
            frame = Frame(held[2] << 8 | held[3], bytes(held[_HEAD : end - 2]))
            del held[:end]
            yield frame
