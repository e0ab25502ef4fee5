"""Accuracy on the real drive ``car-rtk``: whole drive, and GNSS withheld in one place at a time.

``python -m tests.benchmarks.car [CONFIG]``; about a minute. An outage's error is horizontal, in two
places: at the end of the withheld window, as ``companion evaluate`` has it, and at the last epoch
before the next fix, up to a second later. Ten places are spread evenly over the drive; nine more
lie halfway between them, where settings can be judged before they are confirmed on the ten.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import math
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.config import DEG, Config, load
from companion.navigation.earth import ned_difference
from companion.types import VehicleRecording
from replay.reader import read_log
from replay.window import Window
from tests.benchmarks.common import (
    NS,
    ROOT,
    errors_against,
    horizontal_at,
    need_data,
    next_fix_ns,
    rmse,
    solve,
    start_ns,
    table,
)

LENGTHS_S = (10, 20, 30, 60)
PLACES = 10
_MOVING_MPS = 1.0
_LEAD_IN_S = 30.0
"""From the first motion to the first outage: heading and biases have been seen by then."""
ANTENNA_B = (0.0, -0.05, 0.0)
"""Truth is of the antenna, 5 cm to the left of the IMU (the data's README)."""

Ends = Callable[[Window], tuple[float, float]]
"""Errors of one outage at the window's end and at the last epoch before the next fix."""


def variant(config: Config, non_holonomic: bool, zero_velocity: bool) -> Config:
    """``config`` with its two pseudo-measurements on or off."""
    replace = msgspec.structs.replace
    constraints = replace(
        config.constraints, non_holonomic=non_holonomic, zero_velocity=zero_velocity
    )
    return replace(config, constraints=constraints)


def places(vehicle: VehicleRecording, length_s: int, between: bool = False) -> list[Window]:
    """Windows of one length, starts evenly spread over the moving part, or halfway ``between``."""
    truth = vehicle.truth
    assert truth is not None
    origin = start_ns(vehicle)
    moving = truth.t_ns[np.hypot(truth.vel_n[:, 0], truth.vel_n[:, 1]) > _MOVING_MPS]
    # The next fix must still be in the log.
    last = min(int(moving[-1]), int(vehicle.gnss[0].t_ns[-1]))
    first_s = (int(moving[0]) - origin) / NS + _LEAD_IN_S
    last_s = (last - origin) / NS - length_s - 1.0
    starts = np.linspace(first_s, last_s, PLACES)
    if between:
        starts = 0.5 * (starts[1:] + starts[:-1])
    return [Window(float(start), float(length_s)) for start in starts]


def our_ends(vehicle: VehicleRecording, config: Config) -> Ends:
    """Outage errors of our published solution."""
    truth = vehicle.truth
    assert truth is not None
    origin = start_ns(vehicle)

    def ends(window: Window) -> tuple[float, float]:
        result = solve(vehicle, config, [window])
        errors = errors_against(result.solution, truth, ANTENNA_B)
        over = origin + round((window.start_s + window.seconds) * NS)
        fix = next_fix_ns(result.vehicle.gnss[0].t_ns, over)
        return horizontal_at(errors, over), horizontal_at(errors, fix)

    return ends


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Nothing from a C library reaches the terminal: it warns at each start and each outage."""
    sys.stdout.flush()
    kept = [os.dup(1), os.dup(2)]
    with open(os.devnull, "wb") as nothing:
        for stream in (1, 2):
            os.dup2(nothing.fileno(), stream)
    try:
        yield
    finally:
        for stream, before in zip((1, 2), kept, strict=True):
            os.dup2(before, stream)
            os.close(before)


def inslib_ends(vehicle: VehicleRecording, config: Config, lateral: bool) -> Ends:
    """Outage errors of INSLIB's Ins with the same sensor parameters, heading from course."""
    inslib = importlib.import_module("INSLIB")
    imu, gnss, truth = vehicle.imu[0], vehicle.gnss[0], vehicle.truth
    assert truth is not None
    origin = start_ns(vehicle)
    dt_s = float(np.median(np.diff(imu.t_ns))) / NS
    spec = config.imu
    accel_var = [spec.accel_noise_mps2_rthz**2 / dt_s] * 3
    gyro_var = [(spec.gyro_noise_dps_rthz * DEG) ** 2 / dt_s] * 3
    settings = inslib.Config(
        auto_init=True,
        automotive_mode=True,
        automotive_lateral_constraint=lateral,
        allow_unlimited_deadreckoning=True,
        acc_bias_init_stddev_mps2=spec.accel_bias_sd_mps2,
        gyr_bias_init_stddev_rps=spec.gyro_bias_sd_dps * DEG,
        acc_bias_pred_stddev_mps2_sqrts=spec.accel_bias_walk_mps2_rts,
        gyr_bias_pred_stddev_rps_sqrts=spec.gyro_bias_walk_dps_rts * DEG,
    )
    accel, gyro = imu.accel_b.tolist(), imu.gyro_b.tolist()
    steps = np.diff(imu.t_ns, prepend=imu.t_ns[0] - round(dt_s * NS)) / NS
    fix_at = np.searchsorted(imu.t_ns, gnss.t_ns)

    def error(nav: Any, i: int) -> float:
        llh = nav.position_llh()
        if llh is None:
            return math.nan
        t = np.array([imu.t_ns[i] - origin])
        expected = [
            np.interp(t, truth.t_ns - origin, c) for c in (truth.lat, truth.lon, truth.height)
        ]
        found = [np.array([x]) for x in llh]
        return math.hypot(*ned_difference(*found, *expected)[0, :2])

    def ends(window: Window) -> tuple[float, float]:
        begin = origin + round(window.start_s * NS)
        over = begin + round(window.seconds * NS)
        used = (gnss.t_ns < begin) | (gnss.t_ns >= over)
        fixes = {int(i): m for m, i in enumerate(fix_at) if used[m]}
        stops = [
            int(np.searchsorted(imu.t_ns, t)) - 1 for t in (over, next_fix_ns(gnss.t_ns, over))
        ]
        with silenced():
            return walk(inslib.Ins(settings), fixes, stops)

    def walk(nav: Any, fixes: dict[int, int], stops: list[int]) -> tuple[float, float]:
        found = {}
        for i in range(stops[-1] + 1):
            nav.imu(int(imu.t_ns[i]) // 1000, steps[i], accel[i], gyro[i], accel_var, gyro_var)
            m = fixes.get(i)
            if m is not None:
                place = (gnss.lat[m], gnss.lon[m], gnss.height[m])
                nav.gnss_pos_llh(place, gnss.sd_pos[m] ** 2)
                nav.gnss_vel(gnss.vel_n[m], gnss.sd_vel[m] ** 2)
            nav.update()
            if i in stops:
                found[i] = error(nav, i)
        return found[stops[0]], found[stops[1]]

    return ends


def outage_row(
    name: str, vehicle: VehicleRecording, ends: Ends, between: bool = False
) -> list[str]:
    """One row: for each length the mean and the worst, at window's end / before the next fix."""
    cells = [name]
    for length_s in LENGTHS_S:
        found = np.array([ends(window) for window in places(vehicle, length_s, between)])
        mean, worst = found.mean(axis=0), found.max(axis=0)
        cells.append(f"{mean[0]:.1f} ≤{worst[0]:.0f} | {mean[1]:.1f} ≤{worst[1]:.0f}")
    return cells


def main(config_path: Path) -> None:
    """Print both tables."""
    vehicle = read_log([need_data("car-rtk")]).vehicles[0]
    config = load(config_path)
    truth = vehicle.truth
    assert truth is not None
    variants = {
        "inertial only": variant(config, non_holonomic=False, zero_velocity=True),
        "non-holonomic": variant(config, non_holonomic=True, zero_velocity=True),
        "inertial only, no zero velocity": variant(
            config, non_holonomic=False, zero_velocity=False
        ),
        "non-holonomic, no zero velocity": variant(config, non_holonomic=True, zero_velocity=False),
    }
    rows = []
    for name, chosen in variants.items():
        solution = solve(vehicle, chosen).solution
        errors = errors_against(solution, truth, ANTENNA_B)
        speed = np.hypot(solution.vel_n[:, 0], solution.vel_n[:, 1])
        moving_ns = int(solution.t_ns[int(np.argmax(speed > _MOVING_MPS))])
        after = errors.t_ns > moving_ns + round(_LEAD_IN_S * NS)
        whole, later = rmse(errors, solution.mode > 0), rmse(errors, after)
        rows.append(
            [name, f"{whole.position_h:.2f}", f"{whole.velocity_h:.3f}", f"{later.position_h:.2f}",
             f"{later.velocity_h:.3f}", f"{later.velocity_v:.3f}"]
        )  # fmt: skip
    print("Whole drive, RMSE against RTK: m and m/s; 'moving' from 30 s after the first motion")
    print(
        table(
            ["", "position h", "velocity h", "moving: position h", "velocity h", "velocity v"], rows
        )
    )
    print(
        f"\nHorizontal error of an outage [m], {PLACES} places one at a time: mean ≤worst"
        "\nat the end of the withheld window | at the last epoch before the next fix"
    )
    rows = [outage_row(name, vehicle, our_ends(vehicle, c)) for name, c in variants.items()]
    rows += [
        outage_row(f"{name}, halfway between", vehicle, our_ends(vehicle, variants[name]), True)
        for name in ("inertial only", "non-holonomic")
    ]
    if importlib.util.find_spec("INSLIB") is not None:
        rows += [
            outage_row("INSLIB, course heading", vehicle, inslib_ends(vehicle, config, False)),
            outage_row("INSLIB, lateral constraint", vehicle, inslib_ends(vehicle, config, True)),
        ]
    print(table(["", *(f"{length} s" for length in LENGTHS_S)], rows))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "configs" / "car.toml")
