"""The handheld walk of ``rtk-walk`` as a recording: IMU, raw GNSS, and the receiver's own RTK.

The IMU's file is in g and deg/s with milliseconds of its own clock; the file beside it that was
filtered tells what time that is. Axes: z up, turned over to body FRD.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from companion.gnss.gps_time import GPS_EPOCH_POSIX_S
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
gyro_noise_dps_rthz = 0.03  # swung in the hand, not at rest: see walk_gyro.py
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
