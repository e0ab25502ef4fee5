"""A CAN recording and a telemetry log as one run: the same bits again, also from its run log."""

from __future__ import annotations

import gzip
from itertools import islice
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.config import load, to_toml
from companion.types import Recording
from replay.configuration import ChosenConfig, choose_config
from replay.reader import read_log
from replay.session import SessionResult, run_log, run_session

_LINES = 90_000
"""About a minute of the bus: on the ground and take-off."""
_BYTES = 3_200_000
"""About as much of the telemetry."""


@pytest.fixture(scope="module")
def run(
    data_dir: Path, root: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Recording, ChosenConfig]:
    """The beginning of a recorded flight with a DroneCAN IMU."""
    folder = tmp_path_factory.mktemp("run")
    source = data_dir / "sitl" / "k1_can_mission.tlog"
    if not source.exists():
        pytest.skip("no recorded flight with a CAN IMU")
    bus, tlog = folder / "bus.log", folder / "flight.tlog"
    with gzip.open(source.with_suffix(".candump.log.gz"), "rt") as lines:
        bus.write_text("".join(islice(lines, _LINES)))
    with source.open("rb") as file:
        tlog.write_bytes(file.read(_BYTES))
    replace = msgspec.structs.replace
    config = load(root / "configs" / "sitl.toml")
    config = replace(config, imu=replace(config.imu, source="RawIMU", latency_ms=0.0))
    return read_log([bus, tlog]), ChosenConfig(config, "test", to_toml(config))


def digests(result: SessionResult) -> tuple[str, str]:
    return result.digest, result.digest_published


def test_a_joined_run_and_its_log_give_the_same_bits(
    run: tuple[Recording, ChosenConfig], tmp_path: Path
) -> None:
    recording, chosen = run
    path = tmp_path / "run.mcap"
    with run_log(path, recording, chosen) as writer:
        first = run_session(recording.vehicles[0], chosen, writer=writer)
        writer.close({"vehicles": {}})
    assert digests(run_session(recording.vehicles[0], chosen)) == digests(first)
    logged = read_log([path])
    again = run_session(logged.vehicles[0], choose_config(logged))
    assert digests(again) == digests(first)
    assert len(first.solution) > 1000


def test_the_same_files_read_again_give_the_same_samples(
    run: tuple[Recording, ChosenConfig],
) -> None:
    recording, _ = run
    again = read_log([Path(p) for p in recording.path.split(" + ")])
    for one, two in zip(recording.vehicles[0].imu, again.vehicles[0].imu, strict=True):
        assert one.source == two.source
        for name in ("t_ns", "t_rx_ns", "seq", "gyro_b", "accel_b", "interval_s"):
            assert np.array_equal(getattr(one, name), getattr(two, name), equal_nan=True)
