"""Values that a configuration of the direct filter may have."""

from __future__ import annotations

from companion.config.estimator import Direct
from companion.config.ranges import positive, within


def check_direct(direct: Direct) -> None:
    """Raise :class:`~companion.types.ConfigError` for a value that cannot be, naming its key."""
    for name, unit in (
        ("jerk_mps3_rthz", "m/s³/√Hz"),
        ("angular_acceleration_dps2_rthz", "deg/s²/√Hz"),
    ):
        for value in getattr(direct, name):
            positive(f"direct.{name}", value, unit)
    for name, unit in (
        ("max_gap_s", "seconds"),
        ("attitude_sd_deg", "degrees"),
        ("attitude_yaw_sd_deg", "degrees"),
        ("attitude_tau_s", "seconds"),
        ("transition_sigmas", "standard deviations"),
        ("transition_sd_mps2", "m/s²"),
        ("circular_sd_mps2", "m/s²"),
    ):
        positive(f"direct.{name}", getattr(direct, name), unit)
    for name, high, unit in (
        ("acceleration_tau_s", 1e6, "seconds"),
        ("rate_tau_s", 1e6, "seconds"),
        ("gyro_sample_sd_dps", 1e3, "deg/s"),
        ("accel_sample_sd_mps2", 1e3, "m/s²"),
        ("attitude_slow_sd_deg", 180.0, "degrees"),
        ("attitude_slow_yaw_sd_deg", 180.0, "degrees"),
    ):
        within(f"direct.{name}", getattr(direct, name), 0.0, high, unit, " (0: none)")
