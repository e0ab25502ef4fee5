"""smsfusion's AidedINS (extra ``bench``) on the samples that our engine gets.

It knows neither a rotating Earth nor late fixes: it is given a flat frame at its start and each fix
at the sample at which it is valid. It starts from the true state, warm, with 15 states.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from companion.config import DEG, Config
from companion.navigation.earth import gravity, ned_difference
from companion.navigation.rotation import quat_from_rpy
from companion.types import F64, VehicleRecording


def available() -> bool:
    """Whether the package is installed."""
    return importlib.util.find_spec("smsfusion") is not None


def make(vehicle: VehicleRecording, config: Config) -> tuple[Callable[[], Any], Callable[[], F64]]:
    """(a timed pass over the whole recording, an untimed one that returns its position errors).

    The errors are (M, 3) NED [m] at the fixes.
    """
    # By name: it is an optional package without types.
    AidedINS = importlib.import_module("smsfusion").AidedINS
    imu, gnss, truth = vehicle.imu[0], vehicle.gnss[0], vehicle.truth
    assert truth is not None
    place = np.searchsorted(imu.t_ns, gnss.t_ns).tolist()
    origin = truth.lat[0], truth.lon[0], truth.height[0]
    start = [np.full(1, x) for x in origin]
    at_fix = [
        np.interp(gnss.t_ns - gnss.t_ns[0], truth.t_ns - gnss.t_ns[0], column)
        for column in (truth.lat, truth.lon, truth.height)
    ]
    measured = ned_difference(gnss.lat, gnss.lon, gnss.height, *start)
    expected = ned_difference(at_fix[0], at_fix[1], at_fix[2], *start)
    fixes = dict(
        zip(
            place,
            zip(measured, gnss.vel_n, gnss.sd_pos**2, gnss.sd_vel**2, strict=True),
            strict=True,
        )
    )
    state = np.zeros(16)
    state[3:6] = truth.vel_n[0]
    state[6:10] = quat_from_rpy(*truth.rpy[0])
    spec = config.imu
    P0 = np.diag(
        np.repeat(
            [1.0, 0.01, DEG**2, spec.accel_bias_sd_mps2**2, (spec.gyro_bias_sd_dps * DEG) ** 2], 3
        )
    )
    tau_s = 300.0
    spread = math.sqrt(tau_s / 2.0)

    def begin() -> Any:
        return AidedINS(
            1e9 / float(np.median(np.diff(imu.t_ns))),
            x0_prior=state.copy(),
            P0_prior=P0.copy(),
            err_acc={
                "N": spec.accel_noise_mps2_rthz,
                "B": spec.accel_bias_walk_mps2_rts * spread,
                "tau_cb": tau_s,
            },
            err_gyro={
                "N": spec.gyro_noise_dps_rthz * DEG,
                "B": spec.gyro_bias_walk_dps_rts * DEG * spread,
                "tau_cb": tau_s,
            },
            g=float(gravity(origin[0], origin[2])),
            ignore_bias_acc=False,
            cold_start=False,
        )

    def walk(after_fix: Callable[[Any], None] | None) -> None:
        ins = begin()
        for i, (f, w) in enumerate(zip(imu.accel_b, imu.gyro_b, strict=True)):
            fix = fixes.get(i)
            if fix is None:
                ins.update(f, w)
                continue
            ins.update(f, w, pos=fix[0], pos_var=fix[2], vel=fix[1], vel_var=fix[3])
            if after_fix is not None:
                after_fix(ins)

    def errors() -> F64:
        found: list[F64] = []
        walk(lambda ins: found.append(ins.position()))
        return np.array(found) - expected[: len(found)]

    return lambda: walk(None), errors
