"""The direct filter behind the engine: the same bits however samples arrive; gaps; bad input."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from companion.config import Config, FurtherImu
from companion.engine import Engine
from companion.types import (
    AttitudeSamples,
    CompanionError,
    Mode,
    Solution,
    VehicleRecording,
)
from replay.player import play
from replay.simulator import Simulation, load_scenario, matching_config, run

THIN = 25
"""Of 100 Hz: a ground station's 4 Hz."""


@pytest.fixture(scope="module")
def flight() -> Simulation:
    base = load_scenario("fixed-wing")
    shorter = msgspec.structs.replace(base.trajectory, duration_s=60.0)
    return run(msgspec.structs.replace(base, trajectory=shorter), 3)


def _slow(flight: Simulation, config: dict[str, object]) -> tuple[VehicleRecording, Config]:
    """The flight with a thinned IMU and the true attitude, and a configuration for it."""
    recording = flight.recording
    imu = tuple(stream.take(slice(None, None, THIN)) for stream in recording.imu)
    truth = recording.truth
    assert truth is not None
    attitude = AttitudeSamples("ATTITUDE", truth.t_ns, truth.t_rx_ns, truth.seq, truth.rpy)
    base = matching_config(load_scenario("fixed-wing"))
    engine = msgspec.structs.replace(base.engine, estimator="direct", output_rate_hz=10.0)
    direct = msgspec.structs.replace(base.direct, **config)
    chosen = msgspec.structs.replace(base, engine=engine, direct=direct)
    slow = attitude.take(slice(None, None, max(1, len(attitude) // 240)))
    return replace(recording, imu=imu, attitude=(slow,)), chosen


def _settled(recording: VehicleRecording, config: Config, block_s: float) -> tuple[str, Solution]:
    parts: list[Solution] = []
    engine = play(recording, config, lambda _, out: parts.append(out.settled), block_s)
    assert engine.counters.late_fused > 0
    return engine.digest, Solution.concatenate(parts)


def test_late_fixes_and_cuts_into_blocks_leave_no_trace(flight: Simulation) -> None:
    recording, config = _slow(flight, {"attitude": True})
    digest, solution = _settled(recording, config, 10.0)
    assert _settled(recording, config, 0.3)[0] == digest
    assert len(solution) > 400
    assert np.all(np.diff(solution.t_ns) > 0)
    # Rows come at 10 Hz although the IMU has 4.
    assert np.median(np.diff(solution.t_ns)) == pytest.approx(1e8, rel=0.5)


def test_a_gap_is_carried_by_the_model_with_growing_deviations(flight: Simulation) -> None:
    recording, config = _slow(flight, {"attitude": True})
    t0 = int(recording.imu[0].t_ns[0])

    def outside(t: np.ndarray) -> np.ndarray:
        return (t < t0 + 40e9) | (t > t0 + 45e9)

    silent = replace(
        recording,
        imu=tuple(s.take(outside(s.t_ns)) for s in recording.imu),
        gnss=tuple(s.take(outside(s.t_ns)) for s in recording.gnss),
        baro=tuple(s.take(outside(s.t_ns)) for s in recording.baro),
        attitude=tuple(s.take(outside(s.t_ns)) for s in recording.attitude),
    )
    _, solution = _settled(silent, config, 10.0)
    inside = (solution.t_ns > t0 + 40.3e9) & (solution.t_ns < t0 + 44.7e9)
    assert inside.sum() > 35
    sd = solution.sd[inside, 0, 0]
    assert np.all(np.diff(sd) > 0)
    assert sd[-1] > 10.0
    assert solution.resets[-1] == 0
    config = msgspec.structs.replace(
        config, direct=msgspec.structs.replace(config.direct, max_gap_s=2.0)
    )
    _, solution = _settled(silent, config, 10.0)
    assert solution.resets[-1] == 1
    assert solution.mode[-1] == Mode.NAVIGATING


def test_an_engine_that_shakes_the_airframe_does_not_move_the_height(flight: Simulation) -> None:
    """Samples of ±30 m/s² at 4 Hz, ten times what the configuration knows, from 20 s on."""
    recording, config = _slow(flight, {"attitude": True})
    (imu,) = recording.imu
    rng = np.random.default_rng(7)
    shaken = imu.accel_b.copy()
    late = imu.t_ns > imu.t_ns[0] + 20e9
    shaken[late, 2] += 30.0 * rng.standard_normal(late.sum())
    _, solution = _settled(replace(recording, imu=(replace(imu, accel_b=shaken),)), config, 10.0)
    truth = recording.truth
    assert truth is not None
    height = np.interp(solution.t_ns, truth.t_ns, truth.height)
    off = np.abs(solution.height - height)
    assert off.max() < 5.0 * solution.sd[:, 0, 2].max()
    assert off.max() < 20.0
    assert solution.resets[-1] == 0


def test_what_is_no_number_is_refused_and_a_smoother_gets_a_reason(flight: Simulation) -> None:
    recording, config = _slow(flight, {"attitude": True})
    imu, attitude = recording.imu[0], recording.attitude[0]
    further = msgspec.structs.replace(config, further_imu=(FurtherImu(source="imu2"),))
    bad = imu.take(slice(10, 11))
    bad = replace(bad, source="imu2", gyro_b=bad.gyro_b * np.nan)
    engine = Engine(further)
    engine.step(imu.take(slice(0, 20)))
    engine.step(bad)
    engine.step(replace(attitude.take(slice(0, 1)), rpy=np.full((1, 3), np.inf)))
    assert engine.counters.refused == {"refused_invalid": 2}
    with pytest.raises(CompanionError, match="error-state"):
        Engine(config, "states")
