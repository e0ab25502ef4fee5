"""What satellites look like from a place: the terms that are the same for all, and each one's line.

Computed once of a place and shared by correction, solution, test of faults, scatter and DOP.
"""

from __future__ import annotations

import math

from companion._jit import njit
from companion.gnss.corrected import overhead, range_from
from companion.gnss.geometry import geodetic
from companion.types import F64

# --- of a place
F_LAT, F_LON, F_HEIGHT = 0, 1, 2
"""Geodetic [rad, rad, m]."""
F_NORTH, F_EAST, F_UP = 3, 6, 9
"""Unit vectors, ECEF."""
F_ZENITH = 12
"""Tropospheric delay of a satellite overhead [m]; 0 in the Earth, where it means nothing. From F_UP
on, this is the site of :func:`companion.gnss.corrected.overhead`."""
FRAME_SIZE = 13
_EARTH = 1e6

# --- of a satellite, from a place
G_LINE, G_RANGE = 0, 3
"""Unit vector towards it, ECEF; range that is expected, with Sagnac and troposphere [m]."""
G_RESIDUAL, G_LEVER = 4, 5
"""Residual of its range at the solution [m], and h (HᵀWH)⁻¹ hᵀ of its line there [m²]."""
G_RATE_RESIDUAL, G_RATE_LEVER = 6, 7
"""The same of its rate [m/s, m²/s²]; NaN where there is no velocity or no rate."""
SIGHT_SIZE = 8


@njit("b1(f8, f8, f8, f8[::1])", cache=True, counted=False)
def stand(x: float, y: float, z: float, frame: F64) -> bool:
    """Fill ``frame`` (:data:`FRAME_SIZE`,) of an ECEF point; false where that is in the Earth."""
    frame[:] = 0.0
    if x * x + y * y + z * z < _EARTH * _EARTH:
        return False
    geodetic(x, y, z, frame)
    sp, cp = math.sin(frame[F_LAT]), math.cos(frame[F_LAT])
    sl, cl = math.sin(frame[F_LON]), math.cos(frame[F_LON])
    frame[F_NORTH], frame[F_NORTH + 1], frame[F_NORTH + 2] = -sp * cl, -sp * sl, cp
    frame[F_EAST], frame[F_EAST + 1] = -sl, cl
    overhead(frame, frame[F_UP:])
    return True


@njit("f8(f8[::1], i8, f8[::1])", cache=True, counted=False)
def along(frame: F64, axis: int, u: F64) -> float:
    """Component of ``u`` (3,), ECEF, along an axis of ``frame``: F_NORTH, F_EAST or F_UP."""
    return float(frame[axis] * u[0] + frame[axis + 1] * u[1] + frame[axis + 2] * u[2])


@njit("void(f8[:, ::1], i8, f8[::1], f8[::1], f8[:, ::1])", cache=True, counted=False)
def look(rows: F64, m: int, x: F64, frame: F64, sight: F64) -> None:
    """Line and range of ``m`` corrected satellites from ``x`` (3,), whose ``frame`` is filled."""
    for s in range(m):
        sight[s, G_RANGE] = range_from(rows[s], x, frame[F_UP:], sight[s])
