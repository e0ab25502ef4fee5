"""A channel's window of whitened innovations, and three numbers with known distributions.

For a healthy sensor, whitened innovations u = L⁻¹ y, L Lᵀ = S, are independent standard normal.
Of a window of n with m components each,

    spread       ν v = Σ |u − ū|²              is χ² with ν = (n − 1) m degrees of freedom
    mean         F = n |ū|² / (m v)            is F with m and ν, whatever the size of noise
    correlation  ρ = Σ uₖ·uₖ₋₁ / Σ |uₖ|²       is about normal with variance 1 / (n m)

The first two are turned into standard normal deviates by Wilson and Hilferty's cube root (1931) and
Paulson's (1942). The largest term of the spread counts as the second largest does, but where a mean
is held against it: no single innovation, however wrong, decides.

Beside the spread about the mean stands that between neighbours (von Neumann 1941),

    v' = Σ |uₖ − uₖ₋₁|² / 2ν    about χ² with (2 (n−1)² / (3 n − 4)) m degrees of freedom,

which noise gives likewise, but a step or a drift inside the window, which is no noise, does not.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.estimation.adaptation.layout import COUNT, NEXT, RING
from companion.types import F64

FEWEST = 8
"""Innovations before anything is said of them."""
SMALLEST = 1e-9
"""Sum of squares that something is divided by at least."""


@njit("void(f8[::1], i8, f8, f8, f8)", cache=True)
def push(w: F64, length: int, x: float, y: float, z: float) -> None:
    """Put one innovation into the window ``w``; the oldest of ``length`` goes."""
    at = RING + 3 * int(w[NEXT])
    w[at], w[at + 1], w[at + 2] = x, y, z
    w[NEXT] = (w[NEXT] + 1.0) % length
    w[COUNT] = min(w[COUNT] + 1.0, float(length))


@njit("f8(f8, f8)", cache=True)
def deviate_of_chi2(v: float, dof: float) -> float:
    """Standard normal deviate of χ²/dof = ``v``."""
    a = 2.0 / (9.0 * dof)
    return float((max(v, 0.0) ** (1.0 / 3.0) - (1.0 - a)) / math.sqrt(a))


@njit("f8(f8, f8, f8)", cache=True)
def deviate_of_f(x: float, dof: float, dof_below: float) -> float:
    """Standard normal deviate of an F with ``dof`` and ``dof_below``."""
    a, b = 2.0 / (9.0 * dof), 2.0 / (9.0 * dof_below)
    root = max(x, 0.0) ** (1.0 / 3.0)
    return float(((1.0 - b) * root - (1.0 - a)) / math.sqrt(b * root * root + a))


@njit("b1(f8[::1], i8, i8, f8[::1])", cache=True)
def statistics(w: F64, length: int, m: int, out: F64) -> bool:
    """Fill ``out`` (7,): deviates of mean, spread and correlation, v, |ū|²/m, v' and its deviate.

    False with fewer than :data:`FEWEST` innovations; ``out`` is not touched then.
    """
    n = int(w[COUNT])
    if n < FEWEST:
        return False
    mean = np.zeros(3)
    for k in range(n):
        for i in range(m):
            mean[i] += w[RING + 3 * k + i]
    square = 0.0
    for i in range(m):
        mean[i] /= n
        square += mean[i] * mean[i]
    first = int(w[NEXT]) if n == length else 0
    about, total, product, largest, second = 0.0, 0.0, 0.0, 0.0, 0.0
    between, widest, next_widest = 0.0, 0.0, 0.0
    previous = RING + 3 * first
    for j in range(n):
        at = RING + 3 * ((first + j) % length)
        e, jump = 0.0, 0.0
        for i in range(m):
            u = w[at + i]
            d = u - mean[i]
            e += d * d
            total += u * u
            if j > 0:
                before = w[previous + i]
                product += u * before
                jump += (u - before) * (u - before)
        previous = at
        between += jump
        if jump > widest:
            widest, next_widest = jump, widest
        elif jump > next_widest:
            next_widest = jump
        about += e
        if e > largest:
            largest, second = e, largest
        elif e > second:
            second = e
    dof = float((n - 1) * m)
    v = (about - largest + second) / dof
    out[0] = deviate_of_f(n * square * dof / (m * max(about, SMALLEST)), float(m), dof)
    out[1] = deviate_of_chi2(v, dof)
    out[2] = product / max(total, SMALLEST) * math.sqrt(float(n * m))
    out[3] = v
    out[4] = square / m
    # A step is one difference; it counts as the next one does.
    out[5] = 0.5 * (between - widest + next_widest) / dof
    out[6] = deviate_of_chi2(out[5], 2.0 * (n - 1) * (n - 1) * m / (3.0 * n - 4.0))
    return True
