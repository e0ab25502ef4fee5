"""How near the off-line smoothers come to a batch solution of the whole flight, and for what time.

``python -m tests.benchmarks.smoothing_optimality [SECONDS]``; some minutes for the hour. The batch
is gtsam's (extra ``bench``): Levenberg-Marquardt over a factor graph with a node at every fix of
5 Hz, outages included, CombinedImuFactor between neighbours, and the fixes' positions and
velocities, all with the noise that was simulated and that the filter is told. gtsam's Earth is flat
and at rest, so what the rotating one adds is taken off the inertial increments beforehand, and the
increments are those of our mechanisation (coning, sculling): the same model, solved otherwise.
Times are CPU of building and solving, without the simulation and that preparation.
"""

from __future__ import annotations

import importlib
import sys
import time
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from companion.config import DEG, Config
from companion.navigation import earth
from companion.smoothing.offline import smooth
from companion.types import F64, I64, NS, Solution, VehicleRecording
from replay.preparation import withhold_gnss
from replay.recorded import record
from replay.simulator import load_scenario, matching_config, simulate
from replay.simulator.aids import GnssSpec
from replay.simulator.scenarios import graded
from replay.smoothing import Method, record_for, smoothed
from replay.window import Window
from tests.benchmarks.common import table

RATE_HZ = 5.0
HEADING_DEG = 30.0
_SURE_HEADING_DEG = 2.0


def flight(seconds: float) -> tuple[VehicleRecording, Config, list[Window]]:
    """A flight with just the errors that are modelled, an outage of 10 to 60 s every 5 minutes."""
    base = load_scenario("multirotor-mission")
    replace = msgspec.structs.replace
    scenario = replace(
        base,
        trajectory=replace(base.trajectory, duration_s=seconds, heading_deg=HEADING_DEG),
        imu=(graded("mems-consumer", rate_hz=100.0).modelled_only(),),
        gnss=(GnssSpec(correlated_sd_position_m=0.0, correlated_sd_height_m=0.0),),
        baro=None,
        mag=None,
    )
    config = matching_config(scenario)
    config = replace(
        config,
        alignment=replace(config.alignment, heading="fixed", fixed_heading_deg=HEADING_DEG),
        mag=replace(config.mag, sd_deg=_SURE_HEADING_DEG),
        constraints=replace(config.constraints, zero_velocity=False),
        # The batch takes every fix.
        source_faults=replace(config.source_faults, detect=False),
        engine=replace(config.engine, gate_probability=1.0 - 1e-12),
    )
    starts = np.arange(100.0, seconds - 80.0, 300.0)
    lengths = (10.0, 20.0, 30.0, 60.0)
    windows = [Window(float(s), lengths[i % 4]) for i, s in enumerate(starts)]
    return withhold_gnss(simulate(scenario, seed=1), windows), config, windows


@dataclass(frozen=True)
class FlatEarth:
    """Axes north, east, down of one place, and inertial increments as if it did not rotate."""

    origin: F64
    """ECEF [m]."""
    C_te: F64
    gravity: float
    gyro: F64
    """(N, 3) mean rate over the interval behind each sample [rad/s]; the first row is not used."""
    accel: F64
    """(N, 3) mean specific force, in the axes of the interval's start [m/s²]."""

    def place(self, lat: F64, lon: F64, height: F64) -> F64:
        """(N, 3) position [m]."""
        return np.asarray((earth.ecef(lat, lon, height) - self.origin) @ self.C_te.T)


def _axes(lat: F64, lon: F64) -> F64:
    """(N, 3, 3) C_ne: rows north, east, down in ECEF."""
    s, c, sl, cl = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    zero = np.zeros_like(s)
    return np.stack(
        [
            np.stack([-s * cl, -s * sl, c], axis=-1),
            np.stack([-sl, cl, zero], axis=-1),
            np.stack([-c * cl, -c * sl, -s], axis=-1),
        ],
        axis=-2,
    )


def _matrices(q: F64) -> F64:
    """(N, 3, 3) C_nb."""
    w, x, y, z = q.T
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def flat_earth(vehicle: VehicleRecording, track: Solution) -> FlatEarth:
    """The inertial samples at the epochs of ``track``, one each, for a flat Earth at rest.

    ``track`` says where and how the vehicle was: to a metre and a milliradian is enough for what
    Earth rate, Coriolis force and the bend of gravity add.
    """
    imu = vehicle.imu[0]
    at = np.searchsorted(imu.t_ns, track.t_ns)
    w1, f1 = imu.gyro_b[at], imu.accel_b[at]
    w0, f0 = np.roll(w1, 1, axis=0), np.roll(f1, 1, axis=0)
    dt = np.diff(track.t_ns, prepend=track.t_ns[0] - 1)[:, None] / NS
    k = dt * dt / 12.0
    dtheta = 0.5 * (w0 + w1) * dt + k * np.cross(w0, w1)
    dvel = 0.5 * (f0 + f1) * dt
    turned = np.cross(dtheta, dvel)
    dvel = dvel + 0.5 * turned + np.cross(dtheta, turned) / 6.0
    dvel += k * (np.cross(w0, f1) + np.cross(f0, w1))
    C_ne = _axes(track.lat, track.lon)
    C_te = C_ne[0]
    C_tn = C_te @ C_ne.transpose(0, 2, 1)
    C_bt = (C_tn @ _matrices(track.q_nb)).transpose(0, 2, 1)
    rate_t = C_te @ np.array([0.0, 0.0, earth.RATE])
    local = np.array([earth.gravity(*x) for x in zip(track.lat, track.height, strict=True)])
    gravity = C_tn[:, :, 2] * local[:, None]
    gravity0 = float(local[0])
    vel_t = (C_tn @ track.vel_n[:, :, None])[:, :, 0]
    extra = gravity - [0.0, 0.0, gravity0] - 2.0 * np.cross(rate_t, vel_t)
    # Of the interval's two ends; the body axes are those of its start.
    mean = 0.5 * (extra + np.roll(extra, 1, axis=0))
    start = np.roll(C_bt, 1, axis=0)
    dvel += (start @ mean[:, :, None])[:, :, 0] * dt
    dtheta -= (start @ rate_t) * dt
    origin = earth.ecef(track.lat[:1], track.lon[:1], track.height[:1])[0]
    return FlatEarth(origin, C_te, gravity0, dtheta / dt, dvel / dt)


class Batch:
    """The factor graph of a flight."""

    def __init__(self, gtsam: Any, config: Config, flat: FlatEarth) -> None:
        self._g = gtsam
        self._flat = flat
        params = gtsam.PreintegrationCombinedParams.MakeSharedD(flat.gravity)
        imu = config.imu
        params.setAccelerometerCovariance(np.eye(3) * imu.accel_noise_mps2_rthz**2)
        params.setGyroscopeCovariance(np.eye(3) * (imu.gyro_noise_dps_rthz * DEG) ** 2)
        params.setBiasAccCovariance(np.eye(3) * imu.accel_bias_walk_mps2_rts**2)
        params.setBiasOmegaCovariance(np.eye(3) * (imu.gyro_bias_walk_dps_rts * DEG) ** 2)
        params.setIntegrationCovariance(np.eye(3) * 1e-12)
        self._params = params
        self._config = config
        self._graph = gtsam.NonlinearFactorGraph()
        self._values = gtsam.Values()

    def build(self, vehicle: VehicleRecording, track: Solution, nodes: I64) -> None:
        """Nodes at the rows ``nodes`` of ``track``, which is also where the iteration starts."""
        g, flat = self._g, self._flat
        noise = g.noiseModel.Diagonal.Sigmas
        X, V, B = (g.symbol_shorthand.X, g.symbol_shorthand.V, g.symbol_shorthand.B)
        rows = track.take(nodes)
        C_tn = flat.C_te @ _axes(rows.lat, rows.lon).transpose(0, 2, 1)
        C_tb = C_tn @ _matrices(rows.q_nb)
        place = flat.place(rows.lat, rows.lon, rows.height)
        vel = (C_tn @ rows.vel_n[:, :, None])[:, :, 0]
        for i in range(len(nodes)):
            bias = g.imuBias.ConstantBias(rows.accel_bias_b[i], rows.gyro_bias_b[i])
            self._values.insert(X(i), g.Pose3(g.Rot3(C_tb[i]), place[i]))
            self._values.insert(V(i), vel[i])
            self._values.insert(B(i), bias)
            if i:
                self._between(i, int(nodes[i - 1]), int(nodes[i]), bias)
        self._start(C_tb[0], place[0])
        fixes = vehicle.gnss[0]
        at = np.searchsorted(rows.t_ns, fixes.t_ns)
        seen = flat.place(fixes.lat, fixes.lon, fixes.height)
        C_fix = flat.C_te @ _axes(fixes.lat, fixes.lon).transpose(0, 2, 1)
        vel_fix = (C_fix @ fixes.vel_n[:, :, None])[:, :, 0]
        gnss = self._config.gnss
        sd = noise([gnss.sd_position_m, gnss.sd_position_m, gnss.sd_height_m])
        sd_vel = noise([gnss.sd_velocity_mps, gnss.sd_velocity_mps, gnss.sd_velocity_down_mps])
        for m, i in enumerate(at.tolist()):
            if i < len(nodes) and rows.t_ns[i] == fixes.t_ns[m]:
                self._graph.add(g.GPSFactor(X(i), seen[m], sd))
                self._graph.add(g.PriorFactorVector(V(i), vel_fix[m], sd_vel))

    def _between(self, i: int, begin: int, end: int, bias: Any) -> None:
        g, flat = self._g, self._flat
        X, V, B = (g.symbol_shorthand.X, g.symbol_shorthand.V, g.symbol_shorthand.B)
        sum_ = g.PreintegratedCombinedMeasurements(self._params, bias)
        step = 1.0 / 100.0
        for k in range(begin + 1, end + 1):
            sum_.integrateMeasurement(flat.accel[k], flat.gyro[k], step)
        self._graph.add(g.CombinedImuFactor(X(i - 1), V(i - 1), X(i), V(i), B(i - 1), B(i), sum_))

    def _start(self, C_tb: F64, place: F64) -> None:
        """What is known at the first node: heading and biases as configured, the rest hardly."""
        g, imu = self._g, self._config.imu
        noise = g.noiseModel.Diagonal.Sigmas
        # Attitude errors are of the body, which is nearly level at the start.
        tilt, heading = 0.05, self._config.mag.sd_deg * DEG
        sd = noise([tilt, tilt, heading, 100.0, 100.0, 100.0])
        X, B = g.symbol_shorthand.X, g.symbol_shorthand.B
        level = g.Pose3(g.Rot3.Ypr(HEADING_DEG * DEG, *g.Rot3(C_tb).ypr()[1:]), place)
        self._graph.add(g.PriorFactorPose3(X(0), level, sd))
        spread = [imu.accel_bias_sd_mps2] * 3 + [imu.gyro_bias_sd_dps * DEG] * 3
        self._graph.add(g.PriorFactorConstantBias(B(0), g.imuBias.ConstantBias(), noise(spread)))

    def solve(self, count: int) -> tuple[F64, int]:
        """Positions of the nodes (count, 3), and how many iterations it took."""
        g = self._g
        optimizer = g.LevenbergMarquardtOptimizer(self._graph, self._values)
        values = optimizer.optimize()
        X = g.symbol_shorthand.X
        place = np.array([values.atPose3(X(i)).translation() for i in range(count)])
        return place, int(optimizer.iterations())


def main(seconds: float) -> None:
    """Print the table."""
    try:
        gtsam = importlib.import_module("gtsam")
    except ImportError:
        sys.exit("gtsam is not installed: pip install gtsam")
    vehicle, config, windows = flight(seconds)
    ours: dict[Method, tuple[Solution, float]] = {}
    for method in ("bryson-frazier", "two-filter", "two-filter-straight"):
        begin = time.process_time()
        run = record_for(method, vehicle, config, rate_hz=2 * RATE_HZ, covariance=False)
        ours[method] = smoothed(run, method), time.process_time() - begin
    dense = record(vehicle, config, rate_hz=100.0, covariance=False)
    forward = dense.solution
    flat = flat_earth(vehicle, smooth(dense.tapes, dense.config))
    step = round(NS / RATE_HZ)
    origin = int(vehicle.imu[0].t_ns[0])
    nodes = np.flatnonzero((forward.t_ns - origin) % step == 0)
    begin = time.process_time()
    batch = Batch(gtsam, config, flat)
    batch.build(vehicle, forward, nodes)
    built = time.process_time() - begin
    place, iterations = batch.solve(len(nodes))
    cpu = time.process_time() - begin
    t = forward.t_ns[nodes]
    truth = vehicle.truth
    assert truth is not None
    at = np.searchsorted(truth.t_ns, t)
    true = flat.place(truth.lat[at], truth.lon[at], truth.height[at])
    assert np.array_equal(truth.t_ns[at], t)
    since = (t - origin) / NS
    out = np.any([(since >= w.start_s) & (since <= w.start_s + w.seconds) for w in windows], axis=0)
    rows = [_row("gtsam", place - place, place - true, out, cpu, cpu)]
    rows[0][1] = rows[0][2] = ""
    for method, (solution, spent) in ours.items():
        here = solution.take(np.searchsorted(solution.t_ns, t))
        assert np.array_equal(here.t_ns, t)
        track = flat.place(here.lat, here.lon, here.height)
        rows.append(_row(method, track - place, track - true, out, spent, cpu))
    print(
        f"{seconds:.0f} s of flight at 100 Hz, {len(nodes)} nodes, {len(windows)} outages of 10 to "
        f"60 s; gtsam built its graph in {built:.1f} s and took {iterations} iterations"
    )
    head = ["RMS m, 3-D", "off the batch", "in outages", "error", "in outages", "CPU s", "share"]
    print(table(head, rows))


def _row(name: str, off: F64, error: F64, out: F64, spent: float, batch: float) -> list[str]:
    def rms(x: F64) -> str:
        return f"{np.sqrt(np.mean(np.sum(x**2, axis=1))):.4f}"

    return [
        name, rms(off), rms(off[out]), rms(error), rms(error[out]),
        f"{spent:.1f}", f"{100 * spent / batch:.0f} %",
    ]  # fmt: skip


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 3600.0)
