"""Λ as a product of columns is Λ: both back over the same tape, every optional state on it."""

from __future__ import annotations

import numpy as np
import pytest

from companion.estimation.covariance import STRIDE
from companion.estimation.tape import (
    C_STEP,
    F_FADE,
    F_GAIN,
    F_TURN,
    FADE,
    ROW,
    STEP,
    TURN,
    UPDATE,
)
from companion.smoothing.composite import (
    LAM,
    SCRATCH,
    WIDTH,
    begin,
    flush,
    smoothed_blocks,
    step_back,
    take_back,
)
from companion.smoothing.factor import (
    MOST,
    multiply_out,
    smoothed_by_columns,
    take_columns_back,
)
from companion.smoothing.phi import K_SIZE, coefficients, step_size
from companion.smoothing.transition import decay_factors
from tests.smoothing.linear import linear_run


@pytest.mark.parametrize("seed", range(3))
def test_a_product_of_columns_is_taken_back_as_the_whole(seed: int) -> None:
    run = linear_run(seed)
    n, lay, s = int(run.lay[0]), run.lay, run.s0.copy()
    few, many = np.zeros(n * WIDTH), np.zeros(n * WIDTH)
    Lam, U, V = (np.zeros(n * STRIDE) for _ in range(3))
    d, D, w, K = np.ones(n), np.ones(n), np.zeros(STRIDE), np.zeros(K_SIZE)
    B = np.zeros((24, 3, 3))
    begin(many, lay)
    columns, c, f = 0, len(run.coarse), len(run.fine)
    kinds = run.kinds.tolist()
    while columns < MOST:
        kind = kinds.pop()
        if kind == STEP:
            c -= C_STEP
            f -= step_size(lay)
            coefficients(run.coarse[c : c + C_STEP], run.fine[f : f + step_size(lay)], lay, s, B, K)
            decay_factors(run.fine[f], lay, run.par, d)
            step_back(K, lay, d, few, w[:n].copy())
            step_back(K, lay, d, many, D)
            flush(many, D, Lam, lay, U, V)
        elif kind != ROW:
            f -= {TURN: F_TURN, FADE: F_FADE}.get(kind, F_GAIN + n + kind - UPDATE)
            take_columns_back(kind, run.fine[f:], n, few, columns, d, w)
            take_back(kind, run.fine[f:], n, many, Lam, d, w)
            columns += kind >= UPDATE
    lam = [x.reshape(n, WIDTH)[:, LAM] for x in (few, many)]
    assert np.allclose(*lam, rtol=1e-9, atol=1e-12 * np.abs(lam[0]).max())
    P = np.zeros((n, STRIDE))
    P[:, :n] = run.P0
    dx, cov, whole = np.zeros(n), np.zeros(30), np.zeros(30)
    smoothed_by_columns(P.reshape(-1), few, n, np.zeros(SCRATCH), dx, cov)
    smoothed_blocks(P.reshape(-1), Lam, n, np.zeros(SCRATCH), whole)
    assert np.allclose(dx, -run.P0 @ lam[1], rtol=1e-9, atol=1e-9 * np.abs(dx).max())
    assert np.allclose(cov, whole, rtol=1e-6, atol=1e-9 * np.abs(np.diag(run.P0)).max())
    product = np.zeros(n * STRIDE)
    multiply_out(few, n, product)
    one, two = (x.reshape(n, STRIDE)[:, :n] for x in (product, Lam))
    assert np.abs(one - two).max() < 1e-9 * np.abs(two).max()
    assert np.all(few.reshape(n, WIDTH)[:, :MOST] == 0.0)
