"""Two-filter smoothing by whole covariances: the classical combination, for comparison.

    P_s = (P_f⁻¹ + P_b⁻¹ − Π⁻¹)⁻¹,   δx = P_s (P_b⁻¹ (x_b ⊟ x_f) − Π⁻¹ (0 ⊟ x_f))

Π is the stationary covariance of what both runs know beforehand, the slow GNSS error: a time-
reversible process, so that the run backwards starts from it again (Fraser & Potter 1969; Wall,
Willsky & Sandell 1981 for Π). On linear problems it is the optimal smoother, but for the hundredth
of the final state that starts the run backwards.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.config import Config
from companion.estimation import parameters as par
from companion.estimation.recording import Chunk, Tape
from companion.estimation.stretch import Stretch
from companion.navigation import layout as lo
from companion.smoothing.backward_run import Backward, run_backwards
from companion.smoothing.correction import (
    apart,
    correct,
    from_rows,
    published_blocks,
    square,
    state_rows,
)
from companion.smoothing.offline import SmoothingError
from companion.smoothing.tape_states import covariance_at_rows, optional, states_at_rows
from companion.smoothing.two_filter import by_stretch
from companion.types import F64, Solution


def two_filter_weighted(
    tapes: Sequence[Tape], stretches: Sequence[Stretch], config: Config
) -> Solution:
    """The covariance-weighted two-filter solution at the output rows of ``tapes``.

    Raises :class:`SmoothingError` where a covariance cannot be inverted.
    """
    parts = []
    for tape, stretch in by_stretch(tapes, stretches):
        chunks = [chunk for chunk in tape.chunks if len(chunk.t_ns)]
        back = run_backwards(stretch, config, np.concatenate([c.t_ns for c in chunks]))
        parts += [_of_chunk(chunk, own, config) for chunk, own in back.by_chunk(chunks)]
    return Solution.concatenate(parts)


def _of_chunk(chunk: Chunk, back: Backward, config: Config) -> Solution:
    layout = par.layout(config)
    lay, n = layout.vector(), layout.n
    extra = states_at_rows(chunk, lay, par.parameter_vector(config))
    rows = chunk.nominal.copy()
    P = covariance_at_rows(chunk, lay, par.parameter_vector(config))
    cov = P.copy()
    dx = np.zeros((len(rows), n))
    known = back.known
    if known.any():
        between = optional(back.nominal[known], lay) - extra[known]
        between[:, : lo.CORE_STATES] = apart(state_rows(back.nominal[known]), rows[known])
        prior = np.zeros(n)
        if layout.gnss >= 0:
            slow = slice(layout.gnss, layout.gnss + 3)
            prior[slow] = 1.0 / par.initial_variances(config, layout)[slow]
        dx[known], cov[known] = combine(
            P[known], square(back.triangle[known], n), between, prior, -extra[known]
        )
    correct(rows, dx, lay)
    return from_rows(rows, chunk.t_ns, published_blocks(cov), chunk.mode, chunk.resets)


def combine(P: F64, P_back: F64, between: F64, prior: F64, beforehand: F64) -> tuple[F64, F64]:
    """Smoothed error (N, n) relative to the forward estimates, and its covariance (N, n, n).

    ``P``, ``P_back`` (N, n, n) forward and backward covariances, ``between`` (N, n) = x_b ⊟ x_f,
    ``prior`` (n,) diagonal of Π⁻¹, ``beforehand`` (N, n) = 0 ⊟ x_f.
    """
    try:
        # Scaled to unit variances: metres, radians and biases are far apart.
        sd = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
        scale = sd[:, :, None] * sd[:, None, :]
        information = np.linalg.inv(P / scale)
        back = np.linalg.inv(P_back / scale)
        weight = prior * sd * sd
        total = information + back
        total[:, range(len(prior)), range(len(prior))] -= weight
        cov = np.linalg.inv(total)
    except np.linalg.LinAlgError:
        raise SmoothingError("a covariance on the tape is not positive definite") from None
    pull = (back @ (between / sd)[:, :, None])[:, :, 0] - weight * beforehand / sd
    dx: F64 = (cov @ pull[:, :, None])[:, :, 0] * sd
    return dx, 0.5 * (cov + cov.transpose(0, 2, 1)) * scale
