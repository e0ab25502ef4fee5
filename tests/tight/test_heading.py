"""A heading that was lost in flight is noticed and found again, on ranges as on fixes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from companion.types import NS
from tests.consistency import runs

from . import flights


def test_a_heading_that_was_lost_is_noticed_and_found_again() -> None:
    """A gyro that tells of a turn of 115 degrees which nobody flew."""
    simulation, vehicle = runs.run(flights.SCENARIO, 3), flights.flight().recording
    imu = vehicle.imu[0]
    t = (imu.t_ns - imu.t_ns[0]) / NS
    turn = np.where((t > 50.0) & (t < 50.5), 4.0, 0.0)[:, None] * [0.0, 0.0, 1.0]
    struck = replace(vehicle, imu=(replace(imu, gyro_b=imu.gyro_b + turn),))
    flown = runs.fly(struck, flights.config(alignment={"heading": "unknown"}))
    lost = flown.event("heading-lost")
    assert lost is not None
    assert 50.0 < (lost.t_ns - imu.t_ns[0]) / NS < 65.0
    off = np.abs(np.degrees(runs.yaw_error(simulation, flown.solution)))
    at = (flown.solution.t_ns - simulation.t0_ns) / NS
    assert off[(at > 50.5) & (at < 52.0)].min() > 60.0
    assert off[at > 100.0].max() < 10.0
