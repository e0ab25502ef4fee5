"""Sensor folders: columns, missing cells, arrival order, and errors that name file and line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.types import LogFormatError, Recording
from replay.reader import read_log

from . import logs


def read(tmp_path: Path, **changed: tuple[str, str]) -> Recording:
    for name, content in logs.folder(4.0).items():
        old, new = changed.get(name.split(".")[0], ("", ""))
        (tmp_path / name).write_bytes(content.replace(old.encode(), new.encode(), 1))
    return read_log([tmp_path])


def test_values_and_missing_cells(tmp_path: Path) -> None:
    recording = read(tmp_path)
    (vehicle,) = recording.vehicles
    assert vehicle.name == "rover"
    assert recording.config_toml is not None
    imu, fix = vehicle.imu[0], vehicle.gnss[0]
    assert imu.t_ns[1] == logs.WALL_US * 1000 + 20_000_000
    np.testing.assert_array_equal(imu.accel_b[0], logs.ACCEL)
    np.testing.assert_array_equal(np.isnan(fix.vel_n[:, 2]), np.arange(len(fix)) == 1)
    assert np.isnan(fix.sd_pos).all()
    assert (fix.t_rx_ns - fix.t_ns == 100_000_000).all()
    # 100 ms late: behind the five IMU samples that were taken meanwhile, numbered by arrival.
    assert fix.seq[0] > imu.seq[4]
    assert fix.seq[0] < imu.seq[6]


@pytest.mark.parametrize(
    ("name", "old", "new", "says"),
    [
        ("imu", "accel_x_mps2", "accel_x_g", r"imu.csv:1: column 'accel_x_mps2' is missing"),
        ("imu", ",0.1,-9", ",zero,-9", r"imu.csv:2: "),
        ("imu", ",0.01,", ",oops,", r"imu.csv:2: gyro_x_radps is 'oops'"),
        ("imu", ",0.01,", ",0.01,3,", r"imu.csv:2: 8 cells, the header has 7"),
        ("gnss", ",47.4,", ",4740000.0,", "not degrees"),
    ],
)
def test_errors_name_the_place(name: str, old: str, new: str, says: str, tmp_path: Path) -> None:
    if old == ",0.1,-9":
        old, new = ",0.1,0.1,-0.2", ",0.1,zero,-0.2"
    with pytest.raises(LogFormatError, match=says):
        read(tmp_path, **{name: (old, new)})


def test_wrong_units_are_named(tmp_path: Path) -> None:
    header = "t_ns,gyro_x_radps,gyro_y_radps,gyro_z_radps,accel_x_mps2,accel_y_mps2,accel_z_mps2\n"
    path = tmp_path / "imu.csv"
    path.write_text(header + "".join(f"{i}0,0,0,0,0,0,-1\n" for i in range(20)))
    with pytest.raises(LogFormatError, match="in g"):
        read_log([tmp_path])
    path.write_text(header + "".join(f"{i}0,0,0,90,0,0,-9.8\n" for i in range(20)))
    with pytest.raises(LogFormatError, match="in deg/s"):
        read_log([tmp_path])


def test_backward_times_are_dropped_and_noted(tmp_path: Path) -> None:
    t = logs.WALL_US * 1000 + 60_000_000
    recording = read(tmp_path, imu=(f"\n{t},", f"\n{t - 50_000_000},"))
    assert len(recording.vehicles[0].imu[0]) == 199
    assert any("backward" in note for note in recording.notes)
