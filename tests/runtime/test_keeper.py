"""What a run leaves for the next one: heading, streams, biases."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.config import Alignment, Config
from companion.navigation.rotation import quat_from_rpy
from companion.runtime import saved_state
from companion.runtime.keeper import Keeper, standing_heading
from companion.types import COV_ATT, NS, Mode, Solution

from .flights import can_frames, fly, pieces, vehicle, with_can

T0 = 1_750_000_000 * NS


def _epoch(speed_mps: float, mode: Mode = Mode.NAVIGATING, yaw_sd_deg: float = 2.0) -> Solution:
    cov = np.zeros((1, 5, 6))
    cov[0, COV_ATT, [0, 3, 5]] = np.square(np.radians([0.1, 0.1, yaw_sd_deg]))
    one, three = np.zeros(1), np.zeros((1, 3))
    vel_n = np.array([[0.0, -speed_mps, 0.0]])
    q = quat_from_rpy(0.1, -0.1, math.radians(-10.0))[np.newaxis]
    kind = np.array([int(mode)])
    return Solution(np.array([T0]), one, one, one, vel_n, q, three, three, cov, kind, kind)


def test_the_heading_of_a_vehicle_that_stands() -> None:
    left = standing_heading(Config(), _epoch(0.05))
    assert left is not None
    assert left.heading_deg == pytest.approx(-10.0)
    assert left.sd_deg == pytest.approx(2.0)
    assert left.t_ns == T0


@pytest.mark.parametrize(
    "last",
    [
        _epoch(2.0),
        _epoch(0.0, Mode.HEADING_UNKNOWN),
        _epoch(0.0, Mode.COASTING),
        _epoch(0.0, yaw_sd_deg=math.nan),
        Solution.empty(),
    ],
)
def test_no_heading_worth_keeping(last: Solution) -> None:
    assert standing_heading(Config(), last) is None


def test_a_run_leaves_its_state(tmp_path: Path) -> None:
    """Every second without waiting for the disk, at the end safely; older biases until new ones."""
    recording, config = vehicle()
    config = msgspec.structs.replace(
        with_can(config, "can-imu"), alignment=Alignment(heading="fixed", fixed_heading_deg=0.0)
    )
    arrivals = [*can_frames(recording.imu[0]), *pieces(recording.gnss[0])]
    flown = fly(arrivals, config, tmp_path / "r.mcap")
    older = saved_state.SavedBiases(
        source="can-imu",
        saved_ns=T0,
        gyro_bias_dps=(0.1, 0.0, 0.0),
        gyro_bias_sd_dps=0.01,
        accel_bias_mps2=(0.0, 0.0, 0.0),
        accel_bias_sd_mps2=0.01,
    )
    before = saved_state.SavedState(saved_ns=T0, axes=config.imu.axes, biases=older)
    path = tmp_path / "v.state.toml"
    keeper = Keeper(path, before)
    keeper.keep(flown.core)
    keeper.keep(flown.core, last=True)
    assert saved_state.of_last_second(path).exists()
    state = saved_state.read(path)
    assert state is not None
    assert state.inputs["imu"] == "can-imu"
    assert state.inputs["gnss"] == recording.gnss[0].source
    assert state.biases is not None
    assert state.saved_ns == flown.core.now_ns
