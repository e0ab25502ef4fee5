"""MAVLink 2 signatures: made and verified with a shared key (mavlink.io/en/guide/message_signing).

    signature = first 48 bits of SHA-256(key + frame up to and with CRC + link id + timestamp)

The timestamp counts 10 µs since 2015-01-01 and has to grow on each (system, component, link): an
old frame sent again is refused. pymavlink verifies too, but its own time once stood still (its
issue 961), and it raises where a frame should be counted; hence this one, tested against it.
"""

from __future__ import annotations

import hashlib
import hmac
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np

from companion.types import ConfigError
from drivers.mavlink.dialect import crc_table
from drivers.mavlink.framer import checksum

KEY_BYTES = 32
SIGNATURE_BYTES = 13
"""Link id, 6 bytes of timestamp, 6 bytes of signature."""
_SIGNED_FLAG = 0x01
_EPOCH_NS = 1_420_070_400_000_000_000
_TICK_NS = 10_000
_STALE_TICKS = 6_000_000
"""A minute: a stream that is new to us may not begin further behind our own time."""
_STREAMS = 256
"""Streams that are remembered; a vehicle has a handful."""


class Refusal(Enum):
    """Why a frame was not taken."""

    UNSIGNED = "unsigned"
    BAD_SIGNATURE = "bad_signature"
    REPLAYED = "replayed"


@dataclass(slots=True)
class SigningCounters:
    """What verification did."""

    accepted: int = 0
    unsigned: int = 0
    bad_signature: int = 0
    replayed: int = 0


def read_key(path: Path) -> bytes:
    """The 32 bytes of a key file, raw or hexadecimal.

    Raises :class:`ConfigError`, which never shows what the file holds.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise ConfigError(
            f"key 'mavlink.signing_key_file': {path} cannot be read: {error.strerror}"
        ) from None
    if len(raw) == KEY_BYTES:
        return raw
    try:
        key = bytes.fromhex(raw.decode("ascii").strip())
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise ConfigError(
            f"key 'mavlink.signing_key_file': {path} must hold 32 bytes, raw or as 64 hexadecimal "
            f"digits; it has {len(raw)} bytes"
        )
    return key


class Signing:
    """Signs what goes out on one link and verifies what comes in."""

    def __init__(self, key: bytes, link_id: int = 0) -> None:
        if len(key) != KEY_BYTES:
            raise ConfigError(f"a signing key has {KEY_BYTES} bytes, not {len(key)}")
        self._key = key
        self._link_id = link_id
        self._ticks = 0
        self._streams: dict[tuple[int, int, int], int] = {}
        self.counters = SigningCounters()

    def set_time(self, unix_ns: int) -> None:
        """Tell what time it is. Our timestamps follow it, but never go back."""
        self._ticks = max(self._ticks, (unix_ns - _EPOCH_NS) // _TICK_NS)

    def sign(self, frame: bytes) -> bytes:
        """The same MAVLink 2 frame, unsigned before, with its signature."""
        self._ticks += 1
        flagged = bytearray(frame)
        flagged[2] |= _SIGNED_FLAG
        msgid = int.from_bytes(flagged[7:10], "little")
        body = np.frombuffer(bytes(flagged[:-2]), np.uint8)
        crc = int(checksum(body, 1, body.shape[0], int(crc_table()[msgid, 0])))
        flagged[-2:] = crc.to_bytes(2, "little")
        stamped = bytes(flagged) + bytes([self._link_id]) + self._ticks.to_bytes(6, "little")
        return stamped + self._signature(stamped)

    def _signature(self, stamped: bytes) -> bytes:
        return hashlib.sha256(self._key + stamped).digest()[:6]

    def verify(self, frame: bytes, *, signed: bool) -> Refusal | None:
        """Whether a whole frame, signature included, is to be refused, and why. Counts."""
        refusal = self._judge(frame) if signed else Refusal.UNSIGNED
        counters = self.counters
        match refusal:
            case None:
                counters.accepted += 1
            case Refusal.UNSIGNED:
                counters.unsigned += 1
            case Refusal.BAD_SIGNATURE:
                counters.bad_signature += 1
            case Refusal.REPLAYED:
                counters.replayed += 1
        return refusal

    def _judge(self, frame: bytes) -> Refusal | None:
        if not hmac.compare_digest(self._signature(frame[:-6]), frame[-6:]):
            return Refusal.BAD_SIGNATURE
        ticks = int.from_bytes(frame[-12:-6], "little")
        stream = (frame[5], frame[6], frame[-13])
        last = self._streams.get(stream)
        oldest = last + 1 if last is not None else self._ticks - _STALE_TICKS
        if ticks < oldest:
            return Refusal.REPLAYED
        if last is None and len(self._streams) >= _STREAMS:
            # Only holders of the key get here. Forgetting one would let it be replayed.
            return Refusal.REPLAYED
        self._streams[stream] = ticks
        # An authentic time ahead of ours: take it, or the other side would refuse ours as stale.
        self._ticks = max(self._ticks, ticks)
        return None
