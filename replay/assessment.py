"""One vehicle's solution held against the best reference that its recording has."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from companion.config import Config
from companion.types import I64, NS, AidingReports, ReferenceSamples, Solution, VehicleRecording
from replay.evaluation import (
    Evaluation,
    EvaluationError,
    Outage,
    evaluate,
    find_outages,
    silences,
)
from replay.preparation import start_ns
from replay.sky import FULL
from replay.window import Window

Reference = tuple[Literal["truth", "autopilot"], ReferenceSamples]


def references(vehicle: VehicleRecording) -> list[Reference]:
    """What a solution can be held against, the better one first."""
    found: list[Reference] = []
    if vehicle.truth is not None and len(vehicle.truth):
        found.append(("truth", vehicle.truth))
    if vehicle.autopilot is not None and len(vehicle.autopilot):
        found.append(("autopilot", vehicle.autopilot))
    return found


def outages_of(
    vehicle: VehicleRecording, config: Config, withheld: Sequence[Window]
) -> tuple[Outage, ...]:
    """Times without GNSS, in order: the withheld windows, and what else the receiver lost."""
    origin = start_ns(vehicle)
    known = [
        Outage(origin + round(w.start_s * NS), origin + round((w.start_s + w.seconds) * NS))
        for w in withheld
    ]
    # Fixes are stamped late; the outage ends when the first fix after it was valid.
    ranges = config.raw_gnss.coupling != "off"
    late = round((config.raw_gnss if ranges else config.gnss).latency_ms * 1e6)
    if ranges:
        gaps = silences(times_of_ranges(vehicle, config))
    else:
        gaps = _fixes_lost(vehicle, config)
    for gap in gaps:
        begin, end = gap.start_ns - late, gap.end_ns - late
        if not any(begin < o.end_ns and end > o.start_ns for o in known):
            known.append(Outage(begin, end))
    return tuple(sorted(known, key=lambda o: o.start_ns))


def _fixes_lost(vehicle: VehicleRecording, config: Config) -> tuple[Outage, ...]:
    named = [g for g in vehicle.gnss if config.gnss.source in ("auto", g.source)]
    return find_outages(named[0], min_fix_type=config.gnss.min_fix_type) if named else ()


def times_of_ranges(vehicle: VehicleRecording, config: Config) -> I64:
    """(N,) stamps of epochs with a range; on fixes made of them, with as many as a place takes."""
    least = 1 if config.raw_gnss.coupling == "tight" else FULL
    named = [r for r in vehicle.raw if config.raw_gnss.source in ("auto", r.source)]
    if not named:
        return np.zeros(0, np.int64)
    seen = ((named[0].sat > 0) & np.isfinite(named[0].pseudorange)).sum(axis=1)
    times: I64 = named[0].t_ns[seen >= least]
    return times


def assess(
    vehicle: VehicleRecording,
    config: Config,
    solution: Solution,
    reports: AidingReports,
    *,
    withheld: Sequence[Window] = (),
    window: Window | None = None,
    digest: str | None = None,
    digest_published: str | None = None,
    solution_kind: Literal["forward", "smoothed"] = "forward",
) -> Evaluation:
    """Errors against truth, else against the autopilot's estimate.

    Times count from :func:`~replay.preparation.start_ns`. Raises
    :class:`~replay.evaluation.EvaluationError` where nothing can be compared, with the reason
    that the better reference gave.
    """
    reasons = [EvaluationError("no truth and no autopilot estimate in the log to compare with")]
    for kind, reference in references(vehicle):
        try:
            return evaluate(
                solution,
                reference,
                reference_kind=kind,
                outages=outages_of(vehicle, config, withheld),
                window_s=(window.start_s, window.start_s + window.seconds) if window else None,
                origin_ns=start_ns(vehicle),
                reports=reports,
                digest=digest,
                digest_published=digest_published,
                solution_kind=solution_kind,
            )
        except EvaluationError as error:
            reasons.append(error)
    raise reasons[min(1, len(reasons) - 1)]
