"""The direct filter on raw ranges and with adaptation: the same means as the other estimator's."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from companion.config import Config
from companion.types import (
    NS,
    AdaptationTrace,
    AidingReports,
    Channel,
    Outputs,
    Samples,
    Solution,
    VehicleRecording,
    Verdict,
)
from replay.evaluation import errors_against
from replay.player import play
from tests.tight import flights

from . import receivers

THIN = 4


def _played(
    recording: VehicleRecording, config: Config, block_s: float = 10.0
) -> tuple[Solution, AidingReports, AdaptationTrace, str]:
    """Settled solution, reports, traces and digest; of the 100 Hz of the IMU every fourth sample,
    as a ground station has it, which is what this filter is for."""
    outs: list[Outputs] = []
    recording = replace(
        recording, imu=tuple(s.take(slice(None, None, THIN)) for s in recording.imu)
    )

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
    worst, digests = [], []
    for config in (tight, loose):
        solution, reports, _, digest = _played(cut, config)
        digests.append(digest)
        t, error = flights.errors(solution)
        inside = (t > 60.0) & (t < 76.0)
        worst.append(np.hypot(error[inside, 0], error[inside, 1]).max())
        ranges = reports.channel == Channel.RANGE_GPS
        assert ranges.any() == (config is tight)
        open_sky = (t > 20.0) & (t < 60.0)
        assert np.sqrt(np.mean(error[open_sky] ** 2)) < 1.0  # ranges of 0.7 m
    assert worst[0] < 0.25 * worst[1]
    # How arrivals are cut into blocks leaves no trace in ranges either.
    assert digests[0] == _played(cut, tight, 0.3)[3]


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
    plain, rejected, silent, _ = _played(recording, _with(config, "none"))
    fuzzy, reports, trace, digest = _played(recording, _with(config, "fuzzy"))
    assert _refused(rejected, t0) > 0.3  # what a gate makes of five times the noise
    assert _refused(reports, t0) < 0.02
    assert _rms(noisy, fuzzy) < 0.8 * _rms(noisy, plain)
    assert len(silent) == 0
    assert len(trace) > 0
    late = reports.t_ns > t0 + round((receivers.NOISY_S + 15.0) * NS)
    scale = reports.scale[late & (reports.channel == Channel.GNSS_POSITION_H)]
    assert np.median(scale) > 12.5  # of 25
    assert _played(recording, _with(config, "fuzzy"), 0.3)[3] == digest


def _refused(reports: AidingReports, t0: int) -> float:
    """Share of what fixes measured, from 10 s behind the beginning of the noise on."""
    late = reports.t_ns > t0 + round((receivers.NOISY_S + 10.0) * NS)
    of_fixes = late & (reports.channel <= Channel.GNSS_VELOCITY_V)
    return float(np.mean(reports.verdict[of_fixes] == Verdict.REJECTED_GATE))


@pytest.mark.parametrize("method", ["flac", "innovation"])
def test_every_method_runs_and_stays_near(noisy: Noisy, method: str) -> None:
    recording, _, config = noisy
    solution = _played(recording, _with(config, method))[0]
    assert solution.resets[-1] == 0
    assert _rms(noisy, solution) < 10.0  # what a single fix is off by
