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


@njit("b1(f8[:, ::1], i8)", cache=True, counted=False)
def invert_spd(M: F64, n: int) -> bool:
    """Invert the leading n×n (n ≤ 7) of a symmetric positive definite matrix in place.

    ``M`` (8, 8), the last column being scratch. Gauss-Jordan without pivoting, which a positive
    definite matrix does not need. False, and the matrix destroyed, where it is not (numerically)
    definite.
    """
    for i in range(n):
        if not M[i, i] > 0.0:
            return False
        M[i, 7] = M[i, i]
    for k in range(n):
        if not M[k, k] > 1e-12 * M[k, 7]:
            return False
        inverse = 1.0 / M[k, k]
        M[k, k] = 1.0
        for j in range(n):
            M[k, j] *= inverse
        for i in range(n):
            if i != k:
                f = M[i, k]
                M[i, k] = 0.0
                for j in range(n):
                    M[i, j] -= f * M[k, j]
    return True


@njit("void(f8[:, ::1], i8, f8[::1], f8)", cache=True, counted=False)
def add_line(N: F64, k: int, u: F64, weight: float) -> None:
    """Add ``weight`` hᵀh of a range's line h to ``N`` (8, 8), above and on the diagonal only.

    h holds −``u`` (3,), the line of sight, for the place, and a 1 at ``k`` > 2 for its clock.
    """
    w0, w1, w2 = weight * u[0], weight * u[1], weight * u[2]
    N[0, 0] += w0 * u[0]
    N[0, 1] += w0 * u[1]
    N[0, 2] += w0 * u[2]
    N[1, 1] += w1 * u[1]
    N[1, 2] += w1 * u[2]
    N[2, 2] += w2 * u[2]
    N[0, k] -= w0
    N[1, k] -= w1
    N[2, k] -= w2
    N[k, k] += weight


@njit("void(f8[:, ::1], i8)", cache=True, counted=False)
def mirror(N: F64, n: int) -> None:
    """Fill the leading n×n below the diagonal from above it."""
    for i in range(1, n):
        for j in range(i):
            N[i, j] = N[j, i]


@njit("void(f8[:, ::1], i8[::1], i8, f8[:, ::1], f8[::1])", cache=True, counted=False)
def dilution(G: F64, systems: I64, m: int, M: F64, out: F64) -> None:
    """GDOP, PDOP, HDOP, VDOP, TDOP into ``out`` (5,); :data:`NO_DOP` where there is none.

    ``G`` (m, 3): lines of sight towards the satellites, NED; a clock for each of ``systems`` (m,)
    that occurs; ``M`` (8, 8) is scratch. GDOP = √tr (HᵀH)⁻¹, Sasiadek & Hartana 2004 eq. 8.
    """
    for i in range(5):
        out[i] = NO_DOP
    M[:, :] = 0.0
    n = 3
    for s in range(m):
        # Which column is a system's own stands in the last one until all are in.
        k = int(M[systems[s], 7])
        if k == 0:
            k = n
            M[systems[s], 7] = n
            n += 1
        add_line(M, k, G[s], 1.0)
    if m < n:
        return
    mirror(M, n)
    if not invert_spd(M, n):
        return
    time = 0.0
    for i in range(3, n):
        time += M[i, i]
    horizontal = M[0, 0] + M[1, 1]
    out[GDOP] = math.sqrt(horizontal + M[2, 2] + time)
    out[PDOP] = math.sqrt(horizontal + M[2, 2])
    out[HDOP], out[VDOP], out[TDOP] = math.sqrt(horizontal), math.sqrt(M[2, 2]), math.sqrt(time)


@njit("f8(f8[:, ::1], i8[::1], i8, i8, i8[::1])", cache=True)
def best_set(G: F64, systems: I64, m: int, count: int, best: I64) -> float:
    """The ``count`` of ``m`` satellites with the smallest GDOP, over all combinations.

    ``best`` (≥ count,) receives their rows, in order; returns the GDOP, :data:`NO_DOP` where no
    combination fixes the unknowns. A tie falls to the first in order. 20 choose 4 are 4845 sets,
    three milliseconds.
    """
    index = np.arange(count)
    sub = np.empty((count, 3))
    kinds = np.empty(count, np.int64)
    dop, M = np.empty(5), np.empty((8, 8))
    lowest = NO_DOP
    while True:
        for i in range(count):
            kinds[i] = systems[index[i]]
            for j in range(3):
                sub[i, j] = G[index[i], j]
        dilution(sub, kinds, count, M, dop)
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
