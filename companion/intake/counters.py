"""What the engine did with what came in."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(slots=True)
class Counters:
    """Samples and aids since the engine was made."""

    imu: int = 0
    imu_not_finite: int = 0
    imu_out_of_order: int = 0
    imu_saturated: int = 0
    further_imu: int = 0
    """Samples of units beside the first."""
    further_imu_refused: int = 0
    """Of them, stamped far ahead of the first unit's clock."""
    aids: int = 0
    late_fused: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    """By the name of the verdict."""
    rewinds: int = 0
