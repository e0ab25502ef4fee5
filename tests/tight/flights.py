"""Simulated flights on raw GNSS for the tests of tight coupling: ``from . import flights``."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from companion.config import Config
from companion.types import F64, I64, NS, RawGnssSamples, Solution, VehicleRecording
from replay.simulator.raw_gnss import RawFlight, with_raw_gnss
from tests.consistency import runs

SECONDS = 110.0
SCENARIO = runs.honest("multirotor-mission", SECONDS)
LEVER = SCENARIO.gnss[0].lever_arm_b_m


def config(**sections: dict[str, object]) -> Config:
    """Tight coupling with the noise that is simulated; the heading is given."""
    base: dict[str, dict[str, object]] = {
        "raw_gnss": {
            "coupling": "tight",
            "sd_range_m": 0.7,
            "sd_multipath_m": 0.0,
            "iono_residual": 0.0,
        },
        "alignment": {"heading": "fixed", "fixed_heading_deg": 30.0},
    }
    for name, keys in sections.items():
        base[name] = base.get(name, {}) | keys
    return runs.changed(runs.matching_config(SCENARIO), **base)


@cache
def flight(seed: int = 3, systems: tuple[int, ...] = (0, 1)) -> RawFlight:
    """A multirotor's mission under two systems."""
    return with_raw_gnss(runs.run(SCENARIO, seed), seed, lever_arm_b_m=LEVER, systems=systems)


def seconds(vehicle: VehicleRecording) -> F64:
    """(N,) time of each epoch since the first inertial sample."""
    return np.asarray((vehicle.raw[0].t_ns - vehicle.imu[0].t_ns[0]) / NS)


def with_raw(vehicle: VehicleRecording, raw: RawGnssSamples) -> VehicleRecording:
    """The same flight with other epochs."""
    return replace(vehicle, raw=(raw,))


def withheld(vehicle: VehicleRecording, start: float, end: float, left: int) -> VehicleRecording:
    """All but the first ``left`` satellites of each epoch gone between two times."""
    raw, t = vehicle.raw[0], seconds(vehicle)
    inside = ((t >= start) & (t < end))[:, None]
    gone = inside & (np.arange(raw.sat.shape[1]) >= left)
    return with_raw(vehicle, replace(raw, sat=np.where(gone, 0, raw.sat)))


def errors(solution: Solution, seed: int = 3) -> tuple[F64, F64]:
    """Seconds (N,) and position error NED (N, 3) [m]."""
    simulation = runs.run(SCENARIO, seed)
    t: I64 = solution.t_ns - simulation.t0_ns
    return t / NS, runs.errors(simulation, solution)[:, 0]
