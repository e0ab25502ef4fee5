"""Noise of whole satellite systems, from what each epoch leaves over: found, and where."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from companion.config import Config, RawGnss
from companion.estimation.adaptation.constellations import Constellations
from companion.intake.raw_gnss.receiver import Receiver
from companion.types import F64, Channel
from replay.simulator.constellation import SatelliteFault, SystemNoise

from .test_receiver import sky_of

NOISE = RawGnss(sd_range_m=0.7, sd_multipath_m=0.0, sd_rate_mps=0.04, iono_residual=0.0)
GPS, GALILEO, BEIDOU = range(3)


# Factors stay at 1: what is found is not what an adapted R has made of it.
TRUSTING = msgspec.convert(
    {"adaptation": {"fuzzy": {"r_min": 1.0, "r_max": 1.0}}, "raw_gnss": msgspec.to_builtins(NOISE)},
    Config,
)


def _scatter(seconds: int, **sky: object) -> F64:
    """(2, 3) mean of v over the epochs, weighted by redundancy."""
    made = sky_of(seconds, **sky)
    receiver = Receiver(NOISE, Constellations(TRUSTING))
    receiver.listen(made.broadcast)
    found = receiver.prepare(made.raw).found
    assert (found[:, 0, :, 1].sum(axis=1) > 0.0).all()
    total = found.sum(axis=0)
    return np.asarray(total[:, :, 0] / total[:, :, 1])


def test_a_healthy_sky_scatters_by_one_in_every_system() -> None:
    # About 300 epochs of 3 and more redundant satellites a system: sd √(2/900) = 0.05; four of it.
    assert _scatter(300) == pytest.approx(np.ones((2, 3)), abs=0.2)


def test_one_satellite_at_fault_makes_no_system_noisy() -> None:
    """Six metres: what the test of faults mostly passes."""
    fault = SatelliteFault(107, 0.0, 300.0, step_m=6.0)
    # 36 m² against 0.5, spread over eight, would be 10. From 2 on an adaptation is told of.
    assert _scatter(300, faults=(fault,)).max() < 2.0


def test_a_noisy_system_is_found_and_comes_back() -> None:
    made = sky_of(240, noises=(SystemNoise(GALILEO, 80.0, 160.0, 5.0),))
    trust = Constellations(Config(raw_gnss=NOISE))
    receiver = Receiver(NOISE, trust)
    receiver.listen(made.broadcast)
    factors, used = [], []
    for i in range(len(made.raw)):
        used.append(len(receiver.take(made.raw, i).rows))
        factors.append(trust.factors.copy())
    f = np.array(factors)
    # Twenty epochs of some five redundant satellites: 25 to a fifth, and three of these.
    assert f[100:160, :, GALILEO].min() > 10.0
    assert f[100:160, :, GALILEO].max() < 60.0
    # A wrong weight of one system takes little of the others' nominal scatter away.
    assert f[:, :, [GPS, BEIDOU]].max() < 2.0
    assert f[200:].max() < 1.5
    assert np.mean(used[100:160]) > 0.97 * np.mean(used[:80])
    trace = trust.take_trace()
    mine = trace.channel == Channel.RANGE_GALILEO
    peak = trace.r_scale[mine].argmax()
    assert trace.spread[mine][peak] > 4.0
    assert trace.firing[mine][peak].argmax() == 6
    assert trust.take_trace().t_ns.size == 0
