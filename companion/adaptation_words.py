"""The rules of an adaptation in words, for people who look at a flight and not at a table."""

from __future__ import annotations

from companion.types import Rule

MOST = 0.5
"""Share beyond which a cause is named."""
_SPREAD = {"LOW": "less than expected", "USUAL": "as expected", "HIGH": "more than expected"}
_MEAN = {"ZERO": "about zero", "SMALL": "a little off zero", "LARGE": "far off zero"}


def told(rule: int, to_model: float, to_source: float) -> str:
    """What a rule saw, and whose a mean was taken for; empty for a method without rules (−1).

    ``to_model`` and ``to_source``: shares of the mean, 0 to 1. :class:`ValueError` for a number
    that is no rule.
    """
    if rule == -1:
        return ""
    _, spread, _, mean = Rule(rule).name.split("_")
    text = f"innovations scatter {_SPREAD[spread]}, {_MEAN[mean]}"
    if mean == "ZERO":
        return text
    if to_model > MOST:
        return f"{text}: most of it taken for the inertial unit's error"
    if to_source > MOST:
        return f"{text}: most of it taken for a fault of the source, which scales nothing"
    return text
