"""Which logs stand out among the others: how far a figure is from the batch's median, robustly.

Modified z of the logarithm, z = (ln x − median) / (1.4826 · MAD), and 3.5 as the limit: Iglewicz
and Hoaglin 1993, "How to Detect and Handle Outliers". Logarithms, because errors that are ten
times the usual ones are as unusual at a metre as at a kilometre.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from replay.batch.outcome import Outcome, Row

LIMIT = 3.5
FEWEST = 8
"""Fewer logs have no usual value to stand out from."""
_LEAST_SPREAD = 0.35
"""Of the logarithm: among twins, or where most have none of it, what is beyond the limit is still
more than three times the usual."""

_RANK = {"bad": 0, "degraded": 1, "good": 2}


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of a row in which more is worse."""

    name: str
    words: str
    unit: str
    floor: float
    """Added before the logarithm: smaller values are all as good as none."""


FIGURES = (
    Figure("horizontal_rmse_m", "horizontal error", "m", 0.1),
    Figure("velocity_rmse_mps", "velocity error", "m/s", 0.02),
    Figure("yaw_rmse_deg", "heading error", "°", 0.2),
    Figure("position_nees", "position NEES", "", 1.0),
    Figure("smoothed_horizontal_rmse_m", "smoothed horizontal error", "m", 0.1),
    Figure("stated_sd_max_m", "largest stated deviation", "m", 0.5),
    Figure("refused_share", "share refused", "", 0.01),
    Figure("longest_outage_s", "longest outage", "s", 5.0),
    Figure("resets", "resets", "", 1.0),
)
_AGAINST = {"horizontal_rmse_m", "velocity_rmse_mps", "yaw_rmse_deg", "position_nees",
            "smoothed_horizontal_rmse_m"}  # fmt: skip
"""Differences from the autopilot's estimate are not errors against truth: each has its own usual
value."""


@dataclass(frozen=True, slots=True)
class Found:
    """A row with what stands out of it."""

    outcome: Outcome
    row: Row
    z: float
    """The largest; 0 where nothing is above its median."""
    words: tuple[str, ...]
    """What is beyond the limit, the most unusual first."""


def ranked(outcomes: Sequence[Outcome]) -> list[Found]:
    """Every row: outliers first, the most unusual before, then by verdict and by what is next."""
    rows = [(outcome, row) for outcome in outcomes for row in outcome.rows]
    scores: list[dict[str, tuple[float, str]]] = [{} for _ in rows]
    for figure in FIGURES:
        for group in _groups(figure, [row for _, row in rows]):
            for at, z, text in _scored(figure, [row for _, row in rows], group):
                scores[at][figure.name] = z, text
    found = []
    for (outcome, row), score in zip(rows, scores, strict=True):
        order = sorted(score.values(), reverse=True)
        words = tuple(text for z, text in order if z > LIMIT)
        found.append(Found(outcome, row, order[0][0] if order else 0.0, words))
    return sorted(
        found,
        key=lambda f: (not f.words, -f.z if f.words else _RANK[f.row.verdict], -f.z, f.outcome.log),
    )


def _groups(figure: Figure, rows: Sequence[Row]) -> Iterator[list[int]]:
    """Indices of rows that can be held against each other."""
    kinds = ("truth", "autopilot") if figure.name in _AGAINST else (None,)
    for kind in kinds:
        yield [
            at
            for at, row in enumerate(rows)
            if getattr(row, figure.name) is not None and kind in (None, row.reference)
        ]


def _scored(
    figure: Figure, rows: Sequence[Row], group: Sequence[int]
) -> Iterator[tuple[int, float, str]]:
    """Index, z and words of each row of a group that is above its median."""
    if len(group) < FEWEST:
        return
    values = np.array([float(getattr(rows[at], figure.name)) for at in group])
    logs = np.log(values + figure.floor)
    centre = float(np.median(logs))
    spread = max(1.4826 * float(np.median(np.abs(logs - centre))), _LEAST_SPREAD)
    usual = float(np.median(values))
    for at, value, z in zip(group, values, (logs - centre) / spread, strict=True):
        if z > 0:
            unit = f" {figure.unit}" if figure.unit else ""
            yield at, float(z), f"{figure.words} {value:.3g}{unit} (median {usual:.3g})"
