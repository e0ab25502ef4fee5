"""The ROS 2 bag, read back by a reader that has only the definitions in the file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from companion.types import CompanionError, Solution
from replay.ros2 import FIX, ODOMETRY, write_bag
from tests.outputs.zenoh_help import T0, solution
from tests.replay.test_maps import flown

mcap_ros2 = pytest.importorskip("mcap_ros2.decoder", reason="mcap-ros2-support is not installed")


def test_a_ros_reader_gets_what_was_flown(tmp_path: Path) -> None:
    """Heading 30° in north-east-down is 60° in east-north-up; 10 m/s north."""
    track = solution(100)
    cov = track.cov.copy()
    cov[:, 0] = [1.0, 0.5, 0.1, 4.0, 0.2, 9.0]  # nn, ne, nd, ee, ed, dd
    track = replace(track, cov=cov)
    path = tmp_path / "run.mcap"
    assert write_bag(track, path, name="x", height_datum="msl") == 100
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[mcap_ros2.DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
        assert metadata["companion"]["height_datum"] == "msl"
        found = list(reader.iter_decoded_messages(topics=[ODOMETRY]))
        fixes = [m for _, _, _, m in reader.iter_decoded_messages(topics=[FIX])]
    assert len(found) == len(fixes) == 100
    schema, _, record, last = found[-1]
    assert schema.name == "nav_msgs/msg/Odometry"
    assert record.log_time == T0 + 99 * 20_000_000
    assert (last.header.stamp.sec, last.header.stamp.nanosec) == divmod(record.log_time, 10**9)
    assert (last.header.frame_id, last.child_frame_id) == ("map", "base_link")
    place = last.pose.pose.position
    assert (place.x, place.z) == pytest.approx((0.0, 0.0), abs=1e-3)
    assert place.y == pytest.approx(99 * 0.2, rel=2e-3)
    q = last.pose.pose.orientation
    turned = np.sign(q.w) * np.array([q.x, q.y, q.z, q.w])  # q and −q are one attitude
    assert turned == pytest.approx([0, 0, np.sin(np.pi / 6), np.cos(np.pi / 6)])
    v = last.twist.twist.linear
    assert (v.x, v.y, v.z) == pytest.approx((10 * np.cos(np.pi / 6), 10 * np.sin(np.pi / 6), 0))
    assert np.reshape(last.pose.covariance, (6, 6))[:3, :3] == pytest.approx(
        np.array([[4.0, 0.5, -0.2], [0.5, 1.0, -0.1], [-0.2, -0.1, 9.0]])
    )
    assert np.reshape(last.twist.covariance, (6, 6))[3, 3] == 1e6
    fix = fixes[-1]
    assert fix.latitude == pytest.approx(np.degrees(track.lat[-1]), abs=1e-12)
    assert (fix.altitude, fix.header.frame_id) == (500.0, "base_link")
    assert (fix.status.status, fix.status.service, fix.position_covariance_type) == (0, 1, 3)
    assert fix.position_covariance[0] == 4.0


def test_epochs_without_a_solution_are_left_out(tmp_path: Path) -> None:
    assert write_bag(flown(), tmp_path / "a.mcap", name="x", height_datum="hae") == 990
    empty = tmp_path / "b.mcap"
    assert write_bag(Solution.empty(), empty, name="x", height_datum="hae") == 0
    with empty.open("rb") as file:
        assert make_reader(file).get_summary() is not None


def test_what_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(CompanionError, match="No such file"):
        write_bag(flown(), tmp_path / "no" / "a.mcap", name="x", height_datum="hae")
    with pytest.raises(CompanionError, match="before 1970"):
        write_bag(flown(begin_ns=-(10**12)), tmp_path / "a.mcap", name="x", height_datum="hae")
