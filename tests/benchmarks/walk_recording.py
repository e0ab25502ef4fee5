"""The handheld walk of ``rtk-walk`` as a recording: IMU, raw GNSS, and the receiver's own RTK.

The IMU's file is in g and deg/s with milliseconds of its own clock; the file beside it that was
filtered tells what time that is. Axes: z up, turned over to body FRD.

Run as ``python -m tests.benchmarks.walk_recording`` for what the gyro is worth in motion.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from companion.gnss.gps_time import GPS_EPOCH_POSIX_S
from companion.navigation.rotation import quat_to_matrix, rotate_body
from companion.types import NS, ImuSamples, ReferenceSamples, VehicleRecording
from replay.raw_gnss.folder import on_clock
from replay.raw_gnss.ubx import read_ubx
from replay.streams import numbered

G0 = 9.80665
_TICK_MS, _TICK_NS = 3_326_345, 1_756_402_240_961_000_000
"""The same sample in both files: its tick, and its time as POSIX nanoseconds of GPS time."""

CONFIG = """
[vehicle]
kind = "handheld"
[imu]
gyro_noise_dps_rthz = 0.05  # swung in the hand, not at rest: see tilt_between_rests
accel_noise_mps2_rthz = 0.02
gyro_bias_sd_dps = 0.5
accel_bias_sd_mps2 = 0.3
[gnss]
latency_sd_ms = 5.0
lever_arm_sd_m = 0.5      # the antenna is carried beside the IMU; how far is not known
[baro]
use = false
[raw_gnss]
clock = "gps"
coupling = "{coupling}"
"""


def walk(folder: Path) -> VehicleRecording:
    """The recording from ``rtk-walk``; the truth is the receiver's RTK place and velocity."""
    lines = [line.split(",") for line in (folder / "imu_1730.csv").read_text().splitlines()]
    rows = np.array([[float(c) for c in cells] for cells in lines if len(cells) == 7][1:-1])
    t = (rows[:, 6].astype(np.int64) - _TICK_MS) * 1_000_000 + _TICK_NS
    fresh = np.r_[True, np.diff(t) > 0]
    over = np.array([1.0, -1.0, -1.0])
    n = int(fresh.sum())
    imu = ImuSamples(
        "imu", t[fresh], t[fresh], np.arange(n), np.radians(rows[fresh, 3:6]) * over,
        rows[fresh, :3] * G0 * over, np.full(n, np.nan),
    )  # fmt: skip
    raw, broadcast, fixes, _ = read_ubx(folder / "gnss_1730.ubx")
    assert fixes is not None
    raw, fixes = on_clock(raw, "gps"), on_clock(fixes, "gps")
    start = np.full(len(broadcast), raw.t_ns[0])
    broadcast = type(broadcast)(
        broadcast.source, start, start, broadcast.seq, broadcast.sat, broadcast.values
    )
    truth = ReferenceSamples(
        "rtk", fixes.t_ns, fixes.t_rx_ns, fixes.seq, fixes.lat, fixes.lon, fixes.height,
        fixes.vel_n, np.full((len(fixes), 3), np.nan),
    )  # fmt: skip
    [imu], [broadcast], [raw], [truth] = numbered([[imu], [broadcast], [raw], [truth]])
    assert raw.t_ns[0] > GPS_EPOCH_POSIX_S * NS
    return VehicleRecording("walk", imu=(imu,), raw=(raw,), broadcast=(broadcast,), truth=truth)


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


def main() -> None:
    folder = Path(__file__).resolve().parents[3] / "shared" / "data" / "rtk-walk"
    tilt, seconds = tilt_between_rests(walk(folder).imu[0])
    noise = tilt / np.sqrt(2.0 * seconds)
    print(f"The gyro alone tilts by {tilt:.2f} deg in {seconds:.0f} s between two rests:")
    print(f"as white noise of each of two axes {noise:.2f} deg/s/√Hz")


if __name__ == "__main__":
    main()
