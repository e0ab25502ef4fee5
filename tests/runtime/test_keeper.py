"""What a run leaves for the next one: its heading, and how fast it may have turned since."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.config import Alignment
from companion.navigation.rotation import quat_from_rpy
from companion.runtime import saved_state
from companion.runtime.keeper import AT_LEAST, TURNS, Keeper, Turning
from companion.types import COV_ATT, NS, Mode, Solution

from .flights import can_frames, fly, pieces, vehicle, with_can

T0 = 1_750_000_000 * NS


def _epoch(second: int, yaw_deg: float, mode: Mode = Mode.NAVIGATING) -> Solution:
    cov = np.zeros((1, 5, 6))
    cov[0, COV_ATT, [0, 3, 5]] = np.square(np.radians([0.1, 0.1, 2.0]))
    one, three = np.zeros(1), np.zeros((1, 3))
    q = quat_from_rpy(0.1, -0.1, math.radians(yaw_deg))[np.newaxis]
    kind = np.array([int(mode)])
    return Solution(
        np.array([T0 + second * NS]), one, one, one, three, q, three, three, cov, kind, kind
    )


def test_the_fastest_turn_of_the_last_minute() -> None:
    turning = Turning()
    yaws = [350.0, 355.0, 1.0, -2.0] + [-2.0] * AT_LEAST
    found = [turning.heading(_epoch(at, yaw)) for at, yaw in enumerate(yaws)]
    assert found[:AT_LEAST] == [None] * AT_LEAST  # not known yet how it turns
    last = found[-1]
    assert last is not None
    assert last.heading_deg == pytest.approx(-2.0)
    assert last.sd_deg == pytest.approx(2.0)
    assert last.turn_dps == pytest.approx(6.0)  # from 355 to 1, not 354
    assert last.t_ns == T0 + (len(yaws) - 1) * NS
    for at in range(len(yaws), len(yaws) + TURNS):
        last = turning.heading(_epoch(at, -2.0))
    assert last is not None
    assert last.turn_dps == pytest.approx(0.0, abs=1e-9)


def test_no_heading_no_word_of_it() -> None:
    turning = Turning()
    for at in range(2 * AT_LEAST):
        assert turning.heading(_epoch(at, 10.0, Mode.HEADING_UNKNOWN)) is None
    assert turning.heading(Solution.empty()) is None


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
