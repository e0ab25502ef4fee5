"""Malformed traffic, made beside the good: what a loose connector, a bug or a stranger sends."""

from __future__ import annotations

import random

from replay.simulator.live.slcan import Frame


def mavlink_garbage(frames: list[bytes], rng: random.Random) -> list[bytes]:
    """One malformed datagram for each good frame: a flipped bit, a cut, noise, a wrong length."""
    return [_spoiled(frame, rng) for frame in frames]


def _spoiled(frame: bytes, rng: random.Random) -> bytes:
    kind = rng.randrange(4)
    if kind == 0:
        at = rng.randrange(1, len(frame))
        return frame[:at] + bytes([frame[at] ^ 1 << rng.randrange(8)]) + frame[at + 1 :]
    if kind == 1:
        return frame[: rng.randrange(1, len(frame))]
    if kind == 2:
        return rng.randbytes(rng.randrange(1, 280))
    return frame[:1] + bytes([rng.randrange(256)]) + frame[2:]


def can_garbage(frames: list[Frame], rng: random.Random) -> list[bytes]:
    """One malformed slcan line for each good frame.

    Half of them are no lines of the protocol; the others are proper frames of a neighbour that no
    driver can make sense of: the good frame's identifier with another node's number.
    """
    return [_bad_line(frame, rng) for frame in frames]


def _bad_line(frame: Frame, rng: random.Random) -> bytes:
    can_id, extended, _ = frame
    kind = rng.randrange(4)
    if kind == 0:
        return rng.randbytes(rng.randrange(1, 20)).replace(b"\r", b"!") + b"\r"
    if kind == 1:
        return b"T%08X9" % can_id + b"00" * 9 + b"\r"
    neighbour = can_id ^ 1 << rng.randrange(7)
    data = rng.randbytes(rng.randrange(9))
    head = b"T%08X" % neighbour if extended else b"t%03X" % neighbour
    return head + b"%d" % len(data) + data.hex().upper().encode() + b"\r"
