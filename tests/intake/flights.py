"""Simulated flights with several inertial units, some of which go wrong."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import msgspec

from companion.config import Config, FurtherImu
from replay.simulator.aids import BaroSpec
from replay.simulator.disturbances import Failure
from replay.simulator.scenarios import Scenario, TrajectorySpec, graded
from replay.simulator.simulation import Simulation, run
from replay.simulator.suite import suite_config

ARMS = ((0.0, 0.0, 0.0), (0.12, 0.05, -0.03), (-0.1, 0.08, 0.02))
"""Where the units sit, body FRD [m]."""
FAULTS: dict[str, dict[str, Any]] = {
    "drifting": {"gyro_dps_s": (0.03, -0.02, 0.025), "accel_mps2_s": (0.03, 0.02, -0.03)},
    "frozen": {},
    "saturated": {},
    "silent": {},
    "noisy": {"factor": 10.0},
    "scaled": {"factor": 1.2},
}
"""Six ways for a unit to go wrong."""


def failure(kind: str, start_s: float, length_s: float = math.inf) -> Failure:
    """A unit that goes wrong at ``start_s`` in one of the six ways."""
    return Failure(kind=kind, start_s=start_s, length_s=length_s, **FAULTS[kind])  # type: ignore[arg-type]


def scenario(
    failures: dict[int, Failure], units: int = 3, duration_s: float = 90.0, grade: str = ""
) -> Scenario:
    """A multirotor's mission with ``units`` consumer IMUs; ``failures`` by place of the unit."""
    more: dict[str, Any] = {} if grade else {"vibration_mps2": 0.5}
    return Scenario(
        name="several-imus",
        trajectory=TrajectorySpec(kind="multirotor-mission", duration_s=duration_s),
        imu=tuple(
            graded(
                grade or "mems-consumer",
                source=f"imu{i + 1}",
                rate_hz=100.0,
                lever_arm_b_m=ARMS[i],
                failures=(failures[i],) if i in failures else (),
                **more,
            )
            for i in range(units)
        ),
        baro=BaroSpec(),
        truth_rate_hz=10.0,
    )


def config(of: Scenario) -> Config:
    """What a careful user writes: full scales and lever arms known, faults not."""
    replace = msgspec.structs.replace
    base = suite_config(of)
    full = {"gyro_range_dps": 2000.0, "accel_range_mps2": 16.0 * 9.80665}
    return replace(
        base,
        imu=replace(base.imu, source="imu1", **full),
        further_imu=tuple(
            FurtherImu(source=u.source, lever_arm_b_m=u.lever_arm_b_m, **full) for u in of.imu[1:]
        ),
    )


@cache
def flown(
    kind: str = "", units: int = 3, unit: int = 1, start_s: float = 40.0, length_s: float = math.inf
) -> tuple[Simulation, Config]:
    """A flight of 90 s of which one unit goes wrong, and its configuration."""
    failures = {unit: failure(kind, start_s, length_s)} if kind else {}
    of = scenario(failures, units)
    return run(of, 3), config(of)
