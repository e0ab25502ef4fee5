"""Where a satellite stands in the sky, what a set of them is worth (DOP), the best n of a set."""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.navigation.earth import E2, A, B
from companion.types import F64, I64
from companion.types import NO_DOP as NO_DOP

GDOP, PDOP, HDOP, VDOP, TDOP = range(5)


@njit("void(f8, f8, f8, f8[::1])", cache=True, entry=True)
def geodetic(x: float, y: float, z: float, out: F64) -> None:
    """Latitude, longitude [rad], height [m] of an ECEF point into ``out`` (3,).

    Bowring's start and two turns of the fixed point: below 1e-6 m from −10 to 50 000 km.
    """
    p = math.sqrt(x * x + y * y)
    u = math.atan2(z * A, p * B)
    second = E2 / (1.0 - E2)
    lat = 0.0
    for _ in range(3):
        lat = math.atan2(z + second * B * math.sin(u) ** 3, p - E2 * A * math.cos(u) ** 3)
        u = math.atan2(B * math.sin(lat), A * math.cos(lat))
    s, c = math.sin(lat), math.cos(lat)
    n = A / math.sqrt(1.0 - E2 * s * s)
    out[0], out[1] = lat, math.atan2(y, x)
    out[2] = p * c + z * s - n * (1.0 - E2 * s * s)


@njit("void(f8, f8, f8[:, ::1])", cache=True, entry=True, counted=False)
def ned_axes(lat: float, lon: float, R: F64) -> None:
    """``R`` (3, 3): rows are north, east and down in ECEF, C_ne."""
    sp, cp, sl, cl = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    R[0, 0], R[0, 1], R[0, 2] = -sp * cl, -sp * sl, cp
    R[1, 0], R[1, 1], R[1, 2] = -sl, cl, 0.0
    R[2, 0], R[2, 1], R[2, 2] = -cp * cl, -cp * sl, -sp


@njit("b1(f8[:, ::1], i8)", cache=True)
def invert_spd(M: F64, n: int) -> bool:
    """Invert the leading n×n (n ≤ 8) of a symmetric positive definite matrix in place.

    Gauss-Jordan without pivoting, which a positive definite matrix does not need. False, and the
    matrix destroyed, where it is not (numerically) definite.
    """
    scale = np.empty(8)
    for i in range(n):
        if not M[i, i] > 0.0:
            return False
        scale[i] = M[i, i]
    for k in range(n):
        pivot = M[k, k]
        if not pivot > 1e-12 * scale[k]:
            return False
        M[k, k] = 1.0
        for j in range(n):
            M[k, j] /= pivot
        for i in range(n):
            if i != k:
                f = M[i, k]
                M[i, k] = 0.0
                for j in range(n):
                    M[i, j] -= f * M[k, j]
    return True


@njit("void(f8[:, ::1], i8[::1], i8, f8[::1])", cache=True, entry=True)
def dilution(G: F64, systems: I64, m: int, out: F64) -> None:
    """GDOP, PDOP, HDOP, VDOP, TDOP into ``out`` (5,); :data:`NO_DOP` where there is none.

    ``G`` (m, 3): lines of sight towards the satellites, NED; a clock for each of ``systems`` (m,)
    that occurs. GDOP = √tr (HᵀH)⁻¹, Sasiadek & Hartana 2004 eq. 8.
    """
    for i in range(5):
        out[i] = NO_DOP
    M = np.zeros((8, 8))
    column = np.full(8, -1)
    n = 3
    h = np.zeros(8)
    for s in range(m):
        if column[systems[s]] < 0:
            column[systems[s]] = n
            n += 1
    if m < n:
        return
    for s in range(m):
        for i in range(n):
            h[i] = -G[s, i] if i < 3 else 0.0
        h[column[systems[s]]] = 1.0
        for i in range(n):
            for j in range(n):
                M[i, j] += h[i] * h[j]
    if not invert_spd(M, n):
        return
    time = 0.0
    for i in range(3, n):
        time += M[i, i]
    horizontal = M[0, 0] + M[1, 1]
    out[GDOP] = math.sqrt(horizontal + M[2, 2] + time)
    out[PDOP] = math.sqrt(horizontal + M[2, 2])
    out[HDOP], out[VDOP], out[TDOP] = math.sqrt(horizontal), math.sqrt(M[2, 2]), math.sqrt(time)


@njit("void(f8[:, ::1], f8[:, ::1])", cache=True, entry=True)
def lines_of_sight(sky: F64, lines: F64) -> None:
    """``lines`` (M, 3): unit vectors towards azimuth and elevation ``sky`` (M, 2) [rad], NED."""
    for s in range(sky.shape[0]):
        flat = math.cos(sky[s, 1])
        lines[s, 0], lines[s, 1] = flat * math.cos(sky[s, 0]), flat * math.sin(sky[s, 0])
        lines[s, 2] = -math.sin(sky[s, 1])


@njit("f8(f8[:, ::1], i8[::1], i8, i8, i8[::1])", cache=True, entry=True)
def best_set(G: F64, systems: I64, m: int, count: int, best: I64) -> float:
    """The ``count`` of ``m`` satellites with the smallest GDOP, over all combinations.

    ``best`` (≥ count,) receives their rows, in order; returns the GDOP, :data:`NO_DOP` where no
    combination fixes the unknowns. A tie falls to the first in order. 20 choose 4 are 4845 sets,
    three milliseconds.
    """
    index = np.arange(count)
    sub = np.empty((count, 3))
    kinds = np.empty(count, np.int64)
    dop = np.empty(5)
    lowest = NO_DOP
    while True:
        for i in range(count):
            kinds[i] = systems[index[i]]
            for j in range(3):
                sub[i, j] = G[index[i], j]
        dilution(sub, kinds, count, dop)
        if dop[GDOP] < lowest:
            lowest = dop[GDOP]
            for i in range(count):
                best[i] = index[i]
        at = count - 1
        while at >= 0 and index[at] == m - count + at:
            at -= 1
        if at < 0:
            return lowest
        index[at] += 1
        for i in range(at + 1, count):
            index[i] = index[i - 1] + 1
