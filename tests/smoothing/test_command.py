"""``companion smooth`` end to end on the flight that ships with the project."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from replay.run_log import read_solution


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, sample_flight: Path) -> tuple[Path, dict]:
    """The smoothed run log, and what the command printed as JSON."""
    out = tmp_path_factory.mktemp("smooth") / "flight.smoothed.mcap"
    command = ["smooth", sample_flight, "--outage", "60+20", "--out", out, "--json"]
    return out, _json(*command)


def _json(*words: object) -> dict:
    done = subprocess.run(
        [sys.executable, "-m", "companion", *map(str, words)],
        capture_output=True, text=True, timeout=200, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found: dict = json.loads(done.stdout)
    return found


def test_it_writes_both_solutions(run: tuple[Path, dict]) -> None:
    out, printed = run
    stored = read_solution(out)
    assert stored.smoothed is not None
    assert len(stored.smoothed) == printed["vehicles"][0]["epochs"]
    accuracy = printed["vehicles"][0]["accuracy"]
    assert accuracy["smoothed"]["solution"] == "smoothed"
    worst = [accuracy[k]["outages"][0]["max_horizontal_error_m"] for k in ("forward", "smoothed")]
    assert worst[1] < worst[0]


def test_evaluate_and_export_take_it(run: tuple[Path, dict], tmp_path: Path) -> None:
    out, printed = run
    judged = _json("evaluate", out, "--solution", "smoothed", "--json")
    assert (
        judged["position_rmse_m"]
        == printed["vehicles"][0]["accuracy"]["smoothed"]["position_rmse_m"]
    )
    made = _json("export", out, "--solution", "smoothed", "-o", tmp_path / "track.csv", "--json")
    assert made["epochs"] == printed["vehicles"][0]["epochs"]


def test_a_log_cut_off_in_flight_smooths_up_to_the_cut(
    run: tuple[Path, dict], tmp_path: Path
) -> None:
    """A run log without its end, as after a power loss: in the middle of a chunk."""
    whole, printed = run
    cut = tmp_path / "cut.mcap"
    data = whole.read_bytes()
    cut.write_bytes(data[: len(data) * 6 // 10])
    made = _json("smooth", cut, "--out", tmp_path / "cut.smoothed.mcap", "--json")
    (vehicle,) = made["vehicles"]
    assert 0 < vehicle["epochs"] < printed["vehicles"][0]["epochs"]
    before, after = (read_solution(p) for p in (whole, tmp_path / "cut.smoothed.mcap"))
    assert before.smoothed is not None
    assert after.smoothed is not None
    # Its first half has all the future that matters.
    half = after.smoothed.take(slice(0, len(after.smoothed) // 2))
    same = before.smoothed.take(np.flatnonzero(np.isin(before.smoothed.t_ns, half.t_ns)))
    assert np.array_equal(same.t_ns, half.t_ns)
    assert np.abs(same.lat - half.lat).max() * 6.4e6 < 0.5
