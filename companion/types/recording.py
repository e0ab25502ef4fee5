"""A run as read from a log."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from companion.types.samples import (
    AttitudeSamples,
    BaroSamples,
    BroadcastSamples,
    GnssSamples,
    ImuSamples,
    MagSamples,
    RawGnssSamples,
    ReferenceSamples,
)


@dataclass(frozen=True, slots=True)
class StreamInfo:
    """What a reader found out about one stream."""

    source: str
    kind: Literal["imu", "gnss", "baro", "mag", "attitude", "raw", "truth", "autopilot"]
    count: int
    rate_hz: float
    """Median rate; 0 with fewer than two samples."""
    longest_gap_s: float
    gaps: int
    """Intervals longer than five median ones and longer than 0.5 s."""
    note: str = ""


@dataclass(frozen=True, slots=True)
class VehicleRecording:
    """Everything recorded of one vehicle, in columns."""

    name: str
    imu: tuple[ImuSamples, ...] = ()
    """Best source first; the engine uses the first one unless the configuration names another."""
    gnss: tuple[GnssSamples, ...] = ()
    baro: tuple[BaroSamples, ...] = ()
    mag: tuple[MagSamples, ...] = ()
    truth: ReferenceSamples | None = None
    autopilot: ReferenceSamples | None = None
    height_datum: Literal["hae", "msl"] = "hae"
    streams: tuple[StreamInfo, ...] = ()
    raw: tuple[RawGnssSamples, ...] = ()
    broadcast: tuple[BroadcastSamples, ...] = ()
    """Navigation messages for the receiver at the same place in ``raw``."""
    smoothing_gaps: tuple[tuple[int, int], ...] = ()
    """Spans [ns] in which the smoother of a live run gave way to its filter."""
    attitude: tuple[AttitudeSamples, ...] = ()
    """Of other estimators, the autopilot's; used only where the configuration asks for it."""


@dataclass(frozen=True, slots=True)
class Recording:
    """One run as read from a log: one entry a vehicle, and what was wrong with the file."""

    path: str
    format: str
    """``tlog``, ``dataflash``, ``ulog``, ``folder`` or ``mcap``."""
    vehicles: tuple[VehicleRecording, ...]
    notes: tuple[str, ...] = ()
    """One line for each oddity a person should know: bad bytes, clock jumps, truncation."""
    config_toml: str | None = None
    """Configuration that came with the data (``vehicle.toml``, or the one in our own log)."""
    metadata: dict[str, str] = field(default_factory=dict)
