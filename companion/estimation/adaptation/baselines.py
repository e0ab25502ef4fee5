"""What is in print, behind the same interface: each estimates one factor on a channel's R.

None of them tells a bad sensor from a bad model; they are here to be compared with.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.estimation.adaptation.layout import COUNT, RATE, RING, SHAPE
from companion.estimation.adaptation.parameters import (
    FORGETTING,
    HUBER_K,
    IGG_HIGH,
    IGG_LOW,
    LENGTH,
)
from companion.estimation.adaptation.window import FEWEST, push
from companion.navigation.layout import WINDOW_SIZE, WINDOWS
from companion.types import F64

SMALLEST, LARGEST = 1e-2, 1e6
"""Bounds of an estimated factor: the published estimators may leave the positive numbers."""
ITERATIONS = 3
"""Of the variational fixed point, which converges by a factor of ten or more a round."""


@njit("f8(f8)", cache=True)
def bounded(x: float) -> float:
    """``x`` within the bounds; nominal where it is not a number."""
    return min(max(x, SMALLEST), LARGEST) if x == x else 1.0


@njit("f8(f8[::1], f8[::1], i8, i8, f8[::1], f8[::1], f8[::1])", cache=True)
def innovation_scale(s: F64, a: F64, channel: int, m: int, y: F64, foreseen: F64, R: F64) -> float:
    """R from the innovations' covariance in a window: R̂ = Ĉ − H P⁻ Hᵀ.

    Mohamed and Schwarz 1999, eq. 15, as one factor: the mean of (y² − H P⁻ Hᵀ)/R over window and
    components. ``foreseen`` (3,) is the diagonal of H P⁻ Hᵀ.
    """
    w = s[WINDOWS + channel * WINDOW_SIZE : WINDOWS + (channel + 1) * WINDOW_SIZE]
    e = 0.0
    for i in range(m):
        e += (y[i] * y[i] - foreseen[i]) / (R[i] * m)
    push(w, int(a[LENGTH]), min(e, LARGEST), 0.0, 0.0)
    n = int(w[COUNT])
    if n < FEWEST:
        return 1.0
    total = 0.0
    for k in range(n):
        total += w[RING + 3 * k]
    return float(bounded(total / n))


@njit("f8(f8[::1], f8[::1], i8, i8, f8[::1], f8[::1], f8[::1])", cache=True)
def variational_scale(s: F64, a: F64, channel: int, m: int, y: F64, foreseen: F64, R: F64) -> float:
    """R by variational Bayes: an inverse gamma that forgets, its fixed point at each update.

    Särkkä and Nummenmaa 2009, algorithm 1, for one factor f on all components' R: f̂ = β/α,
    α ← ρ α + m/2, β ← ρ β + ½ Σ (ε² + (H P Hᵀ)_ii)/R_i with residual ε and P after the update,
    taken component by component.
    """
    w = s[WINDOWS + channel * WINDOW_SIZE : WINDOWS + (channel + 1) * WINDOW_SIZE]
    rho = a[FORGETTING]
    if w[COUNT] == 0.0:
        # As if the configured R had been seen for as long as is remembered.
        w[COUNT] = 1.0
        w[SHAPE] = w[RATE] = 0.5 * m / max(1.0 - rho, 1e-3)
    shape = rho * w[SHAPE] + 0.5 * m
    kept = rho * w[RATE]
    factor = w[RATE] / w[SHAPE]
    rate = kept
    for _ in range(ITERATIONS):
        rate = kept
        for i in range(m):
            after = factor * R[i] / (foreseen[i] + factor * R[i])
            rate += 0.5 * (y[i] * y[i] * after * after + foreseen[i] * after) / R[i]
        factor = bounded(rate / shape)
    w[SHAPE], w[RATE] = shape, factor * shape
    return float(factor)


@njit("f8(f8[::1], i8, f8)", cache=True)
def huber_scale(a: F64, m: int, nis: float) -> float:
    """Huber's weight of this innovation: 1 up to k, then k/d; d² = NIS per component."""
    d = math.sqrt(nis / m)
    return min(d / a[HUBER_K], LARGEST) if d > a[HUBER_K] else 1.0


@njit("f8(f8[::1], i8, f8)", cache=True)
def igg3_scale(a: F64, m: int, nis: float) -> float:
    """IGG-III (Yang 1999): 1 up to k₀, falling to none at k₁; beyond it the gate refuses."""
    d = math.sqrt(nis / m)
    low, high = a[IGG_LOW], a[IGG_HIGH]
    if d <= low or d >= high:
        return 1.0
    t = (high - d) / (high - low)
    return float(min(d / (low * np.float64(t * t)), LARGEST))
