"""The front door: dispatch, merging, refusals in one line, and the check before a filter runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.types import ImuTooSlowError, LogFormatError
from replay.reader import read_log, require_inputs

from . import logs


def test_content_decides_before_the_suffix(tmp_path: Path) -> None:
    path = tmp_path / "flight.bin"
    path.write_bytes(logs.ulog(1.0))
    assert read_log([path]).format == "ulog"


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("x.zip", b"PK\x03\x04abc", "zip"),
        ("x.mat", b"MATLAB 5.0 MAT-file", "MATLAB"),
        ("x.ubx", b"\xb5\x62\x01\x07", "UBX"),
        ("x.csv", b"a,b\n1,2\n", "CSV"),
        ("x.tlog", b"", "empty"),
        ("x.what", b"hello there", "unknown"),
        ("x.tlog", b"\0" * 4000, "no MAVLink frame"),
        ("x.BIN", b"\xa3\x95" * 300, "no DataFlash"),
        ("x.ulg", b"ULog\x01\x12\x35\x01", "ULog"),
    ],
)
def test_refuses_in_one_line(name: str, content: bytes, says: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(LogFormatError, match=says) as caught:
        read_log([path])
    assert "\n" not in str(caught.value)


def test_absent_file_and_empty_list_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LogFormatError, match="No such file"):
        read_log([tmp_path / "none.tlog"])
    with pytest.raises(LogFormatError, match="no log given"):
        read_log([])


def test_two_files_of_one_run(tmp_path: Path) -> None:
    tlog, binlog = tmp_path / "a.tlog", tmp_path / "b.bin"
    tlog.write_bytes(logs.tlog(1.0))
    binlog.write_bytes(logs.dataflash(1.0))
    both = read_log([tlog, binlog])
    assert [v.name for v in both.vehicles] == ["sys1", "vehicle"]
    assert [v.name for v in read_log([tlog, binlog], vehicle="sys1").vehicles] == ["sys1"]
    with pytest.raises(LogFormatError, match="both hold vehicle 'sys1'"):
        read_log([tlog, tlog])
    with pytest.raises(LogFormatError, match="there is sys1, vehicle"):
        read_log([tlog, binlog], vehicle="other")


def test_slow_imu_is_refused_for_a_strapdown_filter_with_its_rate(tmp_path: Path) -> None:
    path = tmp_path / "slow.tlog"
    path.write_bytes(
        b"".join(logs.stamped(logs.WALL_US + b, f) for b, f in logs.tlog_frames(20.0, rate_hz=5))
    )
    vehicle = read_log([path]).vehicles[0]
    with pytest.raises(ImuTooSlowError, match=r"HIGHRES_IMU, comes at 5\.0 Hz"):
        require_inputs(vehicle)
    require_inputs(vehicle, minimum_hz=4.0)


def test_real_logs_read_or_refuse(data_dir: Path) -> None:
    suffixes = {".tlog", ".bin", ".ulg", ".mat", ".csv", ".zip", ".ubx", ".dbc", ".log", ".gz"}
    paths = [p for p in sorted(data_dir.rglob("*")) if p.suffix.lower() in suffixes]
    refusals, read = [], 0
    for path in [*paths, data_dir / "car-rtk"]:
        try:
            recording = read_log([path])
        except LogFormatError as error:
            refusals.append(str(error))
            continue
        read += 1
        for vehicle in recording.vehicles:
            for imu in vehicle.imu:
                assert (np.diff(imu.t_ns) > 0).all()
    assert not [text for text in refusals if "\n" in text]
    assert read > 25


@pytest.mark.parametrize(
    ("name", "data", "what"),
    [
        (
            "a.obs",
            f"{'     3.03           OBSERVATION DATA':60}RINEX VERSION / TYPE\n".encode(),
            "RINEX",
        ),
        ("a.txt", b"# \n# Raw,utcTimeMillis,TimeNanos\n", "GnssLogger"),
        ("a.rtcm3", b"\xd3\x00\x13", "RTCM 3"),
        ("a.dat", b"\xb5\x62\x02\x15", "u-blox"),
    ],
)
def test_raw_gnss_by_itself_is_told_where_it_belongs(
    tmp_path: Path, name: str, data: bytes, what: str
) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(LogFormatError, match=f"{what}.*raw_gnss/ of a sensor folder"):
        read_log([path])
