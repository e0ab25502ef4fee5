"""What ``companion smooth`` does."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Union

import msgspec
import numpy as np
from rich.console import Console
from rich.markup import escape

from companion import present
from companion.cli.commands import LOADING, SolutionKind, out_path, plain, read
from companion.config import Config, to_toml
from companion.config.settings import alone, smoothable
from companion.types import NS, AidingReports, CompanionError, Smoothed, Solution, VehicleRecording
from replay.window import Window, read_windows

if TYPE_CHECKING:
    from replay.smoothing import Method as OffLine

Method = Union["OffLine", Literal["on-line"]]


@dataclass(frozen=True, slots=True)
class Made:
    """A smoothed solution, and what it cost."""

    solution: Solution
    forward_cpu_s: float
    smoothing_cpu_s: float
    history_bytes: int
    stretches: int
    """Stretches between declared breaks, each smoothed by itself."""
    on_line: Smoothed | None = None


def smoothed_config(config: Config) -> Config:
    """``config`` with its bank, if it has one, dissolved into the estimator that is smoothed.

    Raises :class:`CompanionError` where a smoother can follow none of them.
    """
    if not config.bank.estimators:
        return config
    name = smoothable(config)
    if name is None:
        raise CompanionError(
            "key 'bank.estimators': a smoother needs an error-state one among them"
        )
    return alone(config, name)


def smooth_vehicle(
    console: Console,
    vehicle: VehicleRecording,
    config: Config,
    method: OffLine,
    rate_hz: float | None,
    covariance: bool,
) -> Made:
    """Run forward with a tape, and smooth."""
    with present.notice_if_slow(console, LOADING):
        from replay.smoothing import record_for, smoothed
    begin = time.process_time()
    with present.progress(console, f"Vehicle {vehicle.name}, forward") as update:
        run = record_for(
            method, vehicle, config, rate_hz=rate_hz, covariance=covariance, progress=update
        )
    middle = time.process_time()
    with present.notice_if_slow(console, "Smoothing …"):
        solution = smoothed(run, method)
    return Made(
        solution=solution,
        forward_cpu_s=middle - begin,
        smoothing_cpu_s=time.process_time() - middle,
        history_bytes=run.history_bytes,
        stretches=max(len(run.tapes), len(run.stretches)),
    )


def smooth_as_live(
    console: Console, vehicle: VehicleRecording, config: Config, rate_hz: float, window: int | None
) -> Made:
    """Smooth a fixed lag behind the filter, as a live run does."""
    with present.notice_if_slow(console, LOADING):
        from replay.on_line import on_line_config, smooth_on_line
    config = on_line_config(config, window or config.smoothing.window, rate_hz)
    with present.progress(console, f"Vehicle {vehicle.name}, on line") as update:
        run = smooth_on_line(vehicle, config, progress=update)
    solution = run.smoothed.solution
    stretches = len(np.unique(solution.resets))
    return Made(
        solution, run.forward_cpu_s, run.smoothing_cpu_s, 0, stretches, on_line=run.smoothed
    )


def smooth_run(
    console: Console,
    run: Path,
    method: Method,
    rate_hz: float,
    covariance: bool,
    out: Path | None,
    outages: Sequence[Window],
    config_path: Path | None,
    vehicle_name: str | None,
    window: int | None = None,
    estimator: str | None = None,
) -> dict[str, Any]:
    """Smooth every vehicle into a run log, the smoothed solution beside the forward one.

    Of a bank, the forward solution is the published one, and its first estimator that a smoother
    can follow is smoothed; ``estimator`` names another, which then runs alone.
    """
    from replay.preparation import navigable, withhold_gnss

    recording, chosen = read(console, [run], config_path, vehicle_name, estimator)
    # The forward run's part is the filter's; what is smoothed comes from below.
    config = msgspec.structs.replace(
        chosen.config, smoothing=msgspec.structs.replace(chosen.config.smoothing, enabled=False)
    )
    chosen = replace(chosen, config=config, toml=to_toml(config))
    config = smoothed_config(config)
    # What the run itself was refused stays withheld, and is judged as an outage.
    outages = outages or read_windows(recording.metadata.get("outages", ""))
    fit, _ = navigable(recording, chosen.config, vehicle_name)
    path = out_path(out, [run], ending="smoothed")
    with present.notice_if_slow(console, LOADING):
        from replay import session
    found = []
    with session.run_log(path, recording, chosen, outages) as writer:
        closing = []
        for vehicle in fit:
            with present.progress(console, f"Vehicle {vehicle.name}, as published") as update:
                forward = session.run_session(
                    vehicle, chosen, writer=writer, outages=outages, progress=update
                )
            flown = withhold_gnss(vehicle, outages)
            if method == "on-line":
                made = smooth_as_live(console, flown, config, rate_hz, window)
            else:
                made = smooth_vehicle(console, flown, config, method, rate_hz, covariance)
            writer.smoothed(made.on_line or made.solution, vehicle.name)
            accuracy = {
                "forward": _accuracy(flown, chosen.config, forward.solution, outages, "forward"),
                "smoothed": _accuracy(flown, chosen.config, made.solution, outages, "smoothed"),
            }
            closing.append((vehicle.name, forward.digest, forward.digest_published))
            found.append(_entry(vehicle.name, method, made, accuracy))
            _show(console, found[-1])
        writer.close(
            {
                "vehicles": {
                    name: {"digest": digest, "digest_published": published}
                    for name, digest, published in closing
                }
            }
        )
    console.print(f"Run log   {escape(str(path))}")
    return {"log": str(run), "out": str(path), "vehicles": found}


def _accuracy(
    vehicle: VehicleRecording,
    config: Config,
    solution: Solution,
    outages: Sequence[Window],
    kind: SolutionKind,
) -> dict[str, Any] | None:
    """Errors for JSON; None where there is nothing to compare with."""
    from replay.assessment import assess
    from replay.evaluation import EvaluationError

    reports = AidingReports.empty()  # innovations belong to the forward run
    try:
        found = assess(vehicle, config, solution, reports, withheld=outages, solution_kind=kind)
    except EvaluationError:
        return None
    return found.to_json()


def _entry(name: str, method: str, made: Made, accuracy: dict[str, Any]) -> dict[str, Any]:
    late = {}
    if made.on_line is not None and len(made.on_line):
        lag_s = made.on_line.lag_ns / NS
        late = {
            "lag_s": {"median": float(np.median(lag_s)), "max": float(lag_s.max())},
            "as_filtered": int(np.count_nonzero(~made.on_line.smoothed)),
        }
    return plain(
        {
            **late,
            "vehicle": name,
            "method": method,
            "epochs": len(made.solution),
            "stretches": made.stretches,
            "history_mb": made.history_bytes / 1e6,
            "forward_cpu_s": made.forward_cpu_s,
            "smoothing_cpu_s": made.smoothing_cpu_s,
            "accuracy": accuracy,
        }
    )


def _show(console: Console, entry: dict[str, Any]) -> None:
    """A few lines for people."""
    history = f"; history {entry['history_mb']:.1f} MB" if entry["history_mb"] else ""
    console.print(
        f"Smoothed  {entry['epochs']} epochs by {entry['method']} in "
        f"{entry['smoothing_cpu_s']:.2f} s of CPU, after {entry['forward_cpu_s']:.2f} s forward"
        f"{history}"
    )
    if "lag_s" in entry:
        lag = entry["lag_s"]
        console.print(
            f"          {lag['median']:.1f} s behind the filter, {lag['max']:.1f} s at most; "
            f"{entry['as_filtered']} epochs as the filter had them"
        )
    if entry["stretches"] > 1:
        console.print(f"          {entry['stretches']} stretches, a declared reset between them")
    for kind in ("forward", "smoothed"):
        accuracy = entry["accuracy"][kind]
        if accuracy is None:
            continue
        position, velocity = accuracy["position_rmse_m"], accuracy["velocity_rmse_mps"]
        worst = [o["max_horizontal_error_m"] for o in accuracy["outages"]]
        outages = ", worst in outages " + "/".join(f"{x:.1f}" for x in worst if x is not None)
        console.print(
            f"{kind.capitalize():9} horizontal {_number(position['horizontal'], 'm')}, "
            f"velocity {_number(velocity['3d'], 'm/s')}{outages + ' m' if worst else ''} "
            f"(RMSE against the {accuracy['reference']})"
        )


def _number(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.3f} {unit}"
