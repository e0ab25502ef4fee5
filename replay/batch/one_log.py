"""The work on one log: read, replay, smooth, evaluate, report; what is left is a row a vehicle."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from companion.config import Config, to_toml
from companion.types import (
    AidingReports,
    Channel,
    CompanionError,
    Solution,
    VehicleRecording,
    Verdict,
)
from replay.assessment import assess
from replay.batch.outcome import Row
from replay.configuration import ChosenConfig, choose_config, said_of_data
from replay.evaluation import Evaluation, EvaluationError
from replay.preparation import navigable
from replay.reader import read_log
from replay.report.page import write_report
from replay.report.run_view import RunView
from replay.report.verdict import Judgement, horizontal_sd
from replay.session import SessionResult, run_session
from replay.smoothing import record_for, smoothed
from replay.streams import rate_hz as median_rate_hz
from replay.summary import Summary, summarise
from replay.window import read_windows

REPORTS = "reports"


class NotWritten(Exception):
    """The page could not be written: no fault of the log's."""


def work_on(
    log: str, name: str, config: str | None, out: str, key: str, rate_hz: float
) -> list[dict[str, Any]]:
    """Work on the log at ``log``; its rows as plain types, its pages in ``out``.

    ``name``: what the pages call it; ``key``: part of their file names; ``rate_hz``: smoothed
    epochs a second. Raises :class:`CompanionError` for a log that cannot be navigated, and
    :class:`NotWritten` where its page has no place.
    """
    config_path = None if config is None else Path(config)
    can, clock = said_of_data(config_path)
    recording = read_log([Path(log)], can=can, clock=clock)
    chosen = _without_on_line(choose_config(recording, config_path))
    fit, refused = navigable(recording, chosen.config)
    withheld = read_windows(recording.metadata.get("outages", ""))
    left_out = "; ".join(f"{one.name}: {one.reason}" for one in refused)
    rows = []
    for vehicle in fit:
        begin = time.process_time()
        run = run_session(vehicle, chosen, outages=withheld)
        later, why_not = _smoothed(run.vehicle, chosen.config, rate_hz)
        page = _page_name(name, key, vehicle.name if len(fit) > 1 else "")
        view = RunView(
            name=name,
            vehicle=run.vehicle,
            config=chosen.config,
            solution=run.solution,
            reports=run.reports,
            events=run.events,
            smoothed=later,
            withheld=withheld,
            notes=recording.notes,
            digest=run.digest,
            adaptation=run.adaptation,
            satellites=run.satellites,
        )
        try:
            judgement = write_report(view, Path(out) / REPORTS / page)
        except CompanionError as error:
            raise NotWritten(str(error)) from None
        row = _row(recording.format, chosen, view, run, judgement)
        row = msgspec.structs.replace(
            row,
            not_smoothed_because=why_not,
            left_out=left_out,
            report=f"{REPORTS}/{page}",
            cpu_s=time.process_time() - begin,
        )
        rows.append(msgspec.to_builtins(row))
    return rows


def _without_on_line(chosen: ChosenConfig) -> ChosenConfig:
    """The smoothing here is the off-line one, from all measurements."""
    smoothing = msgspec.structs.replace(chosen.config.smoothing, enabled=False)
    config = msgspec.structs.replace(chosen.config, smoothing=smoothing)
    return ChosenConfig(config, chosen.origin, to_toml(config))


def _smoothed(
    vehicle: VehicleRecording, config: Config, rate_hz: float
) -> tuple[Solution | None, str]:
    """The smoothed solution, or why there is none: not every estimator can be smoothed."""
    try:
        run = record_for("bryson-frazier", vehicle, config, rate_hz=rate_hz)
        solution = smoothed(run, "bryson-frazier")
    except CompanionError as error:
        return None, str(error)
    return (solution, "") if len(solution) else (None, "no epoch to smooth")


def _page_name(name: str, key: str, vehicle: str) -> str:
    """A file name that is nobody else's, of characters that no file system minds."""
    stem = re.sub(r"[^A-Za-z0-9_.-]+", "_", "-".join(filter(None, (Path(name).name, vehicle))))
    return f"{stem[:80]}-{key[:8]}.html"


def _row(
    form: str, chosen: ChosenConfig, view: RunView, run: SessionResult, judgement: Judgement
) -> Row:
    summary = summarise(view.vehicle, view.solution, view.reports, view.events)
    forward = _evaluated(view, view.solution, "forward")
    later = None if view.smoothed is None else _evaluated(view, view.smoothed, "smoothed")
    imu = view.vehicle.imu[0]
    aligned = view.aligned()
    sd = horizontal_sd(aligned)
    sd = sd[np.isfinite(sd)]
    outages = view.outages()
    worst = [
        o.max_horizontal_error_m
        for o in (forward.outages if forward else ())
        if o.max_horizontal_error_m is not None
    ]
    return Row(
        vehicle=view.vehicle.name,
        verdict=judgement.level,
        headline=judgement.headline,
        format=form,
        config=chosen.origin,
        estimator=chosen.config.engine.estimator.replace("auto", "error-state"),
        start_utc=summary.flight.start_utc,
        duration_s=summary.flight.duration_s,
        distance_m=summary.flight.distance_m,
        max_speed_mps=summary.flight.max_speed_mps,
        imu=imu.source,
        imu_rate_hz=median_rate_hz(imu.t_ns),
        reference=forward.reference if forward else None,
        horizontal_rmse_m=_known(forward and forward.position_rmse_m["horizontal"]),
        position_rmse_m=_known(forward and forward.position_rmse_m["3d"]),
        velocity_rmse_mps=_known(forward and forward.velocity_rmse_mps["3d"]),
        yaw_rmse_deg=_known(forward and forward.attitude_rmse_deg["yaw"]),
        position_nees=_known(forward and forward.position_nees_mean),
        smoothed_horizontal_rmse_m=_known(later and later.position_rmse_m["horizontal"]),
        smoothed_velocity_rmse_mps=_known(later and later.velocity_rmse_mps["3d"]),
        not_smoothed_because="",
        stated_sd_median_m=float(np.median(sd)) if len(sd) else None,
        stated_sd_max_m=float(sd.max()) if len(sd) else None,
        refused_share=_refused_share(view.reports),
        outages=len(outages),
        longest_outage_s=max(((o.end_ns - o.start_ns) / 1e9 for o in outages), default=0.0),
        worst_outage_m=max(worst, default=None),
        resets=summary.start.resets,
        warnings=_count(summary, "warning"),
        errors=_count(summary, "error"),
        left_out="",
        digest=run.digest,
        digest_published=run.digest_published,
        report="",
        cpu_s=0.0,
    )


def _evaluated(
    view: RunView, solution: Solution, kind: Literal["forward", "smoothed"]
) -> Evaluation | None:
    """Errors against the best reference; None where there is none."""
    try:
        return assess(
            view.vehicle,
            view.config,
            solution,
            AidingReports.empty(),
            withheld=view.withheld,
            solution_kind=kind,
        )
    except EvaluationError:
        return None


def _known(value: float | Evaluation | None) -> float | None:
    return float(value) if isinstance(value, int | float) and np.isfinite(value) else None


def _refused_share(reports: AidingReports) -> float | None:
    """Of the measurements that reached the gate or a source's judgement, those not taken."""
    verdict = reports.verdict[~np.isin(reports.channel, (Channel.SOURCE_H, Channel.SOURCE_V))]
    taken = int(np.count_nonzero(verdict == Verdict.ACCEPTED))
    refused = int(
        np.count_nonzero(np.isin(verdict, (Verdict.REJECTED_GATE, Verdict.REJECTED_SOURCE)))
    )
    return refused / (taken + refused) if taken + refused else None


def _count(summary: Summary, level: str) -> int:
    return sum(event["level"] == level for event in summary.events)
