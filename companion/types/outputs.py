"""What one step of the engine gives out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Self

import numpy as np

from companion.types.arrays import F64, I64, Rows
from companion.types.solution import Smoothed, Solution
from companion.types.updates import AdaptationTrace, AidingReports

NO_SMOOTHED = Smoothed.empty()

SMOOTHING_GAVE_WAY, SMOOTHING_RESUMED = "smoothing-gave-way", "smoothing-resumed"
"""Kinds of event that a replay follows: their times say which windows a live run left out."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something that a person or a program downstream should know, at its time."""

    t_ns: int
    kind: str
    """Stable kebab-case name: ``aligned``, ``heading-found``, ``imu-gap``, ``reset``, …"""
    text: str
    """One line for people."""
    level: Literal["info", "warning", "error"] = "info"


NO_DOP = 1e3
"""Dilution of a set of satellites that does not fix the unknowns."""


@dataclass(frozen=True, slots=True)
class Satellites(Rows):
    """The satellites that epochs of raw measurements were fused of, as columns."""

    t_ns: I64
    used: I64
    excluded: I64
    """(N,) whose range contradicted the others."""
    dop: F64
    """(N, 5) GDOP, PDOP, HDOP, VDOP, TDOP of those in use; :data:`NO_DOP` without."""

    @classmethod
    def empty(cls) -> Self:
        i = np.zeros(0, np.int64)
        return cls(i, i, i, np.zeros((0, 5)))


NO_SATELLITES = Satellites.empty()


@dataclass(frozen=True, slots=True)
class Outputs:
    """What one engine step gave out."""

    published: Solution
    """Epochs reached for the first time: the causal solution, as a user had it at the time."""
    settled: Solution
    """Epochs that nothing arriving inside the delay ring can change any more."""
    reports: AidingReports
    events: tuple[Event, ...]
    smoothed: Smoothed = NO_SMOOTHED
    """Only from :meth:`companion.engine.Engine.smooth`."""
    adaptation: AdaptationTrace = field(default_factory=AdaptationTrace.empty)
    members: tuple[tuple[str, Solution], ...] = ()
    """Of a bank: what each estimator would have published, under its name."""
    satellites: Satellites = NO_SATELLITES
    """One row an epoch of raw GNSS, as it arrived."""
