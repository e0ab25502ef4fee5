"""What is wrong with a vehicle at this moment, in words, worst first. Pure: time is passed in."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Literal

import msgspec

from companion.types import NS, Mode, Verdict
from companion.watch.picture import SENSOR_KINDS, VehiclePicture

HEALTH_LATE_NS = 3 * NS
"""Health comes once a second."""
WIDE_MS = 20.0
"""Latency that is worth looking at."""
_NAMES = {"gnss": "GNSS", "baro": "barometer", "mag": "magnetometer"}


class Alarm(msgspec.Struct, frozen=True):
    """One thing that is wrong."""

    level: Literal["warning", "error"]
    part: str
    """What to colour: ``vehicle``, ``gnss``, ``baro``, ``mag``, ``health``, ``latency``."""
    text: str


def alarms(v: VehiclePicture, now_ns: int) -> list[Alarm]:
    """Everything that is wrong; errors first."""
    standing = v.standing(now_ns)
    if standing == "gone":
        return [Alarm("error", "vehicle", "the companion is gone: its liveliness token vanished")]
    if standing == "waiting":
        return [Alarm("warning", "vehicle", "no navigation state has come yet")]
    if standing == "silent":
        return [Alarm("error", "vehicle", f"no navigation state for {v.age_s(now_ns):.0f} s")]
    found = _modes(v) + _overdue(v, now_ns) + _health(v, now_ns)
    if not math.isnan(v.latency_ms) and v.latency_ms > WIDE_MS:
        found.append(Alarm("warning", "latency", f"states are {v.latency_ms:.0f} ms old"))
    return sorted(found, key=lambda alarm: alarm.level != "error")


def _modes(v: VehiclePicture) -> list[Alarm]:
    if v.mode is Mode.COASTING:
        return [Alarm("error", "vehicle", "coasting: neither position nor velocity is aided")]
    if v.mode in (Mode.ALIGNING, Mode.HEADING_UNKNOWN):
        assert v.mode is not None
        return [Alarm("warning", "vehicle", v.mode.name.lower().replace("_", " "))]
    return []


def _overdue(v: VehiclePicture, now_ns: int) -> list[Alarm]:
    """Sensors of which no channel gives anything, or whose every latest measurement is refused."""
    channels = defaultdict(list)
    for channel, gate in v.gates.items():
        if channel in SENSOR_KINDS:
            channels[SENSOR_KINDS[channel]].append(gate)
    found = []
    for kind, gates in channels.items():
        name = _NAMES[kind]
        if all(gate.overdue(now_ns) for gate in gates):
            age_s = (now_ns - max(gate.last_ns for gate in gates)) / NS
            text = f"{name}: no measurement for {age_s:.1f} s"
            found.append(Alarm("error" if kind == "gnss" else "warning", kind, text))
        elif all(gate.last not in (None, Verdict.ACCEPTED) for gate in gates):
            words = sorted(
                {gate.last.name.lower().replace("_", " ") for gate in gates if gate.last}
            )
            found.append(Alarm("warning", kind, f"{name}: {', '.join(words)}"))
    return found


def _health(v: VehiclePicture, now_ns: int) -> list[Alarm]:
    if v.health is None:
        return []
    if now_ns - v.health_ns > HEALTH_LATE_NS:
        age_s = (now_ns - v.health_ns) / NS
        return [Alarm("warning", "health", f"no report of health for {age_s:.0f} s")]
    if v.health.level == "ok":
        return []
    return [Alarm(v.health.level, "health", v.health.text)]
