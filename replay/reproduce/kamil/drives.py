"""The paper's drives on simulated sensors of its grade, and the filter that it describes."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from companion.config import Config
from companion.types import F64, Solution, VehicleRecording
from replay.evaluation import errors_against
from replay.preparation import start_ns
from replay.reproduce.kamil.routes import Route, drive, length_m
from replay.simulator.aids import GnssSpec
from replay.simulator.matching import matching_config
from replay.simulator.scenarios import Scenario, TrajectorySpec, graded
from replay.simulator.simulation import run
from replay.simulator.trajectory import Trajectory
from replay.window import Window

FIRST_OUTAGE_S = 40.0
"""Where the paper's outages begin."""
_BETWEEN_S = 25.0
_LAST_FIXES_S = 8.0
_HEADING_SD_DEG = 5.0
_PLACE_DEG = (49.8671, 8.6385)
"""The campus in Darmstadt."""


@dataclass(frozen=True, slots=True)
class Drive:
    """One of the drives of a route."""

    route: Route
    vehicle: VehicleRecording
    config: Config
    duration_s: float
    length_m: float

    def windows(self, seconds: float) -> list[Window]:
        """Outages of one length, as many as the drive has room for: the first as in the paper."""
        found = []
        start = FIRST_OUTAGE_S
        while start + seconds + _LAST_FIXES_S <= self.duration_s:
            found.append(Window(start, seconds))
            start += seconds + _BETWEEN_S
        return found

    def errors(self, solution: Solution) -> tuple[F64, F64]:
        """Seconds since the start (N,), and position errors of the solution (N, 3) [m, NED]."""
        truth = self.vehicle.truth
        assert truth is not None
        found = errors_against(solution, truth)
        return (found.t_ns - start_ns(self.vehicle)) / 1e9, found.position_n


def simulate(route: Route, seed: int) -> Drive:
    """A drive of ``route``: the same way for every seed, other sensor errors."""
    plan, duration = drive(route)
    place = TrajectorySpec(
        kind="car-with-stops",
        duration_s=duration,
        lat_deg=_PLACE_DEG[0],
        lon_deg=_PLACE_DEG[1],
        height_hae_m=190.0,
    )
    scenario = Scenario(
        name=route.name,
        trajectory=place,
        imu=(graded("mems-consumer", rate_hz=100.0),),
        gnss=(GnssSpec(rate_hz=1.0, lever_arm_b_m=(0.3, 0.0, -1.2)),),
        truth_rate_hz=10.0,
    )
    lat, lon = np.radians(_PLACE_DEG)
    trajectory = Trajectory(plan, float(lat), float(lon), place.height_hae_m)
    simulation = run(scenario, seed, trajectory)
    # Where the car points at the start is known from the map, as well as one draws it there.
    heading = np.random.default_rng([7, seed]).normal(0.0, _HEADING_SD_DEG)
    return Drive(
        route,
        simulation.recording,
        _as_the_paper(matching_config(scenario), heading),
        duration,
        length_m(plan, duration),
    )


def _as_the_paper(config: Config, heading_deg: float) -> Config:
    """Fifteen states, GPS position and velocity, and nothing of what one knows about cars."""
    replace = msgspec.structs.replace
    return replace(
        config,
        constraints=replace(
            config.constraints, non_holonomic=False, course=False, zero_velocity=False
        ),
        alignment=replace(config.alignment, heading="fixed", fixed_heading_deg=heading_deg),
        mag=replace(config.mag, sd_deg=_HEADING_SD_DEG),
    )
