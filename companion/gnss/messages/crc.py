"""CRC-24Q (polynomial 0x1864CFB), as Galileo, SBAS and RTCM 3 use it."""

from __future__ import annotations


def _table() -> tuple[int, ...]:
    out = []
    for byte in range(256):
        crc = byte << 16
        for _ in range(8):
            crc = crc << 1 ^ (0x1864CFB if crc & 0x800000 else 0)
        out.append(crc)
    return tuple(out)


_TABLE = _table()


def crc24q(data: bytes | bytearray) -> int:
    """The 24 bits over ``data``, from a register of zeros."""
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFFFFFF) ^ _TABLE[crc >> 16 ^ byte]
    return crc
