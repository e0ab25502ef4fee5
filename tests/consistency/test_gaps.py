"""What goes missing or wrong in a stream is bridged, counted, or declared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from companion.types import NS, VehicleRecording
from replay.simulator import Simulation
from replay.simulator.aids import Fault

from . import runs


@pytest.fixture(scope="module")
def drive() -> Simulation:
    return runs.run(runs.honest("car-with-stops", 70.0), 3)


def _config(**engine: object):  # type: ignore[no-untyped-def]
    scenario = runs.honest("car-with-stops", 70.0)
    return runs.changed(
        runs.matching_config(scenario),
        alignment={"heading": "fixed", "fixed_heading_deg": 30.0},
        engine={"output_rate_hz": 10.0, **engine},
    )


def _without_imu(sim: Simulation, start_s: float, length_s: float) -> VehicleRecording:
    t = (sim.recording.imu[0].t_ns - sim.t0_ns) / NS
    keep = (t < start_s) | (t >= start_s + length_s)
    return replace(sim.recording, imu=(sim.recording.imu[0].take(keep),))


def test_a_short_gap_is_bridged_within_what_p_says(drive: Simulation) -> None:
    flown = runs.fly(_without_imu(drive, 35.0, 0.4), _config())
    assert [e.kind for e in flown.events] == ["aligned"]
    assert flown.solution.resets.max() == 0
    after = (flown.solution.t_ns - drive.t0_ns) / NS
    at = np.flatnonzero((after > 35.35) & (after < 36.0))
    error = runs.errors(drive, flown.solution)[at]
    assert np.all(np.abs(error[:, :3]) < 4.0 * flown.solution.sd[at, :3])


def test_a_long_gap_is_a_declared_reset(drive: Simulation) -> None:
    config = runs.changed(_config(), alignment={"heading": "auto"})
    flown = runs.fly(_without_imu(drive, 35.0, 2.0), config)
    gap = flown.event("imu-gap")
    assert gap is not None
    assert gap.level == "warning"
    assert flown.solution.resets[-1] == 1
    assert [e.kind for e in flown.events].count("aligned") == 2


def test_samples_that_are_not_finite_are_counted_and_dropped(drive: Simulation) -> None:
    imu = drive.recording.imu[0]
    gyro = imu.gyro_b.copy()
    gyro[3000:3010] = np.nan
    gyro[4000, 1] = np.inf
    flown = runs.fly(replace(drive.recording, imu=(replace(imu, gyro_b=gyro),)), _config())
    assert flown.engine.counters.imu_not_finite == 11
    assert flown.solution.resets.max() == 0
    assert np.isfinite(flown.solution.cov).all()


def test_a_clock_that_jumps_back_restarts_the_estimator(drive: Simulation) -> None:
    imu = drive.recording.imu[0]
    cut = 3000
    t = imu.t_ns.copy()
    t[cut:] -= 20 * NS
    gnss = drive.recording.gnss[0]
    later = gnss.t_ns > imu.t_ns[cut]
    moved = replace(gnss, t_ns=np.where(later, gnss.t_ns - 20 * NS, gnss.t_ns))
    flown = runs.fly(
        replace(drive.recording, imu=(replace(imu, t_ns=t),), gnss=(moved,)), _config()
    )
    assert flown.event("clock-back") is not None
    assert flown.solution.resets[-1] == 1


def test_a_position_jump_that_stays_is_believed_once_it_has_told_one_place_for_long() -> None:
    fault = Fault(start_s=30.0, length_s=100.0, step_n_m=(400.0, 300.0, 0.0))
    scenario = runs.honest("car-with-stops", 70.0, faults=(fault,))
    sim = runs.run(scenario, 3)
    flown = runs.fly(sim.recording, _config(gate_relock_s=10.0))
    relocked = flown.event("relocked")
    assert relocked is not None
    seconds = (relocked.t_ns - sim.t0_ns) / NS
    # A fault after 2 s, then for as long as the source had been good before: half a minute.
    assert 60.0 <= seconds <= 64.0
    t = (flown.solution.t_ns - sim.t0_ns) / NS
    error = np.linalg.norm(runs.errors(sim, flown.solution)[:, 0, :2], axis=1)
    # Before: the fault is kept out. After: the solution is where the fixes are, 500 m away.
    assert error[(t > 30) & (t < seconds)].max() < 5.0
    assert np.abs(error[t > seconds + 2] - 500.0).max() < 5.0
    assert flown.solution.resets[-1] == 1


def test_feedback_beats_feedforward_as_the_paper_says() -> None:
    """Ten minutes with a turn-on bias: the free INS leaves the range where its error is linear."""
    scenario = runs.honest("fixed-wing", 600.0)
    sim = runs.run(scenario, 2)
    config = runs.changed(runs.matching_config(scenario), engine={"output_rate_hz": 2.0})
    rmse = {}
    for correction in ("feedback", "feedforward"):
        flown = runs.fly(sim.recording, runs.changed(config, engine={"correction": correction}))
        t = (flown.solution.t_ns - sim.t0_ns) / NS
        error = runs.errors(sim, flown.solution)
        early = (t > 20) & (t < 40)
        assert runs.nees(error, flown.solution)[early, 0].mean() < 10
        rmse[correction] = np.sqrt(np.mean(error[t > 60, 1] ** 2))
    print("velocity RMSE [m/s]", rmse)
    assert rmse["feedback"] < rmse["feedforward"]


def test_an_accelerometer_that_begins_to_err_at_rest_does_not_run_away() -> None:
    """Idling propellers alias into an offset of 0.6 m/s²: found by velocity, level learned anew."""
    scenario = runs.honest("hover", 120.0)
    sim = runs.run(scenario, 5)
    imu = sim.recording.imu[0]
    struck = imu.t_ns > sim.t0_ns + 60 * NS
    accel = imu.accel_b + np.where(struck[:, None], 0.6, 0.0)
    gyro = imu.gyro_b + np.where(struck[:, None], 0.01, 0.0)
    recording = replace(sim.recording, imu=(replace(imu, accel_b=accel, gyro_b=gyro),))
    config = runs.changed(
        runs.matching_config(scenario),
        alignment={"heading": "fixed", "fixed_heading_deg": 30.0},
        constraints={"zero_velocity": False},
    )
    flown = runs.fly(recording, config)
    off = np.linalg.norm(runs.errors(sim, flown.solution)[:, :2, :2], axis=2)
    after = flown.solution.t_ns > sim.t0_ns + 90 * NS
    assert flown.event("level-lost") is not None
    assert off[:, 0].max() < 20.0  # without recovery hundreds of metres
    assert off[after, 1].max() < 1.0
