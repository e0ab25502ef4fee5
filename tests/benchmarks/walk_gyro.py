"""What the gyro of the walk is worth, swung in a hand: the noise that the filter is to be given.

Run as ``python -m tests.benchmarks.walk_gyro``. A datasheet says the noise of a unit at rest; in
the hand scale and axes err with every swing. Looked at in two ways: what the gyro alone tilts by
between two rests, and, for several densities, whether coasting without any satellite is as far off
as the filter says, NEES of the horizontal place over windows every six seconds. The density is
chosen by loose coupling, the baseline of what it is used for: where its NEES is nearest to 2.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from companion.config import Config, parse
from companion.navigation.rotation import quat_to_matrix, rotate_body
from companion.types import F64, NS, ImuSamples, VehicleRecording
from tests.benchmarks import tight_coupling as tight
from tests.benchmarks.walk_recording import CONFIG, walk

DENSITIES = 0.02, 0.03, 0.04, 0.05, 0.12
STARTS_S = tuple(float(t) for t in range(30, 101, 6))
LENGTHS_S = tight.LENGTHS_S
RESTS_S = (7.2, 8.9), (116.0, 128.0)
"""The unit lies still before and after the walk."""


def tilt_between_rests(imu: ImuSamples) -> tuple[float, float]:
    """Tilt error [deg] of the gyro alone from one rest to the other, and seconds in between.

    Its bias is the line through both rests; level is what the accelerometer says in each, whose
    bias is the same in both to first order. Nothing else has a part in it, GNSS least of all.
    """
    t = (imu.t_ns - imu.t_ns[0]) / NS
    rests = [(t > a) & (t < b) for a, b in RESTS_S]
    bias = [imu.gyro_b[rest].mean(axis=0) for rest in rests]
    down = [imu.accel_b[rest].mean(axis=0) for rest in rests]
    begin, end = RESTS_S[0][1], RESTS_S[1][0]
    between = np.flatnonzero((t >= begin) & (t <= end))
    part = ((t - begin) / (end - begin))[:, None]
    rate = imu.gyro_b - bias[0] - part * (bias[1] - bias[0])
    q, C = np.array([1.0, 0.0, 0.0, 0.0]), np.empty((3, 3))
    for i in between[1:]:
        turn = 0.5 * (rate[i - 1] + rate[i]) * (t[i] - t[i - 1])
        rotate_body(q, *turn.tolist())
    quat_to_matrix(q, C)
    foreseen, seen = (d / np.linalg.norm(d) for d in (C.T @ down[0], down[1]))
    return float(np.degrees(np.arccos(foreseen @ seen))), end - begin


def coasting_nees(vehicle: VehicleRecording, config: Config) -> list[float]:
    """NEES of the horizontal place, which 2 is honest for, at the end of :data:`LENGTHS_S`."""
    origin = int(vehicle.imu[0].t_ns[0])
    t, e = tight.errors(vehicle, tight.published(vehicle, config))
    base = e[t > origin + round(tight.OPEN_S * NS)].mean(axis=0)
    found: list[list[float]] = [[] for _ in LENGTHS_S]
    for start in STARTS_S:
        begin = origin + round(start * NS)
        ends = [begin + round(length * NS) for length in LENGTHS_S]
        part = tight.withheld(vehicle, begin, ends[-1], tight.NO_SATELLITE)
        solution = tight.published(part, config)
        t, e = tight.errors(part, solution)
        for n, end in enumerate(ends):
            at = int(np.searchsorted(t, end)) - 1
            if t[at] < end - NS:
                continue  # the walk is over
            cov = solution.cov[int(np.searchsorted(solution.t_ns, t[at])), 0]
            P: F64 = np.array([[cov[0], cov[1]], [cov[1], cov[3]]])
            off = (e[at] - base)[:2]
            found[n].append(float(off @ np.linalg.solve(P, off)))
    return [float(np.mean(one)) for one in found]


def main() -> None:
    vehicle = walk(Path(tight.DATA))
    tilt, seconds = tilt_between_rests(vehicle.imu[0])
    noise = tilt / np.sqrt(2.0 * seconds)
    print(f"The gyro alone tilts by {tilt:.2f} deg in {seconds:.0f} s between two rests:")
    print(f"as white noise of each of two axes {noise:.2f} deg/s/√Hz")
    print(f"\nNEES of the place without satellites, {len(STARTS_S)} windows; 2 is honest")
    head = "".join(f"{f'after {length:.0f} s':>12}" for length in LENGTHS_S)
    print(f"{'deg/s/√Hz':>10} {'coupling':>9}{head}")
    given = parse(CONFIG.format(coupling="tight")).imu.gyro_noise_dps_rthz
    for density in DENSITIES:
        for coupling in ("loose", "tight"):
            text = CONFIG.replace(f"= {given}", f"= {density}").format(coupling=coupling)
            cells = "".join(f"{x:12.2f}" for x in coasting_nees(vehicle, parse(text)))
            print(f"{density:10.2f} {coupling:>9}{cells}", flush=True)


if __name__ == "__main__":
    main()
