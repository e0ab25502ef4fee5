"""The chi-square gate of one to three degrees of freedom, without a statistics library's start-up.

    Q(1, x) = erfc √(x/2)     Q(2, x) = e^(−x/2)     Q(3, x) = Q(1, x) + √(2x/π) e^(−x/2)

Abramowitz and Stegun, 26.4.4 and 26.4.5.
"""

from __future__ import annotations

import math

_STEPS = 60
"""Newton's method on ln Q, which is nearly straight, settles in under ten."""


def exceeded_with(probability: float, dof: int) -> float:
    """x that a chi-square variable of ``dof`` 1, 2 or 3 exceeds with ``probability`` in (0, 1)."""
    wanted = math.log(probability)
    x = max(-2.0 * wanted, 1e-300)
    if dof == 2:
        return x
    for _ in range(_STEPS):
        tail, density = _tail_and_density(x, dof)
        new = x + (math.log(tail) - wanted) * tail / density
        # Below the smallest step, or thrown out on the left, where ln Q is flat.
        new = new if new > 0.0 else x / 2.0
        if abs(new - x) <= 1e-15 * x:
            return new
        x = new
    return x


def _tail_and_density(x: float, dof: int) -> tuple[float, float]:
    """Q and −dQ/dx for ``dof`` 1 or 3."""
    tail, e = math.erfc(math.sqrt(x / 2.0)), math.exp(-x / 2.0)
    if dof == 1:
        return tail, e / math.sqrt(2.0 * math.pi * x)
    root = math.sqrt(2.0 * x / math.pi)
    return tail + root * e, 0.5 * root * e
