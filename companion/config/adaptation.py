"""Configuration of the adaptation: how the filter learns that a sensor is not what it says.

Thresholds are probabilities, bounds are factors on variances: numbers without units. The two rule
tables are meant to be read and edited; see docs/adaptation.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import msgspec

from companion.config.ranges import within
from companion.config.section import Section
from companion.types import ConfigError

Method = Literal["none", "fuzzy", "flac", "innovation", "variational", "huber", "igg3"]
METHODS: tuple[Method, ...] = (
    "none", "fuzzy", "flac", "innovation", "variational", "huber", "igg3",
)  # fmt: skip
"""In the order of the codes that the kernels know."""

Spread = Literal["low", "usual", "high"]
SPREADS: tuple[Spread, ...] = ("low", "usual", "high")
Mean = Literal["zero", "small", "large"]
MEANS: tuple[Mean, ...] = ("zero", "small", "large")
Action = Literal["nominal", "hold", "match"]
ACTIONS: tuple[Action, ...] = ("nominal", "hold", "match")
Weight = Literal["zero", "small", "medium", "large"]


class Rule(Section):
    """If the innovations' spread and mean are so, then R and Q go there."""

    spread: Spread
    """Scatter about the mean, against what the filter believes of it."""
    mean: Mean
    """Mean against the scatter."""
    r: Action
    """Of the channel's R: ``nominal`` (what the configuration says), ``hold`` (what it is now),
    ``match`` (what explains the spread)."""
    q: Action
    """The same of Q, as far as the fault is the inertial unit's."""


class FlacRule(Section):
    """If the innovations' covariance and mean are so, then the past is forgotten so fast."""

    covariance: Mean
    """Against S: ``zero``, ``small`` (as it should be) or ``large``."""
    mean: Mean
    """Of the innovations, against their scatter."""
    alpha: Weight
    """Weight of the new against the past."""


def _rules() -> tuple[Rule, ...]:
    table: dict[Spread, tuple[tuple[Action, Action], ...]] = {
        # mean          zero                   small                  large
        "low": (("match", "nominal"), ("match", "nominal"), ("match", "match")),
        "usual": (("nominal", "nominal"), ("nominal", "nominal"), ("match", "match")),
        "high": (("match", "nominal"), ("match", "match"), ("match", "match")),
    }
    return tuple(
        Rule(spread=spread, mean=mean, r=r, q=q)
        for spread, row in table.items()
        for mean, (r, q) in zip(MEANS, row, strict=True)
    )


def _flac_rules() -> tuple[FlacRule, ...]:
    table: dict[Mean, tuple[Weight, Weight, Weight]] = {
        # mean   zero     small     large
        "zero": ("small", "zero", "zero"),
        "small": ("zero", "large", "medium"),
        "large": ("large", "medium", "zero"),
    }
    return tuple(
        FlacRule(covariance=covariance, mean=mean, alpha=alpha)
        for covariance, row in table.items()
        for mean, alpha in zip(MEANS, row, strict=True)
    )


class Fuzzy(Section):
    """Covariance scaling by rules: each channel's R, and the Q of the inertial unit."""

    usual: float = 0.95
    """Share of all windows of a healthy sensor in which an input is taken for wholly usual."""
    false_alarm: float = 1e-6
    """Probability with which a window of a healthy sensor counts as wholly unusual."""
    r_max: float = 100.0
    """Bounds of the factor on R; 100 is a deviation ten times what was said."""
    r_min: float = 1.0
    """Below 1, R may also become smaller than is configured. Where the receiver's own word is R
    (``gnss.sd_reported``), it may in any case fall to what is configured, if its innovations
    disprove it."""
    q_max: float = 100.0
    """Bound of the factor on Q, from 1."""
    rise: float = 4.0
    """Factor by which a scale may grow from one update to the next."""
    fall: float = 1.2
    """And by which it may shrink."""
    rules: tuple[Rule, ...] = _rules()
    """One for each spread and mean, in any order; those that are not given stay as they are."""


class Flac(Section):
    """Exponential data weighting by rules, after Sasiadek and Wang; memberships are ours."""

    small: float = 1.01
    """α of a small weight; ``zero`` is 1."""
    medium: float = 1.02
    """α of a medium weight."""
    large: float = 1.04
    """α of a large weight."""
    rules: tuple[FlacRule, ...] = _flac_rules()
    """One for each covariance and mean, as above."""


class Adaptation(Section):
    """What the filter does when innovations are not what it foresees."""

    method: Method = "fuzzy"
    """``none``, or how R and Q follow the innovations: see docs/adaptation.md."""
    window: int = 20
    """Innovations of a channel that are looked at together."""
    fuzzy: Fuzzy = Fuzzy()
    flac: Flac = Flac()
    variational_forgetting: float = 0.95
    """``variational``: what remains of the knowledge about R from one update to the next."""
    huber: float = 1.345
    """``huber``: deviations beyond which weight falls; 1.345 costs 5 % of efficiency."""
    igg3: tuple[float, float] = (1.5, 6.0)
    """``igg3``: deviations beyond which weight falls, and beyond which it is zero."""


LONGEST_WINDOW = 32
SHORTEST_WINDOW = 8
"""Fewer innovations tell nothing of a mean and a correlation."""


def check_adaptation(a: Adaptation) -> None:
    """Raise :class:`ConfigError` for values that cannot be used, naming the key."""
    key = "adaptation"
    within(f"{key}.window", a.window, SHORTEST_WINDOW, LONGEST_WINDOW, "innovations")
    within(f"{key}.variational_forgetting", a.variational_forgetting, 0.5, 1.0, "share")
    within(f"{key}.huber", a.huber, 0.5, 10.0, "deviations")
    low, high = a.igg3
    if not 0.5 <= low < high <= 20.0:
        raise ConfigError(f"key '{key}.igg3': two rising deviations in 0.5 to 20, got {a.igg3}")
    f = a.fuzzy
    within(f"{key}.fuzzy.usual", f.usual, 0.5, 0.999, "probability")
    within(f"{key}.fuzzy.false_alarm", f.false_alarm, 1e-12, 0.01, "probability")
    within(f"{key}.fuzzy.r_min", f.r_min, 0.01, 1.0, "factor")
    within(f"{key}.fuzzy.r_max", f.r_max, 1.0, 1e4, "factor")
    within(f"{key}.fuzzy.q_max", f.q_max, 1.0, 1e4, "factor")
    within(f"{key}.fuzzy.rise", f.rise, 1.01, 100.0, "factor")
    within(f"{key}.fuzzy.fall", f.fall, 1.01, 100.0, "factor")
    for name in ("small", "medium", "large"):
        value = getattr(a.flac, name)
        within(f"{key}.flac.{name}", value, 1.0, 1.2, "factor α")
    _once(f"{key}.fuzzy.rules", [_fuzzy_inputs(r) for r in f.rules], "spread and mean")
    _once(f"{key}.flac.rules", [_flac_inputs(r) for r in a.flac.rules], "covariance and mean")


def with_all_rules(a: Adaptation) -> Adaptation:
    """``a`` with the nine rules of each table: those that it does not give are the default's."""
    replace = msgspec.structs.replace
    own = {_fuzzy_inputs(rule) for rule in a.fuzzy.rules}
    fuzzy = (*a.fuzzy.rules, *(rule for rule in _rules() if _fuzzy_inputs(rule) not in own))
    own = {_flac_inputs(rule) for rule in a.flac.rules}
    flac = (*a.flac.rules, *(rule for rule in _flac_rules() if _flac_inputs(rule) not in own))
    return replace(a, fuzzy=replace(a.fuzzy, rules=fuzzy), flac=replace(a.flac, rules=flac))


def _fuzzy_inputs(rule: Rule) -> tuple[str, str]:
    return rule.spread, rule.mean


def _flac_inputs(rule: FlacRule) -> tuple[str, str]:
    return rule.covariance, rule.mean


def _once(key: str, pairs: Sequence[tuple[str, str]], what: str) -> None:
    """Raise where two rules are for the same pair of inputs."""
    for pair in pairs:
        if pairs.count(pair) > 1:
            raise ConfigError(
                f"key '{key}': one rule for each pair of {what}, got {pairs.count(pair)} for "
                f"'{pair[0]}' and '{pair[1]}'"
            )
