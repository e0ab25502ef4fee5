"""State of the live process."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from companion.types.solution import Mode

SensorState = Literal["waiting", "ok", "slow", "silent", "back", "no-fix"]
"""``waiting``: nothing came yet; ``slow``: well below its rate; ``silent``: longer than its
time-out; ``back``: came back a moment ago, not yet held for steady; ``no-fix``: a receiver that
talks, and has had no fix for as long as would make it silent."""
LinkState = Literal["up", "lost", "retrying"]
"""``lost``: gone just now; ``retrying``: at least one attempt to open it (again) failed."""
LogState = Literal["off", "writing", "stopped"]
"""``stopped``: the disk does not take it (full?); writing resumes when it does."""


@dataclass(frozen=True, slots=True)
class SensorHealth:
    """How one stream of samples is doing."""

    kind: Literal["imu", "gnss", "baro", "mag", "raw"]
    source: str
    state: SensorState
    used: bool
    """The engine is fed with it; others are only logged."""
    rate_hz: float
    """Samples over the last seconds; 0 while silent."""
    age_s: float
    """Since the last arrival; NaN before the first."""
    samples: int
    lost: int = 0
    """Missing by the sensor's own counter, where it sends one."""
    saturated: int = 0
    """Samples with an axis at the end of its range."""


@dataclass(frozen=True, slots=True)
class LinkHealth:
    """One bus or connection."""

    name: str
    state: LinkState
    received: int
    """Frames or datagrams so far."""
    malformed: int = 0
    """Of them, or bytes among them, what was no message; counted and dropped."""
    reopened: int = 0
    note: str = ""
    """Why it is not up."""


@dataclass(frozen=True, slots=True)
class LoopHealth:
    """How busy the process is, over the time since the last report."""

    load: float
    """CPU time of the process per second, in cores."""
    latency_p50_ms: float
    """From the arrival of a sample to the hand-over of what came of it; NaN without any."""
    latency_p99_ms: float
    latency_max_ms: float
    stall_ms: float
    """Longest time for which no link was looked at: what a latency cannot see."""


@dataclass(frozen=True, slots=True)
class LogHealth:
    """The run log on its way to the disk."""

    state: LogState
    path: str = ""
    written_bytes: int = 0
    queued_bytes: int = 0
    dropped_bytes: int = 0
    """Never reached the disk: the queue was full, or writing had stopped."""


@dataclass(frozen=True, slots=True)
class Health:
    """State of the live process as a whole, about once a second."""

    vehicle: str
    t_ns: int
    uptime_s: float
    mode: Mode
    level: Literal["ok", "warning", "error"]
    """The worst of all parts; ``error``: there is no solution to rely on."""
    text: str
    """One line for people: what is wrong, worst first, or that all is well."""
    sensors: tuple[SensorHealth, ...]
    links: tuple[LinkHealth, ...]
    loop: LoopHealth
    log: LogHealth
    counters: dict[str, int] = field(default_factory=dict)
    """Everything else that is counted, by a stable name (``engine.late_fused``)."""
