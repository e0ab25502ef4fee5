"""The command line: exit status, one-line errors, one JSON object, and help."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from companion.cli import app as surface
from companion.cli import main

COMMANDS = (
    "replay",
    "report",
    "tune",
    "evaluate",
    "export",
    "simulate",
    "smooth",
    "reproduce",
    "compare",
    "batch",
    "bench",
    "check",
    "demo",
    "run",
    "satellites",
    "watch",
)


class Ran:
    """Status and output of one call."""

    def __init__(self, status: int, out: str, err: str) -> None:
        self.status, self.out, self.err = status, out, err

    @property
    def json(self) -> dict[str, Any]:
        """The one object on stdout; fails if there is anything else."""
        assert self.out.count("\n") == 1
        value: dict[str, Any] = json.loads(self.out)
        return value


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Call the command in this process, in an empty directory."""
    monkeypatch.chdir(tmp_path)

    def call(*args: object) -> Ran:
        capfd.readouterr()
        with pytest.raises(SystemExit) as left:
            main([str(a) for a in args])
        code = left.value.code
        assert code is None or isinstance(code, int)
        out, err = capfd.readouterr()
        return Ran(code or 0, out, err)

    return call


def assert_explained(ran: Ran, *words: str) -> None:
    """Exit 1 and one line on stderr that holds ``words``, and no traceback anywhere."""
    assert ran.status == 1, ran.err
    errors = [line for line in ran.err.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1, ran.err
    assert ran.err.splitlines()[-1] == errors[0]
    assert "Traceback" not in ran.err + ran.out
    assert "internal error" not in ran.err
    for word in words:
        assert word in errors[0]


# ------------------------------------------------------------------------------ surface


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example_and_json(run: Any, command: str) -> None:
    ran = run(command, "--help")
    assert ran.status == 0
    assert "Example: companion " + command in ran.out
    assert "--json" in ran.out
    assert ran.err == ""


def test_help_names_units(run: Any) -> None:
    assert "seconds" in run("replay", "--help").out
    assert "m/s" in run("evaluate", "--help").out


def test_version(run: Any) -> None:
    ran = run("--version")
    assert ran.status == 0
    assert ran.out.startswith("companion ")


@pytest.mark.parametrize(
    "args",
    [
        ["nonsense"],
        ["replay", "a.tlog", "--nonsense"],
        ["replay", "a.tlog", "--outage", "120"],
        ["replay", "a.tlog", "--outage", "120+-5"],
        ["replay", "a.tlog", "--outage", "a+b"],
        ["replay", "a.tlog", "--outage", "10+inf"],
        ["replay", "a.tlog", "--outage", "nan+5"],
        ["replay", "a.tlog", "--speed", "0"],
        ["replay", "a.tlog", "--speed", "fast"],
        ["evaluate"],
        ["evaluate", "a.tlog", "--window", "5"],
        ["export", "a.tlog"],
        ["export", "a.tlog", "--format", "xls", "-o", "x"],
        ["simulate", "hover", "-o", "x", "--seed", "-1"],
    ],
)
def test_wrong_usage_exits_2_and_keeps_stdout_empty(run: Any, args: list[str]) -> None:
    ran = run(*args, "--json") if args != ["nonsense"] else run(*args)
    assert ran.status == 2
    assert ran.out == ""
    assert "Traceback" not in ran.err


def test_help_is_quick_and_loads_nothing_heavy() -> None:
    code = (
        "import sys, companion.cli.app; "
        "print([m for m in ('numba', 'numpy', 'scipy', 'pymavlink') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.strip() == "[]"


# ------------------------------------------------------------------------------ bad input


@pytest.mark.parametrize("command", ["replay", "evaluate", "export"])
@pytest.mark.parametrize("name", ["empty.tlog", "noise.tlog", "noise.BIN", "noise.ulg", "a.mcap"])
def test_hopeless_file_is_one_line(run: Any, tmp_path: Path, command: str, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(b"" if name == "empty.tlog" else bytes(range(1, 251)) * 40)
    args = ["-o", tmp_path / "out.csv"] if command == "export" else []
    assert_explained(run(command, path, *args), name)
    assert not (tmp_path / "out.csv").exists()
    assert not list(tmp_path.glob("*.run.mcap")), "no run log of a run that never was"


@pytest.mark.parametrize("command", ["replay", "evaluate"])
def test_absent_file_and_empty_directory(run: Any, tmp_path: Path, command: str) -> None:
    assert_explained(run(command, tmp_path / "none.tlog"), "none.tlog")
    (tmp_path / "folder").mkdir()
    assert_explained(run(command, tmp_path / "folder"), "folder")


def test_unknown_suffix_says_what_is_readable(run: Any, tmp_path: Path) -> None:
    path = tmp_path / "photo.jpg"
    path.write_bytes(b"\xff\xd8\xff\xe0" + bytes(100))
    assert_explained(run("replay", path), "photo.jpg", ".tlog")


def test_failure_with_json_is_one_object(run: Any, tmp_path: Path) -> None:
    ran = run("replay", tmp_path / "none.tlog", "--json")
    assert_explained(ran, "none.tlog")
    assert "none.tlog" in ran.json["error"]


def test_bad_configuration_names_the_key(run: Any, tmp_path: Path, sample_flight: Path) -> None:
    config = tmp_path / "bad.toml"
    config.write_text("[imu]\ngyro_noise = 1\n", encoding="utf-8")
    assert_explained(run("replay", sample_flight, "--config", config), "imu.gyro_noise", "bad.toml")


def test_unknown_scenario_lists_the_known(run: Any, tmp_path: Path) -> None:
    assert_explained(run("simulate", "moon-landing", "-o", tmp_path / "x"), "multirotor-mission")


def test_log_is_never_written_over_its_source(
    run: Any, tmp_path: Path, sample_flight: Path
) -> None:
    copy = tmp_path / "flight.tlog"
    copy.write_bytes(sample_flight.read_bytes())
    assert_explained(run("replay", copy, "--out", copy), "is the log being read")
    assert copy.read_bytes() == sample_flight.read_bytes()


def test_out_into_nowhere(run: Any, tmp_path: Path, sample_flight: Path) -> None:
    out = tmp_path / "none" / "run.mcap"
    assert_explained(run("replay", sample_flight, "--out", out), "does not exist")


def test_unexpected_error_is_one_line_without_traceback(
    run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> dict[str, Any]:
        raise ZeroDivisionError("division\nby zero")

    monkeypatch.delenv("COMPANION_DEBUG", raising=False)
    monkeypatch.setattr("companion.cli.commands.replay_logs", broken)
    ran = run("replay", tmp_path / "x.tlog")
    assert ran.status == 1
    assert ran.err.splitlines() == [
        "error: internal error ZeroDivisionError: division by zero; "
        "run with COMPANION_DEBUG=1 for the traceback"
    ]
    monkeypatch.setenv("COMPANION_DEBUG", "1")
    assert "Traceback" in run("replay", tmp_path / "x.tlog").err


def test_closed_pipe_ends_quietly(root: Path) -> None:
    script = f"{sys.executable} -m companion --help | head -c 1 >/dev/null; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(
        ["bash", "-c", script], cwd=root, capture_output=True, text=True, timeout=60, check=True
    )
    assert "Traceback" not in done.stderr
    assert done.stdout.strip() in ("0", "1")


# ------------------------------------------------------------------------------ a flight


@pytest.fixture(scope="module")
def flown(sample_flight: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any, str]:
    """Run log, JSON and people's text of the sample flight with one withheld window."""
    out = tmp_path_factory.mktemp("flown") / "sample.mcap"
    options = ("--outage", "60+10", "--json")
    done = subprocess.run(
        [sys.executable, "-m", "companion", "replay", sample_flight, "--out", out, *options],
        capture_output=True,
        text=True,
        timeout=200,
        env={**os.environ, "COLUMNS": "120"},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("\n") == 1
    return out, json.loads(done.stdout), done.stderr


def test_replay_tells_what_was_flown(flown: tuple[Path, Any, str]) -> None:
    out, result, text = flown
    assert out.stat().st_size > 0
    (vehicle,) = result["vehicles"]
    assert vehicle["flight"]["duration_s"] > 60
    assert vehicle["flight"]["distance_m"] > 50
    assert {s["kind"] for s in vehicle["sensors"]} >= {"imu", "gnss", "baro"}
    assert vehicle["gates"]["gnss_position_h"]["accepted"] > 100
    assert vehicle["accuracy"]["reference"] == "truth"
    assert any(
        abs(o["start_s"] - 60) < 1 and abs(o["seconds"] - 10) < 1
        for o in vehicle["accuracy"]["outages"]
    )
    for words in ("Flown", "Sensors", "Aiding", "Settings", "Errors against truth", str(out)):
        assert words in text


def test_evaluate_of_the_log_equals_that_of_the_replay(
    flown: tuple[Path, Any, str], run: Any
) -> None:
    out, result, _ = flown
    ran = run("evaluate", out, "--json")
    assert ran.status == 0, ran.err
    accuracy = ran.json
    (vehicle,) = result["vehicles"]
    assert accuracy["digest"] == vehicle["digest"]
    assert accuracy["digest_published"] == vehicle["digest_published"]
    assert accuracy["samples"] == vehicle["accuracy"]["samples"]
    assert accuracy["position_rmse_m"] == vehicle["accuracy"]["position_rmse_m"]
    assert set(accuracy) == {
        "solution", "reference", "duration_s", "samples", "position_rmse_m", "velocity_rmse_mps",
        "attitude_rmse_deg", "position_nees_mean", "outages", "digest", "digest_published",
    }  # fmt: skip


def test_window_cuts_the_evaluation(flown: tuple[Path, Any, str], run: Any) -> None:
    out, result, _ = flown
    cut = run("evaluate", out, "--window", "40+30", "--json").json
    assert 29 < cut["duration_s"] <= 30
    assert cut["samples"] < result["vehicles"][0]["accuracy"]["samples"]


def test_log_replays_to_the_same_digest(flown: tuple[Path, Any, str], run: Any) -> None:
    out, result, _ = flown
    again = run("replay", out, "--json")
    assert again.status == 0, again.err
    assert again.json["vehicles"][0]["digest"] == result["vehicles"][0]["digest"]
    assert (
        again.json["vehicles"][0]["digest_published"] == result["vehicles"][0]["digest_published"]
    )
    assert "came with" in again.json["vehicles"][0]["config"]


def test_one_estimator_of_a_log_is_evaluated_by_name(
    flown: tuple[Path, Any, str], run: Any
) -> None:
    """The same inputs with the same windows withheld, by that estimator."""
    out, result, _ = flown
    ran = run("evaluate", out, "--estimator", "error-state+none", "--json")
    assert ran.status == 0, ran.err
    (vehicle,) = result["vehicles"]
    assert ran.json["digest"] != vehicle["digest"]
    assert [o["start_s"] for o in ran.json["outages"]] == [
        o["start_s"] for o in vehicle["accuracy"]["outages"]
    ]
    ran = run("evaluate", out, "--estimator", "kalman", "--json")
    assert ran.status == 1
    assert "--estimator: unknown 'kalman'" in ran.err


def test_export_writes_the_published_columns(
    flown: tuple[Path, Any, str], run: Any, tmp_path: Path
) -> None:
    out, _, _ = flown
    csv = tmp_path / "flight.csv"
    ran = run("export", out, "--format", "csv", "-o", csv, "--json")
    assert ran.status == 0, ran.err
    lines = csv.read_text(encoding="utf-8").splitlines()
    assert lines[0].replace(" ", "").startswith("t_ns,lat_deg,lon_deg,alt_hae_m,vel_n_mps")
    assert len(lines) - 1 == ran.json["epochs"]


def test_simulate_replays_with_its_own_configuration(run: Any, tmp_path: Path) -> None:
    scenario = tmp_path / "short.toml"
    scenario.write_text(
        'name = "short"\n[trajectory]\nkind = "hover"\nduration_s = 30.0\n', encoding="utf-8"
    )
    made = run("simulate", scenario, "-o", tmp_path / "made", "--seed", "3", "--json")
    assert made.status == 0, made.err
    assert Path(made.json["tlog"]).is_file()
    ran = run("replay", tmp_path / "made", "--json")
    assert ran.status == 0, ran.err
    assert "came with" in ran.json["vehicles"][0]["config"]


def test_speed_paces_and_changes_no_bit(run: Any, tmp_path: Path) -> None:
    scenario = tmp_path / "short.toml"
    scenario.write_text(
        'name = "short"\n[trajectory]\nkind = "static"\nduration_s = 8.0\nrest_s = 8.0\n',
        encoding="utf-8",
    )
    assert run("simulate", scenario, "-o", tmp_path / "made", "--json").status == 0
    fast = run("replay", tmp_path / "made", "--json").json
    begin = time.monotonic()
    paced = run("replay", tmp_path / "made", "--speed", "8", "--json").json
    # Eight seconds of samples at eight times real time; less only if pacing does nothing.
    assert time.monotonic() - begin > 0.9
    assert paced["vehicles"][0]["digest"] == fast["vehicles"][0]["digest"]


def test_internal_modules_stay_out_of_the_surface() -> None:
    names = {c.callback.__name__ for c in surface.app.registered_commands if c.callback}
    assert names == set(COMMANDS)
