"""Parameters of the adaptation as the kernels take them, made from a configuration."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np

from companion.config.adaptation import ACTIONS, MEANS, METHODS, SPREADS, Adaptation
from companion.types import F64

(
    LENGTH,  # innovations of a window
    USUAL,  # deviate up to which an input is wholly usual
    ODD,  # deviate halfway
    UNUSUAL,  # deviate from which it is wholly unusual
    R_MAX,
    R_MIN,
    Q_MAX,
    RISE,
    FALL,
    R_TABLE,  # nine actions, spread by spread
    Q_TABLE,
    ALPHA_TABLE,  # nine weights α, covariance by covariance
    FORGETTING,
    HUBER_K,
    IGG_LOW,
    IGG_HIGH,
    SIZE,
) = (*range(10), 18, 27, 36, 37, 38, 39, 40)


def adaptation_vector(config: Adaptation) -> F64:
    """The parameters of ``config``, by the names of this module.

    Rules go to their place in a table: their order in the configuration leaves no trace.
    """
    p = np.zeros(SIZE)
    f = config.fuzzy
    p[LENGTH] = config.window
    # Not scipy's: importing it would cost a start a fifth of a second.
    normal = NormalDist()
    p[USUAL], p[UNUSUAL] = normal.inv_cdf(f.usual), -normal.inv_cdf(f.false_alarm)
    p[ODD] = 0.5 * (p[USUAL] + p[UNUSUAL])
    p[R_MAX], p[R_MIN], p[Q_MAX] = f.r_max, f.r_min, f.q_max
    p[RISE], p[FALL] = f.rise, f.fall
    for rule in f.rules:
        at = 3 * SPREADS.index(rule.spread) + MEANS.index(rule.mean)
        p[R_TABLE + at] = ACTIONS.index(rule.r)
        p[Q_TABLE + at] = ACTIONS.index(rule.q)
    weights = {"zero": 1.0, **{n: getattr(config.flac, n) for n in ("small", "medium", "large")}}
    for flac in config.flac.rules:
        at = 3 * MEANS.index(flac.covariance) + MEANS.index(flac.mean)
        p[ALPHA_TABLE + at] = weights[flac.alpha]
    p[FORGETTING] = config.variational_forgetting
    p[HUBER_K] = config.huber
    p[IGG_LOW], p[IGG_HIGH] = config.igg3
    return p


def method_code(config: Adaptation) -> int:
    """The code of the method, see layout.py."""
    return METHODS.index(config.method)
