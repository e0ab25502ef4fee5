"""Two real inertial units of a quadrotor (``ansfl-quad``): fused against each alone.

Run as ``python -m tests.benchmarks.several_imus``. The data set's RTK positions, thinned to 2 Hz
and made consumer grade (white, 0.5 m horizontal and 0.8 m vertical, seeded), aid; then GNSS is
withheld for five seconds at a time, and the error at the end of each outage is held against RTK.
How the second unit sits beside the first is found from the rates of one path (Wahba's problem) and
used on all of them. The paths begin in flight, with the heading unknown.
"""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from companion.config import (
    Alignment,
    Baro,
    Config,
    Constraints,
    EngineConfig,
    FurtherImu,
    Gnss,
    Imu,
    ImuFusion,
    Vehicle,
)
from companion.types import (
    F64,
    NS,
    Event,
    GnssSamples,
    ImuSamples,
    Outputs,
    ReferenceSamples,
    Samples,
    Solution,
    VehicleRecording,
)
from replay.evaluation import errors_against
from replay.player import play
from replay.preparation import withhold_gnss
from replay.window import Window
from tests.benchmarks.common import need_data, table

PATHS = ("Horizontal/path_9", "Vertical/path_1", "Horizontal/path_20")
CALIBRATED_ON = "Horizontal/path_1"
FLIP = np.diag([1.0, -1.0, -1.0])
"""The units have z up; their y is turned with it."""
RADIUS_M = 6_371_000.0
LAT, LON = math.radians(32.8257), math.radians(34.956)
T0_NS = 1_700_000_000 * NS
FIX_STEP, OUTAGE_S, SEEDS = 5, 5.0, 3


def _table(path: Path) -> tuple[list[str], F64]:
    with path.open(encoding="utf-8") as file:
        rows = list(csv.reader(file))
    return [name.strip() for name in rows[0]], np.array(rows[1:], dtype=np.float64)


def _imu(folder: Path, unit: int) -> ImuSamples:
    _, x = _table(folder / f"IMU_{unit}.csv")
    t = T0_NS + np.rint(x[:, 0] * NS).astype(np.int64)
    return ImuSamples(
        f"imu{unit}", t, t, t, np.radians(x[:, 7:10]) @ FLIP, x[:, 4:7] @ FLIP,
        np.full(len(t), np.nan),
    )  # fmt: skip


def _between(folder: Path) -> F64:
    """(3, 3) rotation from the second unit's axes to the first's, by the rates of one path."""
    one, two = _imu(folder, 1), _imu(folder, 2)
    n = min(len(one), len(two))
    u, _, vt = np.linalg.svd(one.gyro_b[:n].T @ two.gyro_b[:n])
    turn: F64 = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return turn


def _recording(folder: Path, seed: int) -> VehicleRecording:
    names, x = _table(folder / "GT.csv")
    ned = x[:, [names.index("North"), names.index("East"), names.index("Down")]]
    height = x[:, names.index("height_above_takeoff(meters)")]
    # The sign of Down differs from path to path: the height says which it is.
    ned[:, 2] = -(height - height[0])
    t = T0_NS + np.rint(x[:, 0] * NS).astype(np.int64)
    lat = LAT + ned[:, 0] / RADIUS_M
    lon = LON + ned[:, 1] / (RADIUS_M * math.cos(LAT))
    nan3 = np.full((len(t), 3), np.nan)
    truth = ReferenceSamples("rtk", t, t, t, lat, lon, 100.0 - ned[:, 2], nan3, nan3)
    at = np.arange(0, len(t), FIX_STEP)
    noise = np.random.default_rng(seed).standard_normal((len(at), 3)) * [0.5, 0.5, 0.8]
    fixes = GnssSamples(
        "rtk-thinned", t[at], t[at], t[at],
        lat[at] + noise[:, 0] / RADIUS_M, lon[at] + noise[:, 1] / (RADIUS_M * math.cos(LAT)),
        100.0 - ned[at, 2] + noise[:, 2], np.full((len(at), 3), np.nan),
        np.full((len(at), 3), np.nan), np.full((len(at), 3), np.nan),
        np.full(len(at), 12), np.full(len(at), 3),
    )  # fmt: skip
    units = [_imu(folder, 1), _imu(folder, 2)]
    blocks: list[Samples] = [*units, fixes]
    order = np.argsort(np.concatenate([b.t_rx_ns for b in blocks]), kind="stable")
    seq = np.empty(len(order), np.int64)
    seq[order] = np.arange(len(order))
    parts = np.split(seq, np.cumsum([len(b) for b in blocks])[:-1])
    one, two, gnss = (replace(b, seq=s) for b, s in zip(blocks, parts, strict=True))
    assert isinstance(one, ImuSamples)
    assert isinstance(two, ImuSamples)
    assert isinstance(gnss, GnssSamples)
    return VehicleRecording(name=folder.name, imu=(one, two), gnss=(gnss,), truth=truth)


def _config(turn: F64) -> Config:
    """A consumer unit on a shaking airframe; the second one turned as it sits."""
    axes = tuple(tuple(float(v) for v in row) for row in turn)
    return Config(
        vehicle=Vehicle(kind="multirotor"),
        imu=Imu(
            source="imu1", gyro_noise_dps_rthz=0.1, accel_noise_mps2_rthz=0.05,
            gyro_bias_sd_dps=0.5, accel_bias_sd_mps2=0.2, vibration_gain_rthz=0.02,
        ),
        further_imu=(FurtherImu(source="imu2", axes=axes),),
        imu_fusion=ImuFusion(mismatch_percent=2.0),
        gnss=Gnss(velocity=False, sd_position_m=0.5, sd_height_m=0.8),
        baro=Baro(use=False),
        constraints=Constraints(zero_velocity=False),
        alignment=Alignment(heading="unknown"),
        engine=EngineConfig(output_rate_hz=20.0),
    )  # fmt: skip


def _solved(recording: VehicleRecording, config: Config) -> tuple[Solution, list[Event]]:
    parts: list[Solution] = []
    events: list[Event] = []

    def sink(_: Samples, out: Outputs) -> None:
        parts.append(out.published)
        events.extend(out.events)

    play(recording, config, sink)
    return Solution.concatenate(parts), events


def _errors(recording: VehicleRecording, config: Config, begin_s: float) -> tuple[float, float]:
    """Position error, 3-D: RMS with all fixes from ``begin_s`` on, RMS at the ends of outages."""
    truth = recording.truth
    assert truth is not None
    solution, _ = _solved(recording, config)
    e = errors_against(solution, truth)
    late = e.t_ns > T0_NS + round(begin_s * NS)
    aided = math.sqrt(float(np.nanmean((e.position_n[late] ** 2).sum(axis=1))))
    end_s = (int(truth.t_ns[-1]) - T0_NS) / NS
    ends = []
    for start in np.arange(begin_s, end_s - OUTAGE_S, OUTAGE_S):
        cut = withhold_gnss(recording, [Window(float(start), OUTAGE_S)])
        e = errors_against(_solved(cut, config)[0], truth)
        at = np.searchsorted(e.t_ns, T0_NS + round((start + OUTAGE_S) * NS)) - 1
        ends.append(float((e.position_n[at] ** 2).sum()))
    return aided, math.sqrt(float(np.nanmean(ends)))


def main() -> None:
    """Print the table."""
    data = need_data("ansfl-quad")
    turn = _between(data / CALIBRATED_ON)
    angle = math.degrees(math.acos((np.trace(turn) - 1.0) / 2.0))
    print(f"Second unit turned by {angle:.1f} deg against the first, found on {CALIBRATED_ON}")
    both = _config(turn)
    replaced = msgspec.structs.replace
    one = replaced(both, further_imu=())
    two = replaced(one, imu=replaced(one.imu, source="imu2"))
    rows = []
    for path in PATHS:
        found: list[list[tuple[float, float]]] = [[], [], []]
        said: list[str] = []
        for seed in range(SEEDS):
            recording = _recording(data / path, seed)
            begin_s = 0.5 * float(recording.imu[0].t_ns[-1] - T0_NS) / NS
            for at, config in enumerate((both, one, two)):
                found[at].append(_errors(recording, config, begin_s))
            said += [e.kind for e in _solved(recording, both)[1] if e.kind.startswith("imu-")]
        means = np.sqrt(np.mean(np.square(found), axis=1))
        told = ", ".join(f"{k} {said.count(k)}" for k in sorted(set(said))) or "-"
        rows.append([path, *(f"{x:.2f}" for x in (*means[:, 0], *means[:, 1])), told])
    print(f"3-D position error, m RMS, {SEEDS} seeds; second half of each path; outages of "
          f"{OUTAGE_S:g} s")  # fmt: skip
    head = ["path", "aided: fused", "first", "second", "end of outage: fused", "first", "second",
            "told"]  # fmt: skip
    print(table(head, rows))


if __name__ == "__main__":
    main()
