"""RTCM 3 frames out of bytes as they come: halves wait, what is no frame is counted and dropped.

A frame is D3, six bits of zero, length (10 bits), payload, CRC-24Q over all of that.
"""

from __future__ import annotations

from collections.abc import Iterator

from companion.gnss.messages.crc import crc24q

PREAMBLE = 0xD3
_HEAD, _CHECK = 3, 3


def pack(payload: bytes) -> bytes:
    """A whole frame."""
    body = bytes((PREAMBLE,)) + len(payload).to_bytes(2, "big") + payload
    return body + crc24q(body).to_bytes(_CHECK, "big")


class Framer:
    """Keeps the beginning of a frame until the rest comes."""

    def __init__(self) -> None:
        self.frames = 0
        self.bad = 0
        """Frames with a wrong CRC."""
        self.skipped = 0
        """Bytes of neither: NMEA, UBX, noise."""
        self._held = bytearray()

    def feed(self, data: bytes) -> Iterator[bytes]:
        """The payload of every frame that ``data`` completes."""
        held = self._held
        held += data
        while True:
            at = held.find(PREAMBLE)
            if at < 0:
                self._drop(len(held))
                return
            self._drop(at)
            if len(held) < _HEAD:
                return
            if held[1] & 0xFC:
                self._drop(1)
                continue
            end = _HEAD + int.from_bytes(held[1:3], "big") + _CHECK
            if len(held) < end:
                return
            if crc24q(held[: end - _CHECK]) != int.from_bytes(held[end - _CHECK : end], "big"):
                # Perhaps the mark stood in something else: look again behind it.
                self.bad += 1
                self._drop(1)
                continue
            self.frames += 1
            payload = bytes(held[_HEAD : end - _CHECK])
            del held[:end]
            yield payload

    def _drop(self, count: int) -> None:
        self.skipped += count
        del self._held[:count]
