"""Random processes that sensor errors are made of, as columns from a seeded generator."""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import lfilter

from companion.types import F64


def gauss_markov(rng: np.random.Generator, count: int, step_s: float, sd: F64, tau_s: float) -> F64:
    """First-order Gauss-Markov process (count, C), stationary from its first sample.

    x_{k+1} = a x_k + sqrt(1 − a²) sd w_k,  a = exp(−step/τ);  ``sd`` (C,) in the unit of x.
    """
    a = math.exp(-step_s / tau_s)
    drive = rng.standard_normal((count, len(sd))) * math.sqrt(1.0 - a * a)
    drive[:1] /= math.sqrt(1.0 - a * a)
    return np.asarray(lfilter([1.0], [1.0, -a], drive, axis=0) * sd)


def random_walk(rng: np.random.Generator, count: int, step_s: float, density: F64) -> F64:
    """Random walk (count, C) that starts at zero; ``density`` (C,) in units of x per √s."""
    steps = rng.standard_normal((count, len(density))) * math.sqrt(step_s)
    steps[:1] = 0.0
    return np.asarray(np.cumsum(steps, axis=0) * density)


def narrow_band(
    rng: np.random.Generator, count: int, step_s: float, rms: float, hz: float, columns: int
) -> F64:
    """Vibration-like noise (count, columns) of given ``rms`` around ``hz``, bandwidth hz / 10.

    x_k = 2 r cos θ x_{k−1} − r² x_{k−2} + w_k; above half the sampling rate ``hz`` aliases, as in
    a sensor without an anti-alias filter. Next to nothing of it is left below hz / 3.
    """
    r = math.exp(-math.pi * 0.1 * hz * step_s)
    c = math.cos(2.0 * math.pi * hz * step_s)
    settle = math.ceil(5.0 / (1.0 - r))
    drive = rng.standard_normal((settle + count, columns))
    out = lfilter([1.0], [1.0, -2.0 * r * c, r * r], drive, axis=0)[settle:]
    # Variance of the AR(2) process driven by unit white noise.
    variance = (1.0 + r * r) / ((1.0 - r * r) * ((1.0 + r * r) ** 2 - 4.0 * r * r * c * c))
    return np.asarray(out * (rms / math.sqrt(variance)))
