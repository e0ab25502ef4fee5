"""A slow sensor in a fast message: each reading once, with the stamp of its first row."""

from __future__ import annotations

import numpy as np

from companion.types import NS
from drivers.mavlink.readings import HELD_NS, Readings


def test_each_reading_comes_once_however_the_rows_are_cut() -> None:
    """A compass read at 10 Hz, told at 200 Hz for 2 s; one reading equals the one before it."""
    t_ns = np.arange(400) * (NS // 200)
    field = np.random.default_rng(1).normal(0.0, 1e-5, (20, 3))
    field[7] = field[6]
    values = np.repeat(field, 20, axis=0)
    whole = Readings().new(values, t_ns)
    assert np.flatnonzero(whole).tolist() == [20 * m for m in range(20) if m != 7]
    for cut in (1, 3, 50):
        stream = Readings()
        parts = [stream.new(values[a : a + cut], t_ns[a : a + cut]) for a in range(0, 400, cut)]
        np.testing.assert_array_equal(np.concatenate(parts), whole)


def test_a_value_that_stays_is_read_again_at_its_own_pace() -> None:
    """Two seconds at rest: whole counts that do not change are measurements too, four a second."""
    t_ns = np.arange(400) * (NS // 200)
    values = np.full((400, 1), 95_025.0)
    told = t_ns[Readings().new(values, t_ns)]
    np.testing.assert_array_equal(np.diff(told), HELD_NS)
    assert len(told) == 8
    stream = Readings()
    one_by_one = np.concatenate(
        [stream.new(values[i : i + 1], t_ns[i : i + 1]) for i in range(400)]
    )
    np.testing.assert_array_equal(t_ns[one_by_one], told)
