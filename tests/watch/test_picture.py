"""What watch makes of messages, without a network or a clock."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from rich.console import Console

from companion.logbook import messages
from companion.logbook.health import encode_health
from companion.logbook.satellites import encode_satellites
from companion.outputs import payloads
from companion.outputs.subscriber import Heard
from companion.types import NO_DOP, NS, Channel, Event, Mode, Satellites, Verdict
from companion.watch.as_json import picture_json
from companion.watch.picture import Fleet, VehiclePicture
from companion.watch.view import fleet_view
from tests.outputs.test_zenoh_publisher import HEALTH
from tests.outputs.zenoh_help import T0, report, solution

SECOND = 1000 * NS
"""CLOCK_MONOTONIC at the beginning."""


def state(k: int = 0, mode: Mode = Mode.NAVIGATING, arrival_ns: int = 0) -> Heard:
    row = messages.encode_states(solution(first=k, mode=mode))[0].tobytes()
    return Heard("v1", payloads.STATE, payloads.with_arrival(row, arrival_ns))


def aiding(channel: Channel, verdict: Verdict, nis: float) -> Heard:
    row = messages.encode_reports(report(channel, verdict, nis))[0].tobytes()
    return Heard("v1", payloads.AIDING, row)


def event(text: str, level: str = "info") -> Heard:
    made = Event(T0, "gate", text, level)  # type: ignore[arg-type]
    return Heard("v1", payloads.EVENTS, payloads.event_message(made))


def flying() -> tuple[Fleet, VehiclePicture]:
    """Two seconds at 50 Hz with everything there is; the clock then is at two seconds."""
    fleet = Fleet()
    fleet.update(Heard("v1", payloads.ALIVE, b""), SECOND)
    for k in range(101):
        now = SECOND + k * NS // 50
        fleet.update(state(k, arrival_ns=now - 300_000), now)
    for _ in range(3):
        fleet.update(aiding(Channel.GNSS_POSITION_H, Verdict.ACCEPTED, 1.38), SECOND + NS)
    fleet.update(aiding(Channel.GNSS_POSITION_H, Verdict.REJECTED_GATE, 27.6), SECOND + NS)
    fleet.update(aiding(Channel.BARO, Verdict.REFUSED_LATE, math.nan), SECOND + NS)
    fleet.update(Heard("v1", payloads.HEALTH, encode_health(HEALTH)), SECOND + NS)
    fleet.update(event("fix 34 m off", "warning"), SECOND + NS)
    return fleet, fleet.vehicles["v1"]


def text_of(fleet: Fleet, now_ns: int, width: int = 120) -> str:
    """The picture without any colour."""
    console = Console(width=width, no_color=True, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(fleet_view(fleet, fleet.chosen(now_ns), now_ns, last=8))
    return console.export_text()


def test_rate_latency_and_mode() -> None:
    _, v = flying()
    now = SECOND + 2 * NS
    assert v.rate_hz(now) == pytest.approx(50.0)
    assert v.latency_ms == pytest.approx(0.3)
    assert v.standing(now) == "navigating"
    assert v.standing(now + 2 * NS) == "silent"
    assert v.rate_hz(now + 10 * NS) == 0.0


def test_latency_of_another_machines_clock_is_not_believed() -> None:
    v = VehiclePicture("v1")
    v.update(state(arrival_ns=SECOND + NS), SECOND)
    assert math.isnan(v.latency_ms)
    row = messages.encode_states(solution())[0].tobytes()
    v.update(Heard("v1", payloads.STATE, row), SECOND)
    assert math.isnan(v.latency_ms)


def test_gates_are_counted_over_a_span() -> None:
    _, v = flying()
    gate = v.gates[Channel.GNSS_POSITION_H]
    assert gate.counts(SECOND + 2 * NS) == (3, 1, 0)
    assert gate.ratio == pytest.approx(2.0)
    assert v.gates[Channel.BARO].counts(SECOND + 2 * NS) == (0, 0, 1)
    assert math.isnan(v.gates[Channel.BARO].ratio)
    assert gate.counts(SECOND + 60 * NS) == (0, 0, 0)
    assert gate.last is None


@pytest.mark.parametrize(
    "name", [payloads.STATE, payloads.AIDING, payloads.HEALTH, payloads.EVENTS]
)
def test_what_cannot_be_read_is_counted(name: str) -> None:
    fleet = Fleet()
    fleet.update(Heard("v1", name, b"\xff\xff\xff"), SECOND)
    v = fleet.vehicles["v1"]
    assert v.broken == 1
    assert v.state is None
    assert "1 messages could not be read" in text_of(fleet, SECOND)


def test_an_empty_state_is_broken_and_not_shown() -> None:
    v = VehiclePicture("v1")
    v.update(Heard("v1", payloads.STATE, b""), SECOND)
    assert (v.broken, v.state) == (1, None)


def test_picture_reads_without_colours() -> None:
    fleet, _ = flying()
    text = text_of(fleet, SECOND + 2 * NS)
    for words in (
        "Vehicle v1  NAVIGATING",
        "50 Hz",
        "0.3 ms old",
        "warning: GNSS silent",
        "45.8368",  # 0.8 rad and 20 m
        "500.00 m",
        "N 10.00",
        "yaw 30.0°",
        "N ±1.00 m",
        "course 0°",
        "can0",
        "200.0",
        "up 2500 in, 1 malformed, reopened 2×",
        "20 % of a core",
        "rejected gate",
        "refused late",
        "gate: fix 34 m off",
    ):
        assert words in text, words


def test_silence_and_disappearance_are_said_in_words() -> None:
    fleet, _ = flying()
    assert "SILENT for 5 s" in text_of(fleet, SECOND + 7 * NS)
    fleet.update(Heard("v1", payloads.ALIVE, None), SECOND + 7 * NS)
    assert "GONE" in text_of(fleet, SECOND + 7 * NS)
    fleet.update(Heard("v2", payloads.ALIVE, b""), SECOND + 7 * NS)
    text = text_of(fleet, SECOND + 7 * NS)
    assert "Vehicles" in text
    assert "waiting" in text


def test_the_vehicle_that_speaks_is_shown() -> None:
    fleet = Fleet()
    fleet.update(Heard("old", payloads.ALIVE, None), SECOND)
    fleet.update(state(), SECOND)
    shown = fleet.chosen(SECOND)
    assert shown is not None
    assert shown.name == "v1"
    assert Fleet().chosen(SECOND) is None


def test_json_is_plain_and_in_degrees() -> None:
    _, v = flying()
    picture = json.loads(json.dumps(picture_json(v, SECOND + 2 * NS), allow_nan=False))
    assert picture["is"] == "navigating"
    assert picture["state"]["lat_deg"] == pytest.approx(np.degrees(0.8 + 100 * 0.2 / 6.37e6))
    assert picture["state"]["rpy_deg"] == pytest.approx([0, 0, 30], abs=1e-4)
    gates = picture["gates"]
    assert gates["gnss_position_h"] == {
        "accepted": 3, "rejected": 1, "refused": 0, "nis_over_gate": pytest.approx(2.0),
        "latest": "rejected_gate", "age_s": pytest.approx(1.0), "overdue": True,
        "sensor": "gnss",
    }  # fmt: skip
    assert gates["baro"]["nis_over_gate"] is None
    assert picture["health"]["sensors"][0]["source"] == "can0"
    assert picture["events"][0]["text"] == "fix 34 m off"
    waiting = picture_json(VehiclePicture("v2"), SECOND)
    assert waiting["state"] is None
    assert waiting["state_age_s"] is None


def test_satellites_are_shown_with_their_geometry_until_they_are_of_long_ago() -> None:
    fleet, vehicle = flying()
    assert picture_json(vehicle, SECOND)["satellites"] is None
    assert "Sky" not in text_of(fleet, SECOND + 2 * NS)
    one = np.array([1], np.int64)
    dop = np.array([[2.25, 2.0, 1.0, 1.75, 1.0]])
    for used, dops, shown in (
        (16, dop, "16 satellites, 1 contradicting them, GDOP 2.2, HDOP 1.0, VDOP 1.8"),
        (2, np.full((1, 5), NO_DOP), "2 satellites, 1 contradicting them\n"),
    ):
        row = encode_satellites(Satellites(T0 * one, used * one, one, dops))[0].tobytes()
        fleet.update(Heard("v1", payloads.SATELLITES, row), SECOND + 2 * NS)
        text = "\n".join(line.rstrip() for line in text_of(fleet, SECOND + 3 * NS).splitlines())
        assert f"Sky    {shown}" in text + "\n"
    told = picture_json(vehicle, SECOND + 12 * NS)["satellites"]
    assert (told["used"], told["excluded"], told["gdop"], told["age_s"]) == (2, 1, None, 10.0)
    assert "10 s ago" in text_of(fleet, SECOND + 12 * NS)
