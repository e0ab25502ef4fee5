"""Simulated runs for the consistency tests: errors, normalised squares and their bounds.

Tests import it as ``from . import runs``.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
from scipy.stats import chi2

from companion.config import Config
from companion.engine import Engine
from companion.navigation.earth import ned_difference
from companion.navigation.rotation import attitude_error_n, quat_from_rpy, rpy_from_quat
from companion.types import F64, NS, AidingReports, Event, Solution
from replay.player import play
from replay.simulator import Scenario, Simulation, load_scenario, matching_config, run
from replay.simulator.aids import GnssSpec
from replay.simulator.scenarios import graded

BLOCKS = ("position", "velocity", "attitude", "accel bias", "gyro bias")


@dataclass(frozen=True)
class Flown:
    """One simulated run through the engine."""

    engine: Engine
    solution: Solution
    """Settled epochs."""
    reports: AidingReports
    events: tuple[Event, ...]

    def event(self, kind: str) -> Event | None:
        """The first event of a kind."""
        return next((e for e in self.events if e.kind == kind), None)


def fly(recording, config: Config) -> Flown:  # type: ignore[no-untyped-def]
    """Play a recording and keep what came out."""
    settled: list[Solution] = []
    reports: list[AidingReports] = []
    events: list[Event] = []

    def sink(_: object, out) -> None:  # type: ignore[no-untyped-def]
        settled.append(out.settled)
        reports.append(out.reports)
        events.extend(out.events)

    engine = play(recording, config, sink)
    return Flown(
        engine,
        Solution.concatenate(settled),
        AidingReports.concatenate(reports),
        tuple(events),
    )


def changed(config: Config, **sections: dict[str, object]) -> Config:
    """``config`` with keys replaced: ``changed(c, engine={"output_rate_hz": 5.0})``."""
    new = {
        name: msgspec.structs.replace(getattr(config, name), **keys)
        for name, keys in sections.items()
    }
    return msgspec.structs.replace(config, **new)


def honest(name: str, duration_s: float, heading_deg: float = 30.0, **gnss: object) -> Scenario:
    """A built-in scenario with just those errors that the filter models, at a cheap IMU rate."""
    base = load_scenario(name)
    imu = graded("mems-consumer", rate_hz=100.0).modelled_only()
    receiver = msgspec.structs.replace(
        GnssSpec(correlated_sd_position_m=0.0, correlated_sd_height_m=0.0),
        lever_arm_b_m=base.gnss[0].lever_arm_b_m,
        **gnss,
    )
    trajectory = msgspec.structs.replace(
        base.trajectory, duration_s=duration_s, heading_deg=heading_deg
    )
    return msgspec.structs.replace(
        base, imu=(imu,), gnss=(receiver,), trajectory=trajectory, truth_rate_hz=10.0
    )


def errors(sim: Simulation, solution: Solution) -> F64:
    """(N, 5, 3) truth − estimate: position [m], velocity, φ [rad], both biases."""
    t = (solution.t_ns - sim.t0_ns) / NS
    truth = sim.trajectory.states(t)
    imu_t = sim.recording.imu[0].t_ns
    q_true = np.array([quat_from_rpy(*rpy) for rpy in truth.rpy])
    out = np.empty((len(solution), 5, 3))
    out[:, 0] = ned_difference(
        truth.lat, truth.lon, truth.height, solution.lat, solution.lon, solution.height
    )
    out[:, 1] = truth.vel_n - solution.vel_n
    out[:, 2] = attitude_error_n(q_true, solution.q_nb)
    for column, true, estimate in (
        (3, sim.accel_bias_b[0], solution.accel_bias_b),
        (4, sim.gyro_bias_b[0], solution.gyro_bias_b),
    ):
        for axis in range(3):
            out[:, column, axis] = (
                np.interp(solution.t_ns, imu_t, true[:, axis]) - estimate[:, axis]
            )
    return out


def nees(error: F64, solution: Solution) -> F64:
    """(N, 5) normalised estimation error squared of the five 3-vectors; 3 is honest."""
    P = np.empty((len(solution), 5, 3, 3))
    for at, (i, j) in enumerate(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))):
        P[..., i, j] = P[..., j, i] = solution.cov[..., at]
    return np.einsum("nbi,nbi->nb", error, np.linalg.solve(P, error[..., None])[..., 0])


def epochs(solution: Solution, start_ns: int, seconds: tuple[float, ...]) -> F64:
    """Indices of the last output epoch at or before each time since ``start_ns``."""
    wanted = start_ns + (np.array(seconds) * NS).astype(np.int64)
    return np.searchsorted(solution.t_ns, wanted, side="right") - 1


def mean_bounds(runs: int, dof: int = 3, probability: float = 0.95) -> tuple[float, float]:
    """Bounds of the mean over independent ``runs`` of a χ² with ``dof`` degrees of freedom."""
    tail = 0.5 * (1.0 - probability)
    low, high = chi2.ppf([tail, 1.0 - tail], runs * dof) / runs
    return float(low), float(high)


def yaw_error(sim: Simulation, solution: Solution) -> F64:
    """(N,) true − estimated yaw [rad], in ±π."""
    t = (solution.t_ns - sim.t0_ns) / NS
    off = sim.trajectory.states(t).rpy[:, 2] - rpy_from_quat(solution.q_nb)[:, 2]
    return np.asarray(np.remainder(off + np.pi, 2 * np.pi) - np.pi)


__all__ = [
    "BLOCKS", "Flown", "changed", "epochs", "errors", "fly", "honest", "matching_config",
    "mean_bounds", "nees", "run", "yaw_error",
]  # fmt: skip
