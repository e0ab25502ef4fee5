"""The direct filter on raw ranges and with adaptation: the same means as the other estimator's."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from companion.config import Config
from companion.config.adaptation import METHODS
from companion.types import (
    F64,
    AdaptationTrace,
    AidingReports,
    Channel,
    Outputs,
    Samples,
    Solution,
    VehicleRecording,
)
from replay.player import play
from replay.simulator import Simulation, load_scenario, matching_config, run
from tests.tight import flights

NOISY_S = 30.0
"""From here on the receiver is five times noisier than it says."""


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


def test_two_satellites_still_aid() -> None:
    """Of an outage of 15 s with two satellites left, ranges leave less than half."""
    vehicle = flights.flight().recording
    cut = flights.withheld(vehicle, 60.0, 75.0, 2)
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
    assert worst[0] < 0.5 * worst[1]


def test_how_ranges_are_cut_into_blocks_leaves_no_trace() -> None:
    vehicle, config = flights.flight().recording, _direct(flights.config())
    digest = _played(vehicle, config)[3]
    assert _played(vehicle, config, 0.3)[3] == digest


# ---------------------------------------------------------------------- adaptation


@pytest.fixture(scope="module")
def noisy() -> tuple[Simulation, VehicleRecording, Config]:
    """A flight whose receiver gets noisier, and says nothing of it."""
    base = load_scenario("fixed-wing")
    shorter = msgspec.structs.replace(base.trajectory, duration_s=90.0)
    flight = run(msgspec.structs.replace(base, trajectory=shorter), 5)
    (fix,) = flight.recording.gnss
    late = fix.t_ns > flight.t0_ns + NOISY_S * 1e9
    rng = np.random.default_rng(11)
    off = np.where(late[:, None], rng.standard_normal((len(fix), 3)), 0.0)
    off *= [7.0, 7.0, 10.0]
    worse = replace(
        fix,
        lat=fix.lat + off[:, 0] / 6.37e6,
        lon=fix.lon + off[:, 1] / (6.37e6 * np.cos(fix.lat)),
        height=fix.height + off[:, 2],
    )
    return flight, replace(flight.recording, gnss=(worse,)), _direct(matching_config(base))


def _with(config: Config, method: str) -> Config:
    adaptation = msgspec.structs.replace(config.adaptation, method=method)
    return msgspec.structs.replace(config, adaptation=adaptation)


def _rms(flight: Simulation, solution: Solution) -> float:
    truth = flight.recording.truth
    assert truth is not None
    t = solution.t_ns
    late = t > flight.t0_ns + (NOISY_S + 5.0) * 1e9
    north = (solution.lat - np.interp(t, truth.t_ns, truth.lat)) * 6.37e6
    east = (solution.lon - np.interp(t, truth.t_ns, truth.lon)) * 6.37e6 * np.cos(truth.lat[0])
    error: F64 = np.hypot(north, east)[late]
    return float(np.sqrt(np.mean(error**2)))


def test_a_noisy_receiver_is_found_out(
    noisy: tuple[Simulation, VehicleRecording, Config],
) -> None:
    flight, recording, config = noisy
    plain, _, silent, _ = _played(recording, _with(config, "none"))
    fuzzy, reports, trace, digest = _played(recording, _with(config, "fuzzy"))
    assert _rms(flight, fuzzy) < 0.8 * _rms(flight, plain)
    assert len(silent) == 0
    assert len(trace) > 0
    late = reports.t_ns > flight.t0_ns + (NOISY_S + 15.0) * 1e9
    scale = reports.scale[late & (reports.channel == Channel.GNSS_POSITION_H)]
    assert np.median(scale) > 5.0  # of 25
    assert _played(recording, _with(config, "fuzzy"), 0.3)[3] == digest


@pytest.mark.parametrize("method", [m for m in METHODS if m not in ("none", "fuzzy")])
def test_every_method_runs_and_stays_sane(
    noisy: tuple[Simulation, VehicleRecording, Config], method: str
) -> None:
    flight, recording, config = noisy
    solution = _played(recording, _with(config, method))[0]
    assert solution.resets[-1] == 0
    assert _rms(flight, solution) < 15.0  # of fixes that are off by 10 m
