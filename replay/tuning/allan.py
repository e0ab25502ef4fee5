"""Allan deviation of a sensor at rest, and the noise processes that explain it.

The two-sample variance of means over τ is, for independent processes, the sum

    σ²(τ) = 3 Q²/τ² + N²/τ + (2 B² T/τ) [1 − T/(2τ) (3 − 4 e^(−τ/T) + e^(−2τ/T))] + K² τ/3

of quantisation Q, white noise of density N, a Gauss-Markov bias of 1σ B and correlation time T,
and a random walk of density K (IEEE Std 952-1997, annex C).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from companion.types import F64

CLUSTERS = 8.0
"""Longest τ: the record holds this many of them. Fewer say next to nothing of their variance."""
_PER_DECADE = 12


@dataclass(frozen=True, slots=True)
class AllanCurve:
    """Overlapping Allan deviation, axes taken together."""

    tau_s: F64
    """(M,) averaging times."""
    deviation: F64
    """(M,) root of the mean variance of the axes, in units of the signal."""
    seconds: float
    """Length of the record."""
    axes: int


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """What explains a curve; None: the record cannot tell."""

    density: float
    """N: white noise [unit·√s], which is unit/√Hz."""
    quantisation: float
    """Q [unit·s]."""
    instability: float | None
    """B: 1σ of the Gauss-Markov bias [unit]."""
    instability_tau_s: float | None
    walk: float | None
    """K: random walk of the bias [unit/√s]."""
    floor: float
    """Lowest point of the curve ÷ 0.664: the bias instability of datasheets [unit]."""
    residual: float
    """RMS of log measured over modelled variance, in standard deviations of the estimate."""

    def walk_between(self, tau_s: float) -> float | None:
        """Random walk density that grows as much as the whole bias does in ``tau_s``, or None.

        A Gauss-Markov bias seen for times far below its own looks like a walk of B √(2/T).
        """
        if self.instability is None or self.instability_tau_s is None:
            return self.walk
        share = -math.expm1(-tau_s / self.instability_tau_s)
        grown = 2.0 * self.instability**2 * share / tau_s
        return math.sqrt(grown + (self.walk or 0.0) ** 2)


def allan_deviation(signal: F64, step_s: float) -> AllanCurve:
    """Overlapping Allan deviation of ``signal`` (N, C), sampled every ``step_s``.

    σ²(m·step) = ⟨(θ_{k+2m} − 2 θ_{k+m} + θ_k)²⟩ / (2 (m·step)²) with θ the running integral.
    Raises :class:`ValueError` for fewer than 100 samples.
    """
    count = len(signal)
    if count < 100:
        raise ValueError(f"{count} samples are too few for an Allan deviation")
    theta = np.zeros((count + 1, signal.shape[1]))
    # Without the mean, which the second difference takes out anyway, the sum keeps its digits.
    np.cumsum((signal - signal.mean(axis=0)) * step_s, axis=0, out=theta[1:])
    longest = count / CLUSTERS
    decades = math.log10(longest)
    m = np.unique(np.logspace(0, decades, max(2, round(decades * _PER_DECADE))).astype(np.int64))
    variance = np.array(
        [np.mean((theta[2 * k :] - 2.0 * theta[k:-k] + theta[: -2 * k]) ** 2) for k in m]
    )
    tau = np.asarray(m * step_s, np.float64)
    deviation = np.asarray(np.sqrt(0.5 * variance) / tau, np.float64)
    return AllanCurve(tau, deviation, count * step_s, signal.shape[1])


def gauss_markov_variance(tau: F64, sd: float, correlation_s: float) -> F64:
    """Allan variance of a Gauss-Markov process of 1σ ``sd``."""
    x = tau / correlation_s
    # The bracket is x/3·(…) for small x, where its terms cancel: 1 − (3 − 4e^−x + e^−2x)/2x.
    bracket = np.where(
        x < 1e-3,
        x / 3.0 - x * x / 4.0,
        1.0 - (3.0 - 4.0 * np.exp(-x) + np.exp(-2.0 * x)) / (2.0 * np.maximum(x, 1e-12)),
    )
    return 2.0 * sd * sd / x * bracket


def fit(curve: AllanCurve) -> NoiseModel:
    """Noise processes that explain ``curve``, each τ weighted by how well it is known.

    A process is stated only where it makes a tenth of the variance somewhere on the curve.
    """
    tau, variance = curve.tau_s, curve.deviation**2
    # Relative standard deviation of an overlapping estimate with T/τ − 1 clusters an axis.
    spread = np.sqrt(2.0 / (1.5 * curve.axes * np.maximum(curve.seconds / tau - 1.0, 1.0)))
    at = int(np.argmin(np.abs(np.log(tau))))
    white = float(curve.deviation[at]) * math.sqrt(tau[at])
    low = float(curve.deviation.min())

    def modelled(x: F64) -> F64:
        q, n, b, t, k = np.exp(x)
        total: F64 = (
            3.0 * q * q / tau**2 + n * n / tau + gauss_markov_variance(tau, b, t) + k * k * tau / 3
        )
        return total

    def residuals(x: F64) -> F64:
        result: F64 = np.log(modelled(x) / variance) / spread
        return result

    best = None
    for t in np.geomspace(10.0 * tau[0], curve.seconds / 5.0, 5):
        start = np.log([0.1 * white * tau[0] ** 0.5, white, low, t, 0.1 * low / math.sqrt(t)])
        bounds = (start - 16.0, start + 8.0)
        found = least_squares(residuals, start, bounds=bounds)
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    q, n, b, t, k = (float(v) for v in np.exp(best.x))
    total = modelled(best.x)
    has_b = bool(np.any(gauss_markov_variance(tau, b, t) > 0.1 * total)) and t < curve.seconds / 5.0
    has_k = bool(np.any(k * k * tau / 3 > 0.1 * total))
    return NoiseModel(
        density=n,
        quantisation=q,
        instability=b if has_b else None,
        instability_tau_s=t if has_b else None,
        walk=k if has_k else None,
        floor=low / 0.664,
        residual=float(np.sqrt(np.mean(residuals(best.x) ** 2))),
    )
