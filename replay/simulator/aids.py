"""Aiding sensors: GNSS receiver, barometer, magnetometer, as specifications and as errors."""

from __future__ import annotations

import math
from typing import Literal

import msgspec
import numpy as np

from companion.navigation import earth
from companion.types import F64, I64, CompanionError
from replay.simulator.disturbances import NoiseChange, noise_factor
from replay.simulator.noise import gauss_markov, random_walk
from replay.simulator.trajectory import Trajectory


class Outage(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """No fix in [start, start + length)."""

    start_s: float
    length_s: float


class Fault(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A position fault in [start, start + length), velocity untouched.

    error_n(t) = step + ramp · (t − start): a step is a glitch, a ramp a slow spoofing drift.
    """

    start_s: float
    length_s: float
    step_n_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """NED."""
    ramp_n_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)


class GnssSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One receiver. Position error = white + Gauss-Markov + faults; velocity error is white."""

    source: str = "GPS_RAW_INT"
    rate_hz: float = 5.0
    sd_position_m: float = 0.5
    """White, 1σ, north and east each."""
    sd_height_m: float = 0.9
    correlated_sd_position_m: float = 1.0
    """Gauss-Markov, 1σ; τ below."""
    correlated_sd_height_m: float = 1.7
    correlated_tau_s: float = 60.0
    sd_velocity_mps: float = 0.1
    sd_velocity_down_mps: float = 0.15
    latency_ms: float = 100.0
    """Arrival − validity."""
    latency_jitter_ms: float = 0.0
    """Arrival is later still by up to this, uniformly; order of arrival is kept."""
    stamped: Literal["validity", "arrival"] = "validity"
    """What ``t_ns`` says; receivers that stamp at arrival leave the latency to be configured."""
    lever_arm_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    outages: tuple[Outage, ...] = ()
    during_outage: Literal["silent", "no-fix"] = "silent"
    """``no-fix``: the messages go on, with fix type 1 and nothing in them."""
    faults: tuple[Fault, ...] = ()
    noise_changes: tuple[NoiseChange, ...] = ()
    spike_probability: float = 0.0
    """Share of single fixes with an added spike (multipath)."""
    spike_sd_m: float = 20.0
    reported_factor: float = 1.0
    """Reported standard deviations over true ones: receivers claim too much or too little."""

    @property
    def total_sd_m(self) -> tuple[float, float]:
        """1σ of the whole position error, horizontal (each axis) and vertical [m], no faults."""
        return (
            math.hypot(self.sd_position_m, self.correlated_sd_position_m),
            math.hypot(self.sd_height_m, self.correlated_sd_height_m),
        )


class BaroSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Static pressure of the standard atmosphere over the ellipsoid, wrong by a drifting offset."""

    source: str = "SCALED_PRESSURE"
    rate_hz: float = 10.0
    sd_m: float = 0.3
    """White, as height."""
    offset_sd_m: float = 20.0
    """Of the day's weather, constant."""
    walk_m_rts: float = 0.03
    arrival_ms: float = 10.0


class MagSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Three-axis magnetometer in the Earth's field at the start."""

    source: str = "HIGHRES_IMU"
    rate_hz: float = 10.0
    sd_t: float = 3e-7
    hard_iron_t: tuple[float, float, float] = (0.0, 0.0, 0.0)
    field_n_t: tuple[float, float, float] | None = None
    """NED field [T]; absent: World Magnetic Model at the place and date of the start."""
    arrival_ms: float = 5.0


ISA_PRESSURE_PA = 101325.0
ISA_LAPSE_PER_M = 0.0065 / 288.15
ISA_EXPONENT = 5.255876


def isa_pressure(height: F64) -> F64:
    """Pressure [Pa] of the ISA troposphere at ``height`` [m]: p0 (1 − L h / T0)^(g M / R L)."""
    return np.asarray(ISA_PRESSURE_PA * (1.0 - ISA_LAPSE_PER_M * height) ** ISA_EXPONENT)


def earth_field_n(lat: float, lon: float, height: float, year: float) -> F64:
    """Magnetic field (3,) NED [T] of the World Magnetic Model 2025 at ``year`` (2025.5, …)."""
    from pygeomag import GeoMag

    try:
        found = GeoMag(coefficients_file="wmm/WMM_2025.COF").calculate(
            glat=math.degrees(lat), glon=math.degrees(lon), alt=height / 1000.0, time=year
        )
    except ValueError as error:
        raise CompanionError(f"World Magnetic Model: {error}") from None
    return np.array([found.x, found.y, found.z]) * 1e-9


def _outside(t: F64, windows: tuple[Outage, ...]) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    good = np.ones(len(t), dtype=np.bool_)
    for w in windows:
        good &= (t < w.start_s) | (t >= w.start_s + w.length_s)
    return good


def antenna(trajectory: Trajectory, t: F64, lever_b: F64) -> tuple[F64, F64]:
    """Latitude, longitude, height (N, 3) and velocity (N, 3) of a point ``lever_b`` from the IMU.

    v = v_n + C_nb (w_eb_b × lever_b), w_eb_b = w_ib_b − C_bn w_ie.  Groves 2013, eqs 14.122-14.123.
    """
    s = trajectory.states(t)
    llh = np.stack([s.lat, s.lon, s.height], axis=-1)
    if not lever_b.any():
        return llh, s.vel_n
    C_nb = s.C_nb
    w_ie_n = earth.RATE * np.stack([np.cos(s.lat), np.zeros(len(t)), -np.sin(s.lat)], axis=-1)
    w_eb_b = trajectory.inertial(t)[0] - np.einsum("nji,nj->ni", C_nb, w_ie_n)
    vel_n = s.vel_n + np.einsum("nij,nj->ni", C_nb, np.cross(w_eb_b, lever_b))
    return shifted(llh, C_nb @ lever_b), vel_n


def shifted(llh: F64, offset_n: F64) -> F64:
    """Positions (N, 3) moved by ``offset_n`` (N, 3) [m, NED]; first order, 1 mm within 1 km."""
    s, c = np.sin(llh[:, 0]), np.cos(llh[:, 0])
    w2 = 1.0 - earth.E2 * s * s
    n = earth.A / np.sqrt(w2)
    m = n * (1.0 - earth.E2) / w2
    h = llh[:, 2]
    return llh + np.stack(
        [offset_n[:, 0] / (m + h), offset_n[:, 1] / ((n + h) * c), -offset_n[:, 2]], axis=-1
    )


class Fixes(msgspec.Struct, frozen=True):
    """Simulated fixes as columns; times in seconds since the start."""

    t: F64
    """(N,) validity."""
    t_rx: F64
    """(N,) arrival."""
    llh: F64
    """(N, 3), NaN without a fix."""
    vel_n: F64
    sd_pos: F64
    sd_vel: F64
    num_sats: I64
    fix_type: I64


def fixes(spec: GnssSpec, rng: np.random.Generator, trajectory: Trajectory, t: F64) -> Fixes:
    """What the receiver gives for validity times ``t`` (N,), outages taken out or marked."""
    count = len(t)
    sd_white = np.array([spec.sd_position_m, spec.sd_position_m, spec.sd_height_m])
    sd_slow = np.array([spec.correlated_sd_position_m] * 2 + [spec.correlated_sd_height_m])
    sd_vel = np.array([spec.sd_velocity_mps, spec.sd_velocity_mps, spec.sd_velocity_down_mps])
    more = noise_factor(spec.noise_changes, t)
    error = rng.standard_normal((count, 3)) * sd_white * more
    error += gauss_markov(rng, count, 1.0 / spec.rate_hz, sd_slow, spec.correlated_tau_s)
    vel_error = rng.standard_normal((count, 3)) * sd_vel * more
    spikes = rng.uniform(size=(count, 1)) < spec.spike_probability
    error += spikes * rng.standard_normal((count, 3)) * spec.spike_sd_m
    jitter = rng.uniform(0.0, 1e-3, count) * spec.latency_jitter_ms
    for fault in spec.faults:
        since = t - fault.start_s
        inside = (since >= 0) & (since < fault.length_s)
        error += inside[:, None] * (np.array(fault.step_n_m) + np.outer(since, fault.ramp_n_mps))
    llh, vel_n = antenna(trajectory, t, np.array(spec.lever_arm_b_m))
    llh, vel_n = shifted(llh, error), vel_n + vel_error
    horizontal, vertical = spec.total_sd_m
    sd_pos = np.tile([horizontal, horizontal, vertical], (count, 1)) * spec.reported_factor
    sd_vel = np.tile(sd_vel, (count, 1)) * spec.reported_factor
    fixed = _outside(t, spec.outages)
    for column in (llh, vel_n, sd_pos, sd_vel):
        column[~fixed] = np.nan
    out = Fixes(
        t,
        np.maximum.accumulate(t + 1e-3 * spec.latency_ms + jitter),
        llh,
        vel_n,
        sd_pos,
        sd_vel,
        np.where(fixed, 14, 0),
        np.where(fixed, 3, 1),
    )
    if spec.during_outage == "silent":
        return Fixes(*(getattr(out, name)[fixed] for name in Fixes.__struct_fields__))
    return out


def pressure(spec: BaroSpec, rng: np.random.Generator, height: F64) -> F64:
    """Pressure (N,) [Pa] measured at true heights (N,) [m]."""
    offset = rng.standard_normal() * spec.offset_sd_m
    walk = random_walk(rng, len(height), 1.0 / spec.rate_hz, np.array([spec.walk_m_rts]))[:, 0]
    return isa_pressure(height + offset + walk + rng.standard_normal(len(height)) * spec.sd_m)


def magnetic(spec: MagSpec, rng: np.random.Generator, C_nb: F64, field_n: F64) -> F64:
    """Field in body axes (N, 3) [T]: C_bn field_n + hard iron + white noise."""
    clean = np.einsum("nji,j->ni", C_nb, field_n) + np.array(spec.hard_iron_t)
    return np.asarray(clean + rng.standard_normal(clean.shape) * spec.sd_t)
