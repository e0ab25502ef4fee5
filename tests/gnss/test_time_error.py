"""A receiver whose time is off: found by the satellites' motion, and said once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from companion.config import RawGnss
from companion.gnss.corrected import S_SYSTEM
from companion.gnss.single_point import P_POS
from companion.gnss.systems import GPS
from companion.gnss.time_error import time_error
from companion.intake.raw_gnss.receiver import Receiver
from companion.navigation.earth import ecef
from companion.types import NS, Event, RawGnssSamples
from replay.simulator.constellation import Sky, observe

LAT, LON, HEIGHT = 0.8, 0.15, 500.0
LOOKS = 8


def _sky(seed: int, step_s: int = 10, **kw: object) -> Sky:
    """At rest, an epoch every ten seconds."""
    place = ecef(np.array([LAT]), np.array([LON]), np.array([HEIGHT]))
    state = np.concatenate([place, np.zeros((1, 3))], axis=1).repeat(LOOKS, axis=0)
    t = np.arange(LOOKS, dtype=np.int64) * step_s * NS
    return observe(t, state, np.random.default_rng(seed), **kw)  # type: ignore[arg-type]


def _late(sky: Sky, seconds: float) -> RawGnssSamples:
    return replace(sky.raw, tow=sky.raw.tow + seconds)


def _said(sky: Sky, raw: RawGnssSamples, cut: int = LOOKS) -> list[Event]:
    receiver, said = Receiver(RawGnss()), []
    receiver.listen(sky.broadcast)
    for begin in range(0, len(raw), cut):
        said += receiver.prepare(raw.take(slice(begin, begin + cut))).events
    return [e for e in said if e.kind == "receiver-time"]


@pytest.mark.parametrize("seconds", [0.04, -0.02, 0.0])
def test_without_noise_the_error_is_exact_and_with_few_satellites_untold(seconds: float) -> None:
    sky, found = _sky(1, sd_range_m=0.0, sd_rate_mps=0.0), np.empty(2)
    receiver = Receiver(RawGnss(exclude=False))
    receiver.listen(sky.broadcast)
    made = receiver.take(_late(sky, seconds), 0)
    assert made.point is not None
    place = made.point[P_POS : P_POS + 3]
    assert time_error(made.rows, place, found)
    # The line of sight turns while the place is off by 600 m a second: second order.
    assert found[0] == pytest.approx(-seconds, abs=2e-5)
    assert 0.0 < found[1] < 0.02
    gps = made.rows[made.rows[:, S_SYSTEM] == GPS]
    assert time_error(gps[:7].copy(), place, found)
    assert not time_error(gps[:6].copy(), place, found)
    assert not time_error(made.rows, np.zeros(3), found)


@pytest.mark.parametrize(("seconds", "where"), [(0.05, "ahead of"), (-0.05, "behind")])
def test_a_time_that_is_off_is_said_once_however_the_stream_is_cut(
    seconds: float, where: str
) -> None:
    sky = _sky(2)
    whole = _said(sky, _late(sky, seconds))
    assert [e.level for e in whole] == ["warning"]
    assert where in whole[0].text
    # Stated as 50 ms with an error of some, and a place 30 m off.
    told = float(whole[0].text.split("time is ")[1].split()[0])
    assert told == pytest.approx(50.0, abs=15.0)
    assert _said(sky, _late(sky, seconds), 1) == whole
    assert _said(sky, _late(sky, seconds), 3) == whole


def test_good_time_is_not_doubted() -> None:
    for seed in range(20):
        assert _said(_sky(seed), _sky(seed).raw) == []


def test_a_look_is_taken_once_in_ten_seconds() -> None:
    sky = _sky(3, step_s=1)
    # Eight epochs of a second each hold one or two looks; six are needed.
    assert _said(sky, _late(sky, 0.05)) == []
