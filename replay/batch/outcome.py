"""What became of one log: small enough that a thousand of them are nothing."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

Ended = Literal["done", "refused", "failed"]
"""``refused``: it cannot be navigated, and would not be next time either; ``failed``: its process
died, took too long, or met an error of ours: it is tried again in the next run."""


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One vehicle of one log; None where a figure is not known."""

    vehicle: str
    verdict: Literal["good", "degraded", "bad"]
    headline: str
    format: str
    config: str
    """Where the configuration is from."""
    estimator: str
    start_utc: str | None
    duration_s: float
    distance_m: float
    max_speed_mps: float
    imu: str
    imu_rate_hz: float
    reference: Literal["truth", "autopilot"] | None
    horizontal_rmse_m: float | None
    position_rmse_m: float | None
    velocity_rmse_mps: float | None
    yaw_rmse_deg: float | None
    position_nees: float | None
    smoothed_horizontal_rmse_m: float | None
    smoothed_velocity_rmse_mps: float | None
    not_smoothed_because: str
    """Empty where it was."""
    stated_sd_median_m: float | None
    """Horizontal standard deviation, the larger axis."""
    stated_sd_max_m: float | None
    refused_share: float | None
    """Of the measurements that the filter saw, those that it did not take."""
    outages: int
    longest_outage_s: float
    worst_outage_m: float | None
    """Largest horizontal error inside an outage."""
    resets: int
    warnings: int
    errors: int
    """Events of these levels."""
    left_out: str
    """Other vehicles of the log that cannot be navigated, and why."""
    digest: str
    digest_published: str
    report: str
    """The page, relative to the batch's directory."""
    cpu_s: float


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """How the work on one log ended; several rows where it holds several vehicles."""

    log: str
    """As it was listed."""
    path: str
    ended: Ended
    rows: tuple[Row, ...] = ()
    reason: str = ""
    """One line: why it was refused, or what it failed of."""
    key: str = ""
    """What decided it, as a digest; see :mod:`replay.batch.store`."""
    wall_s: float = 0.0
    peak_mb: float = 0.0
    """Of the process that worked on it, up to then."""
    reused: bool = False
    """It was done already."""


def as_outcome(table: dict[str, Any]) -> Outcome:
    """From plain types. Raises :class:`msgspec.ValidationError` where they are not an outcome."""
    return msgspec.convert(table, Outcome)
