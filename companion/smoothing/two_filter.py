"""Simplified two-filter smoothing: the forward run and one over the log reversed, put together.

Kamil et al. 2014, section 4.2 and Fig. 2: no inverse of a covariance anywhere. Inside an outage the
backward solution's share grows from 0 at its start through ½ in the middle to 1 at its end;
outside, the two are averaged by their variances. Attitude goes along the shortest turn (slerp),
which is φ → w φ for the rotation vector φ between the two.
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
from companion.smoothing.correction import apart, correct, from_rows, square, state_rows, triangles
from companion.smoothing.fading import Fading, by_variance, fade, joined
from companion.smoothing.tape_states import covariance_at_rows
from companion.types import F64, NS, AidingReports, Channel, Solution, Verdict


def two_filter(
    tapes: Sequence[Tape],
    reports: AidingReports,
    stretches: Sequence[Stretch],
    config: Config,
    fading: Fading = "consistent",
) -> Solution:
    """The simplified two-filter solution at the output rows of ``tapes``.

    ``reports`` of the same run say where GNSS was missing. Epochs for which the run backwards has
    nothing stay as they are.
    """
    parts = []
    for tape, stretch in by_stretch(tapes, stretches):
        chunks = [chunk for chunk in tape.chunks if len(chunk.t_ns)]
        gaps = outages(reports, stretch, config)
        t_ns = np.concatenate([chunk.t_ns for chunk in chunks])
        back = run_backwards(stretch, config, t_ns)
        for chunk, own in back.by_chunk(chunks):
            parts.append(_of_chunk(chunk, own, gaps, config, fading))
    return Solution.concatenate(parts)


def by_stretch(tapes: Sequence[Tape], stretches: Sequence[Stretch]) -> list[tuple[Tape, Stretch]]:
    """The tapes that have rows, each with its inputs."""
    inputs = {stretch.resets: stretch for stretch in stretches}
    found = []
    for tape in tapes:
        resets = next((int(c.resets[0]) for c in tape.chunks if len(c.resets)), None)
        if resets is not None:
            found.append((tape, inputs[resets]))
    return found


def outages(reports: AidingReports, stretch: Stretch, config: Config) -> list[tuple[int, int]]:
    """Outages: between accepted fixes, longer than what the engine calls coasting [ns].

    One that lasts to the end of the stretch has no fix behind it and is none: what the run
    backwards starts from there is the forward run's, and is weighted as that.
    """
    fixes = np.isin(reports.channel, [Channel.GNSS_POSITION_H, Channel.GNSS_VELOCITY_H])
    fixes &= reports.verdict == Verdict.ACCEPTED
    t = np.unique(reports.t_ns[fixes])
    t = t[(t >= stretch.start_ns) & (t <= stretch.end_ns)]
    t = np.concatenate([[stretch.start_ns], t])
    longer = np.diff(t) > round(config.engine.coasting_after_s * NS)
    return list(zip(t[:-1][longer].tolist(), t[1:][longer].tolist(), strict=True))


def _of_chunk(
    chunk: Chunk, back: Backward, gaps: list[tuple[int, int]], config: Config, fading: Fading
) -> Solution:
    layout = par.layout(config)
    P = covariance_at_rows(chunk, layout.vector(), par.parameter_vector(config))
    P_back = square(back.triangle, layout.n)
    P_back[~back.known] = P[~back.known]
    weights = by_variance(_variances(P), _variances(P_back))
    for gap in gaps:
        fade(weights, chunk.t_ns, gap, fading)
    weights.motion[~back.known] = 0.0
    weights.rest[~back.known] = 0.0
    rows = chunk.nominal.copy()
    between = apart(state_rows(back.nominal), rows)
    between[~back.known] = 0.0
    dx = np.zeros((len(rows), layout.n))
    dx[:, : lo.CORE_STATES] = weights.correction(between)
    correct(rows, dx, layout.vector())
    cov = joined(weights, P, P_back, _common(P, P_back, config))
    return from_rows(rows, chunk.t_ns, triangles(cov), chunk.mode, chunk.resets)


def _variances(P: F64) -> F64:
    """(N, 5) variances of the blocks of the core, their components taken together."""
    diagonal = np.diagonal(P, axis1=1, axis2=2)[:, : lo.CORE_STATES]
    total: F64 = diagonal.reshape(-1, 5, 3).sum(axis=2)
    return total


def _common(P: F64, P_back: F64, config: Config) -> F64:
    """(N, 3) position variance that both runs err by alike: the slow GNSS error, as far as known.

    Never more than either has. It changes within an outage; taking it for constant claims less.
    """
    layout = par.layout(config)
    if layout.gnss < 0:
        return np.zeros((len(P), 3))
    prior = par.initial_variances(config, layout)[layout.gnss : layout.gnss + 3]
    own, other = (np.diagonal(x, axis1=1, axis2=2)[:, :3] for x in (P, P_back))
    return np.minimum(np.minimum(own, other), prior)
