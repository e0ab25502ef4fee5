"""Thinning of epochs."""

from __future__ import annotations

import numpy as np

from companion.outputs.pacing import Pacer
from companion.types import NS


def sent(rate_hz: float, times_ns: list[int]) -> list[int]:
    pacer = Pacer(rate_hz)
    return [t for t in times_ns if pacer.due(t)]


def test_epochs_at_the_rate_all_pass_although_they_jitter() -> None:
    rng = np.random.default_rng(4)
    times = [round(k * NS / 50 + rng.uniform(-0.04, 0.04) * NS / 50) for k in range(500)]
    assert sent(50.0, times) == times


def test_faster_epochs_are_thinned_evenly() -> None:
    times = [k * NS // 50 for k in range(500)]
    assert np.diff(sent(10.0, times)).tolist() == [NS // 10] * 99


def test_a_gap_makes_no_burst_and_a_clock_that_jumps_back_no_silence() -> None:
    assert sent(10.0, [0, 5 * NS, 5 * NS + NS // 50, 5 * NS + NS // 10]) == [
        0,
        5 * NS,
        5 * NS + NS // 10,
    ]
    assert sent(10.0, [5 * NS, 0, NS // 50, NS // 10]) == [5 * NS, 0, NS // 10]
