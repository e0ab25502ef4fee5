"""Height of a flight whose receiver wanders: what can be had of it, and what one fix gives.

``python -m tests.benchmarks.height [DRAWS]``; a few seconds. The height above the datum is known up
to a constant by a barometer that walks by 2 cm/√s; the receiver has the error that the simulated
flights' README states (white 0.5 m, Gauss-Markov 1.7 m with τ = 60 s), with the outages and the
window of ``c3_outage``. The best linear estimate of the constant stands beside ArduPilot's way, the
height of the fix that sets the origin carried on by the barometer; then what the three recorded
receivers showed in their first ten seconds.
"""

from __future__ import annotations

import json
import sys

import numpy as np

from companion.types import F64
from replay.reader import read_log
from tests.benchmarks.common import NS, need_data
from tests.benchmarks.sitl import FLIGHTS

WHITE_M, SLOW_M, TAU_S, BARO_M_RTS = 0.5, 1.7, 60.0, 0.02
DT_S, FIXES_A_STEP = 0.5, 5.0  # GPS_RAW_INT at 10 Hz
START_S, ORIGIN_S = 10.0, 25.0
OURS_M, EKF3_M = 1.19, 0.36
"""What was measured on ``c3_outage``, to be placed among the draws (docs/results.md)."""


def gains(on: np.ndarray) -> tuple[F64, F64]:
    """Kalman gains (N, 2) of (constant, slow error), and the constant's variance (N,) [m²]."""
    keep = np.exp(-DT_S / TAU_S)
    F, H = np.diag([1.0, keep]), np.ones(2)
    Q = np.diag([BARO_M_RTS**2 * DT_S, SLOW_M**2 * (1.0 - keep**2)])
    P = np.diag([1e4, SLOW_M**2])
    K, var = np.zeros((len(on), 2)), np.empty(len(on))
    for i, fix in enumerate(on):
        P = F @ P @ F.T + Q
        if fix:
            K[i] = P @ H / (H @ P @ H + WHITE_M**2 / FIXES_A_STEP)
            P = P - np.outer(K[i], H @ P)
        var[i] = P[0, 0]
    return K, var


def drawn(draws: int, t: F64, K: F64, stationary: bool, rng: np.random.Generator) -> F64:
    """(N, draws) errors of the estimate, and in the last row that of the origin's fix alone."""
    keep = np.exp(-DT_S / TAU_S)
    step = SLOW_M * np.sqrt(1.0 - keep**2)
    slow = rng.normal(0.0, SLOW_M, draws) if stationary else np.zeros(draws)
    drift, constant, believed = np.zeros(draws), np.zeros(draws), np.zeros(draws)
    out = np.empty((len(t) + 1, draws))
    for i, gain in enumerate(K):
        slow = keep * slow + rng.normal(0.0, step, draws)
        drift = drift + rng.normal(0.0, BARO_M_RTS * np.sqrt(DT_S), draws)
        believed = keep * believed
        white = rng.normal(0.0, WHITE_M / np.sqrt(FIXES_A_STEP), draws)
        y = drift + slow + white - constant - believed
        constant, believed = constant + gain[0] * y, believed + gain[1] * y
        out[i] = constant - drift
        if t[i] == ORIGIN_S:
            out[-1] = slow + rng.normal(0.0, WHITE_M, draws)
    return out


def first_fixes(name: str) -> float:
    """Mean error of a recorded receiver's height over its first ten seconds of fixes [m]."""
    vehicle = read_log([need_data("sitl", f"{name}.tlog")]).vehicles[0]
    assert vehicle.truth is not None
    gnss = vehicle.gnss[0].take(vehicle.gnss[0].fix_type >= 3)
    early = gnss.take(gnss.t_ns < gnss.t_ns[0] + 10 * NS)
    return float(
        np.mean(early.height - np.interp(early.t_ns, vehicle.truth.t_ns, vehicle.truth.height))
    )


def main(draws: int) -> None:
    """Print what is to be had, how flights scatter, and how the recorded ones begin."""
    noted = json.loads(need_data("sitl", "c3_outage.ekf3.json").read_text(encoding="utf-8"))
    begin, end = noted["window_s"]
    t = np.arange(0.0, end, DT_S)
    on = t >= START_S
    for event in noted["events"]:
        on &= ~((t >= event["t"]) & (t < event["t"] + event["dur"]))
    K, var = gains(on)
    window = t >= begin
    print(
        f"claimed 1σ at {begin:.0f}, 120, 240, 400 s: "
        + ", ".join(f"{np.sqrt(var[round(s / DT_S)]):.2f}" for s in (begin, 120, 240, 400))
        + " m"
    )
    for stationary in (True, False):
        errors = drawn(draws, t, K, stationary, np.random.default_rng(0))
        best = np.sqrt(np.mean(errors[:-1][window] ** 2, axis=0))
        fix = np.abs(errors[-1])
        begun = "as stated" if stationary else "zero when switched on"
        print(f"slow error {begun}, {draws} flights")
        for who, error, seen in (("best estimate", best, OURS_M), ("one fix", fix, EKF3_M)):
            print(
                f"  {who}: RMS {np.sqrt(np.mean(error**2)):.2f}, median {np.median(error):.2f} m, "
                f"below {seen} m in {np.mean(error < seen):.0%} of flights"
            )
        print(f"  one fix is the better of the two in {np.mean(fix < best):.0%}")
    for name in FLIGHTS:
        print(f"{name}: first ten seconds of fixes, mean height error {first_fixes(name):+.2f} m")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
