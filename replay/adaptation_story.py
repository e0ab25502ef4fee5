"""What adapted, when and why: the trace of a run told in episodes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.adaptation_words import told
from companion.types import F64, NS, AdaptationTrace, Channel

TOLD = 2.0
"""Factor on a variance from which on an episode is told."""
ALPHA_TOLD = 1.005
GAP_NS = 5 * NS
"""Shorter returns to nominal do not end an episode."""


class Episode(msgspec.Struct, frozen=True):
    """A stretch of time in which something was scaled."""

    what: Literal["R", "Q", "α"]
    channel: str
    """Whose R it was; for Q and α the channel at the greatest factor."""
    start_s: float
    """Since the first epoch of the solution."""
    end_s: float
    greatest: float
    """Greatest factor."""
    because: str
    """The rule that fired most often, and the cause that a mean was given."""


def episodes(trace: AdaptationTrace, origin_ns: int) -> list[Episode]:
    """The episodes of a run in order of their start; ``origin_ns`` is the first epoch's time."""
    found: list[Episode] = []
    for channel in np.unique(trace.channel):
        mine = np.flatnonzero(trace.channel == channel)
        found += _told("R", trace, mine, trace.r_scale, TOLD, origin_ns)
    everything = np.arange(len(trace))
    found += _told("Q", trace, everything, trace.q_scale, TOLD, origin_ns)
    found += _told("α", trace, everything, trace.alpha, ALPHA_TOLD, origin_ns)
    return sorted(found, key=lambda e: e.start_s)


def _told(
    what: Literal["R", "Q", "α"],
    trace: AdaptationTrace,
    rows: NDArray[np.intp],
    factor: F64,
    told: float,
    origin_ns: int,
) -> Iterator[Episode]:
    """Episodes of one factor over ``rows``, which are in order of time."""
    over = rows[factor[rows] >= told]
    if not len(over):
        return
    for part in np.split(over, np.flatnonzero(np.diff(trace.t_ns[over]) > GAP_NS) + 1):
        peak = part[np.argmax(factor[part])]
        begin, end = (int(trace.t_ns[at]) - origin_ns for at in (part[0], part[-1]))
        yield Episode(
            what,
            Channel(int(trace.channel[peak])).name.lower(),
            begin / NS,
            end / NS,
            float(factor[peak]),
            _because(trace, part if what == "R" else np.array([peak])),
        )


def _because(trace: AdaptationTrace, part: NDArray[np.intp]) -> str:
    fired = trace.rule[part]
    if not (fired >= 0).any():
        return ""
    rule = int(np.bincount(fired[fired >= 0]).argmax())
    same = part[fired == rule]
    return told(rule, float(trace.to_model[same].mean()), float(trace.to_source[same].mean()))
