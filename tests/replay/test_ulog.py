"""ULog: integrals, Unix time by the receiver, heights, broken files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.types import LogFormatError
from replay.reader import read_log

from . import logs


def test_values_units_and_time(tmp_path: Path) -> None:
    path = tmp_path / "made.ulg"
    path.write_bytes(logs.ulog(2.0))
    (vehicle,) = read_log([path]).vehicles
    imu, fix = vehicle.imu[0], vehicle.gnss[0]
    np.testing.assert_allclose(imu.accel_b[0], logs.ACCEL, atol=1e-6)
    np.testing.assert_allclose(imu.interval_s, 0.01)
    assert imu.t_ns[0] == fix.t_ns[0] == logs.WALL_US * 1000
    assert vehicle.height_datum == "hae"
    np.testing.assert_allclose(fix.height, 547.5)
    np.testing.assert_allclose(fix.vel_n[0], [0.0, 5.0, -0.5])
    np.testing.assert_allclose(fix.sd_pos[0], [1.2, 1.2, 2.5], rtol=1e-6)


def test_a_cut_definition_ends(tmp_path: Path) -> None:
    path = tmp_path / "cut.ulg"
    # An unknown message longer than the rest of the file.
    path.write_bytes(logs.ulog(1.0)[:16] + b"\x10\x7fX" + b"\0" * 30)
    with pytest.raises(LogFormatError):
        read_log([path])


def test_simulator_truth(data_dir: Path) -> None:
    (vehicle,) = read_log([data_dir / "ulg" / "sitl_stifael_14_19_29.ulg"]).vehicles
    assert vehicle.truth is not None
    assert np.isfinite(vehicle.truth.rpy).mean() > 0.9


def test_clipping_and_interference_as_the_drivers_say(data_dir: Path) -> None:
    """Counted in the log with pyulog: two samples with a bit of an axis, an indicator of 2 to 9."""
    (vehicle,) = read_log([data_dir / "ulg" / "roboto_fmuv5_9s.ulg"]).vehicles
    assert vehicle.imu[0].clipped.tolist().count(1.0) == 2
    assert vehicle.imu[0].clipped.sum() == 2.0
    said = vehicle.gnss[0].interference * 255.0
    assert (said.min(), said.max()) == (pytest.approx(2.0), pytest.approx(9.0))
