"""One vehicle with its solution: what a run log holds, else made by a replay just now."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from companion import present
from companion.cli.commands import LOADING, SolutionKind, read, read_recording
from companion.config import Config
from companion.types import (
    NO_SATELLITES,
    AdaptationTrace,
    AidingReports,
    Event,
    Satellites,
    Solution,
    VehicleRecording,
)
from replay.window import Window, read_windows


@dataclass(frozen=True, slots=True)
class Solved:
    """A vehicle with its solution, from a run log or from replaying just now."""

    vehicle: VehicleRecording
    config: Config
    solution: Solution
    reports: AidingReports
    digest: str | None
    digest_published: str | None
    withheld: tuple[Window, ...] = ()
    smoothed: Solution | None = None
    events: tuple[Event, ...] = ()
    notes: tuple[str, ...] = ()
    adaptation: AdaptationTrace = field(default_factory=AdaptationTrace.empty)
    satellites: Satellites = NO_SATELLITES


def solve(
    console: Console,
    run: Path,
    config_path: Path | None,
    vehicle_name: str | None,
    solution: SolutionKind,
    estimator: str | None = None,
) -> Solved:
    """The solution that a run log holds, else that of a replay; no log is written.

    With ``estimator``, a member of a bank or other words of ``companion compare``, always a replay
    by that one alone: a run log has innovations and adaptation of the published one only.
    """
    solved = _solve_forward(console, run, config_path, vehicle_name, estimator)
    if solution == "forward":
        return solved
    if solved.smoothed is not None:
        return replace(solved, solution=solved.smoothed)
    from companion.cli.smooth import smooth_vehicle, smoothed_config

    config = smoothed_config(solved.config)
    made = smooth_vehicle(console, solved.vehicle, config, "bryson-frazier", None, True)
    return replace(solved, solution=made.solution)


def _solve_forward(
    console: Console,
    run: Path,
    config_path: Path | None,
    vehicle_name: str | None,
    estimator: str | None,
) -> Solved:
    if run.suffix == ".mcap" and config_path is None and estimator is None:
        from replay.configuration import choose_config
        from replay.run_log import read_solution

        stored = read_solution(run, vehicle_name)
        if len(stored.solution):
            recording = read_recording(console, [run], vehicle_name)
            vehicle = next(v for v in recording.vehicles if v.name == stored.vehicle)
            return Solved(
                vehicle,
                choose_config(recording).config,
                stored.solution,
                stored.reports,
                stored.digest,
                stored.digest_published,
                read_windows(stored.metadata.get("outages", "")),
                stored.smoothed,
                stored.events,
                recording.notes,
                stored.adaptation,
                stored.satellites,
            )
    from replay.preparation import navigable

    recording, chosen = read(console, [run], config_path, vehicle_name, estimator)
    fit, _ = navigable(recording, chosen.config, vehicle_name)
    with present.notice_if_slow(console, LOADING):
        from replay import session
    if len(fit) > 1:
        console.print(f"Vehicle {escape(fit[0].name)}, the first of several; --vehicle NAME")
    with present.progress(console, f"Vehicle {fit[0].name}") as update:
        # What the run itself was refused stays withheld.
        withheld = read_windows(recording.metadata.get("outages", ""))
        result = session.run_session(fit[0], chosen, outages=withheld, progress=update)
    return Solved(
        result.vehicle,
        chosen.config,
        result.solution,
        result.reports,
        result.digest,
        result.digest_published,
        withheld,
        events=result.events,
        notes=recording.notes,
        adaptation=result.adaptation,
        satellites=result.satellites,
    )
