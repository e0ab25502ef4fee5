"""From what a receiver measured to a corrected satellite: orbit, clocks, ionosphere, noise."""

from __future__ import annotations

import math

from companion._jit import njit
from companion.gnss.atmosphere import klobuchar_towards, mapped
from companion.gnss.corrected import (
    S_POS,
    S_RANGE,
    S_RANGE_VAR,
    S_RATE,
    S_RATE_VAR,
    S_SAT,
    S_SYSTEM,
    line_of_sight,
)
from companion.gnss.knots import satellite_near
from companion.gnss.orbit import E_GROUP_DELAY, E_SAT, clock_polynomial
from companion.gnss.sight import (
    F_EAST,
    F_LAT,
    F_LON,
    F_NORTH,
    F_UP,
    F_ZENITH,
    G_RANGE,
    along,
)
from companion.gnss.systems import B3_HZ, B3I, BEIDOU, CARRIER_HZ, L1_HZ, C
from companion.types import F64

# --- what an observation is: one of an epoch
O_RANGE, O_RATE, O_CN0, O_SD_RANGE, O_SD_RATE, O_SIGNAL = range(6)
"""Pseudorange [m], its rate [m/s], C/N0 [dB-Hz, NaN without], reported 1σ of both (NaN: none),
signal."""
OBSERVATION_SIZE = 6

# --- columns of what it is corrected with
V_RANGE_SD, V_RATE_SD, V_CN0, V_MASK, V_IONO = range(5)
"""1σ at the zenith at V_CN0 [m, m/s]; the C/N0 from which noise grows [dB-Hz]; elevation mask
[rad]; part of the modelled ionospheric delay that counts as 1σ of what is left."""
NOISE_SIZE = 5
_ON_B1 = (L1_HZ / CARRIER_HZ[BEIDOU]) ** 2
_ON_B3 = (L1_HZ / B3_HZ) ** 2
_HORIZON = math.radians(1.0)
_LOST_CN0 = 5.0
_TEN_DB = math.log(10.0) / 10.0


@njit("void(f8[::1], f8, f8, f8[::1], f8[::1])", cache=True, counted=False)
def _variances(seen: F64, up: float, delay: float, noise: F64, row: F64) -> None:
    """Of range and rate: noise of a correlator grows as the signal weakens.

    What is low, at an elevation with sine ``up``, has more multipath too.
    """
    weak = 1.0
    # Written so that NaN, for not said, is strong.
    if seen[O_CN0] < noise[V_CN0]:
        weak = math.exp(_TEN_DB * (noise[V_CN0] - max(seen[O_CN0], _LOST_CN0)))
    var = noise[V_RANGE_SD] * noise[V_RANGE_SD] * weak / (up * up)
    if seen[O_SD_RANGE] > 0.0:
        var = max(var, seen[O_SD_RANGE] * seen[O_SD_RANGE])
    left = noise[V_IONO] * delay
    row[S_RANGE_VAR] = var + left * left
    var = noise[V_RATE_SD] * noise[V_RATE_SD] * weak
    if seen[O_SD_RATE] > 0.0:
        var = max(var, seen[O_SD_RATE] * seen[O_SD_RATE])
    row[S_RATE_VAR] = var


@njit(
    "b1(f8[::1], f8[:, ::1], f8, f8, f8[::1], b1, f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], "
    "f8[::1], f8[::1])",
    cache=True,
    counted=False,
)
def correct(
    e: F64,
    knots: F64,
    week: float,
    second: float,
    seen: F64,
    known: bool,
    x: F64,
    frame: F64,
    ionosphere: F64,
    noise: F64,
    row: F64,
    line: F64,
    sight: F64,
) -> bool:
    """Fill ``row`` (:data:`companion.gnss.corrected.ROW_SIZE`,) from one observation ``seen``.

    ``e``, ``knots``: the satellite's ephemeris and its :mod:`companion.gnss.knots`; ``week``,
    ``second``: of reception. ``x`` (3,), ``frame``: about where the receiver is, where that is
    ``known``; nothing depends on elevation else. ``line`` (3,) gets its line of sight, NED, and
    ``sight`` line and range of :mod:`companion.gnss.sight`. False below the mask, and for numbers
    that are none.
    """
    sent = second - seen[O_RANGE] / C
    # Without relativity and group delay the moment is off by 1e-7 s, the range by 1e-4 m.
    satellite_near(e, knots, week, sent - clock_polynomial(e, week, sent), row)
    clock, clock_rate = row[S_RANGE], row[S_RATE]
    delay, up = 0.0, 1.0
    line[0], line[1], line[2] = 0.0, 0.0, -1.0
    if known:
        r = line_of_sight(row, x[0], x[1], x[2], sight)
        north, east = along(frame, F_NORTH, sight), along(frame, F_EAST, sight)
        up = along(frame, F_UP, sight)
        flat = math.sqrt(north * north + east * east)
        elevation = math.atan2(up, flat)
        if not elevation >= max(noise[V_MASK], _HORIZON):
            return False
        line[0], line[1], line[2] = north, east, -up
        sight[G_RANGE] = r + frame[F_ZENITH] * mapped(up)
        if flat > 0.0:
            north, east = north / flat, east / flat
        delay = klobuchar_towards(
            ionosphere, frame[F_LAT], frame[F_LON], north, east, elevation, second
        )
    sat = int(e[E_SAT])
    system = sat // 100 - 1
    if system == BEIDOU:
        delay *= _ON_B3 if seen[O_SIGNAL] == B3I else _ON_B1
    row[S_RANGE] = seen[O_RANGE] + clock - delay
    if seen[O_SIGNAL] == B3I:
        row[S_RANGE] += C * e[E_GROUP_DELAY]
    row[S_RATE] = seen[O_RATE] + clock_rate
    _variances(seen, up, delay, noise, row)
    row[S_SYSTEM], row[S_SAT] = system, sat
    return bool(math.isfinite(row[S_POS]) and math.isfinite(row[S_RANGE]))
