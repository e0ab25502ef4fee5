"""A receiver without velocity that was refused is believed in the end: the filter begins anew."""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import numpy as np

from companion.types import NS, Event, Mode, Outputs, Samples, Solution
from replay.evaluation import errors_against
from replay.player import play
from replay.simulator import load_scenario, matching_config, run

STRUCK_S, STRUCK_FOR_S = 30.0, 2.0


def test_a_heading_that_was_lost_does_not_lock_out_places_for_good() -> None:
    """The gyro reads 60 °/s too much for two seconds; fixes say where, not how fast."""
    base = load_scenario("fixed-wing")
    of = msgspec.structs.replace(
        base, trajectory=msgspec.structs.replace(base.trajectory, duration_s=90.0)
    )
    flight = run(of, 4)
    (imu,) = flight.recording.imu
    (fix,) = flight.recording.gnss
    t = (imu.t_ns - flight.t0_ns) / NS
    gyro = imu.gyro_b.copy()
    gyro[(t > STRUCK_S) & (t < STRUCK_S + STRUCK_FOR_S), 2] += math.radians(60.0)
    still = replace(fix, vel_n=np.full_like(fix.vel_n, np.nan))
    recording = replace(flight.recording, imu=(replace(imu, gyro_b=gyro),), gnss=(still,), mag=())
    config = matching_config(base)
    config = msgspec.structs.replace(
        config,
        mag=msgspec.structs.replace(config.mag, use=False),
        alignment=msgspec.structs.replace(config.alignment, heading="unknown"),
    )
    parts: list[Solution] = []
    events: list[Event] = []

    def sink(_: Samples, out: Outputs) -> None:
        parts.append(out.published)
        events.extend(out.events)

    play(recording, config, sink)
    kinds = [e.kind for e in events if e.t_ns > flight.t0_ns + round(STRUCK_S * NS)]
    assert "relocked" in kinds
    assert "heading-found" in kinds
    solution = Solution.concatenate(parts)
    assert solution.mode[-1] == Mode.NAVIGATING
    assert recording.truth is not None
    errors = errors_against(solution, recording.truth)
    late = errors.t_ns > flight.t0_ns + 80 * NS
    assert np.hypot(errors.position_n[late, 0], errors.position_n[late, 1]).max() < 10.0
