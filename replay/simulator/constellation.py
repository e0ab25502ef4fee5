"""A made-up sky: satellites on nominal orbits, and what a moving receiver measures of them.

Ranges are made the other way round than they are used: the moment of transmission is searched for,
and the satellite is turned with the Earth while its signal travels, instead of corrected for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion._jit import njit
from companion.gnss.atmosphere import klobuchar, troposphere
from companion.gnss.geometry import geodetic, ned_axes
from companion.gnss.orbit import (
    E_ACCURACY,
    E_AF0,
    E_AF1,
    E_ECC,
    E_GROUP_DELAY,
    E_I0,
    E_ISSUE,
    E_M0,
    E_OMEGA,
    E_OMEGA0,
    E_SAT,
    E_SQRT_A,
    E_TOC,
    E_TOC_WEEK,
    E_TOE,
    E_TOE_OWN,
    E_WEEK,
    EPHEMERIS_SIZE,
    MU,
    MU_GPS,
    OMEGA_E_GPS,
    satellite_at,
)
from companion.gnss.systems import (
    BDT_BEHIND_GPST_S,
    BEIDOU,
    CARRIER_HZ,
    GALILEO,
    GPS,
    L1_HZ,
    C,
    satellite,
)
from companion.types import F64, I64, SATELLITES, BroadcastSamples, RawGnssSamples

PLANES = {
    GPS: (6, 5, 26_560e3, 55.0),
    GALILEO: (3, 8, 29_600e3, 56.0),
    BEIDOU: (3, 8, 27_906e3, 55.0),
}
"""Planes, satellites in each, semi-major axis [m], inclination [deg]."""
FIRST_PRN = {GPS: 1, GALILEO: 1, BEIDOU: 19}
EVERY_S = 7_200
IONOSPHERE = np.array([1.1e-8, 7.5e-9, -6e-8, -6e-8, 9e4, 0.0, -2e5, -6.5e4])


def ephemerides(systems: tuple[int, ...], week: int, start: float, end: float) -> list[F64]:
    """Rows for every satellite and every two hours that touch ``start`` … ``end`` [s of week]."""
    rows = []
    for system in systems:
        planes, slots, a, tilt = PLANES[system]
        motion = math.sqrt((MU_GPS if system == GPS else MU) / a**3)
        own = BDT_BEHIND_GPST_S if system == BEIDOU else 0.0
        for k in range(planes * slots):
            plane, slot = divmod(k, slots)
            first = math.floor(start / EVERY_S)
            for issue, toe in enumerate(range(first * EVERY_S, int(end) + EVERY_S, EVERY_S)):
                row = np.zeros(EPHEMERIS_SIZE)
                row[E_SAT] = satellite(system, FIRST_PRN[system] + k)
                row[E_WEEK] = row[E_TOC_WEEK] = week
                row[E_TOE] = row[E_TOC] = toe
                row[E_TOE_OWN] = toe - own
                row[E_SQRT_A], row[E_ECC] = math.sqrt(a), 0.002 + 0.0007 * (k % 7)
                row[E_I0] = math.radians(tilt)
                # Nodes at week's start; a fixed orbit keeps its node and only moves along.
                row[E_OMEGA0] = 2 * math.pi * plane / planes - OMEGA_E_GPS * own
                row[E_OMEGA] = 0.3 * k
                row[E_M0] = 2 * math.pi * (slot / slots + plane / (planes * slots)) + motion * toe
                row[E_AF0], row[E_AF1] = 1e-5 * math.sin(k), 1e-12 * math.cos(k)
                row[E_AF0] += row[E_AF1] * (toe - first * EVERY_S)
                row[E_GROUP_DELAY] = 5e-9 * math.sin(3.0 * k)
                row[E_ISSUE], row[E_ACCURACY] = issue, 2.0
                rows.append(row)
    return rows


@njit("f8(f8[::1], f8, f8, f8[::1], f8[::1], f8[::1])", cache=True)
def _true_range(e: F64, week: float, second: float, x: F64, out: F64, turned: F64) -> float:
    """Geometric range [m] of a signal that arrives at ``second``; ``turned``: satellite then."""
    travel = 0.075
    for _ in range(6):
        satellite_at(e, week, second - travel, out)
        angle = OMEGA_E_GPS * travel
        c, s = math.cos(angle), math.sin(angle)
        turned[0], turned[1], turned[2] = c * out[0] + s * out[1], c * out[1] - s * out[0], out[2]
        r = math.sqrt((turned[0] - x[0]) ** 2 + (turned[1] - x[1]) ** 2 + (turned[2] - x[2]) ** 2)
        travel = r / C
    return r


@njit(
    "void(f8[:, ::1], f8, f8[::1], f8[:, ::1], f8[:, ::1], f8[::1], f8, f8, f8[:, ::1],"
    "f8[:, ::1], f8[:, ::1])",
    cache=True,
    entry=True,
)
def _measure(
    table: F64, week: float, seconds: F64, x: F64, clock: F64, iono: F64, mask: float, air: float,
    ranges: F64, rates: F64, elevations: F64,
) -> None:  # fmt: skip
    """Fill (N, S): pseudorange, rate and elevation; NaN below ``mask`` [rad]."""
    out, turned, here, axes = np.empty(8), np.empty(3), np.empty(3), np.empty((3, 3))
    u, step = np.empty(3), 0.01
    for i in range(seconds.shape[0]):
        geodetic(x[i, 0], x[i, 1], x[i, 2], here)
        ned_axes(here[0], here[1], axes)
        for k in range(table.shape[0]):
            e = table[k]
            ranges[i, k] = rates[i, k] = elevations[i, k] = np.nan
            if not -0.5 * EVERY_S <= seconds[i] - e[E_TOE] < 0.5 * EVERY_S:
                continue
            r = _true_range(e, week, seconds[i], x[i, :3], out, turned)
            for j in range(3):
                u[j] = (turned[j] - x[i, j]) / r
            n = axes[0, 0] * u[0] + axes[0, 1] * u[1] + axes[0, 2] * u[2]
            w = axes[1, 0] * u[0] + axes[1, 1] * u[1] + axes[1, 2] * u[2]
            d = axes[2, 0] * u[0] + axes[2, 1] * u[1] + axes[2, 2] * u[2]
            elevation = math.asin(-d)
            if elevation < mask:
                continue
            system = int(e[E_SAT]) // 100 - 1
            delay = klobuchar(iono, here[0], here[1], math.atan2(w, n), elevation, seconds[i])
            if system == BEIDOU:
                delay *= (L1_HZ / CARRIER_HZ[BEIDOU]) ** 2
            delay = air * (delay + troposphere(here[0], here[2], elevation))
            ranges[i, k] = r + clock[i, 0] - out[6] + delay
            drift = clock[i, 1] - out[7]
            later = _true_range(
                e, week, seconds[i] + step, x[i, :3] + step * x[i, 3:6], out, turned
            )
            before = _true_range(
                e, week, seconds[i] - step, x[i, :3] - step * x[i, 3:6], out, turned
            )
            rates[i, k] = (later - before) / (2.0 * step) + drift
            elevations[i, k] = elevation


@dataclass(frozen=True, slots=True)
class SatelliteFault:
    """An error of one satellite's pseudorange: ``step_m`` and ``ramp_mps`` from ``start_s`` on."""

    sat: int
    start_s: float
    end_s: float
    step_m: float = 0.0
    ramp_mps: float = 0.0


@dataclass(frozen=True, slots=True)
class SystemNoise:
    """White noise of all ranges and rates of a system, ``factor`` times what it is otherwise."""

    system: int
    start_s: float
    end_s: float
    factor: float


@dataclass(frozen=True, slots=True)
class Sky:
    """What a receiver is given and what it measured."""

    broadcast: BroadcastSamples
    raw: RawGnssSamples
    clock: F64
    """(N, 2) the true receiver clock [m, m/s]."""


def observe(
    t_ns: I64,
    ecef_pos_vel: F64,
    rng: np.random.Generator,
    *,
    systems: tuple[int, ...] = (GPS, GALILEO, BEIDOU),
    start: tuple[int, float] = (2300, 200_000.0),
    mask_deg: float = 5.0,
    sd_range_m: float = 0.7,
    sd_rate_mps: float = 0.04,
    multipath_m: float = 0.0,
    multipath_tau_s: float = 60.0,
    system_bias_m: tuple[float, float, float] = (0.0, 6.0, -9.0),
    clock_m: tuple[float, float] = (3_000.0, 40.0),
    clock_drift_walk_mps_rts: float = 0.15,
    faults: tuple[SatelliteFault, ...] = (),
    noises: tuple[SystemNoise, ...] = (),
    air: float = 1.0,
) -> Sky:
    """Measurements at ``t_ns`` (N,) of a receiver at ``ecef_pos_vel`` (N, 6) [m, m/s].

    White noise grows as 1/sin of the elevation; ``multipath_m`` is the 1σ of a Gauss-Markov error
    at the zenith that grows likewise. ``start``: GPS week and second of week of the first epoch.
    The receiver's clock begins at ``clock_m`` [m, m/s], and its drift is a random walk.
    """
    week, first = start
    seconds = first + (t_ns - t_ns[0]) * 1e-9
    rows = ephemerides(systems, week, float(seconds[0]), float(seconds[-1]))
    table = np.array(rows)
    n, dt = len(t_ns), np.diff(seconds, prepend=seconds[0])
    drift = clock_m[1] + np.cumsum(rng.normal(0, clock_drift_walk_mps_rts, n) * np.sqrt(dt))
    clock = np.stack([clock_m[0] + np.cumsum(drift * dt), drift], axis=1)
    shape = (n, len(rows))
    ranges, rates, elevations = np.empty(shape), np.empty(shape), np.empty(shape)
    _measure(
        table, week, seconds, np.ascontiguousarray(ecef_pos_vel), clock, IONOSPHERE,
        math.radians(mask_deg), air, ranges, rates, elevations,
    )  # fmt: skip
    low = 1.0 / np.sin(np.nan_to_num(elevations, nan=1.0))
    sats = table[:, E_SAT].astype(np.int64)
    louder = _louder(seconds - first, sats, noises)
    ranges += rng.normal(0, sd_range_m, shape) * low * louder
    rates += rng.normal(0, sd_rate_mps, shape) * louder
    for k, sat in enumerate(sats.tolist()):
        ranges[:, k] += system_bias_m[sat // 100 - 1]
        for fault in faults:
            since = seconds - first - fault.start_s
            hit = (fault.sat == sat) & (since >= 0) & (seconds - first < fault.end_s)
            ranges[:, k] += np.where(hit, fault.step_m + fault.ramp_mps * since, 0.0)
    if multipath_m > 0:
        ranges += multipath_m * low * _slow(rng, shape, dt, multipath_tau_s)
    # The receiver stamps by its own clock, which its pseudoranges hold as well.
    stamped = seconds + clock[:, 0] / C
    return Sky(_broadcast(t_ns, table), _columns(t_ns, week, stamped, sats, ranges, rates), clock)


def _louder(t: F64, sats: I64, noises: tuple[SystemNoise, ...]) -> F64:
    """(N, S) factor on white noise at ``t`` (N,) [s] since the first epoch."""
    factor = np.ones((len(t), len(sats)))
    for noise in noises:
        during = (t >= noise.start_s) & (t < noise.end_s)
        factor[np.ix_(during, sats // 100 - 1 == noise.system)] *= noise.factor
    return factor


def _slow(rng: np.random.Generator, shape: tuple[int, int], dt: F64, tau: float) -> F64:
    """Gauss-Markov noise of unit deviation down the first axis."""
    x = rng.normal(size=shape)
    for i in range(1, shape[0]):
        d = math.exp(-dt[i] / tau)
        x[i] = d * x[i - 1] + math.sqrt(1 - d * d) * x[i]
    return x


def _broadcast(t_ns: I64, table: F64) -> BroadcastSamples:
    """All messages at the first epoch."""
    values = np.zeros((len(table) + 1, EPHEMERIS_SIZE))
    values[0, :8] = IONOSPHERE
    values[1:] = table
    t = np.full(len(values), t_ns[0], np.int64)
    sat = values[:, E_SAT].astype(np.int64)
    sat[0] = 0
    return BroadcastSamples("constellation", t, t, np.arange(len(t), dtype=np.int64), sat, values)


def _columns(
    t_ns: I64, week: int, seconds: F64, sats: I64, ranges: F64, rates: F64
) -> RawGnssSamples:
    """What is above the horizon, epoch by epoch."""
    n = len(t_ns)
    sat = np.zeros((n, SATELLITES), np.int64)
    out = np.full((2, n, SATELLITES), np.nan)
    for i in range(n):
        seen = np.flatnonzero(np.isfinite(ranges[i]))
        sat[i, : len(seen)] = sats[seen]
        out[0, i, : len(seen)], out[1, i, : len(seen)] = ranges[i, seen], rates[i, seen]
    none = np.full((n, SATELLITES), np.nan)
    return RawGnssSamples(
        "constellation", t_ns, t_ns, np.arange(n, dtype=np.int64), np.full(n, week, np.int64),
        seconds, sat, np.zeros_like(sat), out[0], out[1], np.where(sat > 0, 45.0, np.nan),
        none, none,
    )  # fmt: skip
