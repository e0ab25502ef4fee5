"""What ``companion check`` says of what it heard; no links, no clocks."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.config import CanBus, CanImu, Config, Imu, Mavlink
from companion.runtime.check.findings import Finding, findings
from companion.runtime.check.heard import (
    CanHeard,
    Heard,
    ImuHeard,
    MavlinkHeard,
    OutputHeard,
    RateHeard,
    StreamHeard,
    SystemHeard,
)
from companion.runtime.check.tally import MavlinkTally, SampleTally
from companion.types import NS, GnssSamples, ImuSamples

UNIT = CanImu(name="can-imu", protocol="dronecan")
CONFIG = Config(can=(CanBus(channel="can0", imu=(UNIT,)),), mavlink=Mavlink(endpoint="/dev/tty0"))
RAW_IMU_OF_42 = (8 << 24 | 1003 << 8 | 42, True)

BUS = CanHeard("socketcan:can0", frames=7000, ids={RAW_IMU_OF_42: 700.0})
IMU = ImuHeard(
    source="can-imu",
    link="socketcan:can0",
    samples=1000,
    rate_hz=100.0,
    gyro_mean_dps=(0.1, 0.0, -0.2),
    accel_mean_mps2=(0.1, -0.1, -9.8),
    gyro_noise_dps_rthz=0.01,
    accel_noise_mps2_rthz=0.004,
)
LINK = MavlinkHeard(
    "/dev/tty0",
    bytes=9000,
    systems=(SystemHeard(1, 1, "ArduPilot", 300, {"HEARTBEAT": 1.0}),),
    vehicle=(1, 1),
    rates=(RateHeard("GPS_RAW_INT", 10.0, True, 9.9, True),),
)


def fix(fix_type: int = 3) -> StreamHeard:
    one, whole = np.zeros(1), np.zeros(1, np.int64)
    vector = np.full((1, 3), 1.2)
    last = GnssSamples(
        "GPS_RAW_INT", whole, whole, whole, one, one, one, vector, vector, vector,
        np.array([14]), np.array([fix_type]),
    )  # fmt: skip
    return StreamHeard("gnss", "GPS_RAW_INT", 50, 10.0, last)


def heard(**changes: Any) -> Heard:
    whole = Heard(
        seconds=8.0,
        buses=(BUS,),
        mavlink=LINK,
        imus=(IMU,),
        streams=(fix(),),
        zenoh=OutputHeard("zenoh", note="opens"),
        log=OutputHeard("log", note="room"),
    )
    return replace(whole, **changes)


def problems(found: list[Finding]) -> list[tuple[str, str]]:
    return [(f.level, f.part) for f in found if f.level != "ok" and f.part != "baro"]


def one(found: list[Finding], part: str) -> Finding:
    (finding,) = [f for f in found if f.part == part and f.level != "ok"]
    return finding


def test_a_vehicle_in_order_has_no_problems() -> None:
    assert problems(findings(CONFIG, heard())) == []


def test_links_that_do_not_open() -> None:
    bus = CanHeard("socketcan:can0", refused="No such device")
    link = MavlinkHeard("/dev/tty0", refused="Permission denied")
    zenoh = OutputHeard("zenoh", "Address already in use", "another program")
    found = findings(CONFIG, heard(buses=(bus,), mavlink=link, imus=(), streams=(), zenoh=zenoh))
    assert one(found, "socketcan:can0").advice == "ip link set can0 up type can bitrate 1000000"
    assert "dialout" in one(found, "/dev/tty0").advice
    assert {part for level, part in problems(found) if level == "error"} == {
        "socketcan:can0",
        "/dev/tty0",
        "imu",
        "gnss",
        "zenoh",
    }


def test_a_silent_bus_and_line() -> None:
    bus, link = CanHeard("socketcan:can0"), MavlinkHeard("/dev/tty0")
    found = findings(CONFIG, heard(buses=(bus,), mavlink=link))
    assert "termination" in one(found, "socketcan:can0").advice
    assert "SERIALn_PROTOCOL = 2" in one(found, "/dev/tty0").advice


@pytest.mark.parametrize(
    ("unit", "advice"),
    [
        (CanImu(name="x", protocol="dronecan", node_id=7), "set node_id = 42"),
        (CanImu(name="x", protocol="xsens-mti"), "protocol = 'dronecan'?"),
    ],
)
def test_a_unit_that_is_configured_wrongly(unit: CanImu, advice: str) -> None:
    config = Config(can=(CanBus(channel="can0", imu=(unit,)),))
    assert advice in one(findings(config, heard(mavlink=None)), "x").advice


def test_identifiers_are_shown_where_nothing_fits() -> None:
    bus = CanHeard("socketcan:can0", frames=10, ids={(0x123, False): 1.0, (0x1234567, True): 2.0})
    found = findings(CONFIG, heard(buses=(bus,), imus=()))
    assert "123, 01234567" in one(found, "can-imu").advice


@pytest.mark.parametrize(
    ("change", "advice"),
    [
        ({"rate_hz": 4.0}, "faster link"),
        ({"rate_hz": 50.0}, "100 Hz or more"),
        ({"lost": 30}, "bus load"),
        ({"saturated": 2}, "full scale"),
        ({"accel_mean_mps2": (0.0, 0.0, -1.0)}, "unit or scale"),
        ({"accel_mean_mps2": (0.0, 0.0, 9.8)}, "imu.axes"),
        ({"gyro_noise_dps_rthz": 1.0}, "imu.gyro_noise_dps_rthz = 1 or more"),
        ({"accel_noise_mps2_rthz": 0.5}, "imu.accel_noise_mps2_rthz = 0.5 or more"),
    ],
)
def test_an_inertial_unit_that_is_not_as_it_should(change: dict[str, Any], advice: str) -> None:
    found = findings(CONFIG, heard(imus=(replace(IMU, **change),)))
    assert advice in one(found, "can-imu").advice


def test_a_unit_slower_than_configured() -> None:
    unit = CanImu(name="can-imu", protocol="dronecan", rate_hz=400.0)
    config = Config(can=(CanBus(channel="can0", imu=(unit,)),))
    assert "100 Hz of 400" in one(findings(config, heard(mavlink=None)), "can-imu").text


def test_a_moving_vehicle_is_not_blamed_for_gravity() -> None:
    moving = replace(IMU, accel_mean_mps2=(2.0, 0.0, -12.0), gyro_mean_dps=(30.0, 0.0, 0.0))
    assert problems(findings(CONFIG, heard(imus=(moving,)))) == []


def test_the_stream_that_is_named_is_missing() -> None:
    config = Config(imu=Imu(source="other"), can=CONFIG.can)
    finding = one(findings(config, heard(mavlink=None)), "imu")
    assert "can-imu" in finding.advice


def test_autopilots_that_are_not_there_or_do_not_give() -> None:
    ground = SystemHeard(255, 190, "", 9, {"HEARTBEAT": 1.0})
    alone = replace(LINK, vehicle=None, systems=(ground,))
    assert "255/190" in one(findings(CONFIG, heard(mavlink=alone)), "/dev/tty0").text
    noise = replace(LINK, vehicle=None, systems=())
    assert "baud rate" in one(findings(CONFIG, heard(mavlink=noise)), "/dev/tty0").advice
    slow = (RateHeard("GPS_RAW_INT", 10.0, True, 2.0, True), RateHeard("X", 9.0, False, 0.0, False))
    short = findings(CONFIG, heard(mavlink=replace(LINK, rates=slow)))
    assert "2.0 of 10 Hz (granted)" in one(short, "/dev/tty0").text


def test_no_fix_is_a_warning_and_no_receiver_an_error() -> None:
    assert problems(findings(CONFIG, heard(streams=(fix(1),)))) == [("warning", "GPS_RAW_INT")]
    assert problems(findings(CONFIG, heard(streams=()))) == [("error", "gnss")]


# --------------------------------------------------------------------------- counting


def test_noise_and_rate_of_known_samples() -> None:
    rng, n, rate = np.random.default_rng(1), 4000, 200.0
    t = (np.arange(n) * NS / rate).astype(np.int64)
    # A slow turn that must not count as noise, and 0.02 deg/s/√Hz that must.
    gyro = np.radians(np.sin(np.arange(n) / rate))[:, None] + rng.standard_normal(
        (n, 3)
    ) * np.radians(0.02 * np.sqrt(rate))
    accel = np.tile([0.0, 0.0, 9.81], (n, 1))
    tally = SampleTally()
    for part in np.split(np.arange(n), 40):
        tally.add(
            "bus",
            ImuSamples("a", t[part], t[part], part, gyro[part], accel[part], np.full(100, np.nan)),
        )
    (imu,) = tally.imus(np.diag([1.0, -1.0, -1.0]), {})
    assert imu.rate_hz == pytest.approx(rate)
    # The largest of three axes, each known to 1/√(2·4000) = 1.1 %: within 5 %.
    assert imu.gyro_noise_dps_rthz == pytest.approx(0.02, rel=0.05)
    assert imu.accel_mean_mps2 == pytest.approx((0.0, 0.0, -9.81))


def test_senders_are_told_apart() -> None:
    tally = MavlinkTally()
    for system, kind in ((1, mavlink.MAV_AUTOPILOT_PX4), (255, mavlink.MAV_AUTOPILOT_INVALID)):
        mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=1)
        tally.feed(mav.heartbeat_encode(2, kind, 0, 0, 4).pack(mav))
    tally.mark()
    tally.feed(b"noise" + mav.heartbeat_encode(2, 8, 0, 0, 4).pack(mav))
    pilot, ground = tally.systems(2.0)
    assert (pilot.system, pilot.autopilot, pilot.messages) == (1, "PX4", {"HEARTBEAT": 0.5})
    assert (ground.system, ground.autopilot, ground.messages) == (255, "", {"HEARTBEAT": 1.0})
    assert tally.since_mark((255, 1)) == {"HEARTBEAT": 1}
    assert tally.bad_bytes == 5
