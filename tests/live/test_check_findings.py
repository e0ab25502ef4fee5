"""What ``companion check`` says of what it heard; no links, no clocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.config import CanBus, CanImu, Config, Imu, Mavlink, RawGnss
from companion.gnss.gps_time import GPS_EPOCH_POSIX_S, WEEK_S
from companion.gnss.systems import GPS
from companion.runtime.check.findings import findings
from companion.runtime.check.heard import (
    CanHeard,
    Finding,
    Heard,
    ImuHeard,
    MavlinkHeard,
    OutputHeard,
    RateHeard,
    StreamHeard,
    SystemHeard,
)
from companion.runtime.check.receiver import ReceiverTally
from companion.runtime.check.tally import MavlinkTally, SampleTally
from companion.types import NS, GnssSamples, ImuSamples
from drivers.rtcm.framer import pack as rtcm_pack
from drivers.ublox.framer import pack
from replay.simulator.constellation import ephemerides
from replay.simulator.live import rtcm, ubx

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


# --------------------------------------------------------------------------- raw GNSS

FIRST_NS = (GPS_EPOCH_POSIX_S - 18 + 2300 * WEEK_S + 100) * NS
"""UTC of second 100 of GPS week 2300."""
RECEIVER = RawGnss(endpoint="tcp:10.0.0.2:5000", coupling="tight")
SATS, RANGES = np.array([101, 105, 110, 122, 231]), np.array([2.1e7, 2.2e7, 2.3e7, 2.1e7, 2.6e7])


def receiver_said(config: RawGnss, *pieces: bytes) -> list[Finding]:
    tally = ReceiverTally(config)
    for k, data in enumerate(pieces):
        tally.feed(k, FIRST_NS + k * NS // 5, data)
    whole = Config(can=CONFIG.can, mavlink=CONFIG.mavlink, raw_gnss=config)
    found = findings(whole, heard(receiver=tally.heard("")))
    return [f for f in found if f.part == config.endpoint]


def ubx_epochs(count: int, week: int = 2300, second: float = 100.0) -> list[bytes]:
    rates = np.ones(len(SATS))
    return [ubx.rawx(week, second + 0.2 * k, SATS, RANGES, rates) for k in range(count)]


def test_a_receiver_in_order() -> None:
    row = next(r for r in ephemerides((GPS,), 2300, 0.0, 10.0) if r[0] == 101)
    [finding] = receiver_said(RECEIVER, *ubx_epochs(20), *ubx.lnav(row))
    assert (finding.level, finding.text) == (
        "ok", "raw GNSS at 5.0 Hz, satellites G4 E1, 45 dB-Hz, 1 ephemerides",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("week", "second", "text"),
    [
        (2300 - 1024, 100.0, "its time is 1024 weeks behind this computer's"),
        (2300, 118.0, "its time is 18.0 s ahead of this computer's"),
    ],
)
def test_a_receiver_of_another_time(week: int, second: float, text: str) -> None:
    found = receiver_said(RECEIVER, *ubx_epochs(20, week, second))
    [finding] = [f for f in found if "time" in f.text]
    assert (finding.level, finding.text) == ("warning", text)


@pytest.mark.parametrize(
    ("pieces", "text", "advice"),
    [
        ((), "nothing came", "raw_gnss.baud"),
        ((b"\x00\xf1\x7e" * 40,), "120 bytes, none of them UBX", "raw_gnss.baud"),
        ((b"$GNGGA,1*00\r\n" * 9,), "none of them UBX", "NMEA comes, which has no ranges"),
        (rtcm.epoch(50.0, SATS, RANGES, RANGES * 0), "none of them UBX", "protocol = 'rtcm3'"),
        ((pack(0x0135, bytes(8)),), "heard are UBX 01-35", "UBX-RXM-RAWX"),
    ],
)
def test_a_receiver_that_sends_something_else(
    pieces: Sequence[bytes], text: str, advice: str
) -> None:
    [finding] = receiver_said(RECEIVER, *pieces)
    assert finding.level == "error"
    assert text in finding.text
    assert advice in finding.advice


def test_a_receiver_that_could_say_more() -> None:
    config = RawGnss(endpoint="/dev/ttyUSB0", protocol="rtcm3")
    rates = np.full(len(SATS), np.nan)
    pieces = [b"".join(rtcm.epoch(50.0 + k, SATS, RANGES, rates, kind=4)) for k in range(5)]
    pieces[2] = pieces[2][:-5]
    pieces[3] += rtcm_pack((1005 << 4).to_bytes(2, "big") + bytes(17))
    texts = {f.text: f.advice for f in receiver_said(config, *pieces)}
    assert "MSM5 or MSM7" in texts["no Doppler: no velocity from it"]
    assert "1019" in texts["no ephemeris in 8 s"]
    assert (
        "own receiver" in texts["a station's coordinates come (1005, 1006): a base's corrections?"]
    )
    assert "coupling" in texts["is logged and not used"]
    assert "baud" in texts["1 broken messages beside 10"]


def test_ranges_stand_in_for_fixes_where_they_are_used() -> None:
    tally = ReceiverTally(RECEIVER)
    for data in ubx_epochs(10):
        tally.feed(1, NS, data)
    receiver = tally.heard("")
    for coupling, missing in (("tight", False), ("off", True)):
        raw = msgspec.structs.replace(RECEIVER, coupling=coupling)
        config = Config(can=CONFIG.can, mavlink=CONFIG.mavlink, raw_gnss=raw)
        found = findings(config, heard(streams=(), receiver=receiver))
        assert (("error", "gnss") in problems(found)) is missing
