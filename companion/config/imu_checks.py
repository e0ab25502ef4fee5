"""Values that a configuration of several inertial units may have."""

from __future__ import annotations

from collections.abc import Sequence

from companion.config.estimator import FurtherImu, Imu, ImuFusion
from companion.config.ranges import not_empty, positive, rotation, within
from companion.types import ConfigError

MOST_FURTHER = 7


def check_units(first: Imu, units: Sequence[FurtherImu], fusion: ImuFusion) -> None:
    """Raise :class:`ConfigError` for a value that cannot be, naming its key."""
    for index, further in enumerate(units):
        key = f"further_imu[{index}]"
        not_empty(f"{key}.source", further.source, "name of an inertial stream")
        for value in further.lever_arm_b_m:
            within(f"{key}.lever_arm_b_m", value, -100.0, 100.0, "metres")
        rotation(f"{key}.axes", further.axes)
        if further.latency_ms is not None:
            within(f"{key}.latency_ms", further.latency_ms, 0.0, 500.0, "milliseconds")
        _ranges(key, further)
        for name, unit in (
            ("gyro_noise_dps_rthz", "deg/s/√Hz"),
            ("accel_noise_mps2_rthz", "m/s²/√Hz"),
        ):
            noise = getattr(further, name)
            if noise is not None:
                positive(f"{key}.{name}", noise, unit)
    sources = [unit.source for unit in units]
    if len(set(sources)) < len(sources):
        raise ConfigError(f"key 'further_imu': each source once, got {', '.join(sources)}")
    if first.source in sources:
        raise ConfigError(
            f"key 'further_imu': '{first.source}' is the first unit (imu.source) already"
        )
    if len(units) > MOST_FURTHER:
        raise ConfigError(f"key 'further_imu': at most {MOST_FURTHER}, got {len(units)}")
    within("imu_fusion.wait_ms", fusion.wait_ms, 0.0, 500.0, "milliseconds")
    positive("imu_fusion.proof_s", fusion.proof_s, "seconds")
    within("imu_fusion.mismatch_percent", fusion.mismatch_percent, 0.0, 50.0, "percent")


def _ranges(key: str, unit: FurtherImu) -> None:
    within(f"{key}.gyro_range_dps", unit.gyro_range_dps, 0.0, 1e5, "deg/s", " (0: not known)")
    within(f"{key}.accel_range_mps2", unit.accel_range_mps2, 0.0, 1e5, "m/s²", " (0: not known)")
