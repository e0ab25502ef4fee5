"""Which estimator is published: the consistent one, with hysteresis, never one just reset."""

from __future__ import annotations

import numpy as np

from companion.selector import RETURN_NS, SETTLED_NS, Selector
from companion.types import (
    NS,
    AidingReports,
    Channel,
    Event,
    Mode,
    Outputs,
    Solution,
    Verdict,
)


def _given(
    t: float, mode: Mode = Mode.NAVIGATING, nis: float = 1.0, resets: int = 0, told: str = ""
) -> Outputs:
    """What half a second up to ``t`` gave out: an epoch, and two components of position."""
    t_ns = np.array([round(t * NS)])
    epoch = Solution(
        t_ns, np.zeros(1), np.zeros(1), np.zeros(1), np.zeros((1, 3)), np.zeros((1, 4)),
        np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 5, 6)), np.array([mode]),
        np.array([resets]),
    )  # fmt: skip
    reports = AidingReports(
        t_ns, np.array([Channel.GNSS_POSITION_H]), np.zeros(1, np.int64), np.array([2]),
        np.zeros((1, 3)), np.ones((1, 3)), np.array([2.0 * nis]), np.array([20.0]), np.ones(1),
        np.array([Verdict.ACCEPTED]),
    )  # fmt: skip
    events = (Event(int(t_ns[0]), told, "", "warning"),) if told else ()
    return Outputs(epoch, Solution.empty(), reports, events)


class _Flight:
    """Two estimators, half a second at a time."""

    def __init__(self) -> None:
        self.selector = Selector(["a", "b"])
        self.t = 100.0
        self.said: list[tuple[float, str]] = []

    def go(self, seconds: float, a: dict[str, object], b: dict[str, object]) -> None:
        for _ in range(round(2 * seconds)):
            self.t += 0.5
            for standing, how in zip(self.selector.standings, (a, b), strict=True):
                if how.get("silent"):
                    continue
                standing.note(_given(self.t, **how))  # type: ignore[arg-type]
            event = self.selector.decide(round(self.t * NS))
            if event is not None:
                self.said.append((self.t, event.text))


def test_the_first_is_published_while_it_is_sound() -> None:
    flight = _Flight()
    flight.go(60.0, {"nis": 1.5}, {"nis": 0.9})
    assert flight.selector.current == 0
    assert flight.said == []


def test_an_inconsistent_one_is_left_and_gone_back_to_late() -> None:
    flight = _Flight()
    flight.go(30.0, {}, {})
    flight.go(20.0, {"nis": 10.0}, {})
    assert flight.selector.current == 1
    assert "a innovations" in flight.said[0][1]
    left = flight.t
    flight.go(60.0, {}, {})
    assert flight.selector.current == 0
    assert len(flight.said) == 2
    # Its window has to clear first, then it has to stay sound.
    assert flight.said[1][0] - left > RETURN_NS / NS


def test_one_that_was_just_reset_is_neither_kept_nor_taken() -> None:
    flight = _Flight()
    flight.go(30.0, {}, {})
    flight.go(0.5, {"told": "relocked"}, {"resets": 1})
    # Both were: to change would be from one to the other.
    flight.go(SETTLED_NS / NS - 1.0, {}, {"resets": 1})
    assert flight.said == []
    flight.go(40.0, {}, {"resets": 1})
    assert flight.selector.current == 0
    flight.go(0.5, {"resets": 1}, {"resets": 1})
    assert flight.selector.current == 1
    assert "was reset" in flight.said[0][1]


def test_one_that_falls_silent_or_coasts_is_left_for_one_that_navigates() -> None:
    flight = _Flight()
    flight.go(30.0, {}, {})
    flight.go(3.0, {"mode": Mode.COASTING}, {})
    assert flight.selector.current == 1
    flight = _Flight()
    flight.go(30.0, {}, {})
    flight.go(3.0, {"silent": True}, {})
    assert flight.selector.current == 1
    assert "gives no solution" in flight.said[0][1]


def test_where_both_are_bad_nothing_is_changed() -> None:
    flight = _Flight()
    flight.go(30.0, {}, {})
    flight.go(60.0, {"nis": 9.0}, {"nis": 9.0})
    assert flight.selector.current == 0
    assert flight.said == []
