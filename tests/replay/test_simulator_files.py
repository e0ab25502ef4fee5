"""Scenario files, written flights, and the sample that ships with the project."""

from __future__ import annotations

import itertools
import struct
from pathlib import Path

import msgspec
import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.config import Adaptation, parse, to_toml
from companion.types import NS, CompanionError, ConfigError, VehicleRecording
from replay.reader import read_log
from replay.simulator.aids import BaroSpec, GnssSpec, MagSpec, Outage
from replay.simulator.flight import write_flight
from replay.simulator.imu import IMU_GRADES
from replay.simulator.matching import imu_config, matching_config
from replay.simulator.messages import UNDULATION_M
from replay.simulator.sample import SAMPLE, SAMPLE_DIRECTORY, SAMPLE_NAME, write_sample
from replay.simulator.scenarios import (
    SCENARIOS,
    Scenario,
    TrajectorySpec,
    graded,
    load_scenario,
    parse_scenario,
)
from replay.simulator.simulation import simulate
from replay.simulator.tlog_writer import write_tlog

SHORT = Scenario(
    name="short",
    trajectory=TrajectorySpec(duration_s=60.0, rest_s=5.0),
    gnss=(
        GnssSpec(
            outages=(Outage(start_s=30.0, length_s=5.0),),
            during_outage="no-fix",
            lever_arm_b_m=(0.1, 0.0, -0.1),
        ),
    ),
    baro=BaroSpec(),
    mag=MagSpec(),
)


# --------------------------------------------------------------------------- scenarios


@pytest.mark.parametrize("name", list(SCENARIOS))
def test_built_in_scenarios_run_and_match_a_valid_configuration(name: str) -> None:
    scenario = SCENARIOS[name]
    brief = msgspec.structs.replace(
        scenario, trajectory=msgspec.structs.replace(scenario.trajectory, duration_s=20.0)
    )
    recording = simulate(brief, 0)
    assert recording.truth is not None
    assert len(recording.imu) == len(scenario.imu)
    config = matching_config(scenario)
    assert parse(to_toml(config)) == config


def test_a_scenario_file_lays_keys_over_its_grade() -> None:
    scenario = parse_scenario(
        """
        name = "mine"
        [trajectory]
        kind = "car-with-stops"
        duration_s = 90
        [imu]
        grade = "tactical"
        rate_hz = 250
        [gnss]
        outages = [{ start_s = 30, length_s = 10 }]
        [baro]
        """
    )
    expected = graded("tactical", rate_hz=250.0)
    assert scenario.imu == (expected,)
    assert scenario.gnss[0].outages == (Outage(start_s=30.0, length_s=10.0),)
    assert scenario.baro == BaroSpec()
    assert scenario.mag is None


def test_several_units_are_several_tables() -> None:
    text = '[[imu]]\ngrade = "tactical"\nsource = "a"\n[[imu]]\nsource = "b"\n'
    assert [unit.source for unit in parse_scenario(text).imu] == ["a", "b"]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[trajectory]\nkind = 'rocket'", "kind"),
        ("[trajectory]\nlength_s = 3", "length_s"),
        ("[trajectory]\nduration_s = -1", "trajectory.duration_s"),
        ("[trajectory]\nrest_s = -1", "trajectory.rest_s"),
        ("[trajectory]\nlat_deg = 90", "trajectory.lat_deg"),
        ("[imu]\ngrade = 'cheap'", "mems-consumer"),
        ("[imu]\nrate_hz = 0", "imu.rate_hz"),
        ("[imu]\nlatency_ms = 9000", "imu.latency_ms"),
        ("[imu]\ngyro_instability_tau_s = 0", "imu.gyro_instability_tau_s"),
        ("[imu]\nvibration_hz = nan", "imu.vibration_hz"),
        ("[imu]\naccel_noise_mps2_rthz = -0.1", "imu.accel_noise_mps2_rthz"),
        ("[imu]\naccel_noise_mps2_rthz = inf", "imu.accel_noise_mps2_rthz"),
        ("[gnss]\nlatency_ms = -5", "gnss.latency_ms"),
        ("[gnss]\ncorrelated_tau_s = 0", "gnss.correlated_tau_s"),
        ("[baro]\nsd_m = nan", "baro.sd_m"),
        ("[trajectory]\nduration_s = 80000\n[imu]\nrate_hz = 2000", "samples"),
        ("imu = []", "imu"),
        ("imu = 3", "imu"),
        ("[gnss]\nrate_hz = 'fast'", "rate_hz"),
        ("name = ", "TOML"),
    ],
)
def test_a_wrong_scenario_is_one_line_that_names_the_key(text: str, named: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_scenario(text, "flight.toml")
    assert str(caught.value).startswith("flight.toml: ")
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unknown_scenario_lists_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="car-with-stops"):
        load_scenario("submarine")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_scenario(str(tmp_path / "absent.toml"))
    path = tmp_path / "mine.toml"
    path.write_text('name = "mine"\n')
    assert load_scenario(str(path)).name == "mine"
    assert load_scenario("hover") is SCENARIOS["hover"]


def test_the_matching_configuration_says_what_was_simulated() -> None:
    spec = graded("mems-consumer").modelled_only()
    imu = imu_config(spec)
    assert imu.gyro_noise_dps_rthz == spec.gyro_noise_dps_rthz
    assert imu.gyro_bias_sd_dps == pytest.approx(spec.gyro_bias_sd_dps)
    assert imu.accel_bias_walk_mps2_rts == spec.accel_bias_walk_mps2_rts
    late = GnssSpec(stamped="arrival", latency_ms=150.0)
    config = matching_config(Scenario(gnss=(late,), trajectory=SHORT.trajectory))
    assert config.gnss.latency_ms == 150.0
    assert not config.baro.use
    for unit in IMU_GRADES.values():
        assert imu_config(unit).gyro_noise_dps_rthz > 0


def test_a_date_without_a_magnetic_model_is_refused() -> None:
    early = msgspec.structs.replace(SHORT, start_unix_s=0)
    with pytest.raises(CompanionError, match="World Magnetic Model"):
        simulate(early, 0)


# --------------------------------------------------------------------------- files


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> tuple[VehicleRecording, Path]:
    directory = tmp_path_factory.mktemp("flight")
    return write_flight(SHORT, 3, directory), directory


def test_a_folder_reads_back_as_it_was_simulated(flight: tuple[VehicleRecording, Path]) -> None:
    made, directory = flight
    recording = read_log([directory])
    found = recording.vehicles[0]
    assert recording.config_toml is not None
    as_users_fly = msgspec.structs.replace(matching_config(SHORT), adaptation=Adaptation())
    assert parse(recording.config_toml) == as_users_fly
    assert found.height_datum == "hae"
    assert np.array_equal(found.imu[0].t_ns, made.imu[0].t_ns)
    # Half a unit of the last printed decimal.
    np.testing.assert_allclose(found.imu[0].gyro_b, made.imu[0].gyro_b, atol=0.51e-9)
    np.testing.assert_allclose(found.imu[0].accel_b, made.imu[0].accel_b, atol=0.51e-7)
    fixed = found.gnss[0].take(found.gnss[0].fix_type >= 3)
    expected = made.gnss[0].take(made.gnss[0].fix_type >= 3)
    assert np.array_equal(fixed.t_rx_ns, expected.t_rx_ns)
    np.testing.assert_allclose(fixed.lat, expected.lat, rtol=0, atol=1e-12)
    np.testing.assert_allclose(fixed.vel_n, expected.vel_n, atol=0.51e-6)
    np.testing.assert_allclose(found.baro[0].pressure, made.baro[0].pressure, atol=0.51e-3)
    np.testing.assert_allclose(found.mag[0].field_b, made.mag[0].field_b, atol=0.51e-12)
    assert found.truth is not None
    assert made.truth is not None
    np.testing.assert_allclose(found.truth.rpy, made.truth.rpy, atol=1e-8)


def test_a_tlog_reads_back_within_its_own_resolution(
    flight: tuple[VehicleRecording, Path],
) -> None:
    made, directory = flight
    found = read_log([directory / "flight.tlog"]).vehicles[0]
    # SYSTEM_TIME is stamped as it arrives, so the boot clock maps to the recording's exactly.
    assert np.array_equal(found.imu[0].t_ns, made.imu[0].t_ns)
    np.testing.assert_allclose(found.imu[0].gyro_b, made.imu[0].gyro_b, rtol=1e-7)
    np.testing.assert_allclose(found.imu[0].accel_b, made.imu[0].accel_b, rtol=1e-7)
    fixed = found.gnss[0].take(found.gnss[0].fix_type >= 3)
    expected = made.gnss[0].take(made.gnss[0].fix_type >= 3)
    assert np.array_equal(fixed.t_ns, expected.t_ns)
    assert np.array_equal(fixed.t_rx_ns, expected.t_rx_ns)
    np.testing.assert_allclose(np.degrees(fixed.lat - expected.lat), 0.0, atol=0.51e-7)
    np.testing.assert_allclose(fixed.height, expected.height, atol=0.51e-3)
    # Centimetres per second and hundredths of a degree at up to 11 m/s.
    np.testing.assert_allclose(fixed.vel_n[:, :2], expected.vel_n[:, :2], atol=0.01)
    np.testing.assert_allclose(fixed.sd_pos[:, 2], expected.sd_pos[:, 2], atol=0.51e-3)
    np.testing.assert_allclose(found.baro[0].pressure, made.baro[0].pressure, rtol=1e-7)
    assert found.truth is not None
    assert made.truth is not None
    common = np.isin(made.truth.t_ns, found.truth.t_ns)
    assert np.count_nonzero(common) >= len(made.truth) - 1
    truth = made.truth.take(common)
    np.testing.assert_allclose(found.truth.vel_n, truth.vel_n, atol=1e-6)
    np.testing.assert_allclose(np.degrees(found.truth.lat - truth.lat), 0.0, atol=0.51e-7)
    # float32 of 440 m above mean sea level: 1.5e-5 m; GPS heights to the millimetre say how far
    # that is from the ellipsoid.
    np.testing.assert_allclose(found.truth.height, truth.height, atol=1.1e-3)
    turn = np.remainder(found.truth.rpy - truth.rpy + np.pi, 2 * np.pi) - np.pi
    np.testing.assert_allclose(turn, 0.0, atol=1e-6)


def frames(path: Path) -> list[tuple[int, object]]:
    """Stamp [µs] and message of each frame, by pymavlink's own parser."""
    raw, parser, out = path.read_bytes(), mavlink.MAVLink(None), []
    at = 0
    while at < len(raw):
        (stamp,) = struct.unpack_from(">Q", raw, at)
        assert raw[at + 8] == 0xFD, "MAVLink 2 throughout"
        length = 12 + raw[at + 9]
        out.append((stamp, parser.decode(bytearray(raw[at + 8 : at + 8 + length]))))
        at += 8 + length
    return out


def test_the_tlog_is_in_arrival_order_with_truth_behind_its_imu_sample(
    flight: tuple[VehicleRecording, Path],
) -> None:
    made, directory = flight
    assert made.truth is not None
    found = frames(directory / "flight.tlog")
    stamps = np.array([stamp for stamp, _ in found])
    assert np.all(np.diff(stamps) >= 0)
    kinds = [message.get_type() for _, message in found]
    assert kinds[:2] == ["HEARTBEAT", "SYSTEM_TIME"]
    assert kinds.count("SIM_STATE") == len(made.truth)
    assert kinds.count("GPS_RAW_INT") == len(made.gnss[0])
    assert kinds.count("HEARTBEAT") == 61
    assert {k for k, after in itertools.pairwise(kinds) if after == "SIM_STATE"} == {"HIGHRES_IMU"}
    fix = next(m for _, m in found if m.get_type() == "GPS_RAW_INT")
    assert (fix.alt_ellipsoid - fix.alt) / 1e3 == pytest.approx(UNDULATION_M)
    lost = [m for _, m in found if m.get_type() == "GPS_RAW_INT" and m.fix_type < 2]
    assert len(lost) == 25
    assert {(m.lat, m.lon, m.vel, m.h_acc) for m in lost} == {(0, 0, 65535, 0)}
    magnetic = [m for _, m in found if m.get_type() == "HIGHRES_IMU" and m.fields_updated & 0x1C0]
    assert abs(len(magnetic) - len(made.mag[0])) <= 1
    assert {m.get_srcSystem() for _, m in found} == {1}


def test_writers_refuse_what_the_formats_cannot_hold(tmp_path: Path) -> None:
    made = simulate(SHORT, 1)
    with pytest.raises(CompanionError, match="needs an IMU"):
        write_tlog(VehicleRecording("empty"), tmp_path / "x.tlog")
    with pytest.raises(CompanionError, match="cannot be written"):
        write_tlog(made, tmp_path / "absent" / "x.tlog")
    (tmp_path / "file").write_text("")
    with pytest.raises(CompanionError, match="cannot be written"):
        write_flight(SHORT, 1, tmp_path / "file")


# --------------------------------------------------------------------------- the sample


def test_the_sample_flight_can_be_made_anew(tmp_path: Path) -> None:
    shipped = SAMPLE_DIRECTORY / SAMPLE_NAME
    assert shipped.stat().st_size < 1_500_000
    fresh = write_sample(tmp_path)
    # One machine gives one file; between processors a sine differs in its last bit, which can
    # move a rounded value by its last place. Counts, kinds and times are the same anywhere.
    old, new = read_log([shipped]).vehicles[0], read_log([fresh]).vehicles[0]
    for was, now in (
        (old.imu[0], new.imu[0]),
        (old.gnss[0], new.gnss[0]),
        (old.baro[0], new.baro[0]),
    ):
        assert np.array_equal(was.t_ns, now.t_ns)
        assert np.array_equal(was.seq, now.seq)
    step = graded("mems-consumer").accel_step_mps2
    np.testing.assert_allclose(old.imu[0].accel_b, new.imu[0].accel_b, atol=1.01 * step)
    assert np.mean(old.imu[0].accel_b == new.imu[0].accel_b) > 0.99
    assert np.mean(old.imu[0].gyro_b == new.imu[0].gyro_b) > 0.99
    np.testing.assert_allclose(old.gnss[0].lat, new.gnss[0].lat, atol=1.8e-9)
    assert old.truth is not None
    assert new.truth is not None
    np.testing.assert_allclose(old.truth.vel_n, new.truth.vel_n, atol=1e-6)


def test_the_sample_flight_is_what_it_says() -> None:
    recording = read_log([SAMPLE_DIRECTORY / SAMPLE_NAME])
    vehicle = recording.vehicles[0]
    assert len(recording.vehicles) == 1
    seconds = (vehicle.imu[0].t_ns[-1] - vehicle.imu[0].t_ns[0]) / NS
    assert seconds == pytest.approx(SAMPLE.trajectory.duration_s, abs=0.1)
    fixed = vehicle.gnss[0].take(vehicle.gnss[0].fix_type >= 3)
    assert np.diff(fixed.t_ns).max() / NS == pytest.approx(10.2, abs=0.01)
    assert vehicle.truth is not None
    speed = np.linalg.norm(vehicle.truth.vel_n, axis=1)
    assert speed[:80].max() < 0.01
    assert speed.max() > 5.0
    assert speed[-20:].max() < 0.01
    assert np.ptp(vehicle.truth.height) > 20.0
