"""The live page's model: what a reader is told, and that nothing grows without end."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from companion.logbook.adaptation import encode_trace
from companion.logbook.health import encode_health
from companion.navigation.earth import ned_difference
from companion.outputs import payloads
from companion.outputs.subscriber import Heard
from companion.types import NS, AdaptationTrace, Channel, Mode, Verdict
from companion.watch.alarms import alarms
from companion.watch.picture import VEHICLES, Fleet
from companion.watch.web.history import POINTS, ROWS, Track, plane_m
from companion.watch.web.model import Cursor, PageModel
from tests.outputs.test_zenoh_publisher import HEALTH
from tests.watch.test_picture import SECOND, aiding, event, state


def at(heard: Heard, now_ns: int, vehicle: str = "v1") -> Heard:
    return Heard(vehicle, heard.name, heard.payload, now_ns)


def told(model: PageModel, cursor: Cursor) -> tuple[dict[str, Any], Cursor]:
    frame, after = model.frame(cursor)
    return json.loads(frame), after


def flown(seconds: int, vehicle: str = "v1") -> PageModel:
    """10 m/s north at 50 Hz, fixes at 5 Hz; a tick every 0.2 s."""
    model = PageModel("s", SECOND)
    for k in range(50 * seconds):
        now = SECOND + k * NS // 50
        model.update(at(state(k, arrival_ns=now - 300_000), now, vehicle))
        if k % 10 == 0:
            fix = aiding(Channel.GNSS_POSITION_H, Verdict.ACCEPTED, 6.9)
            model.update(at(fix, now, vehicle))
            model.tick(now)
    return model


def test_a_new_reader_is_told_everything_and_then_only_what_is_new() -> None:
    model = flown(4)
    model.update(at(event("hello"), SECOND + 4 * NS))
    model.tick(SECOND + 4 * NS)
    frame, cursor = told(model, Cursor())
    v = frame["vehicles"]["v1"]
    assert v["anew"]
    assert len(v["rows"]) == 21
    assert v["rows"][-2][1] == {
        "rate": pytest.approx(50, abs=0.5), "gate.gnss_position_h": 0.5, "latency": 0.3,
        "height": 500, "speed": 10, "climb": 0, "sd_h": pytest.approx(math.sqrt(2), abs=1e-5),
        "sd_v": 1, "roll": 0, "pitch": 0, "yaw": pytest.approx(30),
    }  # fmt: skip
    assert v["track"]["points"][-1][1] == pytest.approx(199 * 0.2, rel=0.01)
    assert [e["text"] for e in v["events"]] == ["hello"]
    assert v["now"]["place_m"][0] == pytest.approx(199 * 0.2, rel=0.01)

    frame, cursor = told(model, cursor)
    v = frame["vehicles"]["v1"]
    assert (v["anew"], v["rows"], v["track"]["points"], v["events"]) == (False, [], [], [])
    model.update(at(event("again", "warning"), SECOND + 5 * NS))
    model.tick(SECOND + 5 * NS)
    v = told(model, cursor)[0]["vehicles"]["v1"]
    assert [e["text"] for e in v["events"]] == ["again"]
    assert len(v["rows"]) == 1
    assert "height" not in v["rows"][0][1]  # of a state that is a second old


def test_a_reader_that_missed_frames_lacks_nothing() -> None:
    model, everything, late = PageModel("s", SECOND), [], Cursor()
    cursor = Cursor()
    seen: list[Any] = []
    for k in range(2000):
        now = SECOND + k * NS // 5
        model.update(at(state(40 * k), now))  # 8 m a tick
        model.tick(now)
        frame, cursor = told(model, cursor)
        track = frame["vehicles"]["v1"]["track"]
        everything = track["points"] if track["again"] else everything + track["points"]
        if k % 97 == 0 or k == 1999:
            frame, late = told(model, late)
            track = frame["vehicles"]["v1"]["track"]
            seen = track["points"] if track["again"] else seen + track["points"]
    assert seen == everything
    assert seen[-1][1] == pytest.approx(1999 * 8, rel=0.01)


def test_rows_points_and_vehicles_have_a_limit() -> None:
    track = Track()
    for k in range(5 * POINTS):
        track.add(k * 0.02, 10.0 * k, 0.0, 2)
        assert len(track.points) <= POINTS
    assert (track.points[0][1], track.generation) == (0.0, 3)
    assert track.points[-1][1] > 0.999 * 50.0 * POINTS
    model = PageModel("s", SECOND)
    for i in range(2 * VEHICLES):
        model.update(at(state(), SECOND, f"stranger {i}"))
    for k in range(ROWS + 10):
        model.tick(SECOND + k * NS // 5)
    vehicles = told(model, Cursor())[0]["vehicles"]
    assert len(vehicles) == VEHICLES
    assert {len(v["rows"]) for v in vehicles.values()} == {ROWS}


def test_gates_do_not_grow_while_nobody_looks() -> None:
    fleet = Fleet()
    said = aiding(Channel.BARO, Verdict.ACCEPTED, 1.0)
    for k in range(2000):
        fleet.update(said, SECOND + k * NS // 10)
    assert len(fleet.vehicles["v1"].gates[Channel.BARO].verdicts) <= 301


def test_the_plane_agrees_with_the_navigation_equations() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        lat, lon = rng.uniform(-1.3, 1.3), rng.uniform(-3.14, 3.14)
        d_lat, d_lon = rng.uniform(-3e-3, 3e-3, 2)
        one = [np.array([x]) for x in (lat + d_lat, lon + d_lon, 0.0, lat, lon, 0.0)]
        north, east, _ = ned_difference(*one)[0]
        found = plane_m((lat + d_lat, lon + d_lon), (lat, lon))
        # Radii halfway against radii at one end: up to 1 % of 20 km near the poles' side.
        assert found == pytest.approx((north, east), abs=0.012 * 20e3)
    # Over the date line: 1e-4 rad, on the equator.
    assert plane_m((0.0, -math.pi + 5e-5), (0.0, math.pi - 5e-5))[1] == pytest.approx(
        637.8, abs=0.1
    )


def test_a_killed_receiver_is_an_error_within_a_second() -> None:
    model = flown(4)
    fleet_end = SECOND + 4 * NS
    for k in range(200, 300):
        now = SECOND + k * NS // 50
        model.update(at(state(k), now))
        if k % 10 == 0:
            model.tick(now)
            alarmed = told(model, Cursor())[0]["vehicles"]["v1"]["now"]["alarms"]
            if alarmed:
                break
    assert alarmed[0]["part"] == "gnss"
    assert alarmed[0]["level"] == "error"
    assert "no measurement" in alarmed[0]["text"]
    assert now - fleet_end < NS


def test_alarms_say_what_is_wrong_worst_first() -> None:
    fleet = Fleet()
    fleet.update(state(mode=Mode.COASTING, arrival_ns=SECOND - 50_000_000), SECOND)
    fleet.update(Heard("v1", payloads.HEALTH, encode_health(HEALTH)), SECOND)
    fleet.update(aiding(Channel.GNSS_POSITION_H, Verdict.REFUSED_NO_FIX, math.nan), SECOND)
    v = fleet.vehicles["v1"]
    assert [(a.level, a.part) for a in alarms(v, SECOND)] == [
        ("error", "vehicle"), ("warning", "gnss"), ("warning", "health"), ("warning", "latency")
    ]  # fmt: skip
    assert "no state for 2 s" in alarms(v, SECOND + 2 * NS)[0].text.replace("navigation ", "")
    fleet.update(Heard("v1", payloads.ALIVE, None), SECOND)
    assert alarms(v, SECOND)[0].text.startswith("the companion is gone")


def test_a_slow_receiver_is_not_overdue_before_its_time() -> None:
    fleet = Fleet()
    for k in range(6):
        fleet.update(aiding(Channel.GNSS_POSITION_H, Verdict.ACCEPTED, 1.0), SECOND + k * NS)
    gate = fleet.vehicles["v1"].gates[Channel.GNSS_POSITION_H]
    assert not gate.overdue(SECOND + 5 * NS + 1_700_000_000)
    assert gate.overdue(SECOND + 5 * NS + 1_900_000_000)


def adapted() -> AdaptationTrace:
    """One barometer measurement taken for worse than it says, in part for the inertial unit's."""
    one = np.ones(1)
    return AdaptationTrace(
        t_ns=np.array([SECOND]), channel=np.array([Channel.BARO]), source=np.array([0]),
        mean=4 * one, spread=9 * one, correlation=one, to_model=0.9 * one, to_source=0 * one,
        firing=np.eye(9)[[7]], r_scale=6.0 * one, q_scale=2.5 * one, alpha=one,
    )  # fmt: skip


def test_adaptation_is_told_with_the_winning_rule() -> None:
    trace = encode_trace(adapted())[0].tobytes()
    model = PageModel("s", SECOND)
    model.update(Heard("v1", payloads.ADAPTATION, trace, SECOND))
    model.tick(SECOND)
    v = told(model, Cursor())[0]["vehicles"]["v1"]
    assert v["now"]["adaptation"]["baro"] == {
        "r_scale": 6.0, "q_scale": 2.5, "alpha": 1.0, "age_s": 0.0,
        "because": "innovations scatter more than expected, a little off zero: most of it "
        "taken for the inertial unit's error",
    }  # fmt: skip
    assert v["rows"][-1][1]["r.baro"] == 6.0
