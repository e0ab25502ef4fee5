"""DataFlash logs: old and new layouts give the same flight."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.types import VehicleRecording
from replay.reader import read_log

from . import logs

UNIX_S = 315_964_800 - 18 + 2288 * 604_800 + 302_400
"""GPS week 2288, half a week in, on the Unix clock; the log's GPS stamps begin there."""


def read(data: bytes, tmp_path: Path) -> VehicleRecording:
    path = tmp_path / "made.bin"
    path.write_bytes(data)
    return read_log([path]).vehicles[0]


@pytest.mark.parametrize("old", [True, False])
def test_values_units_and_time(old: bool, tmp_path: Path) -> None:
    vehicle = read(logs.dataflash(4.0, old=old), tmp_path)
    imu, fix = vehicle.imu[0], vehicle.gnss[0]
    assert imu.source == ("IMU" if old else "IMU[0]")
    assert imu.t_ns[0] == fix.t_ns[0] == UNIX_S * 1_000_000_000
    assert (np.diff(imu.t_ns) == 20_000_000).all()
    np.testing.assert_allclose(imu.accel_b[0], logs.ACCEL, atol=1e-6)
    np.testing.assert_allclose(np.degrees(fix.lat), 47.4, atol=1e-9)
    np.testing.assert_allclose(fix.height, 500.0)
    np.testing.assert_allclose(fix.vel_n[0], [0.0, 5.0, -0.5], atol=1e-6)
    np.testing.assert_allclose(vehicle.baro[0].pressure, 95025.0)
    np.testing.assert_allclose(vehicle.mag[0].field_b[0], [2e-5, -5e-6, 4.3e-5])
    assert vehicle.height_datum == "msl"
    assert vehicle.autopilot is not None
    np.testing.assert_allclose(np.degrees(vehicle.autopilot.rpy[0]), [5.73, -2.86, -1.0], atol=1e-9)


def test_garbage_and_truncation_cost_only_their_records(tmp_path: Path) -> None:
    data = logs.dataflash(4.0)
    at = data.index(b"\xa3\x95\x83", 3000)
    vehicle = read(data[:at] + b"\xa3\x95garbage" + data[at:-5], tmp_path)
    # The record before the garbage has no header behind it and goes with it.
    assert 198 <= len(vehicle.imu[0]) <= 200


def test_one_corrupt_stamp_costs_one_sample(tmp_path: Path) -> None:
    data = bytearray(logs.dataflash(4.0))
    at = data.index(b"\xa3\x95\x83", 3000)
    data[at + 3 + 5] ^= 0x40  # a high byte of TimeUS; there is no checksum to catch it
    vehicle = read(bytes(data), tmp_path)
    assert len(vehicle.imu[0]) == 199


def test_jamming_is_the_receivers_last_word(data_dir: Path) -> None:
    """UBX1 comes twice a second; its largest value in this log is 86 of 255."""
    path = data_dir / "bin-erle" / "copter" / "6-11-2014_GPS_issues2.BIN"
    (vehicle,) = read_log([path]).vehicles
    said = vehicle.gnss[0].interference
    assert np.nanmax(said) == pytest.approx(86.0 / 255.0)
    assert np.isfinite(said).mean() > 0.9
