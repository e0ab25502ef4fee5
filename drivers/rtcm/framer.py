"""RTCM 3 frames: D3, six bits of zero, length (10 bits), payload, CRC-24Q over all of that.

RTCM 10403.3, section 4.
"""

from __future__ import annotations

from companion.gnss.messages.crc import crc24q
from drivers import framing

PREAMBLE = 0xD3
_HEAD, _CHECK = 3, 3


def pack(payload: bytes) -> bytes:
    """A whole frame."""
    body = bytes((PREAMBLE,)) + len(payload).to_bytes(2, "big") + payload
    return body + crc24q(body).to_bytes(_CHECK, "big")


class Framer(framing.Framer[bytes]):
    """Payloads of RTCM 3 among NMEA, UBX and noise."""

    MARK, HEAD = bytes((PREAMBLE,)), _HEAD

    def length(self, head: bytes) -> int | None:
        """As :class:`drivers.framing.Framer` asks."""
        return None if head[1] & 0xFC else _HEAD + int.from_bytes(head[1:], "big") + _CHECK

    def frame(self, whole: bytes) -> bytes | None:
        """As :class:`drivers.framing.Framer` asks."""
        good = crc24q(whole[:-_CHECK]) == int.from_bytes(whole[-_CHECK:], "big")
        return whole[_HEAD:-_CHECK] if good else None
