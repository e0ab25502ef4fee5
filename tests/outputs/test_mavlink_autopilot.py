"""What goes to the autopilot's estimator, field by field as ArduPilot and PX4 ask for it."""

from __future__ import annotations

import datetime
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.config import ToAutopilot
from companion.navigation.rotation import matrix_from_quat
from companion.outputs import mavlink_autopilot as autopilot
from companion.outputs.epoch import Epoch
from companion.outputs.local_frames import Origin, ardupilot_ne, px4_ne
from companion.outputs.mavlink_feeds import AutopilotFeed
from companion.types import NS, Mode, Solution
from tests.outputs.test_mavlink_ground import Sent, epoch, over_the_wire
from tests.outputs.zenoh_help import T0, outputs, solution

ORIGIN = Origin(math.radians(-35.363), math.radians(149.165), 580.0)
DIAGONAL = (0, 6, 11, 15, 18, 20)


def trusted(e: Epoch) -> autopilot.Trust:
    return autopilot.trust(e, 20.0)


@pytest.mark.parametrize(
    ("encode", "frame", "kinds"),
    [
        (
            autopilot.odometry_ardupilot,
            mavlink.MAV_FRAME_LOCAL_FRD,
            {mavlink.MAV_ESTIMATOR_TYPE_GPS_INS},
        ),
        (
            autopilot.odometry_px4,
            mavlink.MAV_FRAME_LOCAL_NED,
            # PX4 takes these with their covariances, and refuses the others.
            {
                mavlink.MAV_ESTIMATOR_TYPE_UNKNOWN,
                mavlink.MAV_ESTIMATOR_TYPE_VISION,
                mavlink.MAV_ESTIMATOR_TYPE_VIO,
            },
        ),
    ],
)
def test_odometry_field_by_field(encode: Any, frame: int, kinds: set[int]) -> None:
    e = epoch()
    m = over_the_wire(encode(e, ORIGIN, 87, 258))
    assert m.time_usec == e.t_ns // 1000
    assert m.frame_id == frame
    assert m.child_frame_id == mavlink.MAV_FRAME_BODY_FRD
    assert m.estimator_type in kinds
    assert m.quality == 87
    assert m.reset_counter == 2
    # North and down of the origin are positive x and z; the vehicle is north-west of it and above.
    assert 340 < m.x < 350
    assert -450 < m.y < -440
    assert m.z == pytest.approx(580.0 - 603.5)
    assert list(m.q) == pytest.approx(e.q_nb.tolist(), abs=1e-7)
    C_nb = matrix_from_quat(e.q_nb)
    assert C_nb @ [m.vx, m.vy, m.vz] == pytest.approx([3.2, -4.0, 0.5], abs=1e-5)
    assert [m.rollspeed, m.pitchspeed, m.yawspeed] == pytest.approx([0.1, 0.0, 0.0], abs=1e-6)
    assert len(m.pose_covariance) == len(m.velocity_covariance) == 21
    pose = [m.pose_covariance[i] for i in DIAGONAL]
    assert pose[:3] == pytest.approx(np.diag(e.cov_pos).tolist(), rel=1e-6)
    assert pose[3:] == pytest.approx(np.diag(e.cov_rpy).tolist(), rel=1e-6)
    assert m.pose_covariance[1] == pytest.approx(e.cov_pos[0, 1], rel=1e-6)
    assert m.pose_covariance[7] == pytest.approx(e.cov_pos[1, 2], rel=1e-6)
    assert m.pose_covariance[3] == 0.0
    velocity = [m.velocity_covariance[i] for i in DIAGONAL]
    body = C_nb.T @ e.cov_vel @ C_nb
    assert velocity[:3] == pytest.approx(np.diag(body).tolist(), rel=1e-5)
    assert all(math.isnan(v) for v in velocity[3:])
    # ArduPilot: cbrt of the summed squares; has to be a finite length and angle.
    assert math.isfinite(sum(v**2 for v in pose))


@pytest.mark.parametrize(("encode", "place"), [(ardupilot_ne, "ardupilot"), (px4_ne, "px4")])
def test_autopilot_finds_our_latitude_and_longitude_again(encode: Any, place: str) -> None:
    """Each autopilot's own way back, in its sources' formulas, ends where we are."""
    lat, lon = math.radians(-35.40), math.radians(149.10)
    north, east = encode(lat, lon, ORIGIN)
    if place == "ardupilot":
        # Location::offset: 1e-7 degrees a metre, the scale of the middle latitude.
        dlat = north / 0.011131884502145034
        dlon = east / 0.011131884502145034 / math.cos(ORIGIN.lat + math.radians(dlat * 1e-7) / 2)
        back = ORIGIN.lat + math.radians(dlat * 1e-7), ORIGIN.lon + math.radians(dlon * 1e-7)
    else:
        x, y = north / 6371000.0, east / 6371000.0
        c = math.hypot(x, y)
        back = (
            math.asin(
                math.cos(c) * math.sin(ORIGIN.lat) + x * math.sin(c) * math.cos(ORIGIN.lat) / c
            ),
            ORIGIN.lon
            + math.atan2(
                y * math.sin(c),
                c * math.cos(ORIGIN.lat) * math.cos(c) - x * math.sin(ORIGIN.lat) * math.sin(c),
            ),
        )
    # A millimetre, 7 km from the origin.
    assert back == pytest.approx((lat, lon), abs=1.6e-10)


def test_metres_across_the_date_line_are_few() -> None:
    origin = Origin(0.0, math.radians(179.999), 0.0)
    for encode in (ardupilot_ne, px4_ne):
        _, east = encode(0.0, math.radians(-179.999), origin)
        assert east == pytest.approx(222.5, rel=2e-3)
    assert px4_ne(origin.lat, origin.lon, origin) == (0.0, 0.0)


def test_gps_input_field_by_field() -> None:
    e = epoch(rpy_deg=(5.0, -3.0, 212.5))
    m = over_the_wire(autopilot.gps_input(e, trusted(e), 1, 19.25))
    assert m.time_usec == e.t_ns // 1000
    assert m.gps_id == 1
    assert m.ignore_flags == 0  # ignored velocities would keep their last value
    assert m.fix_type == 3
    assert (m.lat, m.lon) == (-353599000, 1491601000)
    assert m.alt == pytest.approx(603.5 - 19.25, abs=1e-4)
    assert [m.vn, m.ve, m.vd] == pytest.approx([3.2, -4.0, 0.5], abs=1e-6)
    assert m.horiz_accuracy == pytest.approx(1.0, rel=1e-6)
    assert m.vert_accuracy == pytest.approx(math.sqrt(e.cov_pos[2, 2]), rel=1e-6)
    assert m.speed_accuracy == pytest.approx(math.sqrt(np.trace(e.cov_vel)), rel=1e-6)
    assert 0 < m.hdop <= 1.4  # ArduPilot's limit for arming
    assert m.satellites_visible >= 6  # and for aligning
    assert abs(m.yaw - 21_250) <= 50  # the small roll step turns heading a little


def test_gps_time_is_week_and_milliseconds_with_leap_seconds() -> None:
    utc = datetime.datetime(2026, 11, 22, 6, 0, 0, 250_000, tzinfo=datetime.UTC)
    since = utc - datetime.datetime(1980, 1, 6, tzinfo=datetime.UTC)
    whole = since // datetime.timedelta(milliseconds=1) + 18_000
    t_ns = int(utc.timestamp() * 1000) * 1_000_000
    # 2026-11-22 is a Sunday: the week has just begun.
    week, week_ms = autopilot.gps_time(t_ns)
    assert (week, week_ms) == divmod(whole, 604_800_000)
    assert week_ms == 6 * 3_600_000 + 18_250
    assert autopilot.gps_time(5 * NS) == (0, 0)  # a clock that was never set


@pytest.mark.parametrize(
    ("degrees", "cdeg"),
    [(0.0, 36000), (0.004, 36000), (90.0, 9000), (-90.0, 27000), (-0.01, 35999)],
)
def test_yaw_zero_means_unknown_so_north_is_36000(degrees: float, cdeg: int) -> None:
    assert autopilot.yaw_cdeg(math.radians(degrees)) == cdeg


@pytest.mark.parametrize(
    ("mode", "sd", "expected"),
    [
        (Mode.ALIGNING, 1.0, (False, False, 0)),
        (Mode.HEADING_UNKNOWN, 1.0, (True, False, 95)),
        (Mode.NAVIGATING, 1.0, (True, True, 95)),
        (Mode.NAVIGATING, 19.99, (True, True, 1)),
        (Mode.NAVIGATING, 20.1, (False, False, 0)),
        (Mode.COASTING, 1.0, (True, True, 50)),
        (Mode.COASTING, 15.0, (True, True, 25)),
        (Mode.COASTING, 30.0, (False, False, 0)),
    ],
)
def test_trust_falls_with_uncertainty(mode: Mode, sd: float, expected: tuple[Any, ...]) -> None:
    assert trusted(epoch(mode=mode, position_sd=sd)) == expected


def test_an_epoch_that_is_not_finite_is_not_trusted() -> None:
    e = epoch()
    for broken in (
        replace(e, lat=math.nan),
        replace(e, vel_n=np.array([1.0, math.inf, 0.0])),
        replace(e, cov_att=np.full((3, 3), math.nan)),
    ):
        assert trusted(broken) == (False, False, 0)


class Vehicle(Sent):
    """An autopilot's session that keeps what is sent."""

    system = 1
    undulation_m: float | None = 19.25
    origin: tuple[int, int, int] | None = None


def flown(n: int, first: int = 0, mode: Mode = Mode.NAVIGATING, sd: float = 1.0) -> Solution:
    out = solution(n, first=first, mode=mode)
    out.cov[:, 0, [0, 3]] = 0.5 * sd**2
    return out


def feed(message: Any, vehicle: Vehicle, rate_hz: float = 50.0) -> AutopilotFeed:
    return AutopilotFeed(ToAutopilot(message=message, rate_hz=rate_hz), vehicle)


def test_origin_is_repeated_until_it_is_echoed() -> None:
    vehicle = Vehicle()
    sender = feed("odometry-ardupilot", vehicle)
    sender.publish(outputs(flown(125)), 0)
    asked = [m for m in vehicle.messages if m.get_type() == "SET_GPS_GLOBAL_ORIGIN"]
    assert [m.time_usec - T0 // 1000 for m in asked] == [0, 1_000_000, 2_000_000]
    assert asked[0].target_system == 1
    assert asked[0].latitude == round(math.degrees(0.8) * 1e7)
    assert asked[0].longitude == round(math.degrees(0.15) * 1e7)
    assert asked[0].altitude == 480_750  # above mean sea level
    wanted = [m for m in vehicle.messages if m.get_type() == "COMMAND_LONG"]
    assert [(m.command, m.param1, m.target_system) for m in wanted] == [(512, 49.0, 1)] * 3
    assert len(vehicle.messages) == 125 + 3 + 3
    before = vehicle.messages[-1]
    vehicle.names()
    # ArduPilot keeps centimetres.
    vehicle.origin = asked[0].latitude, asked[0].longitude, 480_750
    sender.publish(outputs(flown(100, first=125)), 0)
    after = vehicle.messages[0]
    assert set(vehicle.names()) == {"ODOMETRY"}
    assert after.reset_counter == before.reset_counter
    assert after.x - before.x == pytest.approx(0.2, abs=0.02)
    assert [n.kind for n in sender.notices()] == ["feed-started"]


def test_an_origin_that_the_autopilot_had_already_is_adopted_as_a_reset() -> None:
    vehicle = Vehicle()
    sender = feed("odometry-px4", vehicle)
    sender.publish(outputs(flown(1)), 0)
    # 0.001° south of ours, 10 m lower.
    vehicle.origin = (
        round(math.degrees(0.8) * 1e7) - 10_000,
        round(math.degrees(0.15) * 1e7),
        470_750,
    )
    vehicle.messages.clear()
    sender.publish(outputs(flown(1, first=1)), 0)
    (m,) = vehicle.messages
    assert m.reset_counter == 1
    assert m.x == pytest.approx(111.19 + 0.2, abs=0.02)
    assert m.z == pytest.approx(-10.0, abs=1e-3)
    assert [n.kind for n in sender.notices()] == ["feed-started", "feed-origin"]


def test_autopilot_that_lost_its_origin_is_given_ours_again() -> None:
    vehicle = Vehicle()
    sender = feed("odometry-ardupilot", vehicle, rate_hz=10.0)
    sender.publish(outputs(flown(10)), 0)
    vehicle.origin = (round(math.degrees(0.8) * 1e7), round(math.degrees(0.15) * 1e7), 480_750)
    sender.publish(outputs(flown(100, first=10)), 0)
    vehicle.names()
    vehicle.origin = None  # restarted
    sender.publish(outputs(flown(10, first=110)), 0)
    assert vehicle.names()[0] == "SET_GPS_GLOBAL_ORIGIN"


def test_odometry_is_withheld_where_it_would_mislead() -> None:
    vehicle = Vehicle()
    sender = feed("odometry-ardupilot", vehicle)
    sender.publish(outputs(flown(20, mode=Mode.ALIGNING)), 0)
    sender.publish(outputs(flown(20, 20, mode=Mode.HEADING_UNKNOWN)), 0)
    assert vehicle.names() == []
    sender.publish(outputs(flown(5, 40)), 0)
    assert vehicle.names().count("ODOMETRY") == 5
    sender.publish(outputs(flown(5, 45, mode=Mode.COASTING, sd=10.0)), 0)
    assert {m.quality for m in vehicle.messages if m.get_type() == "ODOMETRY"} == {50}
    vehicle.names()
    sender.publish(outputs(flown(5, 50, mode=Mode.COASTING, sd=25.0)), 0)
    assert vehicle.names() == []
    assert [n.kind for n in sender.notices()] == ["feed-started", "feed-stopped"]


def test_gps_input_says_no_fix_where_position_is_lost() -> None:
    vehicle = Vehicle()
    sender = feed("gps-input", vehicle, rate_hz=5.0)
    sender.publish(outputs(flown(20, mode=Mode.ALIGNING)), 0)
    assert vehicle.names() == []
    sender.publish(outputs(flown(50, 20, mode=Mode.HEADING_UNKNOWN)), 0)
    assert [(m.get_type(), m.fix_type, m.yaw) for m in vehicle.messages] == [
        ("GPS_INPUT", 3, 0)
    ] * 5
    vehicle.names()
    sender.publish(outputs(flown(10, 70)), 0)
    assert [(m.fix_type, m.yaw) for m in vehicle.messages] == [(3, 3000)]
    vehicle.names()
    sender.publish(outputs(flown(10, 80, mode=Mode.COASTING, sd=15.0)), 0)
    assert [(m.fix_type, m.satellites_visible) for m in vehicle.messages] == [(3, 6)]
    assert vehicle.messages[0].horiz_accuracy == pytest.approx(15.0)
    vehicle.names()
    sender.publish(outputs(flown(10, 90, mode=Mode.COASTING, sd=40.0)), 0)
    assert [(m.fix_type, m.satellites_visible) for m in vehicle.messages] == [(1, 0)]


def test_nothing_goes_out_before_heights_above_sea_level_are_known() -> None:
    for message in ("gps-input", "odometry-ardupilot", "odometry-px4"):
        vehicle = Vehicle()
        vehicle.undulation_m = None
        feed(message, vehicle).publish(outputs(flown(50)), 0)
        assert vehicle.names() == []
