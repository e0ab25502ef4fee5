"""A recording smoothed by any of the off-line methods: what each keeps of the run forward."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from companion.config import Config
from companion.smoothing.fading import Fading
from companion.smoothing.offline import smooth
from companion.smoothing.two_filter import two_filter
from companion.smoothing.weighted import two_filter_weighted
from companion.types import Solution, VehicleRecording
from replay.recorded import RecordedRun, record

Method = Literal[
    "bryson-frazier", "rts", "two-filter", "two-filter-straight", "two-filter-weighted"
]


def record_for(
    method: Method,
    vehicle: VehicleRecording,
    config: Config,
    *,
    rate_hz: float | None = None,
    covariance: bool = True,
    progress: Callable[[float], None] | None = None,
) -> RecordedRun:
    """Run ``vehicle`` forward and keep what ``method`` needs; smoothed epochs come at ``rate_hz``.

    ``covariance`` off: states only, for ``bryson-frazier``; the others have them anyway.
    """
    return record(
        vehicle,
        config,
        rate_hz=rate_hz,
        covariance=covariance or method == "two-filter-weighted",
        tape=method not in ("two-filter", "two-filter-straight"),
        inputs=method.startswith("two-filter"),
        progress=progress,
    )


def smoothed(run: RecordedRun, method: Method) -> Solution:
    """The smoothed solution of a run that was recorded for ``method``.

    Raises :class:`companion.smoothing.offline.SmoothingError` where a covariance cannot be
    inverted by a method that inverts one.
    """
    if method == "two-filter" or method == "two-filter-straight":
        fading: Fading = "consistent" if method == "two-filter" else "straight"
        return two_filter(run.tapes, run.reports, run.stretches, run.config, fading)
    if method == "two-filter-weighted":
        return two_filter_weighted(run.tapes, run.stretches, run.config)
    return smooth(run.tapes, run.config, method)
