"""The simulated vehicle's pure parts: what its autopilot, its CAN adapter and its faults do."""

from __future__ import annotations

import random
from typing import Any

import msgspec
import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.types import NS, CompanionError, ImuSamples, VehicleRecording
from replay.simulator import simulate
from replay.simulator.live import garbage, slcan
from replay.simulator.live.autopilot import BootClock, SimulatedAutopilot
from replay.simulator.live.can_unit import SimulatedCanImu
from replay.simulator.live.faults import Faults, parse_order
from replay.simulator.live.scenario import live_scenario
from replay.simulator.live.vehicle import moved

START_NS = 1_800_000_000 * NS
DRIFT_PPM = 50.0


@pytest.fixture(scope="module")
def recording() -> VehicleRecording:
    made = simulate(live_scenario(seconds=20.0, imu_hz=100.0), seed=3)
    return moved(made, START_NS - int(made.imu[0].t_ns[0]))


@pytest.fixture
def autopilot(recording: VehicleRecording) -> SimulatedAutopilot:
    return SimulatedAutopilot(recording, BootClock(START_NS - 5 * NS, DRIFT_PPM))


class Companion:
    """The other end of the link: packs commands, reads frames."""

    def __init__(self) -> None:
        self.mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)

    def ask(self, name: str, interval_us: float) -> bytes:
        msgid = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
        command = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        message = self.mav.command_long_encode(1, 1, command, 0, msgid, interval_us, 0, 0, 0, 0, 0)
        packed: bytes = message.pack(self.mav)
        return packed

    def read(self, frames: list[bytes]) -> list[Any]:
        return self.mav.parse_buffer(b"".join(frames)) or []


def of(messages: list[Any], name: str) -> list[Any]:
    return [m for m in messages if m.get_type() == name]


def fly(
    autopilot: SimulatedAutopilot, companion: Companion, begin_s: float, end_s: float
) -> list[Any]:
    """Messages between two times, stepped at 5 ms."""
    frames: list[bytes] = []
    for t in np.arange(begin_s, end_s, 0.005):
        frames += autopilot.advance(START_NS + round(t * NS))
    return companion.read(frames)


def test_intervals_are_slow_until_asked_for(autopilot: SimulatedAutopilot) -> None:
    companion = Companion()
    before = fly(autopilot, companion, 0.0, 4.0)
    assert not of(before, "HIGHRES_IMU")
    assert 7 <= len(of(before, "GPS_RAW_INT")) <= 9  # 2 Hz
    autopilot.feed(START_NS + 4 * NS, companion.ask("HIGHRES_IMU", 20_000))
    autopilot.feed(START_NS + 4 * NS, companion.ask("GPS_RAW_INT", 200_000))
    after = fly(autopilot, companion, 4.0, 8.0)
    acks = of(after, "COMMAND_ACK")
    assert [a.result for a in acks] == [mavlink.MAV_RESULT_ACCEPTED] * 2
    assert {(a.target_system, a.target_component) for a in acks} == {(1, 191)}
    assert 198 <= len(of(after, "HIGHRES_IMU")) <= 202  # 50 Hz of the 100 that there are
    assert 19 <= len(of(after, "GPS_RAW_INT")) <= 21


def test_what_it_does_not_have_is_refused(autopilot: SimulatedAutopilot) -> None:
    companion = Companion()
    autopilot.feed(START_NS, companion.ask("OPTICAL_FLOW", 20_000))
    arm = companion.mav.command_long_encode(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    autopilot.feed(START_NS, arm.pack(companion.mav))
    acks = of(companion.read(autopilot.advance(START_NS)), "COMMAND_ACK")
    wanted = [mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_UNSUPPORTED]
    assert [a.result for a in acks] == wanted


def test_timesync_is_answered_and_asked(autopilot: SimulatedAutopilot) -> None:
    companion = Companion()
    now = START_NS + 3 * NS
    autopilot.feed(now, companion.mav.timesync_encode(0, 12345).pack(companion.mav))
    synced = of(companion.read(autopilot.advance(now)), "TIMESYNC")
    (answer,) = [m for m in synced if m.tc1]
    assert answer.ts1 == 12345
    assert answer.tc1 == 8 * NS + round(8 * NS * DRIFT_PPM * 1e-6)
    (first, *_) = [m for m in synced if not m.tc1]
    autopilot.feed(now, companion.mav.timesync_encode(now, first.ts1).pack(companion.mav))
    assert autopilot.timesync_answers == 1


def test_stamps_are_on_the_boot_clock(
    autopilot: SimulatedAutopilot, recording: VehicleRecording
) -> None:
    companion = Companion()
    fixes = of(fly(autopilot, companion, 0.0, 2.0), "GPS_RAW_INT")
    boot_ns = [
        round((t - START_NS + 5 * NS) * (1 + DRIFT_PPM * 1e-6))
        for t in recording.gnss[0].t_ns.tolist()
    ]
    assert {f.time_usec for f in fixes} <= {t // 1000 for t in boot_ns}


def test_reboot_forgets_intervals_and_time(autopilot: SimulatedAutopilot) -> None:
    companion = Companion()
    autopilot.feed(START_NS, companion.ask("HIGHRES_IMU", 10_000))
    assert of(fly(autopilot, companion, 0.0, 1.0), "HIGHRES_IMU")
    autopilot.reboot(START_NS + NS)
    after = fly(autopilot, companion, 1.0, 3.0)
    assert not of(after, "HIGHRES_IMU")
    assert all(m.time_usec < 2 * 1_001_000 for m in of(after, "GPS_RAW_INT"))
    # The beat of the second is that of the first sample's arrival, 1 ms after the start.
    assert [m.time_boot_ms for m in of(after, "SYSTEM_TIME")] == [1, 1001]


def test_silent_receiver_leaves_the_rest(autopilot: SimulatedAutopilot) -> None:
    autopilot.gnss_silent = True
    said = fly(autopilot, Companion(), 0.0, 3.0)
    assert not of(said, "GPS_RAW_INT")
    assert of(said, "SCALED_PRESSURE")


def test_noise_on_the_link_is_counted(autopilot: SimulatedAutopilot) -> None:
    autopilot.feed(START_NS, random.Random(1).randbytes(500))
    for _ in range(20):
        autopilot.feed(START_NS, Companion().ask("HIGHRES_IMU", 10_000))
    assert autopilot.bad_received > 0
    # The longest frame that noise can pretend to be swallows 280 bytes, 7 commands.
    assert autopilot.received["COMMAND_LONG"] >= 13


def test_adapter_opens_as_a_driver_opens_it() -> None:
    adapter = slcan.SlcanAdapter(1_000_000)
    assert not adapter.hears
    assert adapter.feed(b"C\rS8\rO\r") == b"\r\r\r"
    assert adapter.hears
    assert adapter.feed(b"S6\r") == b"\a"  # not while it is open
    assert adapter.feed(b"C\rS6\rO\rV\r") == b"\r\r\rV1013\r"
    assert adapter.is_open
    assert not adapter.hears  # 500 kbit/s on a bus of 1 Mbit/s


def test_adapter_transmits_and_refuses() -> None:
    adapter = slcan.SlcanAdapter()
    assert adapter.feed(b"t12321122\r") == b"\a"  # closed
    adapter.feed(b"S8\rO\r")
    assert adapter.feed(b"t1232112") == b""
    assert adapter.feed(b"2\rT1234567801F\r") == b"z\r\a"
    assert adapter.feed(b"x\rt1239\rt123211zz\rS\r") == b"\a" * 4
    assert adapter.sent == [(0x123, False, b"\x11\x22")]


def test_lines_of_frames() -> None:
    assert slcan.line((0x123, False, b"\x01\xab")) == b"t123201AB\r"
    assert slcan.line((0x1803EB2A, True, b"")) == b"T1803EB2A0\r"


def _encode(samples: ImuSamples) -> list[slcan.Frame]:
    return [(0x100 + i, False, bytes(3)) for i in range(2 * len(samples))]


def test_can_unit_silent_and_lossy(recording: VehicleRecording) -> None:
    unit = SimulatedCanImu(recording.imu[0], _encode)
    assert len(unit.advance(START_NS + NS)) == 2 * 100
    unit.silent = True
    assert unit.advance(START_NS + 2 * NS) == []
    unit.silent, unit.loss_share = False, 0.25
    got = unit.advance(START_NS + 12 * NS)
    assert unit.lost + len(got) == 2 * 1000
    assert unit.lost == pytest.approx(500, abs=5 * np.sqrt(2000 * 0.25 * 0.75))  # 5 sigma


def test_malformed_traffic_is_as_much_as_the_good() -> None:
    frames = [(0x1803EB2A, True, bytes(8))] * 400
    lines = garbage.can_garbage(frames, random.Random(2))
    assert len(lines) == 400
    assert all(line.endswith(b"\r") and line.count(b"\r") == 1 for line in lines)
    assert slcan.line(frames[0]) not in lines
    good = Companion().ask("ATTITUDE", 1000)
    spoiled = garbage.mavlink_garbage([good] * 400, random.Random(2))
    assert all(bad != good for bad in spoiled)


def test_faults_mend_themselves() -> None:
    faults = Faults()
    faults.take(parse_order('{"fault": "gnss-silent", "for_s": 2.5}'), 10 * NS)
    faults.take(parse_order('{"fault": "can-loss", "share": 0.5}'), 10 * NS)
    assert faults.on("gnss-silent")
    assert faults.can_loss_share == 0.5
    assert faults.next_ns == 12_500_000_000
    assert faults.mend(12 * NS) == []
    assert faults.mend(13 * NS) == ["gnss-silent"]
    assert not faults.on("gnss-silent")
    assert faults.on("can-loss")
    faults.take(parse_order('{"fault": "can-loss", "on": false}'), 14 * NS)
    assert not faults.on("can-loss")


@pytest.mark.parametrize(
    "line",
    [
        "",
        "{}",
        "[1]",
        '{"fault": "fire"}',
        '{"fault": "imu-silent", "for_s": -1}',
        '{"fault": "can-loss", "share": 2}',
        '{"fault": "imu-silent", "ask": "counts"}',
        b"\xff\xfe",
    ],
)
def test_bad_orders_are_refused_in_a_line(line: str | bytes) -> None:
    with pytest.raises(CompanionError) as caught:
        parse_order(line)
    assert "\n" not in str(caught.value)


def test_scenario_describes_itself() -> None:
    scenario = live_scenario(imu_hz=1000.0)
    assert msgspec.convert(msgspec.to_builtins(scenario), type(scenario)) == scenario
