"""``raw_gnss/`` of a sensor folder: its clock, what is used of it, and what is said of it."""

from __future__ import annotations

import shutil
from collections.abc import Callable
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

from ..test_cli import Ran
from ..test_cli import run as run
from .test_rinex import OBS_3, TCKF

SECONDS, RATE_HZ = 1, 100
Call = Callable[..., Ran]


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


def test_a_receiver_by_itself_tells_its_satellites_and_writes_fixes_that_are_read(
    data_dir: Path, tmp_path: Path, run: Call
) -> None:
    out = tmp_path / "fixes" / "gnss.csv"
    out.parent.mkdir()
    result = run("satellites", data_dir / "rtk-walk/gnss_1730.ubx", "-o", out, "--json")
    told = result.json
    assert told["solved"] == told["epochs"] == 536
    # Where its own RTK says, but for its base station's coordinates, 8 m off (docs/results.md).
    assert told["place"]["lat_deg"] == pytest.approx(40.0967, abs=2e-4)
    assert told["place"]["lon_deg"] == pytest.approx(-105.1471, abs=2e-4)
    assert [s["name"] for s in told["systems"]] == ["GPS", "Galileo", "BeiDou"]
    assert all(s["with_ephemeris"] < s["satellites"] for s in told["systems"])
    assert told["sky"]["satellites_least"] >= 10
    [fixes] = read_log([out.parent]).vehicles[0].gnss
    assert len(fixes) == 536
    assert fixes.num_sats.min() >= 10
    assert np.isfinite(fixes.vel_n).all()
    assert (fixes.sd_pos > 0.1).all()


@pytest.mark.parametrize(
    ("paths", "why"),
    [
        (["nothing.ubx"], "no such file or folder"),
        (["a.obs"], "no ephemerides; a navigation file is missing"),
        (["a.nav"], "measurements of one receiver are expected; there: none"),
        ([".", "a.obs"], "one folder alone, or files"),
    ],
)
def test_receivers_that_cannot_be_solved_are_one_line(
    folder: Path, run: Call, paths: list[str], why: str
) -> None:
    raw = folder / "raw_gnss"
    result = run("satellites", *(raw / path for path in paths))
    assert result.status == 1
    assert why in result.err
    assert len(result.err.strip().splitlines()) == 1


def test_files_that_stand_beside_are_left_out_and_compact_ones_are_named(folder: Path) -> None:
    raw = folder / "raw_gnss"
    version = f"{'     2.10           G: GLONASS NAV DATA':<60}RINEX VERSION / TYPE\n"
    (raw / "a.23g").write_text(version + f"{'':<60}END OF HEADER\n")
    assert read_log([folder], clock="gps").notes == (
        "a.23g: GLONASS navigation is not used, left out",
    )
    (raw / "b.23d").write_text(
        f"{'1.0                 COMPACT RINEX FORMAT':<60}CRINEX VERS   / TYPE\n"
    )
    with pytest.raises(LogFormatError, match=r"b\.23d: compact RINEX \(Hatanaka\)"):
        read_log([folder])


@pytest.mark.parametrize(
    ("later_s", "said"),
    [
        (1024 * 604_800, "1024 weeks (1 times 1024, after which some clocks begin anew) apart"),
        (-2048 * 604_800, "2048 weeks (2 times 1024, after which some clocks begin anew) apart"),
        (3_600, "3599 s apart"),
    ],
)
def test_recordings_without_a_time_in_common_are_told(
    folder: Path, later_s: int, said: str
) -> None:
    head, *rows = (folder / "imu.csv").read_text().splitlines()
    moved = []
    for row in rows:
        stamp, rest = row.split(",", 1)
        moved.append(f"{int(stamp) + later_s * NS},{rest}")
    (folder / "imu.csv").write_text("\n".join([head, *moved]) + "\n")
    [note] = read_log([folder], clock="gps").notes
    assert note == f"raw_gnss/ and imu.csv have no time in common: {said}"
