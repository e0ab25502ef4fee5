"""The gate's quantile against scipy's."""

from __future__ import annotations

import pytest
from scipy.special import chdtri

from companion.estimation.chi_square import exceeded_with


@pytest.mark.parametrize("dof", [1, 2, 3])
@pytest.mark.parametrize("probability", [1e-15, 1e-4, 0.01, 0.3, 0.5, 0.9, 0.99])
def test_quantile(dof: int, probability: float) -> None:
    # A few units in the last place, more where the tail is nearly one and has lost digits.
    close = 1e-14 / (1.0 - probability)
    assert exceeded_with(probability, dof) == pytest.approx(chdtri(dof, probability), rel=close)
