"""Corrected measurements of one epoch: what is left when satellite and ionosphere are taken off.

    pr  = ρ + c·(receiver clock) + c·(inter-system bias) + troposphere + noise
    ṗr  = ρ̇ + c·(receiver clock rate) + noise

with ρ = |x_s − x_r| + Ω (x_s y_r − y_s x_r) / c, the last term being the Earth's rotation while the
signal travels (Sagnac); x_s is the satellite at transmission in the Earth's frame of that moment.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.gnss.atmosphere import klobuchar, mapped, zenith_delay
from companion.gnss.geometry import geodetic, ned_axes
from companion.gnss.orbit import E_GROUP_DELAY, E_SAT, OMEGA_E_GPS, clock_polynomial, satellite_at
from companion.gnss.systems import B3_HZ, B3I, BEIDOU, CARRIER_HZ, L1_HZ, C
from companion.types import F64, I64

# --- columns of a corrected satellite; also a row of the filter's aid table
S_POS, S_VEL = 0, 3
"""Satellite position [m] and velocity [m/s] at transmission, ECEF."""
S_RANGE, S_RATE = 6, 7
"""Corrected pseudorange [m] and its rate [m/s]; NaN where not measured."""
S_RANGE_VAR, S_RATE_VAR = 8, 9
S_SYSTEM, S_SAT = 10, 11
ROW_SIZE = 12

# --- columns of what an observation is corrected with
V_RANGE_SD, V_RATE_SD, V_CN0, V_MASK, V_IONO = range(5)
"""1σ at the zenith at V_CN0 [m, m/s]; the C/N0 from which noise grows [dB-Hz]; elevation mask
[rad]; part of the modelled ionospheric delay that counts as 1σ of what is left."""
NOISE_SIZE = 5
_ON_B1 = (L1_HZ / CARRIER_HZ[BEIDOU]) ** 2
_ON_B3 = (L1_HZ / B3_HZ) ** 2
_HORIZON = math.radians(1.0)
_LOST_CN0 = 5.0


@njit("f8(f8[::1], f8, f8, f8, f8[::1])", cache=True, counted=False)
def line_of_sight(sat: F64, x: float, y: float, z: float, u: F64) -> float:
    """Range [m] with Sagnac to an ECEF point; ``u`` (3,): unit vector towards the satellite."""
    dx, dy, dz = sat[S_POS] - x, sat[S_POS + 1] - y, sat[S_POS + 2] - z
    r = math.sqrt(dx * dx + dy * dy + dz * dz)
    u[0], u[1], u[2] = dx / r, dy / r, dz / r
    return float(r + OMEGA_E_GPS / C * (sat[S_POS] * y - sat[S_POS + 1] * x))


@njit("f8(f8[::1], f8[::1], f8[::1], f8[::1])", cache=True, counted=False)
def range_rate(sat: F64, u: F64, x: F64, v: F64) -> float:
    """Derivative of :func:`line_of_sight` for a receiver at ``x`` (3,) moving with ``v`` (3,)."""
    rate = 0.0
    for i in range(3):
        rate += u[i] * (sat[S_VEL + i] - v[i])
    turn = sat[S_VEL] * x[1] + sat[S_POS] * v[1] - sat[S_VEL + 1] * x[0] - sat[S_POS + 1] * v[0]
    return float(rate + OMEGA_E_GPS / C * turn)


@njit(
    "i8(f8[:, ::1], i8[::1], f8, f8, f8[:, ::1], f8[::1], f8[::1], f8[::1], f8[:, ::1],f8[:, ::1])",
    cache=True,
    entry=True,
)
def correct(
    ephemerides: F64,
    which: I64,
    week: float,
    second: float,
    observed: F64,
    x: F64,
    ionosphere: F64,
    noise: F64,
    rows: F64,
    sky: F64,
) -> int:
    """Fill ``rows`` (M, :data:`ROW_SIZE`) and ``sky`` (M, 2) from one epoch's observations.

    ``observed`` (M, 6): pseudorange [m], its rate [m/s], C/N0 [dB-Hz], reported 1σ of both (NaN:
    none), signal; ``which`` (M,): row of ``ephemerides`` or −1; ``x`` (3,): about where the
    receiver is, zeros where nobody knows: nothing then depends on elevation. ``sky``: azimuth and
    elevation [rad].
    Satellites below the mask or without ephemeris are left out; returns how many rows there are.
    """
    known = x[0] != 0.0 or x[1] != 0.0
    here, axes, u = np.zeros(3), np.zeros((3, 3)), np.empty(3)
    at = np.empty(8)
    if known:
        geodetic(x[0], x[1], x[2], here)
        ned_axes(here[0], here[1], axes)
    count = 0
    for m in range(which.shape[0]):
        if which[m] < 0:
            continue
        row = rows[count]
        e = ephemerides[which[m]]
        sent = second - observed[m, 0] / C
        # Without relativity and group delay the moment is off by 1e-7 s, the range by 1e-4 m.
        satellite_at(e, week, sent - clock_polynomial(e, week, sent), at)
        for i in range(6):
            row[S_POS + i] = at[i]
        azimuth, elevation = 0.0, 0.5 * math.pi
        delay = 0.0
        if known:
            line_of_sight(row, x[0], x[1], x[2], u)
            n = axes[0, 0] * u[0] + axes[0, 1] * u[1] + axes[0, 2] * u[2]
            w = axes[1, 0] * u[0] + axes[1, 1] * u[1] + axes[1, 2] * u[2]
            d = axes[2, 0] * u[0] + axes[2, 1] * u[1] + axes[2, 2] * u[2]
            azimuth, elevation = math.atan2(w, n), math.atan2(-d, math.sqrt(n * n + w * w))
            if elevation < max(noise[V_MASK], _HORIZON):
                continue
            delay = klobuchar(ionosphere, here[0], here[1], azimuth, elevation, second)
        sat = int(e[E_SAT])
        system = sat // 100 - 1
        if system == BEIDOU:
            delay *= _ON_B3 if observed[m, 5] == B3I else _ON_B1
        row[S_RANGE] = observed[m, 0] + at[6] - delay
        if observed[m, 5] == B3I:
            row[S_RANGE] += C * e[E_GROUP_DELAY]
        row[S_RATE] = observed[m, 1] + at[7]
        # Noise of a correlator grows as the signal weakens; what is low has more multipath too.
        weak = 10.0 ** (max(noise[V_CN0] - max(observed[m, 2], _LOST_CN0), 0.0) / 10.0)
        low = 1.0 / math.sin(elevation) ** 2
        var = noise[V_RANGE_SD] ** 2 * weak * low
        if observed[m, 3] > 0.0:
            var = max(var, observed[m, 3] ** 2)
        row[S_RANGE_VAR] = var + (noise[V_IONO] * delay) ** 2
        var = noise[V_RATE_SD] ** 2 * weak
        if observed[m, 4] > 0.0:
            var = max(var, observed[m, 4] ** 2)
        row[S_RATE_VAR] = var
        row[S_SYSTEM], row[S_SAT] = system, sat
        sky[count, 0], sky[count, 1] = azimuth, elevation
        count += 1
    return count


@njit("void(f8[::1], f8[::1])", cache=True, counted=False)
def overhead(here: F64, site: F64) -> None:
    """``site`` (4,): ECEF unit vector up and delay of the troposphere that way [m] at geodetic
    ``here`` (3,), for all satellites seen from there.
    """
    cp = math.cos(here[0])
    site[0], site[1] = cp * math.cos(here[1]), cp * math.sin(here[1])
    site[2] = math.sin(here[0])
    site[3] = zenith_delay(here[0], here[2])


@njit("f8(f8[::1], f8[::1], f8[::1], f8[::1])", cache=True, counted=False)
def range_from(sat: F64, x: F64, site: F64, u: F64) -> float:
    """As :func:`expected_range`, with ``site`` (4,) of :func:`overhead`."""
    r = line_of_sight(sat, x[0], x[1], x[2], u)
    up = site[0] * u[0] + site[1] * u[1] + site[2] * u[2]
    return float(r + site[3] * mapped(up))


@njit("f8(f8[::1], f8[::1], f8[::1], f8[::1])", cache=True, entry=True)
def expected_range(sat: F64, x: F64, here: F64, u: F64) -> float:
    """Range [m] to a receiver at ECEF ``x``, geodetic ``here``, with Sagnac and troposphere.

    ``u`` (3,) is filled: unit vector towards the satellite.
    """
    site = np.empty(4)
    overhead(here, site)
    return float(range_from(sat, x, site, u))
