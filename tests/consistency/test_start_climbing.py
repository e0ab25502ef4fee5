"""A start in a steady climb: as quiet as rest, and GNSS without a vertical velocity."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from companion.types import COV_VEL, NS, Channel, Mode, Samples, VehicleRecording, Verdict
from replay.configuration import ChosenConfig
from replay.evaluation import errors_against
from replay.session import SessionResult, run_session
from replay.simulator import load_scenario, matching_config, simulate


def _from_the_climb_on(vehicle: VehicleRecording) -> VehicleRecording:
    truth = vehicle.truth
    assert truth is not None
    down = truth.vel_n[:, 2]
    steady = np.abs(np.gradient(down)) < 2e-4
    still = np.hypot(truth.vel_n[:, 0], truth.vel_n[:, 1]) < 0.2
    begin_ns = truth.t_ns[np.flatnonzero((down < -1.5) & steady & still)[0]]

    def cut(streams: tuple[Samples, ...]) -> tuple[Samples, ...]:
        return tuple(s.take(np.flatnonzero(s.t_ns >= begin_ns)) for s in streams)

    gnss = tuple(
        replace(g, vel_n=np.where([True, True, False], g.vel_n, np.nan)) for g in cut(vehicle.gnss)
    )
    return replace(
        vehicle, imu=cut(vehicle.imu), gnss=gnss, baro=cut(vehicle.baro), mag=cut(vehicle.mag)
    )


@pytest.mark.parametrize("seed", range(4))
def test_the_climb_is_found_and_never_taken_for_rest(seed: int) -> None:
    scenario = load_scenario("multirotor-mission")
    brief = msgspec.structs.replace(scenario.trajectory, duration_s=60.0)
    scenario = msgspec.structs.replace(scenario, trajectory=brief)
    vehicle = _from_the_climb_on(simulate(scenario, seed))
    run: SessionResult = run_session(vehicle, ChosenConfig(matching_config(scenario), "", ""))
    solution = run.solution.take(np.flatnonzero(run.solution.mode != Mode.ALIGNING))
    truth = vehicle.truth
    assert truth is not None
    error = errors_against(solution, truth).velocity_n[:, 2]
    sd = solution.sd[:, COV_VEL, 2]
    # Five standard deviations in some thousand correlated epochs: not by chance.
    assert np.all(np.abs(error) < 5.0 * sd)
    since = (solution.t_ns - solution.t_ns[0]) / NS
    assert np.abs(error[since > 3.0]).max() < 0.6
    stood = (run.reports.channel == Channel.ZERO_VELOCITY) & (
        run.reports.verdict == Verdict.ACCEPTED
    )
    speed = np.interp(run.reports.t_ns[stood], truth.t_ns, np.abs(truth.vel_n[:, 2]))
    assert np.all(speed < 0.2)
