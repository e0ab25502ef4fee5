"""The direct filter on raw ranges and with adaptation: the same means as the other estimator's."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from companion.config import Config
from companion.config.adaptation import METHODS
from companion.types import (
    NS,
    AdaptationTrace,
    AidingReports,
    Channel,
    Outputs,
    Samples,
    Solution,
    VehicleRecording,
)
from replay.evaluation import errors_against
from replay.player import play
from tests.tight import flights

from . import receivers


def _played(
    recording: VehicleRecording, config: Config, block_s: float = 10.0
) -> tuple[Solution, AidingReports, AdaptationTrace, str]:
    outs: list[Outputs] = []

    def sink(_: Samples, out: Outputs) -> None:
        outs.append(out)

    engine = play(recording, config, sink, block_s)
    return (
        Solution.concatenate([o.settled for o in outs]),
        AidingReports.concatenate([o.reports for o in outs]),
        AdaptationTrace.concatenate([o.adaptation for o in outs]),
        engine.digest,
    )


def _direct(config: Config) -> Config:
    engine = msgspec.structs.replace(config.engine, estimator="direct", output_rate_hz=10.0)
    return msgspec.structs.replace(config, engine=engine)


# ---------------------------------------------------------------------- ranges


def test_three_satellites_still_aid() -> None:
    """Of what 15 s with three satellites cost, ranges leave less than a quarter."""
    vehicle = flights.flight().recording
    cut = flights.withheld(vehicle, 60.0, 75.0, 3)
    tight = _direct(flights.config())
    loose = msgspec.structs.replace(
        tight, raw_gnss=msgspec.structs.replace(tight.raw_gnss, coupling="loose")
    )
    worst = []
    for config in (tight, loose):
        solution, reports, _, _ = _played(cut, config)
        t, error = flights.errors(solution)
        inside = (t > 60.0) & (t < 76.0)
        worst.append(np.hypot(error[inside, 0], error[inside, 1]).max())
        ranges = reports.channel == Channel.RANGE_GPS
        assert ranges.any() == (config is tight)
        open_sky = (t > 20.0) & (t < 60.0)
        assert np.sqrt(np.mean(error[open_sky] ** 2)) < 1.0  # ranges of 0.7 m
    assert worst[0] < 0.25 * worst[1]


def test_how_ranges_are_cut_into_blocks_leaves_no_trace() -> None:
    vehicle, config = flights.flight().recording, _direct(flights.config())
    digest = _played(vehicle, config)[3]
    assert _played(vehicle, config, 0.3)[3] == digest


# ---------------------------------------------------------------------- adaptation


Noisy = tuple[VehicleRecording, int, Config]


@pytest.fixture(scope="module")
def noisy() -> Noisy:
    recording, t0, config = receivers.noisy(5, 75.0)
    return recording, t0, _direct(config)


def _with(config: Config, method: str) -> Config:
    adaptation = msgspec.structs.replace(config.adaptation, method=method)
    return msgspec.structs.replace(config, adaptation=adaptation)


def _rms(noisy: Noisy, solution: Solution) -> float:
    """Horizontal, from 5 s behind the beginning of the noise on."""
    truth = noisy[0].truth
    assert truth is not None
    e = errors_against(solution, truth)
    late = e.t_ns > noisy[1] + round((receivers.NOISY_S + 5.0) * NS)
    return float(np.sqrt(np.mean((e.position_n[late, :2] ** 2).sum(axis=1))))


def test_a_noisy_receiver_is_found_out(noisy: Noisy) -> None:
    recording, t0, config = noisy
    plain, _, silent, _ = _played(recording, _with(config, "none"))
    fuzzy, reports, trace, digest = _played(recording, _with(config, "fuzzy"))
    assert _rms(noisy, fuzzy) < 0.6 * _rms(noisy, plain)
    assert len(silent) == 0
    assert len(trace) > 0
    late = reports.t_ns > t0 + round((receivers.NOISY_S + 15.0) * NS)
    scale = reports.scale[late & (reports.channel == Channel.GNSS_POSITION_H)]
    assert np.median(scale) > 5.0  # of 25
    assert _played(recording, _with(config, "fuzzy"), 0.3)[3] == digest


@pytest.mark.parametrize("method", [m for m in METHODS if m not in ("none", "fuzzy")])
def test_every_method_runs_and_stays_near(noisy: Noisy, method: str) -> None:
    recording, _, config = noisy
    solution = _played(recording, _with(config, method))[0]
    assert solution.resets[-1] == 0
    assert _rms(noisy, solution) < 10.0  # what a single fix is off by
