"""Biases kept from run to run: what is kept, how it ages, and files that are no state."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.config import Config, Imu, LastHeading, Log, Mavlink, parse
from companion.runtime import saved_state
from companion.runtime.saved_state import SavedBiases, SavedState, StateError
from companion.runtime.start import known_imu, prepare
from companion.types import COV_ACCEL_BIAS, COV_GYRO_BIAS, NS, Mode, Solution

from .flights import with_can

NOW = 1_750_000_000 * NS
CONFIG = Config(imu=Imu(gyro_bias_sd_dps=0.5, accel_bias_sd_mps2=0.2))


def _saved(age_s: float = 0.0, axes: object = CONFIG.imu.axes, **changes: object) -> SavedState:
    values = {
        "source": "imu",
        "saved_ns": NOW - round(age_s * NS),
        "gyro_bias_dps": (0.1, -0.2, 0.3),
        "gyro_bias_sd_dps": 0.01,
        "accel_bias_mps2": (0.05, 0.0, -0.1),
        "accel_bias_sd_mps2": 0.02,
    }
    biases = SavedBiases(**{**values, **changes})  # type: ignore[arg-type]
    return SavedState(saved_ns=biases.saved_ns, axes=axes, biases=biases)  # type: ignore[arg-type]


def _epoch(gyro_sd_dps: float, mode: Mode = Mode.NAVIGATING) -> Solution:
    cov = np.zeros((1, 5, 6))
    cov[0, COV_GYRO_BIAS, [0, 3, 5]] = math.radians(gyro_sd_dps) ** 2
    cov[0, COV_ACCEL_BIAS, [0, 3, 5]] = 0.03**2
    one = np.zeros(1)
    return Solution(
        np.array([NOW]),
        one,
        one,
        one,
        np.zeros((1, 3)),
        np.zeros((1, 4)),
        np.array([[0.01, 0.02, 0.03]]),
        np.radians([[0.1, -0.2, 0.3]]),
        cov,
        np.array([int(mode)]),
        np.zeros(1, np.int64),
    )


def test_what_a_run_learned_is_kept_and_read(tmp_path: Path) -> None:
    kept = saved_state.learned(CONFIG, "imu", _epoch(0.02))
    assert kept is not None
    path = tmp_path / "v.state.toml"
    saved_state.save(path, SavedState(saved_ns=NOW, axes=CONFIG.imu.axes, biases=kept))
    state = saved_state.read(path)
    assert state is not None
    again = state.biases
    assert again == kept
    assert np.allclose(again.gyro_bias_dps, (0.1, -0.2, 0.3))
    assert again.gyro_bias_sd_dps == pytest.approx(0.02)
    assert again.accel_bias_mps2 == (0.01, 0.02, 0.03)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    "last", [_epoch(0.4), _epoch(0.01, Mode.HEADING_UNKNOWN), Solution.empty(), _epoch(math.nan)]
)
def test_what_is_not_worth_keeping(last: Solution) -> None:
    assert saved_state.learned(CONFIG, "imu", last) is None


def test_the_last_second_counts_where_it_is_newer_and_whole(tmp_path: Path) -> None:
    path = tmp_path / "v.state.toml"
    saved_state.save(path, _saved(30.0))
    saved_state.save(path, _saved(1.0), durable=False)
    assert saved_state.read(path) == _saved(1.0)
    saved_state.save(path, _saved(0.0))
    assert saved_state.read(path) == _saved(0.0)
    saved_state.of_last_second(path).write_bytes(b"\x00" * 300)  # what a power cut leaves
    assert saved_state.read(path) == _saved(0.0)
    path.unlink()
    saved_state.save(path, _saved(1.0), durable=False)
    assert saved_state.read(path) == _saved(1.0)


def test_a_crash_while_writing_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "v.state.toml"
    saved_state.save(path, _saved())
    (tmp_path / "v.state.toml.new").mkdir()  # what is written first cannot be
    with pytest.raises(StateError, match="not kept"):
        saved_state.save(path, _saved(10.0))
    assert saved_state.read(path) == _saved()


def test_deviations_grow_with_age() -> None:
    sds = [
        saved_state.warmed(CONFIG, "imu", _saved(age), NOW).imu.gyro_bias_sd_dps
        for age in (0.0, 60.0, 3600.0, 12 * 3600.0, 24 * 3600.0, 1e7, -60.0)
    ]
    assert sds[0] == pytest.approx(0.01)
    assert sds == sorted(sds)
    assert sds[2] == pytest.approx(math.sqrt(0.01**2 + 0.001**2 * 3600 + 0.25 / 24))
    # A day old, older, or from a future that the clock does not know: as the datasheet has it.
    assert sds[4:] == [0.5, 0.5, 0.5]


def test_the_start_gets_the_biases() -> None:
    warm = saved_state.warmed(CONFIG, "imu", _saved(60.0), NOW)
    assert warm.imu.gyro_bias_dps == (0.1, -0.2, 0.3)
    assert warm.imu.accel_bias_mps2 == (0.05, 0.0, -0.1)
    assert 0.02 < warm.imu.accel_bias_sd_mps2 < 0.03


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"source": "other"}, "biases of 'other'"),
        ({"axes": ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))}, "axes"),
        ({"gyro_bias_dps": (50.0, 0.0, 0.0)}, "beyond six"),
    ],
)
def test_biases_of_something_else(changes: dict[str, object], why: str) -> None:
    with pytest.raises(StateError, match=why):
        saved_state.warmed(CONFIG, "imu", _saved(**changes), NOW)


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"\xff\xfe\x00",
        b"source = 3",
        b"source = [",
        b"\x00" * 300,
        b"source = 'imu'\nsurprise = 1\n",
    ],
)
def test_a_file_that_is_no_state(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "v.state.toml"
    path.write_bytes(text)
    with pytest.raises(StateError, match="not a state file"):
        saved_state.read(path)


def test_values_that_are_no_numbers(tmp_path: Path) -> None:
    path = tmp_path / "v.state.toml"
    saved_state.save(path, _saved(gyro_bias_sd_dps=math.nan))
    with pytest.raises(StateError, match="no numbers"):
        saved_state.read(path)


def _config(tmp_path: Path) -> Config:
    config = with_can(CONFIG, "imu")
    return msgspec.structs.replace(config, log=Log(directory=str(tmp_path)))


def test_a_run_begins_warm_and_says_so(tmp_path: Path) -> None:
    config = _config(tmp_path)
    saved_state.save(tmp_path / "vehicle.state.toml", _saved(saved_ns=NOW + 10**9 * NS))
    start = prepare(config, None)
    assert start.config.imu.gyro_bias_dps == (0.1, -0.2, 0.3)
    assert start.notes[0].startswith("warm start")
    assert parse(start.toml) == start.config
    assert start.log.parent == tmp_path


def test_heading_and_streams_of_an_earlier_run(tmp_path: Path) -> None:
    heading = LastHeading(heading_deg=-170.0, sd_deg=2.0, t_ns=NOW)
    saved = msgspec.structs.replace(
        _saved(), heading=heading, inputs={"gnss": "GPS2_RAW", "sonar": "x"}, autopilot=(3, 1)
    )
    saved_state.save(tmp_path / "vehicle.state.toml", saved)
    start = prepare(_config(tmp_path), None)
    assert start.saved == saved
    assert start.config.alignment.last_heading == heading
    assert parse(start.toml) == start.config
    assert start.known == {"gnss": "GPS2_RAW"}
    assert "heading 190°" in start.notes[0]


def test_garbage_is_a_note_and_a_cold_start(tmp_path: Path) -> None:
    (tmp_path / "vehicle.state.toml").write_text("garbage")
    start = prepare(_config(tmp_path), None)
    assert start.config.imu.gyro_bias_dps == (0.0, 0.0, 0.0)
    assert start.notes[0].startswith("cold start")


def test_the_autopilots_imu_starts_cold(tmp_path: Path) -> None:
    """It calibrates anew at each of its starts."""
    config = msgspec.structs.replace(
        CONFIG, mavlink=Mavlink(endpoint="udpin:127.0.0.1:0"), log=Log(directory=str(tmp_path))
    )
    saved_state.save(tmp_path / "vehicle.state.toml", _saved())
    assert known_imu(config) == ""
    start = prepare(config, None)
    assert start.notes == ()
    assert start.config.imu.gyro_bias_dps == (0.0, 0.0, 0.0)
