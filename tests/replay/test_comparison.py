"""Settings side by side: what words mean, and that each is the run it says it is."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from companion.config import Config, to_toml
from companion.types import ConfigError, Recording
from replay.comparison import DEFAULT, compare, settings
from replay.configuration import ChosenConfig, choose_config
from replay.reader import read_log
from replay.session import run_session
from replay.simulator.sample import SAMPLE_DIRECTORY, SAMPLE_NAME
from replay.window import Window

SAMPLE_TLOG = SAMPLE_DIRECTORY / SAMPLE_NAME


@pytest.fixture(scope="module")
def sample() -> Recording:
    return read_log([SAMPLE_TLOG])


def chosen() -> ChosenConfig:
    return ChosenConfig(Config(), "defaults", to_toml(Config()))


def test_words_change_what_they_name() -> None:
    found = settings(chosen(), ["huber", "flac+no-source-faults", "as-configured", "huber"])
    assert [one.name for one in found] == ["huber", "flac+no-source-faults", "as-configured"]
    huber, both, same = (one.chosen.config for one in found)
    assert huber.adaptation.method == "huber"
    assert both.adaptation.method == "flac"
    assert not both.source_faults.detect
    assert same == Config()
    assert settings(chosen(), DEFAULT)[0].name == "none"


def test_a_file_is_laid_over_the_configuration(tmp_path: Path) -> None:
    changes = tmp_path / "mine.toml"
    changes.write_text("[gnss]\nsd_position_m = 4.5\n", encoding="utf-8")
    (one,) = settings(chosen(), [f"mine={changes}"])
    assert one.name == "mine"
    assert one.chosen.config.gnss.sd_position_m == 4.5
    assert one.chosen.config.gnss.sd_height_m == Config().gnss.sd_height_m


def test_what_cannot_be_used_is_said_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"unknown 'fuzy'; known are none, fuzzy"):
        settings(chosen(), ["fuzy"])
    with pytest.raises(ConfigError, match="cannot be read"):
        settings(chosen(), [f"x={tmp_path / 'absent.toml'}"])
    bad = tmp_path / "bad.toml"
    bad.write_text("[gnss]\nsd_positon_m = 4.5\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="did you mean 'sd_position_m'"):
        settings(chosen(), [f"x={bad}"])


def test_a_comparison_is_the_runs_one_by_one(sample: Recording) -> None:
    vehicle, base = sample.vehicles[0], choose_config(sample)
    wanted = settings(base, ["none", "innovation"])
    rows = compare(vehicle, wanted, [Window(100.0, 15.0)])
    alone = run_session(vehicle, wanted[1].chosen, outages=[Window(100.0, 15.0)])
    assert rows[1].digest == alone.digest
    assert rows[1].digest_published == alone.digest_published
    assert rows[0].digest != rows[1].digest
    for row in rows:
        assert row.reference == "truth"
        assert any(abs((o["start_s"] or 0.0) - 100.0) < 0.5 for o in row.outages)
        assert row.accepted > 1000


def test_the_command_prints_one_object(capsys: pytest.CaptureFixture[str]) -> None:
    from companion.cli.app import main

    command = ["compare", str(SAMPLE_TLOG), "--estimators", "none,none+no-source-faults", "--json"]
    with pytest.raises(SystemExit) as ended:
        main(command)
    assert ended.value.code in (0, None)
    rows = json.loads(capsys.readouterr().out)["vehicles"][0]["settings"]
    assert [row["name"] for row in rows] == ["none", "none+no-source-faults"]
    # Nothing is wrong with the sample flight's receiver: looking for faults changes no bit.
    assert rows[0]["digest"] == rows[1]["digest"]
