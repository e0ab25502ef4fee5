"""The running process on a signed link that feeds the autopilot: what goes out, what is refused."""

from __future__ import annotations

import math
import secrets
import signal
import time
from collections import Counter
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.config import ToAutopilot
from companion.navigation.rotation import matrix_from_quat
from companion.types import NS, Mode, Solution
from replay.children import free_port
from replay.run_log import read_solution

from .relay import Relay
from .system import PATIENCE_S, Companion, config_beside, vehicle_at, written

CHEATS, WANTED = 20, 60
"""Datagrams of each kind that are to be refused; ODOMETRY messages that are waited for."""


@dataclass
class Link:
    """What went over the link."""

    said: list[Any]
    badly_signed: int
    cheated: Counter[str]
    summary: dict[str, Any]
    solution: Solution

    def of(self, kind: str) -> list[Any]:
        return [message for message in self.said if message.get_type() == kind]


@pytest.fixture(scope="module")
def link(tmp_path_factory: pytest.TempPathFactory) -> Link:
    folder = tmp_path_factory.mktemp("link")
    key = secrets.token_bytes(32)
    (folder / "key").write_text(key.hex(), encoding="ascii")
    log = folder / "link.mcap"
    with vehicle_at(folder) as vehicle, Relay(vehicle.ready["mavlink"], key) as relay:
        config = config_beside(vehicle, folder, f"tcp/127.0.0.1:{free_port()}")
        config = msgspec.structs.replace(
            config,
            mavlink=msgspec.structs.replace(
                config.mavlink, endpoint=relay.endpoint, signing_key_file=str(folder / "key")
            ),
            to_autopilot=ToAutopilot(message="odometry-ardupilot", rate_hz=20.0),
        )
        with Companion(written(config, folder), log) as companion:
            companion.await_event("aligned")
            for _ in range(CHEATS):
                relay.cheat()
            end = time.monotonic() + PATIENCE_S
            while len(relay.of("ODOMETRY")) < WANTED and time.monotonic() < end:
                time.sleep(0.05)
            companion.send_signal(signal.SIGTERM)
            companion.finish()
            summary = companion.answer(PATIENCE_S)
        said, bad, cheated = list(relay.said), len(relay.refused), relay.cheated
    return Link(said, bad, cheated, summary, read_solution(log).solution)


def test_unsigned_and_replayed_frames_are_refused_and_counted(link: Link) -> None:
    counters = link.summary["counters"]
    assert counters["mavlink.signing.unsigned"] == link.cheated["unsigned"] == CHEATS
    assert counters["mavlink.signing.replayed"] == link.cheated["replayed"] == CHEATS
    assert counters["mavlink.signing.bad_signature"] == 0
    # It went on with what is signed: the rest of the traffic.
    assert counters["mavlink.signing.accepted"] == counters["mavlink.frames"] - 2 * CHEATS
    assert link.summary["mode"] == "navigating"


def test_everything_that_goes_out_is_signed(link: Link) -> None:
    """By pymavlink's verification, which refuses what is not."""
    assert link.badly_signed == 0
    assert {m.get_type() for m in link.said} >= {"HEARTBEAT", "TIMESYNC", "COMMAND_LONG"}
    assert all(m.get_srcSystem() == 1 and m.get_srcComponent() == 191 for m in link.said[1:])


def test_odometry_is_what_ardupilot_takes(link: Link) -> None:
    """Frames, estimator, quality, covariances and rate; what AP_VisualOdom asks for."""
    sent = link.of("ODOMETRY")
    assert len(sent) >= WANTED
    for m in sent:
        assert m.frame_id == mavlink.MAV_FRAME_LOCAL_FRD
        assert m.child_frame_id == mavlink.MAV_FRAME_BODY_FRD
        assert m.estimator_type == mavlink.MAV_ESTIMATOR_TYPE_GPS_INS
        assert 1 <= m.quality <= 100
        assert m.reset_counter == 0
        assert abs(math.hypot(*m.q) - 1.0) < 1e-6
        # Diagonals of position and attitude, and of velocity, are known and positive.
        assert min(m.pose_covariance[i] for i in (0, 6, 11, 15, 18, 20)) > 0
        assert min(m.velocity_covariance[i] for i in (0, 6, 11)) > 0
        assert math.isnan(m.velocity_covariance[15])
    steps = np.diff([m.time_usec for m in sent]) * 1e-6
    assert np.median(steps) == pytest.approx(0.05, abs=0.011)  # epochs come every 20 ms


def test_odometry_is_the_solution(link: Link) -> None:
    """Each is an epoch of the log, in metres from the origin and in body axes."""
    origins = link.of("SET_GPS_GLOBAL_ORIGIN")
    assert len(origins) >= 2  # repeated until the autopilot has it, which this one never says
    assert len({(m.latitude, m.longitude, m.altitude) for m in origins}) == 1
    lat0, lon0 = origins[0].latitude * 1e-7, origins[0].longitude * 1e-7
    solution = link.solution
    assert set(solution.mode.tolist()) <= {Mode.NAVIGATING, Mode.COASTING}
    sent = link.of("ODOMETRY")
    at = np.searchsorted(solution.t_ns // 1000, [m.time_usec for m in sent])
    assert (solution.t_ns[at] // 1000 == [m.time_usec for m in sent]).all()
    # A sphere of ArduPilot's 1.113 cm per 1e-7 degree.
    metres = 0.011131884502145034e7
    north = (np.degrees(solution.lat[at]) - lat0) * metres
    east = (np.degrees(solution.lon[at]) - lon0) * metres * math.cos(math.radians(lat0))
    down = -(solution.height[at] - solution.height[at[0]])
    given = np.array([[m.x, m.y, m.z] for m in sent])
    np.testing.assert_allclose(given[:, :2], np.stack([north, east], axis=1), atol=0.02)
    np.testing.assert_allclose(given[:, 2] - given[0, 2], down, atol=0.02)
    body = np.stack([matrix_from_quat(solution.q_nb[i]).T @ solution.vel_n[i] for i in at.tolist()])
    np.testing.assert_allclose([[m.vx, m.vy, m.vz] for m in sent], body, atol=1e-4)
    turned = np.array([m.q for m in sent]) * np.sign([[m.q[0]] for m in sent])
    own = solution.q_nb[at] * np.sign(solution.q_nb[at][:, :1])
    np.testing.assert_allclose(turned, own, atol=1e-6)
    assert (sent[-1].time_usec - sent[0].time_usec) * 1000 > 2 * NS
