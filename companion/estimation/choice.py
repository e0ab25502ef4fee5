"""Which estimator a configuration asks for."""

from __future__ import annotations

from companion.config import Config
from companion.estimation.direct.filter import DirectFilter
from companion.estimation.error_state import ErrorStateFilter
from companion.estimation.recording import Recording

Estimator = ErrorStateFilter | DirectFilter
"""Both walk sorted samples, can be rewound, and leave rows, reports and events."""


def new_estimator(config: Config, record: Recording) -> Estimator:
    """The estimator that ``engine.estimator`` names; ``auto`` is the error-state filter.

    Raises :class:`~companion.types.CompanionError` where a tape is wanted of one that leaves none.
    """
    if config.engine.estimator == "direct":
        return DirectFilter(config, record)
    return ErrorStateFilter(config, record)
