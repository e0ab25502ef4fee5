"""UBX frames: B5 62, class, identifier, length (2, little-endian), payload, two check bytes.

The check is Fletcher's over class … payload (u-blox interface description F9, UBX checksum).
"""

from __future__ import annotations

from dataclasses import dataclass

from drivers import framing

SYNC = b"\xb5\x62"
_HEAD, _CHECK = 6, 2
_LONGEST = 8192
"""Longer payloads than any that is used here: such a length is noise."""


@dataclass(frozen=True, slots=True)
class Frame:
    """A checked frame."""

    kind: int
    """Class · 256 + identifier."""
    payload: bytes


def checksum(data: bytes) -> bytes:
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


class Framer(framing.Framer[Frame]):
    """UBX among NMEA, RTCM and noise."""

    MARK, HEAD = SYNC, _HEAD

    def length(self, head: bytes) -> int | None:
        """As :class:`drivers.framing.Framer` asks."""
        payload = int.from_bytes(head[4:6], "little")
        return _HEAD + payload + _CHECK if payload <= _LONGEST else None

    def frame(self, whole: bytes) -> Frame | None:
        """As :class:`drivers.framing.Framer` asks."""
        if checksum(whole[len(SYNC) : -_CHECK]) != whole[-_CHECK:]:
            return None
        return Frame(whole[2] << 8 | whole[3], whole[_HEAD:-_CHECK])
