"""What is known of a vehicle from its messages, with time passed in."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any, Literal

from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import DecodeError

from companion.adaptation_words import told
from companion.logbook.health import decode_health
from companion.outputs import payloads
from companion.outputs.subscriber import Heard
from companion.proto import adaptation_pb2, navigation_pb2
from companion.types import NS, Channel, Event, Health, LogFormatError, Mode, Verdict

GATE_SPAN_NS = 30 * NS
"""Accepted and rejected are counted over this long."""
RATE_SPAN_NS = 3 * NS
STALE_NS = NS
"""Without a state for this long, the picture is old."""
EVENTS = 50
VEHICLES = 32
"""More are not followed: a stranger on these keys must not fill the memory."""
OVERDUE_NS, OVERDUE_INTERVALS = 700_000_000, 1.8
"""A sensor's measurements are overdue after this long, or so many of their usual intervals: before
the vehicle itself calls the sensor silent."""
_INTERVALS = 8
"""Of the latest measurements of a channel, whose mean is the usual one."""
_SAME_MACHINE_NS = 60 * NS
"""Beyond that, clocks of two machines were compared."""
SENSOR_KINDS: dict[Channel, Literal["gnss", "baro", "mag"]] = {
    Channel.GNSS_POSITION_H: "gnss",
    Channel.GNSS_POSITION_V: "gnss",
    Channel.GNSS_VELOCITY_H: "gnss",
    Channel.GNSS_VELOCITY_V: "gnss",
    Channel.BARO: "baro",
    Channel.MAG: "mag",
    Channel.RANGE_GPS: "gnss",
    Channel.RANGE_GALILEO: "gnss",
    Channel.RANGE_BEIDOU: "gnss",
}
"""Channels that one sensor gives at its own rate, and the sensor; constraints come and go with what
the vehicle does."""
_LEVELS = {Log.WARNING: "warning", Log.ERROR: "error", Log.FATAL: "error"}


@dataclass(slots=True)
class Gate:
    """What became of one channel's measurements lately."""

    verdicts: deque[tuple[int, Verdict]] = field(default_factory=deque)
    ratio: float = math.nan
    """Of the latest that was held against a gate: NIS over gate, above 1 rejected."""
    last_ns: int = 0
    interval_ns: float = 0.0
    """Usual time from one measurement to the next."""
    _peak: float = -math.inf

    def add(self, verdict: Verdict, ratio: float | None, now_ns: int) -> None:
        """Note a measurement; ``ratio`` where it was held against a gate."""
        self.verdicts.append((now_ns, verdict))
        self._forget(now_ns)
        if ratio is not None:
            self.ratio = ratio
            self._peak = max(ratio, self._peak)
        self.last_ns = now_ns
        n = min(len(self.verdicts) - 1, _INTERVALS)
        if n:
            self.interval_ns = (now_ns - self.verdicts[-1 - n][0]) / n

    def overdue(self, now_ns: int) -> bool:
        """Whether the next measurement should have come, for a sensor at a rate of its own."""
        return now_ns - self.last_ns > max(OVERDUE_NS, OVERDUE_INTERVALS * self.interval_ns)

    def take_peak(self) -> float | None:
        """The largest ratio since the last call; None without any."""
        peak, self._peak = self._peak, -math.inf
        return peak if peak >= 0.0 else None

    def _forget(self, now_ns: int) -> None:
        while self.verdicts and now_ns - self.verdicts[0][0] > GATE_SPAN_NS:
            self.verdicts.popleft()

    def counts(self, now_ns: int) -> tuple[int, int, int]:
        """(accepted, rejected by the gate, refused for another reason) over the last span."""
        self._forget(now_ns)
        accepted = sum(v == Verdict.ACCEPTED for _, v in self.verdicts)
        rejected = sum(v == Verdict.REJECTED_GATE for _, v in self.verdicts)
        return accepted, rejected, len(self.verdicts) - accepted - rejected

    @property
    def last(self) -> Verdict | None:
        """The latest verdict within the span."""
        return self.verdicts[-1][1] if self.verdicts else None


@dataclass(frozen=True, slots=True)
class Adapted:
    """What the adaptation last did to a channel, and why."""

    r_scale: float
    """Factor on the variance of its measurement."""
    q_scale: float
    """Factor on the noise of the inertial unit, and below the exponential weight of the epoch."""
    alpha: float
    because: str
    """The winning rule in words; empty for a method without rules."""
    last_ns: int


@dataclass(slots=True)
class VehiclePicture:
    """One vehicle, as its messages so far say. Times ``now_ns`` are CLOCK_MONOTONIC."""

    name: str
    alive: bool | None = None
    """By its liveliness token; None before anything is known."""
    state: Any = None
    """Latest ``NavState`` message."""
    state_ns: int = 0
    latency_ms: float = math.nan
    """Arrival of a sample at the vehicle to receipt of the state here; same machine only."""
    health: Health | None = None
    health_ns: int = 0
    gates: dict[Channel, Gate] = field(default_factory=dict)
    adaptation: dict[Channel, Adapted] = field(default_factory=dict)
    satellites: Any = None
    """Latest ``Satellites`` message; None without raw GNSS."""
    satellites_ns: int = 0
    events: deque[Event] = field(default_factory=lambda: deque(maxlen=EVENTS))
    broken: int = 0
    """Messages that could not be decoded: another version, or a stranger on these keys."""
    events_heard: int = 0
    """Events so far; :attr:`events` holds the latest of them."""
    _arrivals: deque[int] = field(default_factory=deque)

    def update(self, heard: Heard, now_ns: int) -> None:
        """Take a message; one that cannot be read is counted."""
        if heard.name == payloads.ALIVE:
            self.alive = heard.payload is not None
            return
        if heard.payload is None:
            return
        try:
            self._read(heard.name, heard.payload, now_ns)
        except (DecodeError, LogFormatError, ValueError):
            self.broken += 1

    def _read(self, name: str, payload: bytes, now_ns: int) -> None:
        if name == payloads.STATE:
            self._state(navigation_pb2.NavState.FromString(payload), now_ns)
        elif name == payloads.AIDING:
            report = navigation_pb2.AidingReport.FromString(payload)
            channel, verdict = Channel(report.channel), Verdict(report.verdict)
            gated = verdict in (Verdict.ACCEPTED, Verdict.REJECTED_GATE) and report.gate > 0
            ratio = report.nis / report.gate if gated else None
            self.gates.setdefault(channel, Gate()).add(verdict, ratio, now_ns)
        elif name == payloads.ADAPTATION:
            trace = adaptation_pb2.AdaptationTrace.FromString(payload)
            adapted = Adapted(
                r_scale=trace.r_scale,
                q_scale=trace.q_scale,
                alpha=trace.alpha,
                because=told(trace.rule - 1, trace.to_model, trace.to_source),
                last_ns=now_ns,
            )
            self.adaptation[Channel(trace.channel)] = adapted
        elif name == payloads.SATELLITES:
            self.satellites = navigation_pb2.Satellites.FromString(payload)
            self.satellites_ns = now_ns
        elif name == payloads.HEALTH:
            self.health, self.health_ns = decode_health(payload), now_ns
        elif name == payloads.EVENTS:
            log = Log.FromString(payload)
            t_ns = log.timestamp.seconds * NS + log.timestamp.nanos
            level: Any = _LEVELS.get(log.level, "info")
            self.events.append(Event(t_ns, log.name, log.message, level))
            self.events_heard += 1

    def _state(self, state: Any, now_ns: int) -> None:
        three = state.vel_n, state.sd_pos_m, state.sd_vel_mps, state.sd_att_deg
        if any(len(column) != 3 for column in three):
            raise ValueError("a state with fields of the wrong length")
        Mode(state.mode)
        self.state, self.state_ns = state, now_ns
        self._arrivals.append(now_ns)
        self._forget(now_ns)
        late_ns = now_ns - state.arrival_monotonic_ns
        sane = state.HasField("arrival_monotonic_ns") and 0 <= late_ns < _SAME_MACHINE_NS
        self.latency_ms = late_ns / 1e6 if sane else math.nan

    def rate_hz(self, now_ns: int) -> float:
        """States received a second."""
        self._forget(now_ns)
        n = len(self._arrivals)
        span_ns = self._arrivals[-1] - self._arrivals[0] if n > 1 else 0
        return (n - 1) * NS / span_ns if span_ns else 0.0

    def _forget(self, now_ns: int) -> None:
        while self._arrivals and now_ns - self._arrivals[0] > RATE_SPAN_NS:
            self._arrivals.popleft()

    @property
    def mode(self) -> Mode | None:
        """Of the latest state; None before the first."""
        return Mode(self.state.mode) if self.state is not None else None

    def age_s(self, now_ns: int) -> float:
        """Since the latest state; infinite before the first."""
        return (now_ns - self.state_ns) / NS if self.state is not None else math.inf

    def standing(self, now_ns: int) -> str:
        """In a word: ``gone``, ``silent``, ``waiting``, or the mode."""
        if self.alive is False:
            return "gone"
        if self.mode is None:
            return "waiting"
        if now_ns - self.state_ns > STALE_NS:
            return "silent"
        return self.mode.name.lower().replace("_", " ")


class Fleet:
    """Every vehicle that was heard, in order of appearance, up to :data:`VEHICLES`."""

    def __init__(self) -> None:
        self.vehicles: dict[str, VehiclePicture] = {}

    def update(self, heard: Heard, now_ns: int) -> VehiclePicture | None:
        """Take a message of any vehicle; its picture, or None for one too many."""
        vehicle = self.vehicles.get(heard.vehicle)
        if vehicle is None:
            if len(self.vehicles) >= VEHICLES:
                return None
            vehicle = self.vehicles[heard.vehicle] = VehiclePicture(heard.vehicle)
        vehicle.update(heard, now_ns)
        return vehicle

    def chosen(self, now_ns: int) -> VehiclePicture | None:
        """The one to show: the first that speaks, else the first."""
        speaking = [v for v in self.vehicles.values() if v.age_s(now_ns) < 1.0]
        return next(iter([*speaking, *self.vehicles.values()]), None)
