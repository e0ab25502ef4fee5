"""Inertial rows: one sample a call gives what its block does, to the bit."""

from __future__ import annotations

import msgspec
import numpy as np

from companion.config import Config
from companion.intake.counters import Counters
from companion.intake.inertial import InertialIntake
from companion.types import NS, ImuSamples


def _samples(count: int) -> ImuSamples:
    """Rates and forces, some at the end of a range, some no numbers, some integrals."""
    rng = np.random.default_rng(5)
    gyro, accel = rng.normal(0.0, 0.5, (count, 3)), rng.normal(0.0, 9.0, (count, 3))
    gyro[3, 1], gyro[7], accel[11, 2] = np.nan, np.inf, np.inf
    gyro[20, 0], accel[23, 2], gyro[24, 1], accel[24, 0] = 3.0, -50.0, -3.0, 50.0
    interval = np.where(np.arange(count) % 3, np.nan, 0.005)
    t = np.arange(1, count + 1) * (NS // 200)
    return ImuSamples("imu", t, t, np.arange(count), gyro, accel, interval)


def _config(axes: tuple[tuple[float, float, float], ...]) -> Config:
    config = Config()
    imu = msgspec.structs.replace(
        config.imu, axes=axes, gyro_range_dps=125.0, accel_range_mps2=40.0, latency_ms=3.0
    )
    return msgspec.structs.replace(config, imu=imu)


def test_a_sample_alone_gives_the_row_it_has_in_a_block() -> None:
    samples = _samples(60)
    half = np.sqrt(0.5)
    for axes in (
        ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        ((half, -half, 0.0), (half, half, 0.0), (0.0, 0.0, 1.0)),
    ):
        counted, alone = Counters(), Counters()
        block = InertialIntake(_config(axes), counted)
        one = InertialIntake(_config(axes), alone)
        t, rows = block.rows(samples)
        block.watch(t, rows)
        t, rows = block.finite(t, rows)
        times, single = [], []
        for m in range(len(samples)):
            t_one, row = one.rows(samples.take(slice(m, m + 1)))
            one.watch(t_one, row)
            t_one, row = one.finite(t_one, row)
            times.append(t_one)
            single.append(row)
        np.testing.assert_array_equal(np.concatenate(times), t)
        assert np.concatenate(single).tobytes() == rows.tobytes()
        assert alone == counted
        assert counted.imu_not_finite == 3
        assert counted.imu_saturated == 5  # the infinite ones too
        assert one.events(final=True) == block.events(final=True)
