"""Health of sensors and links: declared states, and an event at each change. Pure.

Driven by arrivals and ticks alone, so that a log of both gives the same events again. What the loop
measures of itself (load, latency) and of the log comes from outside and is only passed on.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from companion.config import Live
from companion.selection import Kind
from companion.types import (
    NS,
    AnySamples,
    Event,
    GnssSamples,
    Health,
    LinkHealth,
    LinkState,
    LogHealth,
    LoopHealth,
    Mode,
    SensorHealth,
    SensorState,
)

RATE_NS: dict[Kind, int] = {
    "imu": 2 * NS,
    "gnss": 10 * NS,
    "baro": 10 * NS,
    "mag": 10 * NS,
    "raw": 10 * NS,
}
"""Rates are means over this long: ten samples of a 1 Hz receiver are its rate to a tenth."""
STEADY_NS = 2 * NS
"""A sensor that came back is held for steady after this long."""
MISSING_NS = 5 * NS
"""A configured sensor that has not been heard for this long from the start is reported."""
SLOW, STEADY = 0.7, 0.85
"""Below this share of its rate a sensor is slow; above the second one no longer."""

_NAMES: dict[Kind, str] = {
    "imu": "IMU",
    "gnss": "GNSS",
    "baro": "barometer",
    "mag": "magnetometer",
    "raw": "raw GNSS",
}
_NOTHING = float("nan")

Level = Literal["ok", "warning", "error"]
Uses = Callable[[Kind, str], bool]
"""Whether a stream feeds the engine."""
Count = Callable[[str], tuple[int, int]]
"""Lost and saturated samples so far of a source, by its driver."""


@dataclass(slots=True)
class _Sensor:
    kind: Kind
    source: str
    timeout_ns: int
    expected_hz: float
    """Configured; 0: the best seen."""
    configured: bool = False
    state: SensorState = "waiting"
    samples: int = 0
    good_ns: int = 0
    """When the last usable sample arrived; before one, when the first did."""
    last_ns: int = 0
    back_ns: int = 0
    silent_since_ns: int = 0
    missed: bool = False
    rate_hz: float = 0.0
    best_hz: float = 0.0
    recent: deque[tuple[int, int]] = field(default_factory=deque)
    """(tick, samples until then), the last few seconds."""

    @property
    def name(self) -> str:
        return f"{_NAMES[self.kind]} {self.source}"


def usable(samples: AnySamples, min_fix_type: int) -> bool:
    """Whether one of ``samples`` at least can be used: a receiver needs a fix."""
    return not isinstance(samples, GnssSamples) or bool((samples.fix_type >= min_fix_type).any())


class HealthMonitor:
    """Watches the streams and links of one vehicle."""

    def __init__(self, vehicle: str, live: Live, start_ns: int) -> None:
        self._vehicle = vehicle
        self._timeout_ns: dict[Kind, int] = {
            "imu": round(live.imu_timeout_s * NS),
            "gnss": round(live.gnss_timeout_s * NS),
            "baro": round(live.aid_timeout_s * NS),
            "mag": round(live.aid_timeout_s * NS),
            "raw": round(live.gnss_timeout_s * NS),
        }
        self._start_ns = start_ns
        self._sensors: dict[tuple[Kind, str], _Sensor] = {}
        self._links: dict[str, LinkHealth] = {}

    # ------------------------------------------------------------------ sensors

    def expect(self, kind: Kind, source: str, rate_hz: float = 0.0) -> None:
        """A stream that is configured: it counts as waiting until it is heard."""
        self._sensors[kind, source] = _Sensor(
            kind, source, self._timeout_ns[kind], rate_hz, configured=True
        )

    def arrived(self, kind: Kind, source: str, count: int, t_rx_ns: int, good: bool = True) -> None:
        """``count`` samples of a stream came, the last one at ``t_rx_ns``.

        ``good``: one of them at least can be used (a receiver has a fix).
        """
        sensor = self._sensors.get((kind, source))
        if sensor is None:
            sensor = _Sensor(kind, source, self._timeout_ns[kind], 0.0)
            self._sensors[kind, source] = sensor
        if good or not sensor.samples:
            sensor.good_ns = t_rx_ns
        sensor.samples += count
        sensor.last_ns = t_rx_ns

    def tick(self, t_ns: int, uses: Uses) -> list[Event]:
        """Look at every sensor; what has changed, as events.

        A stream that is neither configured nor used may come and go: its state says so, and that it
        was heard is all the news there is.
        """
        events: list[Event] = []
        for sensor in self._sensors.values():
            _note_rate(sensor, t_ns)
            used, heard = uses(sensor.kind, sensor.source), sensor.state != "waiting"
            event = self._judge(sensor, t_ns, used)
            if event is not None and (used or sensor.configured or not heard):
                events.append(event)
        return events

    def _judge(self, s: _Sensor, t_ns: int, used: bool) -> Event | None:
        """Move one sensor to the state it is in now."""
        if not s.samples:
            if s.missed or t_ns - self._start_ns < MISSING_NS:
                return None
            s.missed = True
            text = f"{s.name}: nothing heard since the start"
            return Event(t_ns, f"{s.kind}-missing", text, "warning")
        if t_ns - s.last_ns > s.timeout_ns:
            if s.state == "silent":
                return None
            s.state, s.silent_since_ns = "silent", s.last_ns
            text = f"{s.name} silent for {(t_ns - s.last_ns) / NS:.1f} s"
            bad = used and s.kind == "imu"
            return Event(t_ns, f"{s.kind}-silent", text, "error" if bad else "warning")
        if s.state == "silent":
            s.state, s.back_ns = "back", t_ns
            # A rate over the silence would call it slow.
            s.recent.clear()
            text = f"{s.name} back after {(s.last_ns - s.silent_since_ns) / NS:.1f} s"
            return Event(t_ns, f"{s.kind}-back", text)
        if s.state == "waiting":
            s.state = "ok"
            return Event(t_ns, f"{s.kind}-heard", f"{s.name} heard")
        if t_ns - s.good_ns > s.timeout_ns:
            if s.state == "no-fix":
                return None
            s.state = "no-fix"
            return Event(t_ns, f"{s.kind}-no-fix", f"{s.name} has no fix", "warning")
        if s.state == "no-fix":
            s.state = "ok"
            return Event(t_ns, f"{s.kind}-fix", f"{s.name} has a fix again")
        if s.state == "back" and t_ns - s.back_ns < STEADY_NS:
            return None
        return self._judge_rate(s, t_ns)

    def _judge_rate(self, s: _Sensor, t_ns: int) -> Event | None:
        expected = s.expected_hz or s.best_hz
        if s.state != "slow" and 0 < s.rate_hz < SLOW * expected:
            s.state = "slow"
            text = f"{s.name} at {s.rate_hz:.1f} Hz instead of {expected:.1f} Hz"
            return Event(t_ns, f"{s.kind}-slow", text, "warning")
        if s.state != "slow" or s.rate_hz > STEADY * expected:
            s.state = "ok"
        return None

    # ------------------------------------------------------------------ links

    def link(self, name: str, state: LinkState, note: str, t_ns: int) -> Event | None:
        """A link was opened, was lost, or could not be opened; an event where that is news."""
        before = self._links.get(name)
        reopened = before.reopened if before else 0
        if state == "up" and before is not None:
            reopened += 1
        received, malformed = (before.received, before.malformed) if before else (0, 0)
        self._links[name] = LinkHealth(name, state, received, malformed, reopened, note)
        if state == "up":
            text = f"{name} open" if before is None else f"{name} open again"
            return Event(t_ns, "link-up", text)
        if before is None or before.state == "up":
            return Event(t_ns, "link-lost", f"{name}: {note}", "warning")
        return None

    def traffic(self, name: str, received: int, malformed: int) -> None:
        """Frames of a link so far, and what of it was no message."""
        known = self._links.get(name)
        state: LinkState = known.state if known else "up"
        reopened, note = (known.reopened, known.note) if known else (0, "")
        self._links[name] = LinkHealth(name, state, received, malformed, reopened, note)

    # ------------------------------------------------------------------ report

    def report(
        self,
        t_ns: int,
        mode: Mode,
        uses: Uses,
        count: Count,
        loop: LoopHealth,
        log: LogHealth,
        counters: Mapping[str, int],
        excluded: Mapping[str, str] | None = None,
    ) -> Health:
        """Everything together; ``excluded``: inertial units that are done without, and why."""
        sensors = tuple(
            _sensor_health(s, t_ns, uses(s.kind, s.source), *count(s.source))
            for s in self._sensors.values()
        )
        links = tuple(self._links.values())
        level, text = _verdict(mode, sensors, links, log, excluded or {})
        return Health(
            vehicle=self._vehicle,
            t_ns=t_ns,
            uptime_s=(t_ns - self._start_ns) / NS,
            mode=mode,
            level=level,
            text=text,
            sensors=sensors,
            links=links,
            loop=loop,
            log=log,
            counters=dict(counters),
        )


def _note_rate(s: _Sensor, t_ns: int) -> None:
    s.recent.append((t_ns, s.samples))
    while t_ns - s.recent[0][0] > RATE_NS[s.kind]:
        s.recent.popleft()
    since, before = s.recent[0]
    span = t_ns - since
    s.rate_hz = (s.samples - before) * NS / span if span else 0.0
    # The first seconds, and a burst after a pause, say nothing about what is usual.
    if span > RATE_NS[s.kind] // 2 and s.state == "ok":
        s.best_hz = max(s.best_hz, s.rate_hz) if s.best_hz else s.rate_hz


def _sensor_health(s: _Sensor, t_ns: int, used: bool, lost: int, saturated: int) -> SensorHealth:
    return SensorHealth(
        kind=s.kind,
        source=s.source,
        state=s.state,
        used=used,
        rate_hz=0.0 if s.state in ("silent", "waiting") else s.rate_hz,
        age_s=(t_ns - s.last_ns) / NS if s.samples else _NOTHING,
        samples=s.samples,
        lost=lost,
        saturated=saturated,
    )


def _verdict(
    mode: Mode,
    sensors: tuple[SensorHealth, ...],
    links: tuple[LinkHealth, ...],
    log: LogHealth,
    excluded: Mapping[str, str],
) -> tuple[Level, str]:
    """The worst of all parts, and every problem in words, errors first."""
    errors: list[str] = []
    warnings: list[str] = []
    receiver = any(s.used for s in sensors if s.kind in ("gnss", "raw"))
    for s in sensors:
        # A stream that nobody uses may come and go; a receiver is used once it has a fix.
        wanted = s.used or (s.state == "no-fix" and not receiver)
        if wanted and s.state != "ok":
            state = "without a fix" if s.state == "no-fix" else s.state
            text = f"{_NAMES[s.kind]} {s.source} {state}"
            (errors if s.kind == "imu" and s.state == "silent" else warnings).append(text)
    warnings += [f"IMU {source} excluded ({why})" for source, why in excluded.items()]
    if not any(s.used for s in sensors if s.kind == "imu"):
        errors.append("no IMU")
    if mode == Mode.ALIGNING:
        errors.append("aligning")
    elif mode != Mode.NAVIGATING:
        warnings.append(mode.name.lower().replace("_", " "))
    warnings += [f"{link.name} {link.state}" for link in links if link.state != "up"]
    if log.state == "stopped":
        warnings.append("log stopped")
    problems = errors + warnings
    level: Level = "error" if errors else "warning" if warnings else "ok"
    return level, ", ".join(problems) if problems else "navigating"
