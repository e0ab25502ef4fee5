"""A scenario and a seed in, a recording with truth out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from companion.types import (
    F64,
    I64,
    NS,
    BaroSamples,
    GnssSamples,
    ImuSamples,
    MagSamples,
    ReferenceSamples,
    Samples,
    VehicleRecording,
)
from replay.simulator import aids, imu
from replay.simulator.disturbances import inside
from replay.simulator.plans import PLANS
from replay.simulator.scenarios import Scenario, TrajectorySpec, check
from replay.simulator.trajectory import Trajectory

_S = TypeVar("_S", bound=Samples)

# What a random stream is for; a stream's generator depends on the seed, its purpose and its index
# alone, so adding a sensor changes nothing for the others.
_FLIGHT, _IMU, _GNSS, _BARO, _MAG = range(5)


@dataclass(frozen=True, slots=True)
class Simulation:
    """A recording and what no sensor tells: the motion itself and the biases."""

    recording: VehicleRecording
    trajectory: Trajectory
    t0_ns: int
    """Time of the trajectory's second zero."""
    gyro_bias_b: tuple[F64, ...]
    """For each IMU (N, 3) [rad/s], true bias at its samples."""
    accel_bias_b: tuple[F64, ...]
    """For each IMU (N, 3) [m/s²]."""


def plan_trajectory(spec: TrajectorySpec, seed: int) -> Trajectory:
    """The exact trajectory of ``spec``; its own seed, if set, goes before ``seed``."""
    rng = np.random.default_rng([_FLIGHT, seed if spec.seed is None else spec.seed])
    plan = PLANS[spec.kind](spec.duration_s, spec.rest_s, np.radians(spec.heading_deg), rng)
    return Trajectory(plan, np.radians(spec.lat_deg), np.radians(spec.lon_deg), spec.height_hae_m)


def _epochs(duration_s: float, rate_hz: float, phase_s: float = 0.0) -> I64:
    """Times [ns] since the start, rounded to the microseconds that MAVLink can carry."""
    count = int(np.floor((duration_s - phase_s) * rate_hz + 1e-9)) + 1
    microseconds = np.rint((phase_s + np.arange(count) / rate_hz) * 1e6)
    return microseconds.astype(np.int64) * 1000


def _ns(seconds: F64) -> I64:
    """Arrival times to whole microseconds [ns]."""
    return np.rint(seconds * 1e6).astype(np.int64) * 1000


def _running(trajectory: Trajectory, t: F64, duration_s: float) -> F64:
    """(N, 1) 1 where the motors are on: from a second before the first motion to the last one."""
    coarse = np.arange(0.0, duration_s, 0.1)
    moving = coarse[np.linalg.norm(trajectory.states(coarse).vel_n, axis=1) > 0.01]
    if len(moving) == 0:
        return np.zeros((len(t), 1))
    on = (t >= moving[0] - 1.0) & (t <= moving[-1])
    return np.where(on, 1.0, 0.0)[:, None]


def _inertial(
    spec: imu.ImuSpec, rng: np.random.Generator, trajectory: Trajectory, duration_s: float
) -> tuple[ImuSamples, F64, F64]:
    stamp_ns = _epochs(duration_s, spec.rate_hz)
    valid = stamp_ns / NS - spec.latency_ms * 1e-3
    interval = np.full(len(valid), np.nan)
    if spec.output == "integral":
        interval = np.diff(valid, prepend=valid[0] - 1.0 / spec.rate_hz)
        ideal = trajectory.inertial_means(valid, interval)
    else:
        ideal = trajectory.inertial(valid)
    ideal = ideal[0], ideal[1] + _lever_force(trajectory, valid, interval, spec.lever_arm_b_m)
    gyro, accel, gyro_bias, accel_bias = imu.measure(
        spec, rng, *ideal, valid, _running(trajectory, valid, duration_s)
    )
    rx = stamp_ns + _ns(np.array(spec.arrival_ms * 1e-3))
    samples = ImuSamples(spec.source, stamp_ns, rx, stamp_ns, gyro, accel, interval)
    return samples, gyro_bias, accel_bias


def _heard(spec: imu.ImuSpec, unit: tuple[ImuSamples, F64, F64]) -> tuple[ImuSamples, F64, F64]:
    """A unit's samples and true biases without the times at which it is silent."""
    samples, gyro_bias, accel_bias = unit
    valid = samples.t_ns / NS - spec.latency_ms * 1e-3
    silent = np.zeros(len(valid))
    for failure in spec.failures:
        if failure.kind == "silent":
            silent += inside(valid, failure.start_s, failure.length_s)
    said = silent == 0.0
    return samples.take(said), gyro_bias[said], accel_bias[said]


def _lever_force(
    trajectory: Trajectory, t: F64, interval: F64, lever_b: tuple[float, float, float]
) -> F64:
    """What a unit at ``lever_b`` feels beside one at the reference point, (N, 3) [m/s²].

    α × r + ω × (ω × r); for integrals its mean over the interval, centripetal part by Simpson.
    """
    if not any(lever_b):
        return np.zeros((len(t), 3))
    arm = np.array(lever_b)
    instant = np.isnan(interval)
    h = np.where(instant, 2e-4, interval)
    end = np.where(instant, t + 1e-4, t)
    rates = [trajectory.inertial(end - part * h)[0] for part in (1.0, 0.5, 0.0)]
    inward = [np.cross(w, np.cross(w, arm)) for w in rates]
    turn = np.cross((rates[2] - rates[0]) / h[:, None], arm)
    force: F64 = turn + (inward[0] + 4.0 * inward[1] + inward[2]) / 6.0
    return force


def _gnss(
    spec: aids.GnssSpec, rng: np.random.Generator, trajectory: Trajectory, duration_s: float
) -> GnssSamples:
    t_ns = _epochs(duration_s, spec.rate_hz)
    found = aids.fixes(spec, rng, trajectory, t_ns / NS)
    rx = _ns(found.t_rx)
    stamp = rx if spec.stamped == "arrival" else _ns(found.t)
    lat, lon, height = np.ascontiguousarray(found.llh.T)
    return GnssSamples(
        spec.source,
        stamp,
        rx,
        stamp,
        lat,
        lon,
        height,
        found.vel_n,
        found.sd_pos,
        found.sd_vel,
        found.num_sats,
        found.fix_type,
    )


def _baro(
    spec: aids.BaroSpec, rng: np.random.Generator, trajectory: Trajectory, duration_s: float
) -> BaroSamples:
    t_ns = _epochs(duration_s, spec.rate_hz)
    measured = aids.pressure(spec, rng, trajectory.states(t_ns / NS).height)
    return BaroSamples(
        spec.source, t_ns, t_ns + _ns(np.array(spec.arrival_ms * 1e-3)), t_ns, measured
    )


def _mag(
    spec: aids.MagSpec, rng: np.random.Generator, trajectory: Trajectory, scenario: Scenario
) -> MagSamples:
    place = scenario.trajectory
    field_n = np.array(spec.field_n_t or ())
    if spec.field_n_t is None:
        field_n = aids.earth_field_n(
            np.radians(place.lat_deg),
            np.radians(place.lon_deg),
            place.height_hae_m,
            1970.0 + scenario.start_unix_s / (365.2425 * 86400.0),
        )
    t_ns = _epochs(place.duration_s, spec.rate_hz)
    measured = aids.magnetic(spec, rng, trajectory.states(t_ns / NS).C_nb, field_n)
    return MagSamples(
        spec.source, t_ns, t_ns + _ns(np.array(spec.arrival_ms * 1e-3)), t_ns, measured
    )


def _truth(trajectory: Trajectory, first: ImuSamples, rate_hz: float) -> ReferenceSamples:
    step = np.median(np.diff(first.t_ns)) / NS if len(first) > 1 else 1.0
    part = slice(None, None, max(1, round(1.0 / (rate_hz * step))))
    t_ns = first.t_ns[part]
    s = trajectory.states(t_ns / NS)
    rpy = s.rpy.copy()
    rpy[:, 2] = np.remainder(rpy[:, 2] + np.pi, 2 * np.pi) - np.pi
    return ReferenceSamples(
        "truth", t_ns, first.t_rx_ns[part], t_ns, s.lat, s.lon, s.height, s.vel_n, rpy
    )


def _number(blocks: list[Samples], t0_ns: int) -> list[Samples]:
    """The blocks with ``seq`` by time of arrival (ties in the order given) and times from 1970."""
    rx = np.concatenate([b.t_rx_ns for b in blocks])
    seq = np.empty(len(rx), dtype=np.int64)
    seq[np.argsort(rx, kind="stable")] = np.arange(len(rx))
    ends = np.cumsum([len(b) for b in blocks])[:-1]
    return [
        replace(b, seq=s, t_ns=b.t_ns + t0_ns, t_rx_ns=b.t_rx_ns + t0_ns)
        for b, s in zip(blocks, np.split(seq, ends), strict=True)
    ]


def _of(kind: type[_S], blocks: list[Samples]) -> tuple[_S, ...]:
    return tuple(b for b in blocks if isinstance(b, kind))


def run(scenario: Scenario, seed: int, trajectory: Trajectory | None = None) -> Simulation:
    """Simulate ``scenario``: recording, trajectory and true biases.

    ``trajectory`` is driven in place of the scenario's own kind. The same scenario and seed give
    the same bits on one machine and numpy version.
    Raises :class:`ConfigError` for a scenario that cannot be simulated.
    """
    check(scenario)
    duration_s = scenario.trajectory.duration_s
    if trajectory is None:
        trajectory = plan_trajectory(scenario.trajectory, seed)
    generator = np.random.default_rng
    units = [
        _inertial(spec, generator([_IMU, seed, i]), trajectory, duration_s)
        for i, spec in enumerate(scenario.imu)
    ]
    truth = _truth(trajectory, units[0][0], scenario.truth_rate_hz)
    units = [_heard(spec, unit) for spec, unit in zip(scenario.imu, units, strict=True)]
    blocks: list[Samples] = [*(unit[0] for unit in units), truth]
    for i, spec in enumerate(scenario.gnss):
        blocks.append(_gnss(spec, generator([_GNSS, seed, i]), trajectory, duration_s))
    if scenario.baro is not None:
        rng = generator([_BARO, seed])
        blocks.append(_baro(scenario.baro, rng, trajectory, duration_s))
    if scenario.mag is not None:
        blocks.append(_mag(scenario.mag, generator([_MAG, seed]), trajectory, scenario))
    t0_ns = scenario.start_unix_s * NS
    numbered = _number(blocks, t0_ns)
    recording = VehicleRecording(
        name=scenario.name,
        imu=_of(ImuSamples, numbered),
        gnss=_of(GnssSamples, numbered),
        baro=_of(BaroSamples, numbered),
        mag=_of(MagSamples, numbered),
        truth=_of(ReferenceSamples, numbered)[0],
        height_datum="hae",
    )
    return Simulation(
        recording, trajectory, t0_ns, tuple(u[1] for u in units), tuple(u[2] for u in units)
    )


def simulate(scenario: Scenario, seed: int = 0) -> VehicleRecording:
    """The recording of :func:`run`, truth included."""
    return run(scenario, seed).recording
