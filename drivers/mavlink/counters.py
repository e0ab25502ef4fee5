"""What is counted on a link: nothing that arrives is dropped without a number."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class SessionCounters:
    """What came in and what became of it."""

    pieces: int = 0
    """Datagrams, or pieces of a stream."""
    bytes: int = 0
    frames: int = 0
    bad_bytes: int = 0
    """Bytes that belong to no frame."""
    bad_crc: int = 0
    unknown: int = 0
    """Frames outside the dialect, which nobody can check; on a stream they are bad bytes."""
    foreign: int = 0
    """Frames of other systems or components, or before the vehicle was found."""
    lost: int = 0
    """Frames of the vehicle that are missing by its own counter."""
    samples: int = 0
    not_timed: int = 0
    """Samples before the clocks were matched, or whose stamp cannot be right; dropped."""
    repeated: int = 0
    """Samples that repeat one or go back in time; dropped."""
    unusable: int = 0
    """Samples with values that are not numbers; dropped."""
    not_sent: int = 0
    """Frames of ours that found the queue full."""
