"""Every log of the data directory through reader and engine: one row each.

``python -m tests.benchmarks.all_logs [DIR]``; a few minutes. A log ends as replayed or as a refusal
in one line; a traceback or a hang would show as one.
"""

from __future__ import annotations

import math
import multiprocessing
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.types import CompanionError, VehicleRecording
from replay.assessment import assess
from replay.configuration import choose_config
from replay.evaluation import EvaluationError
from replay.preparation import navigable
from replay.reader import READABLE, read_log
from replay.session import SessionResult, run_session
from replay.streams import rate_hz
from replay.summary import summarise
from tests.benchmarks.common import NS, need_data, table

LIMIT_S = 180.0
"""For one log: longer counts as a hang. The largest takes about a tenth of it on a slow core."""
_NOT_LOGS = {".md", ".json"}


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one log."""

    path: str
    ended: str
    """``replayed``, ``refused``, ``crashed`` or ``hung``."""
    shape: tuple[str, str, str, str] = ("", "", "", "")
    """Format, duration, IMU source and rate, fixes."""
    text: str = ""


def candidates(directory: Path) -> Iterator[Path]:
    """Sensor folders and files below ``directory``, texts about them left out, in order."""
    for path in sorted(directory.iterdir()):
        if path.is_dir():
            if (path / "imu.csv").exists():
                yield path
            else:
                yield from candidates(path)
        elif path.suffix not in _NOT_LOGS:
            yield path


def _shape(form: str, vehicle: VehicleRecording) -> tuple[str, str, str, str]:
    imu, gnss = vehicle.imu[:1], vehicle.gnss[:1]
    times = [s.t_ns for s in (*imu, *gnss) if len(s)]
    span = (max(t[-1] for t in times) - min(t[0] for t in times)) / NS if times else 0.0
    inertial = f"{imu[0].source} {rate_hz(imu[0].t_ns):.1f} Hz" if imu else "none"
    fixes = int((gnss[0].fix_type >= 3).sum()) if gnss else 0
    return form, f"{span:.0f}", inertial, str(fixes)


def _replayed(result: SessionResult) -> str:
    """Start, resets, refusals and errors in one line."""
    summary = summarise(result.vehicle, result.solution, result.reports, result.events)
    start, gates = summary.start, summary.gates.values()
    accepted = sum(g.accepted for g in gates)
    gated = sum(g.refused.get("rejected_gate", 0) for g in gates)
    heading = (
        "never levelled"
        if start.levelled_after_s is None
        else "heading never found"
        if start.heading_after_s is None
        else f"heading after {start.heading_after_s:.0f} s"
    )
    share = gated / max(accepted + gated, 1)
    said = f"{heading}; {start.resets} resets; {share:.1%} gated"
    try:
        found = assess(result.vehicle, result.chosen.config, result.solution, result.reports)
    except EvaluationError as error:
        return f"{said}; {error}"
    errors = {
        "m": found.position_rmse_m["horizontal"],
        "m/s": found.velocity_rmse_mps["3d"],
        "° yaw": found.attitude_rmse_deg["yaw"],
    }
    known = ", ".join(f"{x:.2f} {unit}" for unit, x in errors.items() if math.isfinite(x))
    return f"{said}; RMSE to {found.reference} {known}"


def examine(path: Path, name: str) -> Outcome:
    """Read, choose, refuse or replay, as ``companion replay`` does, but for the run log."""
    shape = ("", "", "", "")
    try:
        recording = read_log([path])
        if recording.vehicles:
            shape = _shape(recording.format, recording.vehicles[0])
        chosen = choose_config(recording)
        fit, _ = navigable(recording, chosen.config)
        result = run_session(fit[0], chosen)
        return Outcome(name, "replayed", shape, _replayed(result))
    except CompanionError as error:
        return Outcome(name, "refused", shape, str(error).removeprefix(f"{path}: "))
    except Exception as error:
        return Outcome(name, "crashed", shape, f"{type(error).__name__}: {error}")


def examine_all(directory: Path, limit_s: float = LIMIT_S) -> list[Outcome]:
    """All candidates one after the other, in a process that can be ended when one hangs."""
    context = multiprocessing.get_context("spawn")
    outcomes: list[Outcome] = []
    pool: Any = context.Pool(1)
    try:
        for path in candidates(directory):
            name = str(path.relative_to(directory))
            try:
                outcomes.append(pool.apply_async(examine, (path, name)).get(limit_s))
            except multiprocessing.TimeoutError:
                outcomes.append(Outcome(name, "hung", text=f"not done after {limit_s:g} s"))
                pool.terminate()
                pool = context.Pool(1)
    finally:
        pool.terminate()
    return outcomes


def main(directory: Path) -> None:
    """Print the table and the count of each end."""
    outcomes = examine_all(directory)
    # The outcome's text is no column: it is as long as it is, but for the list of what is readable.
    lines = table(
        ("log", "format", "s", "IMU", "fixes"), [(o.path, *o.shape) for o in outcomes]
    ).splitlines()
    width = max(map(len, lines))
    for line, said in zip(
        lines,
        [
            "outcome",
            *(
                f"{o.ended}: {o.text.partition(READABLE)[0].removesuffix('; readable is ')}"
                for o in outcomes
            ),
        ],
        strict=True,
    ):
        print(f"{line:{width}}  {said}")
    ends = ("replayed", "refused", "crashed", "hung")
    counts = ", ".join(f"{sum(o.ended == end for o in outcomes)} {end}" for end in ends)
    print(f"{len(outcomes)} logs: {counts}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else need_data())
