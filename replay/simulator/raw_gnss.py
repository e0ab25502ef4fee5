"""A simulated flight with a satellite receiver's raw measurements in place of its fixes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from companion.gnss.geometry import ned_axes
from companion.navigation.earth import ecef
from companion.types import (
    F64,
    I64,
    NS,
    BroadcastSamples,
    RawGnssSamples,
    Samples,
    VehicleRecording,
)
from replay.simulator.constellation import Sky, observe
from replay.simulator.simulation import Simulation


@dataclass(frozen=True, slots=True)
class RawFlight:
    """A recording with raw GNSS, and what the receiver's clock truly did."""

    recording: VehicleRecording
    sky: Sky


def with_raw_gnss(
    simulation: Simulation,
    seed: int,
    *,
    rate_hz: float = 5.0,
    lever_arm_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    latency_ms: float = 80.0,
    **sky: Any,
) -> RawFlight:
    """What an antenna on the simulated vehicle measures of a made-up sky.

    ``sky`` as the keywords of :func:`replay.simulator.constellation.observe`. Epochs arrive
    ``latency_ms`` after they are valid, the navigation messages before the first.
    """
    recording = simulation.recording
    seconds = float(recording.imu[0].t_ns[-1] - simulation.t0_ns) / NS
    t: F64 = np.arange(0.0, seconds, 1.0 / rate_hz)
    t_ns: I64 = simulation.t0_ns + np.rint(t * 1e6).astype(np.int64) * 1000
    made = observe(
        t_ns, _antenna(simulation, t, lever_arm_b_m), np.random.default_rng([7, seed]), **sky
    )
    raw = replace(made.raw, t_rx_ns=t_ns + round(latency_ms * 1e6))
    return RawFlight(as_arrived(recording, made.broadcast, raw), made)


def as_arrived(
    recording: VehicleRecording, broadcast: BroadcastSamples, raw: RawGnssSamples
) -> VehicleRecording:
    """``recording`` with raw GNSS for its fixes, all of it numbered by time of arrival."""
    streams: list[Samples] = [
        *recording.imu, *recording.baro, *recording.mag, broadcast, raw
    ]  # fmt: skip
    arrival = np.concatenate([s.t_rx_ns for s in streams])
    number = np.empty(len(arrival), np.int64)
    number[np.argsort(arrival, kind="stable")] = np.arange(len(arrival))
    ends = np.cumsum([len(s) for s in streams])[:-1]
    new: list[Any] = [
        replace(s, seq=seq) for s, seq in zip(streams, np.split(number, ends), strict=True)
    ]
    n, b = len(recording.imu), len(recording.baro)
    return replace(
        recording, imu=tuple(new[:n]), gnss=(), baro=tuple(new[n : n + b]),
        mag=tuple(new[n + b : -2]), broadcast=(new[-2],), raw=(new[-1],),
    )  # fmt: skip


def _antenna(simulation: Simulation, t: F64, lever_b: tuple[float, float, float]) -> F64:
    """(N, 6) ECEF position and velocity of the antenna; a turning lever arm by differences."""
    step = 1e-3
    here, later = (_place(simulation, x, lever_b) for x in (t, t + step))
    states = simulation.trajectory.states(t)
    velocity = np.empty((len(t), 3))
    axes = np.empty((3, 3))
    lever = np.array(lever_b)
    for i in range(len(t)):
        ned_axes(states.lat[i], states.lon[i], axes)
        velocity[i] = axes.T @ states.vel_n[i]
    if lever.any():
        velocity = (later - here) / step
    return np.concatenate([here, velocity], axis=1)


def _place(simulation: Simulation, t: F64, lever_b: tuple[float, float, float]) -> F64:
    """(N, 3) ECEF of the antenna."""
    s = simulation.trajectory.states(t)
    at: F64 = ecef(s.lat, s.lon, s.height)
    axes = np.empty((3, 3))
    lever = np.array(lever_b)
    for i in range(len(t)):
        ned_axes(s.lat[i], s.lon[i], axes)
        at[i] += axes.T @ (s.C_nb[i] @ lever)
    return at
