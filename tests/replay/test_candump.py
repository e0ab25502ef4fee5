"""Recorded CAN traffic: the parser, which units are found in it, and joining with another log."""

from __future__ import annotations

import gzip
from pathlib import Path

import can
import numpy as np
import pytest

from companion.config import CanBus, CanImu, DbcMapping
from companion.types import CompanionError, ImuSamples, LogFormatError
from drivers.can_imu import CanFrame, make_encoder
from replay.can_recording import read_can
from replay.candump import candump_line, parse_candump, read_frames
from replay.configuration import choose_config
from replay.joining import on_arrival_clock
from replay.reader import read_log
from replay.simulator import load_scenario
from replay.simulator.flight import write_flight

from . import logs

T0 = 1_700_000_000_000_000_000
STEP_NS = 5_000_000


def at_rest(count: int, *, begin_ns: int = T0, step_ns: int = STEP_NS) -> ImuSamples:
    """Level and at rest, with a little motion so that no two samples are equal."""
    rng = np.random.default_rng(1)
    t = begin_ns + step_ns * np.arange(count, dtype=np.int64)
    accel = 0.1 * rng.standard_normal((count, 3)) - [0.0, 0.0, 9.81]
    gyro = 0.01 * rng.standard_normal((count, 3))
    return ImuSamples("imu", t, t, np.arange(count), gyro, accel, np.full(count, STEP_NS * 1e-9))


def dump(protocol: str, samples: ImuSamples, channel: str = "can0", **options: object) -> str:
    """A candump log of one unit."""
    frames = make_encoder(protocol, **options).encode(samples)
    each = len(frames) // len(samples)
    return "".join(
        candump_line(int(samples.t_rx_ns[i // each]) + 1000 * (i % each), channel, *frame)
        for i, frame in enumerate(frames)
    )


def merged(*texts: str) -> str:
    return "".join(sorted("".join(texts).splitlines(keepends=True)))


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        ("(1700000000.000001) can0 123#", CanFrame(0x123, False, b"")),
        ("(1700000000.000001) can0 00000123#DEADBEEF", CanFrame(0x123, True, b"\xde\xad\xbe\xef")),
        ("(1700000000.000001) can0 7ff#0011AAbb R", CanFrame(0x7FF, False, b"\0\x11\xaa\xbb")),
        ("(1700000000.000001) vcan12 123##1" + "AB" * 12, CanFrame(0x123, False, b"\xab" * 12)),
        ("(1700000000.000001) can0 123#11_8", CanFrame(0x123, False, b"\x11")),
        ("(1700000000.000001) can0 123#11\r", CanFrame(0x123, False, b"\x11")),
    ],
)  # fmt: skip
def test_lines_of_candump(line: str, frame: CanFrame) -> None:
    found = parse_candump(line.encode())
    assert len(found) == 1
    assert found.bad_lines == 0
    assert found.t_ns.tolist() == [T0 + 1000]
    data = found.data[found.start[0] : found.start[0] + found.length[0]]
    assert (int(found.can_id[0]), bool(found.extended[0]), data) == frame


@pytest.mark.parametrize(
    "line",
    [
        "hello",
        "(1700000000.000001) can0 12#11",
        "(1700000000.000001) can0 FFF#11",
        "(1700000000.000001) can0 123#1",
        "(1700000000.000001) can0 123#1G",
        "(1700000000.000001) can0 123#112233445566778899",
        "(1700000000.000001) can0 123##1" + "00" * 65,
        "(1700000000.000001) can0",
        "(1700000000.000001)can0 123#11",
        "(x.000001) can0 123#11",
        "(17000000000000.000001) can0 123#11",
        "(1700000000) can0 123#11",
        "(",
    ],
)
def test_what_is_no_line_is_counted(line: str) -> None:
    good = "(1700000000.000001) can0 123#11\n"
    found = parse_candump((good + line + "\n\n" + good).encode())
    assert len(found) == 2
    assert found.bad_lines == 1


def test_remote_and_error_frames_are_left_out() -> None:
    text = "(1.0) can0 123#R\n(1.0) can0 123#R8\n(1.0) can0 20000080#0000000000000000\n"
    found = parse_candump(text.encode())
    assert (len(found), found.bad_lines) == (0, 0)


def test_stamps_of_any_precision_and_channels() -> None:
    text = "(5.5) a 123#\n(6.123456789) can10 123#\n(0007.000001) a 123#"
    found = parse_candump(text.encode())
    assert found.t_ns.tolist() == [5_500_000_000, 6_123_456_789, 7_000_001_000]
    assert [found.channels[i] for i in found.channel] == ["a", "can10", "a"]


@pytest.mark.parametrize("seed", range(5))
def test_mutated_logs_are_read_or_refused(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    text = np.frombuffer(dump("dronecan", at_rest(40)).encode(), np.uint8)
    for i in range(40):
        data = text.copy()
        for _ in range(int(rng.integers(1, 200))):
            data[rng.integers(0, len(data))] = rng.integers(0, 256)
        data = data[: rng.integers(1, len(data))]
        path = tmp_path / f"{i}.log"
        path.write_bytes(b"(" + data.tobytes())
        said = _refused(path)
        assert said is None or (said.startswith(str(path)) and "\n" not in said)


def _refused(path: Path) -> str | None:
    """What a reader says about a file that it does not read; None for one that it reads."""
    try:
        recording = read_can(path)
    except CompanionError as error:
        return str(error)
    assert len(recording.vehicles[0].imu[0]) > 0
    return None


@pytest.mark.parametrize("protocol", ["dronecan", "xsens-mti", "sbg-ellipse", "openimu-j1939"])
@pytest.mark.parametrize("packed", [False, True])
def test_known_units_are_found_by_themselves(protocol: str, packed: bool, tmp_path: Path) -> None:
    sent = at_rest(200)
    noise = "".join(candump_line(T0 + i * 777_000, "can0", 0x700 + i % 9, False, b"\0" * 8)
                    for i in range(500))  # fmt: skip
    text = merged(dump(protocol, sent), noise).encode()
    path = tmp_path / ("imu.log.gz" if packed else "imu.log")
    path.write_bytes(gzip.compress(text) if packed else text)
    recording = read_log([path])
    assert recording.format == "candump"
    (imu,) = recording.vehicles[0].imu
    assert len(imu) == 200
    # Half of the coarsest step of all formats: 0.01 m/s² and 1/128 deg/s.
    np.testing.assert_allclose(imu.accel_b, sent.accel_b, atol=0.00501)
    np.testing.assert_allclose(imu.gyro_b, sent.gyro_b, atol=0.001)
    np.testing.assert_allclose(imu.t_ns, sent.t_ns, atol=100_000)


def test_several_units_on_several_buses(tmp_path: Path) -> None:
    sent = at_rest(100)
    path = tmp_path / "two.log"
    path.write_text(
        merged(
            dump("dronecan", sent, node_id=50),
            dump("dronecan", sent, node_id=51),
            dump("sbg-ellipse", sent, channel="can1"),
        )
    )
    names = {imu.source: len(imu) for imu in read_can(path).vehicles[0].imu}
    assert names == {"RawIMU.50@can0": 100, "RawIMU.51@can0": 100, "sbg-ellipse@can1": 100}


def test_other_devices_under_the_same_identifiers_are_no_unit(tmp_path: Path) -> None:
    """A car's bus has frames 0x121 and 0x122 of six bytes, too."""
    path = tmp_path / "car.log"
    path.write_text(
        "".join(
            candump_line(T0 + i * 5_000_000, "can0", 0x121 + i % 2, False, bytes(6))
            for i in range(400)
        )
    )
    with pytest.raises(LogFormatError, match="none of an inertial unit that is known") as caught:
        read_log([path])
    assert "[[can.imu]]" in str(caught.value)


def test_a_unit_by_dbc_needs_the_configuration(tmp_path: Path) -> None:
    dbc = tmp_path / "unit.dbc"
    fields = ' SG_ {}{} : {}|16@1- ({},0) [0|0] "" IMU\n'
    dbc.write_text(
        'VERSION ""\nBS_:\nBU_: IMU\nBO_ 512 G: 6 IMU\n'
        + "".join(fields.format("G", axis, 16 * i, 0.0001) for i, axis in enumerate("XYZ"))
        + "BO_ 513 A: 6 IMU\n"
        + "".join(fields.format("A", axis, 16 * i, 0.001) for i, axis in enumerate("XYZ"))
    )
    mapping = DbcMapping(
        file=str(dbc), gyro_signals=("GX", "GY", "GZ"), accel_signals=("AX", "AY", "AZ")
    )
    sent = at_rest(100)
    path = tmp_path / "imu.log"
    path.write_text(dump("dbc", sent, mapping=mapping))
    with pytest.raises(LogFormatError, match="known"):
        read_log([path])
    axes = ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    unit = CanImu(name="rover", protocol="dbc", dbc=mapping, axes=axes)
    absent = CanImu(name="absent", protocol="dronecan", node_id=9)
    recording = read_log([path], can=[CanBus(channel="can7", imu=(unit, absent))])
    (imu,) = recording.vehicles[0].imu
    assert imu.source == "rover"
    np.testing.assert_allclose(imu.accel_b[:, 0], sent.accel_b[:, 1], atol=0.000501)
    assert any("absent: no frame" in note for note in recording.notes)


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".trc"])
def test_formats_of_python_can(suffix: str, tmp_path: Path) -> None:
    sent = at_rest(50)
    path = tmp_path / f"imu{suffix}"
    with can.Logger(path) as writer:
        for i, frame in enumerate(make_encoder("dronecan").encode(sent)):
            writer(
                can.Message(
                    timestamp=1_700_000_000 + i * 0.0007,
                    arbitration_id=frame.can_id,
                    is_extended_id=True,
                    data=frame.data,
                    channel=0,
                )
            )
    (imu,) = read_log([path]).vehicles[0].imu
    np.testing.assert_allclose(imu.accel_b, sent.accel_b, rtol=1e-6)
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(LogFormatError, match=str(path)):
        read_log([path])


def test_damaged_gzip(tmp_path: Path) -> None:
    whole = gzip.compress(dump("dronecan", at_rest(200)).encode())
    path = tmp_path / "cut.log.gz"
    path.write_bytes(whole[: len(whole) // 2])
    assert 50 < len(read_log([path]).vehicles[0].imu[0]) < 150
    path.write_bytes(whole[:200] + bytes(100) + whole[300:])
    with pytest.raises(LogFormatError):
        read_frames(path)


class TestJoining:
    def test_can_becomes_the_first_imu_of_the_vehicle(self, tmp_path: Path) -> None:
        tlog, log = tmp_path / "a.tlog", tmp_path / "a.log"
        tlog.write_bytes(logs.tlog(4.0))
        alone = read_log([tlog]).vehicles[0]
        begin = int(alone.imu[0].t_rx_ns[0])
        log.write_text(dump("dronecan", at_rest(600, begin_ns=begin)))
        recording = read_log([log, tlog])
        (vehicle,) = recording.vehicles
        assert recording.format == "tlog+can"
        assert vehicle.imu[0].source == "RawIMU"
        assert len(vehicle.imu) == len(alone.imu) + 1
        assert vehicle.streams[0].source == "RawIMU"
        assert {s.source for s in vehicle.streams} >= {s.source for s in alone.streams}
        everything = [*vehicle.imu, *vehicle.gnss, *vehicle.baro, *vehicle.mag]
        seq = np.concatenate([s.seq for s in everything])
        rx = np.concatenate([s.t_rx_ns for s in everything])
        assert len(np.unique(seq)) == len(seq)
        assert (np.diff(rx[np.argsort(seq)]) >= 0).all()
        chosen = choose_config(recording)
        assert (chosen.config.imu.latency_ms, chosen.config.gnss.latency_ms) == (0.0, 100.0)
        again = read_log([tlog, log]).vehicles[0]
        assert np.array_equal(again.imu[0].seq, vehicle.imu[0].seq), "the order given says nothing"

    def test_times_that_do_not_meet_are_refused(self, tmp_path: Path) -> None:
        tlog, log = tmp_path / "a.tlog", tmp_path / "a.log"
        tlog.write_bytes(logs.tlog(2.0))
        log.write_text(dump("dronecan", at_rest(100, begin_ns=5_000_000_000)))
        with pytest.raises(LogFormatError, match="no time in common"):
            read_log([tlog, log])

    def test_which_vehicle_must_be_said(self, tmp_path: Path) -> None:
        tlog, other, log = tmp_path / "a.tlog", tmp_path / "b.bin", tmp_path / "a.log"
        tlog.write_bytes(logs.tlog(2.0))
        other.write_bytes(logs.dataflash(2.0))
        begin = int(read_log([tlog]).vehicles[0].imu[0].t_rx_ns[0])
        log.write_text(dump("dronecan", at_rest(300, begin_ns=begin)))
        with pytest.raises(LogFormatError, match=r"sys1, vehicle.*--vehicle"):
            read_log([tlog, other, log])
        chosen = read_log([tlog, other, log], vehicle="sys1").vehicles[0]
        assert chosen.imu[0].source == "RawIMU"

    def test_two_recordings_of_the_same_unit_are_refused(self, tmp_path: Path) -> None:
        tlog, log = tmp_path / "a.tlog", tmp_path / "a.log"
        tlog.write_bytes(logs.tlog(2.0))
        begin = int(read_log([tlog]).vehicles[0].imu[0].t_rx_ns[0])
        log.write_text(dump("dronecan", at_rest(300, begin_ns=begin)))
        with pytest.raises(LogFormatError, match="two inertial streams of the run are named"):
            read_log([tlog, log, log])

    def test_a_drifting_boot_clock_is_followed(self, tmp_path: Path) -> None:
        path = tmp_path / "a.tlog"
        path.write_bytes(logs.tlog(2.0))
        vehicle = read_log([path]).vehicles[0]
        rng = np.random.default_rng(2)
        true = at_rest(20_000, begin_ns=T0)
        # The autopilot's clock loses 300 ppm, so that its stamps fall behind arrival by 30 ms.
        stamped = T0 + np.rint((true.t_ns - T0) * (1 - 300e-6)).astype(np.int64)
        rx = np.maximum.accumulate(true.t_ns + rng.exponential(3e6, 20_000).astype(np.int64))
        imu = ImuSamples("x", stamped, rx, true.seq, true.gyro_b, true.accel_b, true.interval_s)
        alone = type(vehicle)(name="v", imu=(imu,))
        moved, drift_s = on_arrival_clock(alone)
        assert drift_s == pytest.approx(0.030, abs=0.002)
        # Least sum of a delay (exponential, 3 ms, 200 a second) and the drift in a window so far:
        # √(2 · 300 ppm · 3 ms / 200 Hz) is 95 µs. Three times that for the largest of 25 windows.
        assert np.abs(moved.imu[0].t_ns - true.t_ns).max() < 3 * 95_000

    def test_a_simulated_flight_comes_back_from_its_can_log(self, tmp_path: Path) -> None:
        scenario = load_scenario("multirotor-mission")
        made = write_flight(_shortened(scenario), 3, tmp_path)
        recording = read_log([tmp_path / "imu.log", tmp_path / "flight.tlog"])
        imu, sent = recording.vehicles[0].imu[0], made.imu[0]
        assert imu.source == "RawIMU"
        assert len(imu) == len(sent)
        # float16 latest values, half a step of 2⁻¹⁰ relative.
        np.testing.assert_allclose(imu.accel_b, sent.accel_b, rtol=2**-11, atol=1e-6)
        np.testing.assert_allclose(imu.gyro_b, sent.gyro_b, rtol=2**-11, atol=1e-6)
        # A constant delay of arrival cannot be told from time; its scatter can.
        assert np.ptp(imu.t_ns - sent.t_ns) < 1_000_000


def _shortened(scenario):  # type: ignore[no-untyped-def]
    import msgspec

    replace = msgspec.structs.replace
    return replace(scenario, trajectory=replace(scenario.trajectory, duration_s=40.0))
