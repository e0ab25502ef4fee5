"""Clocks of sensors: what a stalled reader, a wrap, a restart and drift do to times of validity."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.can_imu.clock import NS, Counter, SensorClock, Unwrapped

T0 = 1_700_000_000 * NS
STEP = NS // 100


def run(clock: SensorClock, sensor: np.ndarray, rx: np.ndarray) -> np.ndarray:
    return np.array([clock.at(int(s), int(r)) for s, r in zip(sensor, rx, strict=True)])


def test_a_stalled_readers_backlog_keeps_its_spacing() -> None:
    true = T0 + STEP * np.arange(4000, dtype=np.int64)
    rx = true + 200_000
    # The process stood still for five seconds and found everything waiting.
    rx[2000:2500] = rx[2500]
    clock = SensorClock()
    got = run(clock, true - T0, rx)
    assert clock.restarts == 0
    assert np.abs(got - true - 200_000).max() <= 1


@pytest.mark.parametrize("drift_ppm", [-300.0, 0.0, 300.0])
def test_drift_is_followed(drift_ppm: float) -> None:
    rng = np.random.default_rng(1)
    true = T0 + STEP * np.arange(12_000, dtype=np.int64)
    sensor = np.rint((true - T0) * (1.0 - drift_ppm * 1e-6)).astype(np.int64)
    rx = np.maximum.accumulate(true + rng.exponential(1e6, true.size).astype(np.int64))
    got = run(SensorClock(), sensor, rx)
    assert (np.diff(got) > 0).all()
    assert (got <= rx).all()
    # Least of a hundred delays of 1 ms: 10 µs; the slope over ten of them adds as much, the line
    # lies under all. Drift within a block makes the least one up to √(2 · 300 ppm · 1 ms / 100 Hz)
    # = 77 µs. Three times the sum.
    assert np.abs(got - true)[1500:].max() < 3 * 100_000


def test_a_clock_set_back_unseen_is_recognised() -> None:
    """A 16-bit millisecond clock wraps once, unseen, while the unit is silent for a minute."""
    true = T0 + STEP * np.arange(1000, dtype=np.int64)
    true[500:] += 70 * NS
    raw = ((true - T0) // 1_000_000) % 65_536
    unwrapped, clock = Unwrapped(16, 1_000_000), SensorClock()
    got = np.array([clock.at(unwrapped.at(int(r)), int(t)) for r, t in zip(raw, true, strict=True)])
    assert clock.restarts == 1
    assert np.abs(got - true)[750:].max() <= 1_000_000  # a tick
    assert (np.diff(got) > 0).all()


def test_a_step_forward_is_a_restart() -> None:
    true = T0 + STEP * np.arange(600, dtype=np.int64)
    sensor = true - T0
    sensor[300:] += 30 * NS
    clock = SensorClock()
    got = run(clock, sensor, true)
    assert clock.restarts == 1
    assert np.array_equal(got, true)


def test_unwrapped_follows_wraps_and_shows_a_step_back() -> None:
    clock = Unwrapped(8, 10)
    assert [clock.at(raw) for raw in (250, 255, 4, 2, 100)] == [0, 50, 100, 80, 1060]


@pytest.mark.parametrize(("bits", "lost"), [(5, 40), (5, 3), (8, 300), (16, 300)])
def test_a_counter_that_wrapped_while_nothing_came(bits: int, lost: int) -> None:
    counter = Counter(bits)
    rng = np.random.default_rng(2)
    steps = []
    for i in [*range(200), *range(200 + lost, 400 + lost)]:
        rx = T0 + STEP * i + int(rng.integers(0, STEP // 2))
        steps.append(counter.advance(i % (1 << bits), rx))
    assert sum(steps) - len(steps) == lost
    assert counter.total == 399 + lost


def test_a_counter_that_begins_again_is_no_loss() -> None:
    counter = Counter(16)
    steps = [counter.advance((30_000 + i) & 0xFFFF, T0 + STEP * i) for i in range(100)]
    steps += [counter.advance(i, T0 + STEP * (150 + i)) for i in range(100)]
    assert steps.count(-1) == 1
    assert set(steps) == {1, -1}
