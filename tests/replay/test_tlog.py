"""Telemetry logs: units, axes, clocks, repeats of fixes, truth, several systems."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.types import Recording
from replay.reader import read_log

from . import logs

BOOT_TO_UNIX_NS = (logs.WALL_US - logs.BOOT_US) * 1000


def read(data: bytes, tmp_path: Path) -> Recording:
    path = tmp_path / "made.tlog"
    path.write_bytes(data)
    return read_log([path])


def test_values_units_and_axes(tmp_path: Path) -> None:
    (vehicle,) = read(logs.tlog(4.0), tmp_path).vehicles
    assert [imu.source for imu in vehicle.imu] == ["HIGHRES_IMU", "RAW_IMU"]
    # float32 on the wire for the one, 1 mG and 1 mrad/s for the other.
    for imu, accel_step, gyro_step in zip(vehicle.imu, (1e-6, 0.005), (1e-8, 5e-4), strict=True):
        np.testing.assert_allclose(imu.accel_b[0], logs.ACCEL, atol=accel_step)
        np.testing.assert_allclose(imu.gyro_b[0], logs.GYRO, atol=gyro_step)
    fix = vehicle.gnss[0]
    np.testing.assert_allclose(np.degrees([fix.lat[0], fix.lon[0]]), [47.4, 8.5], atol=1e-9)
    assert vehicle.height_datum == "hae"
    np.testing.assert_allclose(fix.height, 547.5)
    np.testing.assert_allclose(fix.vel_n[0, :2], [0.0, 5.0], atol=1e-12)
    assert np.isnan(fix.vel_n[:, 2]).all()
    np.testing.assert_allclose(fix.sd_pos[0], [1.2, 1.2, 2.5])
    np.testing.assert_allclose(vehicle.baro[0].pressure, 95025.0)
    np.testing.assert_allclose(vehicle.mag[0].field_b[0], [2e-5, -5e-6, 4.3e-5], atol=1e-11)


def test_time_is_the_boot_clock_plus_the_fastest_transport(tmp_path: Path) -> None:
    (vehicle,) = read(logs.tlog(4.0), tmp_path).vehicles
    imu = vehicle.imu[0]
    assert (np.diff(imu.t_ns) == 20_000_000).all()
    # Some 500 stamps with up to 5 ms of jitter: the fastest is within 0.2 ms of the shortest.
    late_ns = imu.t_ns[0] - BOOT_TO_UNIX_NS - (logs.BOOT_US + logs.DELAY_US) * 1000
    assert 0 <= late_ns < 200_000
    assert (imu.t_rx_ns >= imu.t_ns).all()
    assert (imu.t_rx_ns - imu.t_ns < 5_000_000).all()


def test_repeated_fixes_are_one(tmp_path: Path) -> None:
    recording = read(logs.tlog(4.0), tmp_path)
    assert len(recording.vehicles[0].gnss[0]) == 20
    assert any("20 repeats" in note for note in recording.notes)


def test_truth_takes_the_imu_stamp_and_the_datum(tmp_path: Path) -> None:
    (vehicle,) = read(logs.tlog(4.0), tmp_path).vehicles
    assert vehicle.truth is not None
    assert vehicle.autopilot is not None
    assert (vehicle.truth.t_ns == vehicle.imu[0].t_ns).all()
    np.testing.assert_allclose(vehicle.truth.height, 547.5)
    np.testing.assert_allclose(vehicle.truth.vel_n[0], [0.1, 0.2, 0.3], atol=1e-7)
    assert np.degrees(vehicle.truth.lat[0]) == pytest.approx(47.400001, abs=1e-9)
    np.testing.assert_allclose(vehicle.autopilot.vel_n[0], [0.1, -0.2, 0.3])
    # Yaw passes π: interpolated the short way round it follows the truth.
    at = np.searchsorted(vehicle.truth.t_ns, vehicle.autopilot.t_ns)
    error = vehicle.autopilot.rpy[:, 2] - vehicle.truth.rpy[at, 2]
    assert np.abs(np.remainder(error + np.pi, 2 * np.pi) - np.pi).max() < 1e-6


def test_corrupt_stamps_and_bytes(tmp_path: Path) -> None:
    frames = [logs.stamped(logs.WALL_US + b - logs.BOOT_US, f) for b, f in logs.tlog_frames(4.0)]
    clean = read(b"".join(frames), tmp_path).vehicles[0].imu[0]
    frames[100] = b"\xff" * 8 + frames[100][8:]
    frames[200] = logs.stamped(logs.WALL_US - 10**9, frames[200][8:])
    frames[300] = b"noise\xfe\xfd" + frames[300]
    recording = read(b"".join(frames), tmp_path)
    imu = recording.vehicles[0].imu[0]
    assert (imu.t_ns == clean.t_ns).all()
    assert (np.abs(imu.t_rx_ns - clean.t_rx_ns) <= 20_000_000).all()
    assert any("7 bytes" in note for note in recording.notes)
    assert any("2 corrupt" in note for note in recording.notes)


@pytest.mark.parametrize("step_s", [-3600, 3600])
def test_recorder_clock_steps_are_taken_out(step_s: int, tmp_path: Path) -> None:
    frames = logs.tlog_frames(8.0)
    half = len(frames) // 2
    data = b"".join(
        logs.stamped(logs.WALL_US + b - logs.BOOT_US + (step_s * 10**6 if i >= half else 0), f)
        for i, (b, f) in enumerate(frames)
    )
    recording = read(data, tmp_path)
    imu = recording.vehicles[0].imu[0]
    assert (np.diff(imu.t_ns) == 20_000_000).all()
    assert (np.abs(imu.t_rx_ns - imu.t_ns) < 1_000_000).all()
    assert any("3600.0 s" in note for note in recording.notes)


def test_time_goes_on_after_a_reboot(tmp_path: Path) -> None:
    first = logs.tlog_frames(4.0)
    second = logs.tlog_frames(4.0, boot_us=1_000_000)
    data = b"".join(logs.stamped(logs.WALL_US + b - logs.BOOT_US, f) for b, f in first)
    later = logs.WALL_US + 30_000_000
    data += b"".join(logs.stamped(later + b - 1_000_000, f) for b, f in second)
    recording = read(data, tmp_path)
    imu = recording.vehicles[0].imu[0]
    assert len(imu) == 400
    assert imu.t_ns[200] - imu.t_ns[0] == 30_000_000_000
    assert any("restarted 1 time" in note for note in recording.notes)


def test_two_systems_are_two_vehicles(tmp_path: Path) -> None:
    one = logs.tlog_frames(2.0, logs.Autopilot(1, version=1))
    two = logs.tlog_frames(2.0, logs.Autopilot(7), boot_us=500_000_000)
    data = b"".join(
        logs.stamped(logs.WALL_US + a[0], a[1]) + logs.stamped(logs.WALL_US + a[0], b[1])
        for a, b in zip(one, two, strict=True)
    )
    recording = read(data, tmp_path)
    assert [v.name for v in recording.vehicles] == ["sys1", "sys7"]
    assert [len(v.imu[0]) for v in recording.vehicles] == [100, 100]


def test_sitl_flight(data_dir: Path) -> None:
    (vehicle,) = read_log([data_dir / "sitl" / "c3_outage.tlog"]).vehicles
    assert vehicle.imu[0].source == "HIGHRES_IMU"
    assert vehicle.truth is not None
    assert vehicle.autopilot is not None
    assert np.isfinite(vehicle.truth.vel_n).all()
    at = np.searchsorted(vehicle.truth.t_ns[:-1], vehicle.autopilot.t_ns[1000:2000])
    # A hovering copter with GPS: EKF3 and truth are metres apart, not tens.
    north = (vehicle.autopilot.lat[1000:2000] - vehicle.truth.lat[at]) * 6.37e6
    assert np.sqrt(np.mean(north**2)) < 10.0
