"""A real DroneCAN IMU beside MAVLink GPS, replayed as one run, against the autopilot's own IMU.

``python -m tests.benchmarks.can_imu``; about a minute. The bus was recorded by candump while the
telemetry was logged: AP_Periph's RawIMU, about 160 Hz and irregular, integrals free of the filter
that HIGHRES_IMU has passed. Truth is the simulator's own message and never an input.
"""

from __future__ import annotations

import json

import msgspec
import numpy as np

from companion.config import Config, load
from companion.types import VehicleRecording
from replay.evaluation import as_solution
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
from tests.benchmarks.sitl import HEAD, noted_row, row, windows, with_mag

NAME = "k1_can_mission"
_OUTAGES = tuple(Window(start, 30.0) for start in (110.0, 170.0, 230.0, 290.0))
"""GPS withheld, in the mission's legs; seconds from the start of the recording."""


def with_imu(config: Config, source: str, latency_ms: float) -> Config:
    """``config`` with another inertial stream; its magnetometer off."""
    replace = msgspec.structs.replace
    imu = replace(config.imu, source=source, latency_ms=latency_ms)
    return with_mag(replace(config, imu=imu), False)


def ends(vehicle: VehicleRecording, config: Config) -> list[float]:
    """Horizontal error [m] just before the first fix after each withheld window."""
    result = solve(vehicle, config, _OUTAGES)
    assert vehicle.truth is not None
    errors = errors_against(result.solution, vehicle.truth)
    gnss = result.vehicle.gnss[0]
    valid_ns = gnss.t_ns[gnss.fix_type >= 3] - round(config.gnss.latency_ms * 1e6)
    middle = [start_ns(vehicle) + round((w.start_s + 0.5 * w.seconds) * NS) for w in _OUTAGES]
    return [horizontal_at(errors, next_fix_ns(valid_ns, t)) for t in middle]


def main() -> None:
    """Print errors over the nominal window, then at the end of withheld GPS."""
    noted = json.loads(need_data("sitl", f"{NAME}.ekf3.json").read_text(encoding="utf-8"))
    bus = need_data("sitl", f"{NAME}.candump.log.gz")
    recording = read_log([bus, need_data("sitl", f"{NAME}.tlog")])
    vehicle = recording.vehicles[0]
    assert vehicle.truth is not None
    assert vehicle.autopilot is not None
    offset_ns = int(recording.metadata[f"{vehicle.name}.boot_offset_ns"])
    base = load(ROOT / "configs" / "sitl.toml")
    settings = {
        # Its integrals have passed no filter; HIGHRES_IMU's has 10 ms.
        "ours, CAN IMU": with_imu(base, vehicle.imu[0].source, 0.0),
        "ours, HIGHRES_IMU": with_imu(base, "HIGHRES_IMU", 10.0),
    }
    rows = []
    solutions = {who: solve(vehicle, config).solution for who, config in settings.items()}
    solutions["EKF3, its messages"] = as_solution(vehicle.autopilot)
    for who, solution in solutions.items():
        errors = errors_against(solution, vehicle.truth)
        rows.append(row(who, rmse(errors, windows(errors, noted, offset_ns)[1])))
    for note in recording.notes:
        print(note)
    print(f"\n{NAME}, CAN and telemetry as one run: {noted['nominal_seconds']} s")
    print(table(HEAD, [*rows, noted_row(noted["ekf3_nominal"])]))
    print("horizontal error at the end of 30 s without GPS [m]")
    heads = [f"{w.start_s:.0f} s" for w in _OUTAGES]
    lines = [
        [who, *(f"{x:.2f}" for x in found), f"{np.mean(found):.2f}"]
        for who, found in ((who, ends(vehicle, config)) for who, config in settings.items())
    ]
    print(table(["", *heads, "mean"], lines))


if __name__ == "__main__":
    main()
