"""``raw_gnss/`` of a sensor folder: its clock, what is used of it, and what is said of it."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from companion.gnss.gps_time import gps_ns
from companion.types import NS, LogFormatError
from replay.configuration import choose_config, said_of_data
from replay.preparation import navigable
from replay.raw_gnss.folder import on_clock
from replay.raw_gnss.rinex_observations import read_observations
from replay.reader import read_log

from .test_rinex import OBS_3, TCKF

SECONDS, RATE_HZ = 1, 100


@pytest.fixture
def folder(tmp_path: Path, data_dir: Path) -> Path:
    """An IMU at rest on GPS time beside two epochs of a receiver."""
    raw = tmp_path / "run" / "raw_gnss"
    raw.mkdir(parents=True)
    (raw / "a.obs").write_text(OBS_3)
    shutil.copy(data_dir / (TCKF + ".nav"), raw / "a.nav")
    first = on_clock(read_observations(raw / "a.obs")[0], "gps").t_ns[0]
    t = first + np.arange(SECONDS * RATE_HZ) * (NS // RATE_HZ)
    names = [f"{kind}_{axis}_{unit}" for kind, unit in (("gyro", "radps"), ("accel", "mps2"))
             for axis in "xyz"]  # fmt: skip
    rows = "".join(f"{one},0,0,0,0,0,-9.81\n" for one in t)
    (tmp_path / "run" / "imu.csv").write_text(",".join(["t_ns", *names]) + "\n" + rows)
    return tmp_path / "run"


def _config(folder: Path, text: str) -> Path:
    path = folder.parent / "my.toml"
    path.write_text(text)
    return path


def test_the_clock_is_the_configurations_else_the_folders(folder: Path) -> None:
    def begins(config: Path | None) -> int:
        clock = said_of_data(config)[1]
        return int(read_log([folder], clock=clock).vehicles[0].raw[0].t_ns[0])

    gps = _config(folder, '[raw_gnss]\nclock = "gps"\n')
    leap = begins(gps) - begins(None)
    assert leap == 18 * NS
    (folder / "vehicle.toml").write_text(gps.read_text())
    assert begins(None) == begins(gps)
    # One that is silent about it leaves the data's own word.
    assert begins(_config(folder, '[raw_gnss]\ncoupling = "loose"\n')) == begins(None)
    assert begins(_config(folder, '[raw_gnss]\nclock = "utc"\n')) == begins(None) - leap


def test_stamps_that_are_leap_seconds_off_are_doubted(folder: Path) -> None:
    [note] = read_log([folder]).notes
    assert 'raw_gnss.clock = "gps"' in note
    assert "18 s ahead of imu.csv" in note
    assert read_log([folder], clock="gps").notes == ()


def test_ranges_alone_are_used_and_a_configuration_without_them_is_told(folder: Path) -> None:
    recording = read_log([folder], clock="gps")
    chosen = choose_config(recording)
    assert chosen.config.raw_gnss.coupling == "tight"
    assert "tight coupling" in chosen.origin
    assert navigable(recording, chosen.config)[0] == list(recording.vehicles)
    off = choose_config(recording, _config(folder, "[imu]\n")).config
    with pytest.raises(LogFormatError, match='coupling is "off": set "tight" or "loose"'):
        navigable(recording, off)


def test_an_imu_file_without_a_row_is_no_traceback(folder: Path) -> None:
    header = (folder / "imu.csv").read_text().splitlines()[0]
    (folder / "imu.csv").write_text(header + "\n")
    recording = read_log([folder], clock="gps")
    assert recording.vehicles[0].raw[0].t_ns[0] > gps_ns(2268, 0.0)
    with pytest.raises(LogFormatError):
        navigable(recording, choose_config(recording).config)
