"""Starts with an unknown heading: one flight or drive for each heading of the compass.

Shared by the test and by ``python -m tests.benchmarks.heading``. Time counts from the first
horizontal motion, since nothing can tell the heading before it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from companion.types import COV_ATT, F64, I64, NS, Channel, VehicleRecording
from replay.simulator import Scenario, load_scenario, matching_config, run
from replay.simulator.aids import MagSpec

from . import runs

REST_S = 4.0
MOVING_MPS = 0.5
DURATION_S = {"multirotor-mission": 100.0, "car-with-stops": 60.0}
AFTER_S = 20.0
"""Of each run, only what comes up to this long after the first horizontal motion is played."""
NEEDS_HEADING = (Channel.MAG, Channel.COURSE)
"""Aids that say where the nose points: they may serve only once the heading is known."""


@dataclass(frozen=True)
class Start:
    """What became of one start."""

    heading_deg: float
    """True at the start."""
    mode: I64
    """(N,) of each settled epoch."""
    found_s: float
    """From the first motion to ``heading-found``; infinite if it never came."""
    lost: int
    """Times that the heading was given up again."""
    error_deg: F64
    """(N,) true − estimated yaw."""
    sd_deg: F64
    """(N,) standard deviation that was claimed for it."""
    since_s: F64
    """(N,) time of the epochs since the heading was found."""
    early: int
    """Reports of aids that need a heading, from before it was found."""
    later: int
    """And from after."""


def realistic(kind: str, heading_deg: float) -> Scenario:
    """The built-in scenario with all its errors, started at ``heading_deg``."""
    base = load_scenario(kind)
    place = msgspec.structs.replace(
        base.trajectory, duration_s=DURATION_S[kind], rest_s=REST_S, heading_deg=heading_deg
    )
    return msgspec.structs.replace(base, trajectory=place, truth_rate_hz=10.0)


def modelled(kind: str, heading_deg: float) -> Scenario:
    """Only errors that the filter models, in the sizes it is told; with a magnetometer."""
    base = runs.honest(kind, DURATION_S[kind], heading_deg, latency_ms=0.0)
    place = msgspec.structs.replace(base.trajectory, rest_s=REST_S)
    return msgspec.structs.replace(base, trajectory=place, mag=MagSpec())


def _until(recording: VehicleRecording, end_ns: int) -> VehicleRecording:
    """The sensors of ``recording`` up to ``end_ns``."""
    return replace(
        recording,
        imu=tuple(x.take(x.t_ns < end_ns) for x in recording.imu),
        gnss=tuple(x.take(x.t_ns < end_ns) for x in recording.gnss),
        baro=tuple(x.take(x.t_ns < end_ns) for x in recording.baro),
        mag=tuple(x.take(x.t_ns < end_ns) for x in recording.mag),
    )


def start(scenario: Scenario, seed: int) -> Start:
    """Run ``scenario`` with the heading declared unknown, magnetometer and course allowed later."""
    sim = run(scenario, seed)
    config = runs.changed(
        matching_config(scenario),
        alignment={"heading": "unknown"},
        engine={"output_rate_hz": 10.0},
    )
    times = np.arange(0.0, scenario.trajectory.duration_s, 0.02)
    speed = np.linalg.norm(sim.trajectory.states(times).vel_n[:, :2], axis=1)
    moving_s = float(times[int(np.argmax(speed > MOVING_MPS))])
    end_ns = sim.t0_ns + round((moving_s + AFTER_S) * NS)
    flown = runs.fly(_until(sim.recording, end_ns), config)
    found = flown.event("heading-found")
    found_ns = found.t_ns if found is not None else int(flown.solution.t_ns[-1]) + NS
    needing = np.isin(flown.reports.channel, NEEDS_HEADING)
    before = flown.reports.t_ns <= found_ns
    return Start(
        scenario.trajectory.heading_deg,
        flown.solution.mode,
        math.inf if found is None else (found_ns - sim.t0_ns) / NS - moving_s,
        sum(e.kind == "heading-lost" for e in flown.events),
        np.degrees(runs.yaw_error(sim, flown.solution)),
        np.degrees(flown.solution.sd[:, COV_ATT, 2]),
        (flown.solution.t_ns - found_ns) / NS,
        int((needing & before).sum()),
        int((needing & ~before).sum()),
    )


def sweep(
    make: Callable[[str, float], Scenario], kind: str, headings_deg: Iterable[float], seed: int
) -> list[Start]:
    """One start for each heading; the motion is the same seen from the body, errors differ."""
    return [start(make(kind, float(h)), seed + i) for i, h in enumerate(headings_deg)]


def compass(step_deg: float) -> F64:
    """Headings from −180° on, ``step_deg`` apart, once round."""
    return np.arange(-180.0, 180.0, step_deg)
