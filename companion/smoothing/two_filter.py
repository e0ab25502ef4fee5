"""Simplified two-filter smoothing: the forward run and one over the log reversed, put together.

Kamil et al. 2014, section 4.2 and Fig. 2: no inverse of a covariance anywhere.
Inside an outage the backward solution's share w grows from 0 at its start through ½ in the middle
to 1 at its end; outside, the two are averaged by their variances. Attitude goes along the shortest
turn (slerp), which is φ → w φ for the rotation vector φ between the two.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.config import Config
from companion.estimation import parameters as par
from companion.estimation.stretch import Stretch
from companion.navigation import layout as lo
from companion.smoothing.backward_run import run_backwards
from companion.smoothing.correction import (
    apart,
    correct,
    from_rows,
    published_blocks,
    square,
    state_rows,
    to_rows,
)
from companion.types import (
    COV_POS,
    F64,
    I64,
    NS,
    AidingReports,
    Channel,
    Solution,
    Verdict,
)

GRADING = 1.0
"""Exponent of the weights inside an outage: 1 as the paper's straight lines."""
_DIAGONAL = [0, 3, 5]


def two_filter(
    solution: Solution, reports: AidingReports, stretches: Sequence[Stretch], config: Config
) -> Solution:
    """The simplified two-filter solution at the epochs of the settled forward ``solution``.

    ``reports`` of the same run say where GNSS was missing. Epochs for which the run backwards has
    nothing stay as they are.
    """
    parts = [
        _simplified(solution.take(rows), reports, stretch, config)
        for stretch, rows in _by_stretch(solution, stretches)
    ]
    return Solution.concatenate(parts)


def _by_stretch(solution: Solution, stretches: Sequence[Stretch]) -> list[tuple[Stretch, slice]]:
    """Each stretch with the rows of ``solution`` inside it."""
    found = []
    for stretch in stretches:
        rows = np.flatnonzero(solution.resets == stretch.resets)
        if len(rows):
            found.append((stretch, slice(int(rows[0]), int(rows[-1]) + 1)))
    return found


def _simplified(
    forward: Solution, reports: AidingReports, stretch: Stretch, config: Config
) -> Solution:
    back = run_backwards(stretch, config, forward.t_ns)
    layout = par.layout(config)
    other = published_blocks(square(back.triangle, layout.n))
    share = _shares(forward.cov, other, _gaps(reports, stretch, config), forward.t_ns)
    share[~back.known] = 0.0
    rows = to_rows(forward)
    dx = np.zeros((len(rows), layout.n))
    dx[:, : lo.CORE_STATES] = np.repeat(share, 3, axis=1) * apart(state_rows(back.nominal), rows)
    dx[~back.known] = 0.0
    correct(rows, dx, layout.vector())
    cov = _joined(forward.cov, other, share, layout.gnss >= 0)
    cov[~back.known] = forward.cov[~back.known]
    return from_rows(rows, forward.t_ns, cov, forward.mode, forward.resets)


def _gaps(reports: AidingReports, stretch: Stretch, config: Config) -> list[tuple[int, int]]:
    """Outages: between accepted fixes, longer than what the engine calls coasting [ns].

    One that lasts to the end of the stretch has no fix behind it: it ends there, and its end is
    known no better than the forward run knows it.
    """
    fixes = np.isin(reports.channel, [Channel.GNSS_POSITION_H, Channel.GNSS_VELOCITY_H])
    fixes &= reports.verdict == Verdict.ACCEPTED
    t = np.unique(reports.t_ns[fixes])
    t = t[(t >= stretch.start_ns) & (t <= stretch.end_ns)]
    t = np.concatenate([[stretch.start_ns], t])
    longer = np.diff(t) > round(config.engine.coasting_after_s * NS)
    return list(zip(t[:-1][longer].tolist(), t[1:][longer].tolist(), strict=True))


def _shares(own: F64, other: F64, gaps: list[tuple[int, int]], t_ns: I64) -> F64:
    """(N, 5) the backward solution's weight, a column for each block of :attr:`Solution.cov`.

    ``own``, ``other`` (N, 5, 6) are the covariances of the forward and of the backward solution.
    """
    var, var_back = (cov[:, :, _DIAGONAL].sum(axis=2) for cov in (own, other))
    share: F64 = var / (var + var_back)
    for begin, end in gaps:
        a, b = np.searchsorted(t_ns, [begin, end])
        share[a:b] = fading((t_ns[a:b] - begin) / (end - begin))[:, None]
    return share


def fading(elapsed: F64) -> F64:
    """The backward share at a fraction ``elapsed`` of an outage: 0, ½ in the middle, 1."""
    ahead, behind = elapsed**GRADING, (1.0 - elapsed) ** GRADING
    share: F64 = ahead / (ahead + behind)
    return share


def _joined(forward: F64, back: F64, share: F64, shared_prior: bool) -> F64:
    """(N, 5, 6) covariances of the weighted mean.

    The two runs have no measurement in common: (1 − w)² P_f + w² P_b. With a slow GNSS error both
    positions err by it alike: then (1 − w) P_f + w P_b, which holds for any correlation.
    """
    weight = share[:, :, None]
    cov = (1.0 - weight) ** 2 * forward + weight**2 * back
    if shared_prior:
        w_pos = weight[:, COV_POS]
        cov[:, COV_POS] = (1.0 - w_pos) * forward[:, COV_POS] + w_pos * back[:, COV_POS]
    return cov
