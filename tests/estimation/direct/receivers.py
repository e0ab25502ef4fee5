"""Flights with a receiver that gets worse and does not say so."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np

from companion.config import Config
from companion.types import NS, VehicleRecording
from replay.simulator import load_scenario, matching_config, run

NOISY_S = 30.0
"""From here on fixes are five times noisier than they say, position and velocity."""
POSITION_M, VELOCITY_MPS, RADIUS_M = (7.0, 7.0, 10.0), (0.5, 0.5, 0.75), 6.37e6


def noisy(seed: int, duration_s: float) -> tuple[VehicleRecording, int, Config]:
    """A fixed wing's flight, when it began [ns], and settings that know nothing of the noise."""
    base = load_scenario("fixed-wing")
    of = msgspec.structs.replace(
        base, trajectory=msgspec.structs.replace(base.trajectory, duration_s=duration_s)
    )
    flight = run(of, seed)
    (fix,) = flight.recording.gnss
    late = (fix.t_ns > flight.t0_ns + round(NOISY_S * NS))[:, None]
    rng = np.random.default_rng(100 + seed)
    off = late * rng.standard_normal((len(fix), 3)) * POSITION_M
    worse = replace(
        fix,
        lat=fix.lat + off[:, 0] / RADIUS_M,
        lon=fix.lon + off[:, 1] / (RADIUS_M * np.cos(fix.lat)),
        height=fix.height + off[:, 2],
        vel_n=fix.vel_n + late * rng.standard_normal((len(fix), 3)) * VELOCITY_MPS,
    )
    return replace(flight.recording, gnss=(worse,)), flight.t0_ns, matching_config(base)
