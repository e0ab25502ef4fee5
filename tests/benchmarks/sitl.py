"""Against ArduPilot's EKF3 on the same telemetry: RMSE over nominal parts, and each GPS outage.

``python -m tests.benchmarks.sitl [CONFIG]``; about a minute. Truth is the simulator's own message
in the log and never an input. EKF3's figures stand twice: as noted beside each log in its
``ekf3.json``, and from its own GLOBAL_POSITION_INT and ATTITUDE messages, measured by the code that
measures us.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.config import Config, load
from companion.types import VehicleRecording
from replay.evaluation import as_solution
from replay.reader import read_log
from tests.benchmarks.common import (
    NS,
    ROOT,
    Errors,
    Mask,
    Rmse,
    errors_against,
    horizontal_at,
    need_data,
    next_fix_ns,
    rmse,
    solve,
    table,
)

FLIGHTS = ("c3_outage", "p1_plane_outage", "k1_can_mission")
_AFTER_S = 15.0
"""Not nominal after an outage: with this, the nominal seconds noted beside the logs come out."""
HEAD = ("", "pos h m", "pos v m", "(sd)", "vel h m/s", "vel v", "roll °", "pitch °", "yaw °")


def with_mag(config: Config, use: bool) -> Config:
    """``config`` with the magnetometer on or off."""
    replace = msgspec.structs.replace
    return replace(config, mag=replace(config.mag, use=use))


def windows(errors: Errors, noted: dict[str, Any], offset_ns: int) -> tuple[Mask, Mask]:
    """Epochs of the whole window and of its nominal part."""
    boot_s = (errors.t_ns - offset_ns) / NS
    begin, end = noted["window_s"]
    whole = (boot_s >= begin) & (boot_s <= end)
    nominal = whole.copy()
    for event in noted["events"]:
        nominal &= ~((boot_s >= event["t"]) & (boot_s <= event["t"] + event["dur"] + _AFTER_S))
    return whole, nominal


def row(name: str, r: Rmse) -> list[str]:
    """One row of :data:`HEAD`."""
    lengths = (r.position_h, r.position_v, r.position_v_sd)
    return [
        name,
        *(f"{x:.2f}" for x in lengths),
        f"{r.velocity_h:.4f}",
        f"{r.velocity_v:.4f}",
        *(f"{x:.2f}" for x in r.rpy_deg),
    ]


def noted_row(n: dict[str, float]) -> list[str]:
    """EKF3's nominal figures as they were noted beside the log."""
    rpy = (n["roll_deg"], n["pitch_deg"], n["yaw_deg"])
    return row(
        "EKF3, as noted",
        Rmse(n["pos_h_rmse_m"], n["pos_v_rmse_m"], n["pos_v_std"], n["vel_h_rmse"],
             n["vel_v_rmse"], rpy),
    )  # fmt: skip


def ends(
    vehicle: VehicleRecording,
    errors: Errors,
    config: Config,
    events: Sequence[dict[str, Any]],
    offset_ns: int,
) -> list[float]:
    """Horizontal error at the last epoch before the first fix after each outage [m]."""
    gnss = vehicle.gnss[0]
    valid_ns = gnss.t_ns[gnss.fix_type >= 3] - round(config.gnss.latency_ms * 1e6)
    found = []
    for event in events:
        # A little into the outage: the fix that was under way when it began is before it.
        inside = offset_ns + round((event["t"] + 0.5 * event["dur"]) * NS)
        found.append(horizontal_at(errors, next_fix_ns(valid_ns, inside)))
    return found


def flight(name: str, config: Config) -> dict[str, list[float]]:
    """Print one flight's tables; the outages' end errors by solution."""
    noted = json.loads(need_data("sitl", f"{name}.ekf3.json").read_text(encoding="utf-8"))
    recording = read_log([need_data("sitl", f"{name}.tlog")])
    vehicle = recording.vehicles[0]
    offset_ns = int(recording.metadata[f"{vehicle.name}.boot_offset_ns"])
    assert vehicle.truth is not None
    assert vehicle.autopilot is not None
    solutions = {
        "ours, IMU GPS baro": solve(vehicle, with_mag(config, False)).solution,
        "ours, and magnetometer": solve(vehicle, with_mag(config, True)).solution,
        "EKF3, its messages": as_solution(vehicle.autopilot),
    }
    nominal_rows, whole_rows, end_errors = [], [], {}
    seconds = 0.0
    for who, solution in solutions.items():
        errors = errors_against(solution, vehicle.truth)
        whole, nominal = windows(errors, noted, offset_ns)
        nominal_rows.append(row(who, rmse(errors, nominal)))
        whole_rows.append(row(who, rmse(errors, whole)))
        end_errors[who] = ends(vehicle, errors, config, noted["events"], offset_ns)
        if who.startswith("ours"):
            seconds = float(np.count_nonzero(nominal)) * float(np.median(np.diff(errors.t_ns))) / NS
    print(f"\n{name}: nominal {seconds:.1f} s (noted: {noted['nominal_seconds']} s)")
    print(table(HEAD, [*nominal_rows, noted_row(noted["ekf3_nominal"])]))
    if not noted["events"]:
        return {}
    print("the whole window, outages included")
    print(table(HEAD, whole_rows))
    end_errors["EKF3, as noted"] = [event["err_end"] for event in noted["events"]]
    print("horizontal error at the end of each outage [m]")
    lengths = [f"{event['dur']:.0f} s" for event in noted["events"]]
    print(
        table(
            ["", *lengths, "mean"],
            [
                [who, *(f"{x:.2f}" for x in found), f"{np.mean(found):.2f}"]
                for who, found in end_errors.items()
            ],
        )
    )
    return end_errors


def main(config_path: Path | None) -> None:
    """Print the tables of all flights, each vehicle with its own configuration or the given one."""
    for name in FLIGHTS:
        own = "sitl-plane.toml" if "plane" in name else "sitl.toml"
        flight(name, load(config_path or ROOT / "configs" / own))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
