"""Configuration: what is refused, by which name, and what the shipped files hold."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config import Config, load, parse, to_toml
from companion.types import ConfigError, Recording
from replay.configuration import choose_config

CONFIGS = sorted((Path(__file__).resolve().parent.parent / "configs").glob("*.toml"))


def recording(format_: str, config_toml: str | None = None) -> Recording:
    return Recording(path="flight", format=format_, vehicles=(), config_toml=config_toml)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("[imu]\ngyro_noise_dps_rtz = 0.1", "unknown key 'imu.gyro_noise_dps_rtz'"),
        ("[imu]\ngyro_noise_dps_rtz = 0.1", "did you mean 'gyro_noise_dps_rthz'?"),
        ("[gps]\nlatency_ms = 1", "unknown key 'gps'"),
        ("[gnss]\nlatency_ms = '100 ms'", "key 'gnss.latency_ms': Expected `float`"),
        ("[gnss]\nlatency_s = 0.1", "unknown key 'gnss.latency_s'; did you mean 'latency_ms'?"),
        ("[gnss]\nlever_arm_b_m = [0.1, 0.2]", "gnss.lever_arm_b_m"),
        ("[gnss]\nsd_reported = 'trust'", "key 'gnss.sd_reported': Invalid enum value 'trust'"),
        ("[gnss]\nsd_position_m = 0.0", "key 'gnss.sd_position_m': must be positive, got 0"),
        ("[gnss]\nlatency_ms = 9000", "milliseconds between 0 and 2000"),
        ("[imu]\nlatency_ms = -5", "milliseconds between 0 and 500"),
        ("[imu]\ngyro_bias_sd_dps = inf", "key 'imu.gyro_bias_sd_dps': must be positive"),
        ("[imu]\nlatency_ms = nan", "key 'imu.latency_ms'"),
        ("[imu]\ngyro_vibration_gain_rthz = -0.1", "gyro_vibration_gain_rthz': zero (none) or"),
        ("[imu]\ngyro_bias_dps = [0.0, nan, 0.0]", "key 'imu.gyro_bias_dps': three numbers within"),
        ("[imu]\naccel_bias_mps2 = [0.0, 0.0, -11.0]", "key 'imu.accel_bias_mps2': three numbers"),
        ("[engine]\ngate_probability = 1.0", "key 'engine.gate_probability'"),
        ("[alignment]\nhypotheses = 1", "key 'alignment.hypotheses': between 4 and 72"),
        ("[imu\n", "not valid TOML"),
        ("[imu]\naxes = [[1,0,0],[0,1,0]]", "imu.axes"),
        ("[imu]\naxes = [[1,0,0],[0,1,0],[0,0,2]]", "key 'imu.axes': rows must be orthonormal"),
        ("[imu]\naxes = [[1,0,0],[1,0,0],[0,0,1]]", "key 'imu.axes': rows must be orthonormal"),
        ("[imu]\naxes = [[0,1,0],[1,0,0],[0,0,1]]", "key 'imu.axes': determinant is −1"),
    ],
)
def test_refused_by_name(text: str, wanted: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(wanted)) as caught:
        parse(text, "vehicle.toml")
    assert str(caught.value).startswith("vehicle.toml: ")


def test_every_refusal_is_one_line() -> None:
    with pytest.raises(ConfigError) as caught:
        parse("[imu]\naxes = [[1,0,0],\n[0,1", "a.toml")
    assert "\n" not in str(caught.value)


def test_empty_text_is_the_defaults() -> None:
    assert parse("") == Config()


def test_axes_that_turn_are_taken() -> None:
    config = parse("[imu]\naxes = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]")
    assert config.imu.axes[1] == (-1.0, 0.0, 0.0)


def test_missing_file_and_binary_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml: cannot be read"):
        load(tmp_path / "none.toml")
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match=r"binary\.toml: cannot be read"):
        load(binary)
    with pytest.raises(ConfigError, match="cannot be read"):
        load(tmp_path)


def test_configs_are_shipped() -> None:
    assert {p.stem for p in CONFIGS} >= {"multirotor", "sitl", "car", "autopilot-imu"}


@pytest.mark.parametrize("path", CONFIGS, ids=lambda p: p.stem)
def test_shipped_config_loads_and_says_its_units(path: Path) -> None:
    load(path)
    bare = [
        line
        for line in path.read_text(encoding="utf-8").splitlines()
        if re.match(r"\w+_(ms|m|mps|dps|rthz|rts|hz|s|t|mps2|deg) = [-\d.]+ *$", line)
    ]
    assert not bare, "numbers with a unit carry a comment"


@given(st.text(max_size=200))
def test_any_text_is_taken_or_refused(text: str) -> None:
    with suppress(ConfigError):
        assert isinstance(parse(text), Config)


@pytest.mark.parametrize("path", CONFIGS, ids=lambda p: p.stem)
def test_full_text_gives_the_same_configuration_back(path: Path) -> None:
    config = load(path)
    text = to_toml(config)
    assert parse(text) == config
    # Every key is spelled out, so that a new default cannot change an old log.
    assert "hypotheses" in text
    assert "bias_walk_m_rts" in text


@given(st.text(max_size=30), st.floats(allow_nan=False, allow_infinity=False, min_value=1e-300))
def test_full_text_keeps_odd_names_and_numbers(name: str, noise: float) -> None:
    base = Config()
    config = msgspec.structs.replace(
        base,
        vehicle=msgspec.structs.replace(base.vehicle, name=name),
        imu=msgspec.structs.replace(base.imu, accel_scale_sd_ppm=noise),
    )
    again = parse(to_toml(config))
    assert again.vehicle.name == name
    assert again.imu.accel_scale_sd_ppm == noise


def test_choice_of_configuration(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text("[gnss]\nlatency_ms = 7\n", encoding="utf-8")
    came = recording("tlog", "[gnss]\nlatency_ms = 8\n")
    assert choose_config(came, mine).config.gnss.latency_ms == 7
    assert choose_config(came, mine).origin == str(mine)
    assert choose_config(came).config.gnss.latency_ms == 8
    assert "came with flight" in choose_config(came).origin
    # An autopilot's log stamps arrival: the default knows that its fixes are late.
    assert choose_config(recording("tlog")).config.gnss.latency_ms == 100
    assert "GNSS 100 ms" in choose_config(recording("tlog")).origin
    assert choose_config(recording("folder")).config == Config()


def test_bad_configuration_in_a_log_names_the_log() -> None:
    with pytest.raises(ConfigError, match=r"configuration in flight: unknown key 'imu\.x'"):
        choose_config(recording("folder", "[imu]\nx = 1"))


def test_a_dbc_file_is_looked_for_beside_the_configuration(tmp_path: Path) -> None:
    path = tmp_path / "rover.toml"
    path.write_text(
        """
[[can]]
channel = "can0"
[[can.imu]]
name = "unit"
protocol = "dbc"
[can.imu.dbc]
file = "unit.dbc"
gyro_signals = ["a", "b", "c"]
accel_signals = ["d", "e", "f"]
"""
    )
    mapping = load(path).can[0].imu[0].dbc
    assert mapping is not None
    assert mapping.file == str(tmp_path / "unit.dbc")
