"""The latency of fixes, found on flights whose latency is known, and its silence elsewhere."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from companion.config import Config, load
from companion.estimation.gnss_latency import GnssLatencyEstimator, LatencyEstimate
from companion.types import AnySamples, Event, Outputs, VehicleRecording
from replay.player import play
from replay.reader import read_log
from replay.simulator import simulate
from replay.simulator.aids import GnssSpec
from replay.simulator.matching import matching_config
from replay.simulator.scenarios import Scenario, TrajectorySpec, graded


def scenario(kind: str, latency_ms: float, rate_hz: float = 5.0) -> Scenario:
    return Scenario(
        trajectory=TrajectorySpec(kind=kind, duration_s=150.0),  # type: ignore[arg-type]
        imu=(graded("mems-consumer", rate_hz=100.0),),
        gnss=(GnssSpec(rate_hz=rate_hz, latency_ms=latency_ms, stamped="arrival"),),
    )


def configured(config: Config, latency_ms: float) -> Config:
    """The same, with another latency of fixes."""
    gnss = msgspec.structs.replace(config.gnss, latency_ms=latency_ms)
    return msgspec.structs.replace(config, gnss=gnss)


def estimated(
    vehicle: VehicleRecording, config: Config
) -> tuple[LatencyEstimate | None, list[Event]]:
    """What the estimator finds on a flight."""
    found = GnssLatencyEstimator(config)
    events: list[Event] = []

    def sink(samples: AnySamples, out: Outputs) -> None:
        found.add(samples, out)
        events.extend(found.events())

    play(vehicle, config, sink)
    return found.estimate(), events


@pytest.mark.parametrize("latency_ms", [60.0, 220.0])
def test_found_where_the_configuration_is_wrong(latency_ms: float) -> None:
    flight = scenario("multirotor-mission", latency_ms)
    config = configured(matching_config(flight), 120.0)
    estimate, events = estimated(simulate(flight, 3), config)
    assert estimate is not None
    print(f"\n{latency_ms:g} ms: found {estimate}")
    assert abs(estimate.latency_s - latency_ms * 1e-3) < 3 * estimate.sd_s
    assert estimate.sd_s < 0.02
    assert events[-1].kind == "gnss-latency"
    assert events[-1].level == "warning"
    assert "gnss.latency_ms is 120" in events[-1].text


def test_a_right_configuration_is_confirmed() -> None:
    flight = scenario("fixed-wing", 150.0, rate_hz=10.0)
    estimate, events = estimated(simulate(flight, 4), matching_config(flight))
    assert estimate is not None
    assert abs(estimate.latency_s - 0.150) < 3 * estimate.sd_s
    assert {e.level for e in events} == {"info"}


def test_at_rest_nothing_is_claimed() -> None:
    flight = scenario("static", 150.0)
    estimate, events = estimated(simulate(flight, 5), matching_config(flight))
    assert estimate is None
    assert not events


@pytest.mark.parametrize(
    ("log", "config"), [("c3_outage", "sitl"), ("p1_plane_outage", "sitl-plane")]
)
def test_simulated_autopilots_fixes_are_a_tenth_of_a_second_late(
    log: str, config: str, root: Path, data_dir: Path
) -> None:
    (vehicle,) = read_log([data_dir / "sitl" / f"{log}.tlog"]).vehicles
    wrong = configured(load(root / "configs" / f"{config}.toml"), 180.0)
    estimate, _ = estimated(vehicle, wrong)
    assert estimate is not None
    print(f"\n{log}: found {estimate}")
    assert abs(estimate.latency_s - 0.100) < 3 * estimate.sd_s
