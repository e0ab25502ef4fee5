"""What was heard in a check, part by part: the vocabulary between listening and judging."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from companion.types import AnySamples

Vec3 = tuple[float, float, float]

Level = Literal["ok", "warning", "error"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that a check found."""

    level: Level
    part: str
    """The link or stream that it is about."""
    text: str
    advice: str = ""
    """What to do about it; empty where all is well."""


@dataclass(frozen=True, slots=True)
class ImuHeard:
    """One inertial stream, over the time of listening."""

    source: str
    link: str
    samples: int
    rate_hz: float
    gyro_mean_dps: Vec3
    """In the vehicle's body axes."""
    accel_mean_mps2: Vec3
    gyro_noise_dps_rthz: float
    """White part, from the differences of neighbours: slow motion does not count. NaN: too few."""
    accel_noise_mps2_rthz: float
    lost: int = 0
    repeated: int = 0
    malformed: int = 0
    saturated: int = 0


@dataclass(frozen=True, slots=True)
class StreamHeard:
    """One aiding stream."""

    kind: Literal["gnss", "baro", "mag"]
    source: str
    samples: int
    rate_hz: float
    last: AnySamples
    """Its newest sample."""


@dataclass(frozen=True, slots=True)
class CanHeard:
    """One bus."""

    name: str
    refused: str = ""
    """Why it could not be opened, or that it was lost."""
    frames: int = 0
    malformed: int = 0
    ids: dict[tuple[int, bool], float] = field(default_factory=dict)
    """(identifier, 29 bits?) → frames a second."""


@dataclass(frozen=True, slots=True)
class SystemHeard:
    """A sender of MAVLink."""

    system: int
    component: int
    autopilot: str
    """Empty for what is no autopilot."""
    frames: int
    messages: dict[str, float]
    """Name → messages a second."""


@dataclass(frozen=True, slots=True)
class RateHeard:
    """A message that was asked for."""

    message: str
    asked_hz: float
    granted: bool
    heard_hz: float
    needed: bool
    """Navigation, and not only comparison, asks for it."""


@dataclass(frozen=True, slots=True)
class MavlinkHeard:
    """The link to the autopilot."""

    name: str
    refused: str = ""
    bytes: int = 0
    bad_bytes: int = 0
    systems: tuple[SystemHeard, ...] = ()
    vehicle: tuple[int, int] | None = None
    rates: tuple[RateHeard, ...] = ()
    clock: str = ""
    """What its stamps are matched to ours by."""
    round_trip_ms: float = float("nan")
    unsigned: int = 0
    """Frames refused because they carried no valid signature."""


@dataclass(frozen=True, slots=True)
class ReceiverHeard:
    """A satellite receiver on a line of its own."""

    name: str
    protocol: str
    """As configured: ``ublox`` or ``rtcm3``."""
    refused: str = ""
    bytes: int = 0
    frames: int = 0
    """Messages of the configured protocol whose check bytes fit."""
    malformed: int = 0
    other_protocol: dict[str, int] = field(default_factory=dict)
    """Messages of those that were not configured."""
    nmea: int = 0
    kinds: dict[str, int] = field(default_factory=dict)
    """Messages by kind: ``UBX 02-15``, ``1077``."""
    epochs: int = 0
    rate_hz: float = 0.0
    satellites: dict[str, int] = field(default_factory=dict)
    """Measured in the last epoch, by system."""
    cn0_dbhz: float = float("nan")
    """Median."""
    doppler: bool = False
    ephemerides: tuple[str, ...] = ()
    """Satellites whose ephemeris came."""
    ahead_s: float = float("nan")
    """Its time − this computer's, UTC both [s], median; NaN without epochs."""


@dataclass(frozen=True, slots=True)
class OutputHeard:
    """Something that is opened and not listened to: zenoh, the log's directory."""

    name: str
    refused: str = ""
    note: str = ""


@dataclass(frozen=True, slots=True)
class Heard:
    """All of a check."""

    seconds: float
    buses: tuple[CanHeard, ...]
    mavlink: MavlinkHeard | None
    imus: tuple[ImuHeard, ...]
    streams: tuple[StreamHeard, ...]
    zenoh: OutputHeard | None
    log: OutputHeard
    receiver: ReceiverHeard | None = None
