"""The recording that filters are timed on: a simulated multirotor, 200 Hz IMU and 5 Hz GNSS."""

from __future__ import annotations

from typing import TypeVar

import msgspec
import numpy as np

from companion.config import Adaptation, Config
from companion.types import F64, NS, ImuSamples, Samples, VehicleRecording
from replay.simulator import Scenario, load_scenario, matching_config, simulate

S = TypeVar("S", bound=Samples)


def hour(duration_s: float, *, gnss_latency_ms: float = 0.0) -> tuple[Scenario, Config]:
    """The built-in hour's flight cut to ``duration_s``, and parameters that match it.

    Neither barometer nor magnetometer: a peer without them shall see the same measurements.
    Fixes arrive ``gnss_latency_ms`` after the moment that their stamp names.
    """
    scenario = load_scenario("hour")
    replace = msgspec.structs.replace
    scenario = replace(
        scenario,
        trajectory=replace(scenario.trajectory, duration_s=duration_s),
        gnss=(replace(scenario.gnss[0], latency_ms=gnss_latency_ms),),
        baro=None,
    )
    # What is timed is what runs unless it is told otherwise.
    config = replace(matching_config(scenario), adaptation=Adaptation())
    return scenario, config


def flight(duration_s: float, *, gnss_latency_ms: float = 0.0) -> tuple[VehicleRecording, Config]:
    """The flight of :func:`hour` as recorded."""
    scenario, config = hour(duration_s, gnss_latency_ms=gnss_latency_ms)
    return simulate(scenario, seed=0), config


def cut(vehicle: VehicleRecording, begin_s: float, end_s: float) -> VehicleRecording:
    """The samples valid from ``begin_s`` to ``end_s`` after the first one, as a recording."""
    origin = int(vehicle.imu[0].t_ns[0])
    first, last = origin + round(begin_s * NS), origin + round(end_s * NS)

    def inside(samples: S) -> S:
        return samples.take((samples.t_ns >= first) & (samples.t_ns < last))

    return VehicleRecording(
        name=vehicle.name,
        imu=tuple(inside(s) for s in vehicle.imu[:1]),
        gnss=tuple(inside(s) for s in vehicle.gnss[:1]),
        truth=None if vehicle.truth is None else inside(vehicle.truth),
        height_datum=vehicle.height_datum,
    )


def inertial_rows(imu: ImuSamples) -> F64:
    """(N, 6) rate [rad/s] and specific force [m/s²], contiguous."""
    return np.ascontiguousarray(np.hstack([imu.gyro_b, imu.accel_b]))
