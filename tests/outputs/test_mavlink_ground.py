"""MAVLink to ground stations: packed, decoded by pymavlink, and read field by field."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.config import Ground
from companion.navigation.rotation import quat_from_rpy, rotate_body, rotate_nav, rpy_from_quat
from companion.outputs import mavlink_ground as ground
from companion.outputs.epoch import Epoch, before_next, epoch_at
from companion.outputs.mavlink_feeds import GroundFeed
from companion.types import (
    F64,
    NS,
    Channel,
    Event,
    Health,
    LogHealth,
    LoopHealth,
    Mode,
    Outputs,
    Solution,
    Verdict,
)
from tests.outputs.zenoh_help import T0, outputs, report, solution


def over_the_wire(message: Any) -> Any:
    """What a receiver makes of a message."""
    sender, receiver = mavlink.MAVLink(None, 1, 191), mavlink.MAVLink(None)
    (decoded,) = receiver.parse_buffer(message.pack(sender))
    return decoded


def state(
    *,
    rpy_deg: tuple[float, float, float] = (10.0, -20.0, 130.0),
    vel_n: tuple[float, float, float] = (3.0, -4.0, 0.5),
    mode: Mode = Mode.NAVIGATING,
    position_sd: float = 1.0,
    seed: int = 3,
) -> Solution:
    """Two epochs with full covariance blocks, turning at 0.1 rad/s about body forward."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(5, 3, 3))
    cov = root @ root.transpose(0, 2, 1)
    cov[0] *= position_sd**2 / (cov[0, 0, 0] + cov[0, 1, 1])
    cov[2] *= 1e-4
    base = solution(2, mode=mode)
    q0 = quat_from_rpy(*np.radians(rpy_deg))
    q1 = q0.copy()
    rotate_body(q1, 0.002, 0.0, 0.0)
    upper = cov[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    return replace(
        base,
        lat=np.radians([-35.36, -35.3599]),
        lon=np.radians([149.16, 149.1601]),
        height=np.array([600.0, 603.5]),
        vel_n=np.array([vel_n, (vel_n[0] + 0.2, vel_n[1], vel_n[2])]),
        q_nb=np.array([q0, q1]),
        cov=np.tile(upper, (2, 1, 1)),
        resets=np.array([0, 1]),
    )


def epoch(**kwargs: Any) -> Epoch:
    """The second epoch of :func:`state`."""
    made = state(**kwargs)
    return epoch_at(made, 1, before_next(made, 0))


def test_attitude_is_scalar_first_with_mean_rates() -> None:
    e = epoch()
    m = over_the_wire(ground.attitude_quaternion(e, e.t_ns - 1_500_000_000))
    assert m.time_boot_ms == 1500
    assert [m.q1, m.q2, m.q3, m.q4] == pytest.approx(e.q_nb.tolist(), abs=1e-7)
    assert [m.rollspeed, m.pitchspeed, m.yawspeed] == pytest.approx([0.1, 0.0, 0.0], abs=1e-6)
    first = epoch_at(state(), 0, None)
    assert math.isnan(over_the_wire(ground.attitude_quaternion(first, 0)).rollspeed)


def test_global_position_has_amsl_altitude_and_an_upward_third_state() -> None:
    e = epoch()
    m = over_the_wire(ground.global_position_int_cov(e, 19.25, 590.0))
    assert m.time_usec == e.t_ns // 1000
    assert m.estimator_type == mavlink.MAV_ESTIMATOR_TYPE_GPS_INS
    assert (m.lat, m.lon) == (-353599000, 1491601000)
    assert (m.alt, m.relative_alt) == (584_250, 13_500)
    assert [m.vx, m.vy, m.vz] == pytest.approx([3.2, -4.0, 0.5], abs=1e-6)
    cov = np.array(m.covariance).reshape(6, 6)
    expected = np.zeros((6, 6))
    expected[:3, :3] = np.diag([1, 1, -1]) @ e.cov_pos @ np.diag([1, 1, -1])
    expected[3:, 3:] = e.cov_vel
    assert cov == pytest.approx(expected, rel=1e-6)


def test_longitude_beyond_the_date_line_is_wrapped() -> None:
    e = replace(epoch(), lon=math.radians(180.5))
    assert over_the_wire(ground.global_position_int_cov(e, 0.0, 0.0)).lon == -1_795_000_000


def test_local_position_rows_are_position_velocity_acceleration() -> None:
    e = epoch()
    m = over_the_wire(ground.local_position_ned_cov(e, (12.0, -7.0, -3.5)))
    assert m.time_usec == e.t_ns // 1000
    assert [m.x, m.y, m.z] == pytest.approx([12.0, -7.0, -3.5])
    assert [m.vx, m.vy, m.vz] == pytest.approx([3.2, -4.0, 0.5], abs=1e-6)
    assert [m.ax, m.ay, m.az] == pytest.approx([10.0, 0.0, 0.0], abs=1e-4)
    # Nine entries of the first row, eight of the second, …
    starts = np.cumsum([0, 9, 8, 7, 6, 5, 4, 3, 2])
    c = m.covariance
    assert len(c) == 45
    assert [c[s] for s in starts[:3]] == pytest.approx(np.diag(e.cov_pos).tolist(), rel=1e-6)
    assert [c[s] for s in starts[3:6]] == pytest.approx(np.diag(e.cov_vel).tolist(), rel=1e-6)
    assert all(math.isnan(c[s]) for s in starts[6:])
    assert c[1] == pytest.approx(e.cov_pos[0, 1], rel=1e-6)
    assert c[starts[4] + 1] == pytest.approx(e.cov_vel[1, 2], rel=1e-6)


@pytest.mark.parametrize(
    ("mode", "flags"),
    [
        (Mode.ALIGNING, 0),
        (Mode.HEADING_UNKNOWN, 0x33E),
        (Mode.NAVIGATING, 0x33F),  # what ArduPilot reports when it is content
        (Mode.COASTING, 0x10F),
    ],
)
def test_estimator_flags_say_what_can_be_relied_on(mode: Mode, flags: int) -> None:
    m = over_the_wire(ground.estimator_status(epoch(mode=mode), ground.TestRatios()))
    assert m.flags == flags
    assert math.isnan(m.vel_ratio)
    assert math.isnan(m.hagl_ratio)
    assert math.isnan(m.tas_ratio)


def test_estimator_ratios_are_nis_over_gate_and_a_rejected_fix_is_a_glitch() -> None:
    ratios = ground.TestRatios()
    ratios.update(report(Channel.GNSS_POSITION_H, nis=6.9))
    ratios.update(report(Channel.BARO, nis=1.38))
    ratios.update(report(Channel.GNSS_VELOCITY_V, Verdict.REFUSED_LATE, nis=math.nan))
    e = epoch()
    m = over_the_wire(ground.estimator_status(e, ratios))
    assert m.pos_horiz_ratio == pytest.approx(0.5)
    assert m.pos_vert_ratio == pytest.approx(0.1)
    assert math.isnan(m.vel_ratio)
    assert m.pos_horiz_accuracy == pytest.approx(1.0, rel=1e-6)
    assert m.pos_vert_accuracy == pytest.approx(math.sqrt(e.cov_pos[2, 2]), rel=1e-6)
    ratios.update(report(Channel.GNSS_POSITION_H, Verdict.REJECTED_GATE, nis=27.6))
    m = over_the_wire(ground.estimator_status(e, ratios))
    assert m.pos_horiz_ratio == pytest.approx(2.0)
    assert m.flags & mavlink.ESTIMATOR_GPS_GLITCH
    ratios.update(report(Channel.GNSS_POSITION_H))
    assert (
        not over_the_wire(ground.estimator_status(e, ratios)).flags & mavlink.ESTIMATOR_GPS_GLITCH
    )


def test_long_texts_go_in_chunks_that_belong_together() -> None:
    text = "GNSS fixes of receiver 0 rejected for 12 s: 34 m off, gate 9 m; coasting on the IMU"
    chunks = [over_the_wire(m) for m in ground.statustext(Event(T0, "x", text, "warning"), 7)]
    assert "".join(m.text for m in chunks) == "nav: " + text
    assert [m.chunk_seq for m in chunks] == [0, 1]
    assert {m.id for m in chunks} == {8}
    assert {m.severity for m in chunks} == {mavlink.MAV_SEVERITY_WARNING}
    (short,) = [over_the_wire(m) for m in ground.statustext(Event(T0, "x", "1σ is 2 m"), 7)]
    assert (short.text, short.id, short.severity) == (
        "nav: 1? is 2 m",
        0,
        mavlink.MAV_SEVERITY_INFO,
    )


def turned(q: F64, phi: F64) -> F64:
    out = q.copy()
    rotate_nav(out, *phi)
    return out


def test_covariance_of_euler_angles_follows_small_turns() -> None:
    for rpy in ((0.1, 0.7, -2.0), (-0.5, -1.2, 0.3), (2.5, 0.0, 3.0)):
        e = epoch(rpy_deg=tuple(np.degrees(rpy)))
        step = 1e-6
        # J by central differences through the same rotation as the filter's error.
        columns = [
            (
                rpy_from_quat(turned(e.q_nb, step * axis))
                - rpy_from_quat(turned(e.q_nb, -step * axis))
            )
            / (2 * step)
            for axis in np.eye(3)
        ]
        J = np.stack(columns, axis=1)
        assert e.cov_rpy == pytest.approx(J @ e.cov_att @ J.T, rel=1e-5, abs=1e-12)


class Sent:
    """A link that keeps what it is given."""

    def __init__(self) -> None:
        self.messages: list[Any] = []

    def send(self, message: Any) -> None:
        self.messages.append(over_the_wire(message))

    def names(self) -> list[str]:
        names = [m.get_type() for m in self.messages]
        self.messages.clear()
        return names


def health(mode: Mode) -> Health:
    return Health(
        "v", T0, 1.0, mode, "ok", "", (), (), LoopHealth(0.0, 0.1, 0.1, 0.1, 0.2), LogHealth("off")
    )


def test_ground_feed_sends_nothing_of_a_solution_before_there_is_one() -> None:
    link = Sent()
    undulation: list[float | None] = [None]
    feed = GroundFeed(Ground(rate_hz=10.0), link, T0, lambda: undulation[0])
    feed.publish(outputs(solution(50, mode=Mode.ALIGNING)), 0)
    assert link.names() == []
    feed.health(health(Mode.ALIGNING))
    assert link.messages[0].system_status == mavlink.MAV_STATE_CALIBRATING
    assert link.messages[0].type == mavlink.MAV_TYPE_ONBOARD_CONTROLLER
    assert link.messages[0].autopilot == mavlink.MAV_AUTOPILOT_INVALID
    assert link.messages[1].flags == 0
    link.names()
    feed.publish(outputs(solution(50, first=50)), 0)
    assert link.names() == ["ATTITUDE_QUATERNION", "LOCAL_POSITION_NED_COV"] * 10
    undulation[0] = 40.0
    feed.publish(outputs(solution(5, first=100)), 0)
    assert link.names() == [
        "ATTITUDE_QUATERNION",
        "LOCAL_POSITION_NED_COV",
        "GLOBAL_POSITION_INT_COV",
    ]
    event = Event(T0, "reset", "position taken anew", "error")
    empty = solution(0)
    feed.publish(Outputs(empty, empty, report(Channel.BARO), (event,)), 0)
    assert [m.text for m in link.messages] == ["nav: position taken anew"]


def test_ground_feed_leaves_out_what_is_not_finite() -> None:
    link = Sent()
    feed = GroundFeed(Ground(), link, T0, lambda: 0.0)
    broken = solution(3)
    broken.cov[:] = np.nan
    feed.publish(outputs(broken), 0)
    feed.health(health(Mode.NAVIGATING))
    assert link.names() == ["HEARTBEAT"]


def test_local_position_counts_from_the_first_one_sent() -> None:
    link = Sent()
    feed = GroundFeed(Ground(rate_hz=50.0), link, T0, lambda: 0.0)
    feed.publish(outputs(solution(101)), 0)
    local = [m for m in link.messages if m.get_type() == "LOCAL_POSITION_NED_COV"]
    assert (local[0].x, local[0].y, local[0].z) == (0.0, 0.0, 0.0)
    # 2 s at 10 m/s; the sphere that ground stations reckon with is off by less than 0.2 %.
    assert local[-1].x == pytest.approx(20.0, rel=2e-3)
    assert local[-1].time_usec - local[0].time_usec == 2 * NS // 1000
