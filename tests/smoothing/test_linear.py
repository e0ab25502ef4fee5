"""On a linear problem: Bryson-Frazier = RTS = one batch solution of all measurements."""

from __future__ import annotations

import numpy as np
import pytest

from companion.smoothing import bryson_frazier as bf
from companion.smoothing import rts
from companion.smoothing.composite import scratch
from companion.smoothing.covariances import covariances
from companion.smoothing.phi import K_SIZE
from companion.types import F64
from tests.smoothing.linear import LinearRun, linear_run

TOLERANCE = 1e-9
"""Of a standard deviation: rounding of a few hundred products of a 28-state problem; a wrong sign
or a missing term is of the order of one."""


def bryson_frazier(run: LinearRun) -> tuple[F64, F64]:
    n = int(run.lay[0])
    lam, steps = np.zeros(n), np.zeros((run.steps, n + K_SIZE))
    tape = (run.kinds, run.coarse, run.fine, run.lay, run.par)
    room = scratch()
    bf.backward(*tape, room, run.s0.copy(), lam, steps)
    rows = np.zeros_like(run.forward)
    bf.forward(*tape, room, -run.P0 @ lam, steps, rows)
    cov = np.zeros((len(rows), 30))
    before, none = np.zeros((len(rows), n, n)), np.zeros((0, n, n))
    covariances(*tape, run.s0.copy(), run.P0.copy(), none, none, before)
    bf.backward_covariance(*tape, room, steps, before, np.zeros((n, n)), cov)
    cov = cov.reshape(-1, 5, 6)
    return rows, cov


def blocks(cov: F64) -> F64:
    """(rows, 5, 6) published blocks of full covariances (rows, n, n)."""
    i, j = np.triu_indices(3)
    return np.stack([cov[:, 3 * b + i, 3 * b + j] for b in range(5)], axis=1)


@pytest.mark.parametrize("seed", range(4))
def test_bryson_frazier_is_the_batch_solution(seed: int) -> None:
    run = linear_run(seed)
    dx, cov = bryson_frazier(run)
    sd = np.sqrt(np.diagonal(run.batch_cov, axis1=1, axis2=2))
    assert np.abs((run.forward + dx - run.batch) / sd).max() < TOLERANCE
    # P is larger than what is left of it.
    scale = np.abs(blocks(run.batch_cov))[:, :, [0, 3, 5]].max(axis=2)
    assert np.abs((cov - blocks(run.batch_cov)) / scale[:, :, None]).max() < 100 * TOLERANCE


@pytest.mark.parametrize("seed", range(4))
def test_rts_is_the_batch_solution(seed: int) -> None:
    run = linear_run(seed)
    n = int(run.lay[0])
    P = run.P0.copy()
    before, foreseen = (np.zeros((run.steps, n, n)) for _ in range(2))
    tape = (run.kinds, run.coarse, run.fine, run.lay, run.par, run.s0.copy())
    covariances(*tape, P, before, foreseen, np.zeros((0, n, n)))
    rows, cov = np.zeros_like(run.forward), np.zeros((len(run.forward), n, n))
    assert rts.backward(*tape, before, foreseen, np.zeros(n), P, rows, cov)
    sd = np.sqrt(np.diagonal(run.batch_cov, axis1=1, axis2=2))
    assert np.abs((run.forward + rows - run.batch) / sd).max() < TOLERANCE
    scaled = (cov - run.batch_cov) / (sd[:, :, None] * sd[:, None, :])
    assert np.abs(scaled).max() < TOLERANCE
