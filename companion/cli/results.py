"""What is done with a solution once it is there: evaluate, export, report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from rich.console import Console
from rich.markup import escape

from companion import present
from companion.cli.commands import SolutionKind, out_path, plain
from companion.cli.solved import solve
from companion.types import CompanionError
from replay import maps
from replay.assessment import outages_of
from replay.evaluation import as_solution
from replay.export import export_csv
from replay.window import Window

FileFormat = Literal["csv", "kml", "gpx", "geojson", "ros2"]
ExportedSolution = Literal["forward", "smoothed", "autopilot"]
_MAP_RATE_HZ = 5.0
"""A map cannot show more, and a viewer has to hold it all."""


def evaluate_run(
    console: Console,
    run: Path,
    truth: Path | None,
    window: Window | None,
    config_path: Path | None,
    vehicle_name: str | None,
    solution: SolutionKind = "forward",
    estimator: str | None = None,
) -> dict[str, Any]:
    """Errors of one vehicle's solution; a log without a solution is replayed first."""
    solved = solve(console, run, config_path, vehicle_name, solution, estimator)
    from replay.assessment import assess
    from replay.sensor_folder import read_reference

    vehicle = solved.vehicle
    if truth is not None:
        vehicle = replace(vehicle, truth=read_reference(truth), autopilot=None)
    result = assess(
        vehicle,
        solved.config,
        solved.solution,
        solved.reports,
        withheld=solved.withheld,
        window=window,
        digest=solved.digest,
        digest_published=solved.digest_published,
        solution_kind=solution,
    )
    accuracy = result.to_json()
    present.show_accuracy(console, accuracy)
    return accuracy


def export_run(
    console: Console,
    run: Path,
    output: Path,
    file_format: FileFormat,
    config_path: Path | None,
    vehicle_name: str | None,
    kind: ExportedSolution = "forward",
    rate_hz: float | None = None,
    estimator: str | None = None,
) -> dict[str, Any]:
    """Write one vehicle's solution; a log without one is replayed first."""
    wanted: SolutionKind = "smoothed" if kind == "smoothed" else "forward"
    solved = solve(console, run, config_path, vehicle_name, wanted, estimator)
    solution, vehicle = solved.solution, solved.vehicle
    if kind == "autopilot":
        if vehicle.autopilot is None or not len(vehicle.autopilot):
            raise CompanionError(f"{run}: the log holds no estimate by the autopilot")
        solution = as_solution(vehicle.autopilot)
    if file_format == "csv":
        count = export_csv(maps.thin(solution, rate_hz), output)
    elif file_format == "ros2":
        from replay.ros2 import write_bag

        count = write_bag(
            maps.thin(solution, rate_hz),
            output,
            name=f"{run.name} {vehicle.name} {kind}",
            height_datum=vehicle.height_datum,
        )
    else:
        count = maps.write_map(
            solution,
            output,
            file_format,
            name=f"{run.name} {vehicle.name} {kind}",
            height_datum=vehicle.height_datum,
            outages=outages_of(vehicle, solved.config, solved.withheld),
            rate_hz=rate_hz or _MAP_RATE_HZ,
        )
    console.print(f"Wrote {count} epochs to {escape(str(output))}")
    return {
        "out": str(output),
        "format": file_format,
        "solution": kind,
        "vehicle": vehicle.name,
        "epochs": count,
        "height_datum": vehicle.height_datum,
    }


def report_run(
    console: Console,
    run: Path,
    output: Path | None,
    config_path: Path | None,
    vehicle_name: str | None,
    estimator: str | None = None,
) -> dict[str, Any]:
    """Write one vehicle's page; a log without a solution is replayed first."""
    solved = solve(console, run, config_path, vehicle_name, "forward", estimator)
    from replay.report.page import write_report
    from replay.report.run_view import RunView

    view = RunView(
        name=run.name,
        vehicle=solved.vehicle,
        config=solved.config,
        solution=solved.solution,
        reports=solved.reports,
        events=solved.events,
        smoothed=solved.smoothed,
        withheld=solved.withheld,
        notes=solved.notes,
        digest=solved.digest,
        adaptation=solved.adaptation,
        satellites=solved.satellites,
    )
    path = output if output is not None else out_path(None, [run], "report").with_suffix(".html")
    judgement = write_report(view, path)
    style = {"good": "green", "degraded": "yellow", "bad": "red"}[judgement.level]
    console.print(escape(judgement.headline), style=style, highlight=False)
    for evidence in judgement.evidence:
        console.print(
            f"  {evidence.level:9} {escape(evidence.text)}"
            + (f". {escape(evidence.action)}" if evidence.action else ""),
            highlight=False,
        )
    console.print(f"Report    {escape(str(path))}")
    return plain(
        {
            "out": str(path),
            "bytes": path.stat().st_size,
            "vehicle": solved.vehicle.name,
            "verdict": judgement.level,
            "headline": judgement.headline,
            "evidence": judgement.evidence,
        }
    )
