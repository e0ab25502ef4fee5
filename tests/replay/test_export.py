"""Exported solutions read back to what they were, within the decimals that are written."""

from __future__ import annotations

import csv
import time
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from companion.navigation.rotation import quat_from_rpy, rpy_from_quat
from companion.types import NS, CompanionError, Mode, Solution
from replay.export import SOLUTION_COLUMNS, euler_sd, export_csv


def make_solution(n: int) -> Solution:
    rng = np.random.default_rng(11)
    rpy = rng.uniform([-3, -1.2, -3.1], [3, 1.2, 3.1], (n, 3))
    root = rng.normal(size=(n, 5, 3, 3))
    cov = root @ root.swapaxes(2, 3)
    return Solution(
        1_700_000_000 * NS + np.arange(n) * (NS // 50) + 1,
        rng.uniform(-1.5, 1.5, n),
        rng.uniform(-3.1, 3.1, n),
        rng.uniform(-100, 9000, n),
        rng.normal(size=(n, 3)) * 30,
        np.array([quat_from_rpy(*angles) for angles in rpy]),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        cov[:, :, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]],
        np.full(n, Mode.NAVIGATING, dtype=np.int64),
        np.zeros(n, np.int64),
    )


def test_round_trip(tmp_path: Path) -> None:
    path, solution = tmp_path / "out.csv", make_solution(500)
    assert export_csv(solution, path) == 500
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == SOLUTION_COLUMNS
    assert [int(r["t_ns"]) for r in rows] == solution.t_ns.tolist()  # to the nanosecond

    def column(name: str) -> np.ndarray:
        return np.array([float(r[name]) for r in rows])

    # half of the last decimal, and the rounding of the conversion itself
    assert np.abs(column("lat_deg") - np.degrees(solution.lat)).max() < 0.6e-10
    assert np.abs(column("lon_deg") - np.degrees(solution.lon)).max() < 0.6e-10
    assert np.abs(column("alt_hae_m") - solution.height).max() < 0.6e-4
    rpy = np.degrees(rpy_from_quat(solution.q_nb))
    for i, name in enumerate(("roll_deg", "pitch_deg", "yaw_deg")):
        assert np.abs(column(name) - rpy[:, i]).max() < 0.6e-5
    for i, axis in enumerate("ned"):
        assert np.abs(column(f"vel_{axis}_mps") - solution.vel_n[:, i]).max() < 0.6e-4
        assert np.abs(column(f"sd_{axis}_m") - solution.sd[:, 0, i]).max() < 0.6e-4
        assert np.abs(column(f"sd_v{axis}_mps") - solution.sd[:, 1, i]).max() < 0.6e-4


def test_epochs_before_alignment_and_missing_values(tmp_path: Path) -> None:
    path, solution = tmp_path / "out.csv", make_solution(4)
    mode, vel_n = solution.mode.copy(), solution.vel_n.copy()
    mode[0] = Mode.ALIGNING
    vel_n[2] = np.nan
    assert export_csv(replace(solution, mode=mode, vel_n=vel_n), path) == 3
    lines = path.read_text().splitlines()
    assert len(lines) == 4
    assert ",,," in lines[2]
    assert "nan" not in lines[2]


def test_attitude_deviation_is_that_of_the_angles() -> None:
    rng = np.random.default_rng(12)
    rpy = np.array([0.4, 0.9, 2.0])
    root = rng.normal(size=(3, 3)) * 1e-3
    P = root @ root.T
    # The angles' sensitivity by central differences through the rotation itself.
    q = quat_from_rpy(*rpy)
    J = np.zeros((3, 3))
    step = 1e-6
    for i in range(3):
        ends = []
        for sign in (1.0, -1.0):
            turn = np.zeros(4)
            turn[0], turn[1 + i] = np.cos(step / 2), sign * np.sin(step / 2)
            ends.append(rpy_from_quat(_multiply(turn, q)))
        J[:, i] = (ends[0] - ends[1]) / (2 * step)
    expected = np.sqrt(np.diag(J @ P @ J.T))
    upper = P[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    assert np.allclose(euler_sd(rpy[None], upper[None])[0], expected, rtol=1e-6)


def _multiply(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    w = p[0] * q[0] - p[1:] @ q[1:]
    return np.concatenate([[w], p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])])


def test_nine_minutes_take_less_than_a_second(tmp_path: Path) -> None:
    base = make_solution(500)
    index = np.arange(27_000) % 500
    solution = Solution(*(getattr(base, f.name)[index] for f in fields(base)))
    begin = time.process_time()
    export_csv(solution, tmp_path / "out.csv")
    assert time.process_time() - begin < 2.0  # 0.3 s on a quiet machine


def test_a_file_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(CompanionError, match="cannot be written") as caught:
        export_csv(make_solution(3), tmp_path / "absent" / "out.csv")
    assert "\n" not in str(caught.value)
