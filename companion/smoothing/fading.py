"""How a forward and a backward solution are faded over: weights in time, without an inverse.

δx = A (x_b ⊟ x_f) is what the forward solution is corrected by. For two solutions from the same
inertial data their difference in position, d, moves with their difference in velocity, ḋ, and both
errors with it: fading each by itself with the same straight weight leaves velocities that are not
the rate of the positions. What is nought at the outage's start in value and rate, the whole
difference at its end in value and rate, and as smooth as an error of inertial navigation between is
the cubic (Hermite's) in τ, the elapsed fraction of the outage of length T:

    δp = s d + 2 T τ² (1 − τ)² ḋ,           s = 3 τ² − 2 τ³
    δv = 6 τ (1 − τ) / T d + (s + 4 τ (1 − τ) (1 − 2 τ)) ḋ

δv is the rate of δp. Attitude and biases differ as random walks do: straight weights. It is the
optimal interpolation of white acceleration error between two ends that are known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from companion.types import F64, I64, NS

Fading = Literal["consistent", "straight"]
"""``straight``: every quantity by itself from 1:0 through 1:1 to 0:1, Kamil et al. 2014, Fig. 2.
``consistent``: the same ends and middle, position and velocity together."""


@dataclass(frozen=True, slots=True)
class Weights:
    """Shares of the backward solution at N epochs."""

    motion: F64
    """(N, 2, 2) A of position and velocity, alike for every axis."""
    rest: F64
    """(N, 3) of attitude, accelerometer bias and gyro bias."""

    def correction(self, apart: F64) -> F64:
        """δx (N, 15) of differences x_b ⊟ x_f (N, 15)."""
        dx = np.empty_like(apart)
        motion = apart[:, :6].reshape(-1, 2, 3)
        dx[:, :6] = np.einsum("nij,njk->nik", self.motion, motion).reshape(-1, 6)
        dx[:, 6:] = np.repeat(self.rest, 3, axis=1) * apart[:, 6:]
        return dx


def by_variance(own: F64, other: F64) -> Weights:
    """The backward share of an average by variances (N, 5): own of the forward solution."""
    share = own / (own + other)
    motion = np.zeros((len(share), 2, 2))
    motion[:, 0, 0], motion[:, 1, 1] = share[:, 0], share[:, 1]
    return Weights(motion, share[:, 2:].copy())


def fade(weights: Weights, t_ns: I64, gap: tuple[int, int], fading: Fading) -> None:
    """Replace the weights inside an outage from ``gap[0]`` up to ``gap[1]`` [ns]."""
    begin, end = gap
    rows = slice(*np.searchsorted(t_ns, [begin, end]))
    elapsed: F64 = (t_ns[rows] - begin) / (end - begin)
    weights.rest[rows] = elapsed[:, None]
    if fading == "straight":
        weights.motion[rows] = elapsed[:, None, None] * np.eye(2)
    else:
        weights.motion[rows] = consistent(elapsed, (end - begin) / NS)


def consistent(elapsed: F64, seconds: float) -> F64:
    """(N, 2, 2) A of position and velocity at fractions ``elapsed`` of an outage."""
    left = 1.0 - elapsed
    share = elapsed**2 * (3.0 - 2.0 * elapsed)
    A = np.empty((len(elapsed), 2, 2))
    A[:, 0, 0] = share
    A[:, 0, 1] = 2.0 * seconds * (elapsed * left) ** 2
    A[:, 1, 0] = 6.0 * elapsed * left / seconds
    A[:, 1, 1] = share + 4.0 * elapsed * left * (left - elapsed)
    return A


def joined(weights: Weights, P: F64, P_back: F64, common: F64) -> F64:
    """(N, 5, 3, 3) covariances of the corrected solution's blocks.

    The runs share no measurement: (I − A) P_f (I − A)ᵀ + A P_b Aᵀ. What both err by all the same,
    ``common`` (N, 3) variance of position in each, enters as their cross-covariance. ``P``,
    ``P_back`` (N, ≥ 15, ≥ 15).
    """
    A = weights.motion
    keep = np.eye(2) - A
    out = np.empty((len(A), 5, 3, 3))
    for block in range(2):
        total = np.zeros((len(A), 3, 3))
        for i in range(2):
            for j in range(2):
                at = np.s_[:, 3 * i : 3 * i + 3, 3 * j : 3 * j + 3]
                own = keep[:, block, i] * keep[:, block, j]
                other = A[:, block, i] * A[:, block, j]
                total += own[:, None, None] * P[at] + other[:, None, None] * P_back[at]
        both = 2.0 * keep[:, block, 0] * A[:, block, 0]
        total[:, range(3), range(3)] += both[:, None] * common
        out[:, block] = total
    for block in range(2, 5):
        at = np.s_[:, 3 * block : 3 * block + 3, 3 * block : 3 * block + 3]
        share = weights.rest[:, block - 2, None, None]
        out[:, block] = (1.0 - share) ** 2 * P[at] + share**2 * P_back[at]
    return out
