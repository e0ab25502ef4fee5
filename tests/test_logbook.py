"""The log writer: messages against the generated classes, the file against the mcap package."""

from __future__ import annotations

import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.internal.encoder import _VarintBytes
from google.protobuf.message_factory import GetMessageClass
from mcap.reader import make_reader

from companion.logbook import LogWriteError, LogWriter, columns, messages, schemas
from companion.logbook.rows import varint
from companion.proto import navigation_pb2, samples_pb2
from companion.types import (
    NS,
    AidingReports,
    BaroSamples,
    Channel,
    Event,
    GnssSamples,
    ImuSamples,
    MagSamples,
    Mode,
    Outputs,
    ReferenceSamples,
    Solution,
    Verdict,
)
from replay.run_log import read_run, read_solution

T0 = 1_700_000_000 * NS


def make_solution(n: int, seed: int = 1, rate_hz: int = 50) -> Solution:
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(n, 4))
    root = rng.normal(size=(n, 5, 3, 3))
    cov = root @ root.swapaxes(2, 3)
    upper = cov[:, :, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    return Solution(
        T0 + np.arange(n) * (NS // rate_hz),
        0.7 + 1e-6 * rng.normal(size=n),
        0.1 + 1e-6 * rng.normal(size=n),
        100 + rng.normal(size=n),
        rng.normal(size=(n, 3)),
        q / np.linalg.norm(q, axis=1, keepdims=True),
        rng.normal(size=(n, 3)),
        rng.normal(size=(n, 3)),
        upper,
        rng.integers(Mode.HEADING_UNKNOWN, Mode.COASTING + 1, n),
        np.arange(n) // 7,
    )


def make_reports(n: int, seed: int = 2) -> AidingReports:
    rng = np.random.default_rng(seed)
    return AidingReports(
        T0 + np.arange(n) * (NS // 20),
        rng.integers(0, len(Channel), n),
        rng.integers(0, 3, n),
        rng.integers(0, 4, n),
        rng.normal(size=(n, 3)),
        rng.normal(size=(n, 3)),
        rng.normal(size=n) ** 2,
        np.full(n, 16.0),
        np.ones(n),
        rng.integers(0, len(Verdict), n),
    )


def make_baro(n: int, start: int = 0) -> BaroSamples:
    t = T0 + np.arange(start, start + n) * (NS // 20)
    return BaroSamples("BARO", t, t + 1, np.arange(start, start + n), np.linspace(9e4, 1e5, n))


def empty_outputs(**changes: object) -> Outputs:
    parts: dict[str, object] = {
        "published": Solution.empty(),
        "settled": Solution.empty(),
        "reports": AidingReports.empty(),
        "events": (),
    }
    return Outputs(**(parts | changes))  # type: ignore[arg-type]


def writer(path: Path, **options: object) -> LogWriter:
    return LogWriter(path, config_toml="[vehicle]\n", metadata={"k": "v"}, **options)  # type: ignore[arg-type]


def same(a: object, b: object) -> bool:
    """Every column equal bit for bit."""
    for f in fields(a):  # type: ignore[arg-type]
        x, y = getattr(a, f.name), getattr(b, f.name)
        if isinstance(x, np.ndarray):
            if x.shape != y.shape or x.dtype != y.dtype or x.tobytes() != y.tobytes():
                return False
        elif x != y:
            return False
    return True


# ---------------------------------------------------------------------- messages


def test_states_are_what_the_generated_class_reads() -> None:
    solution = make_solution(20)
    sd = solution.sd
    for i, row in enumerate(messages.encode_states(solution)):
        state = navigation_pb2.NavState.FromString(row.tobytes())
        assert state.t_ns == solution.t_ns[i]
        assert state.mode == solution.mode[i]
        assert state.resets == solution.resets[i]
        assert (state.lat, state.lon, state.height) == (
            solution.lat[i],
            solution.lon[i],
            solution.height[i],
        )
        for name in ("vel_n", "q_nb", "accel_bias_b", "gyro_bias_b"):
            assert list(getattr(state, name)) == getattr(solution, name)[i].tolist()
        blocks = (state.cov_pos, state.cov_vel, state.cov_att, state.cov_accel_bias,
                  state.cov_gyro_bias)  # fmt: skip
        assert [list(b) for b in blocks] == solution.cov[i].tolist()
        assert np.allclose(state.sd_pos_m, sd[i, 0], rtol=1e-6)  # float32
        assert np.allclose(state.sd_att_deg, np.degrees(sd[i, 2]), rtol=1e-6)


def test_states_of_another_writer_are_read_by_parsing() -> None:
    solution = make_solution(5)
    own = [row.tobytes() for row in messages.encode_states(solution)]
    # Serialised again by protobuf itself: zero fields vanish, so the length differs.
    other = [navigation_pb2.NavState.FromString(p).SerializeToString() for p in own]
    assert any(a != b for a, b in zip(own, other, strict=True))
    assert same(messages.decode_states(other), solution)
    assert same(messages.decode_states(own), solution)


def test_reports_are_what_the_generated_class_reads() -> None:
    reports = make_reports(50)
    rows = [row.tobytes() for row in messages.encode_reports(reports)]
    for i, row in enumerate(rows):
        report = navigation_pb2.AidingReport.FromString(row)
        for name in ("t_ns", "channel", "verdict", "source", "dof", "nis", "gate", "scale"):
            assert getattr(report, name) == getattr(reports, name)[i]
        assert list(report.innovation) == reports.innovation[i].tolist()
        assert list(report.innovation_sd) == reports.innovation_sd[i].tolist()
    assert same(messages.decode_reports(rows), reports)


def test_enumerations_agree_with_the_vocabulary() -> None:
    for own, proto in (
        (Mode, navigation_pb2.NavState.Mode),
        (Channel, navigation_pb2.AidingReport.Channel),
        (Verdict, navigation_pb2.AidingReport.Verdict),
    ):
        assert {e.name: e.value for e in own} == dict(proto.items())


def test_batches_have_every_column_of_their_type_and_its_wire_number() -> None:
    classes = (samples_pb2.ImuBatch, samples_pb2.GnssBatch, samples_pb2.BaroBatch,
               samples_pb2.MagBatch, samples_pb2.ReferenceBatch,
               navigation_pb2.SolutionBatch)  # fmt: skip
    types = (ImuSamples, GnssSamples, BaroSamples, MagSamples, ReferenceSamples, Solution)
    batches = (columns.IMU, columns.GNSS, columns.BARO, columns.MAG, columns.REFERENCE,
               columns.SOLUTION)  # fmt: skip
    kinds = {"<i8": FieldDescriptor.TYPE_SFIXED64, "<f8": FieldDescriptor.TYPE_DOUBLE}
    for proto, kind, batch in zip(classes, types, batches, strict=True):
        assert batch.type is kind
        assert batch.message == proto.DESCRIPTOR.full_name
        assert {c.name for c in batch.columns} == {f.name for f in fields(kind)} - {"source"}
        described = {f.name: (f.number, f.type) for f in proto.DESCRIPTOR.fields}
        assert described.pop("source") == (1, FieldDescriptor.TYPE_STRING)
        assert described == {c.name: (c.number, kinds[c.dtype]) for c in batch.columns}


def test_fix_is_in_degrees_and_east_north_up() -> None:
    solution = make_solution(3)
    for i, row in enumerate(messages.encode_fixes(solution)):
        fix = LocationFix.FromString(row.tobytes())
        assert fix.timestamp.seconds * NS + fix.timestamp.nanos == solution.t_ns[i]
        assert fix.latitude == np.degrees(solution.lat[i])
        assert fix.frame_id == "wgs84"
        assert fix.position_covariance_type == LocationFix.KNOWN
        nn, ne, nd, ee, ed, dd = solution.cov[i, 0]
        expected = [ee, ne, -ed, ne, nn, -nd, -ed, -nd, dd]
        assert list(fix.position_covariance) == expected
        n, e, d = solution.vel_n[i]
        assert (fix.velocity.x, fix.velocity.y, fix.velocity.z) == (e, n, -d)


def test_odometry_turns_body_axes_into_east_north_up() -> None:
    solution = make_solution(4)
    origin = (float(solution.lat[0]), float(solution.lon[0]), float(solution.height[0]))
    ned_to_enu = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    frd_to_flu = np.diag([1.0, -1, -1])
    for i, row in enumerate(messages.encode_odometry(solution, origin)):
        odometry = Odometry.FromString(row.tobytes())
        pose = odometry.pose
        q = np.array([pose.orientation.w, pose.orientation.x, pose.orientation.y,
                      pose.orientation.z])  # fmt: skip
        C_nb = _matrix(solution.q_nb[i])
        assert np.allclose(_matrix(q), ned_to_enu @ C_nb @ frd_to_flu, atol=1e-12)
        velocity = odometry.linear_velocity
        expected = frd_to_flu @ C_nb.T @ solution.vel_n[i]
        assert np.allclose((velocity.x, velocity.y, velocity.z), expected, atol=1e-12)
        assert np.isclose(pose.position.z, solution.height[i] - origin[2], atol=1e-9)
        cov = np.reshape(odometry.velocity_covariance, (6, 6))[:3, :3]
        assert np.isclose(np.trace(cov), solution.cov[i, 1, [0, 3, 5]].sum())  # a rotation


def _matrix(q: np.ndarray) -> np.ndarray:
    w, r = q[0], q[1:]
    cross = np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
    return (w * w - r @ r) * np.eye(3) + 2 * np.outer(r, r) + 2 * w * cross


@pytest.mark.parametrize("value", [0, 1, 127, 128, 300, 2**32, 2**63])
def test_varint_is_protobufs(value: int) -> None:
    assert _VarintBytes(value) == varint(value)


# ---------------------------------------------------------------------- the file


def test_indexed_reader_opens_the_file_and_finds_every_message(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    solution, reports = make_solution(1000), make_reports(400)
    with writer(path) as log:
        log.outputs(empty_outputs(published=solution, reports=reports), "rover")
        log.samples(make_baro(400), "rover")
        log.raw("can0", T0, 1, b"\x01\x02", "rover")
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        counts = {
            summary.channels[c].topic: n
            for c, n in summary.statistics.channel_message_counts.items()
        }
        assert counts["companion/rover/nav/state"] == 1000
        assert counts["companion/rover/nav/aiding"] == 400
        assert counts["companion/rover/raw"] == 1
        seen = 0
        for schema, _, message in reader.iter_messages():
            assert schema is not None
            assert schema.encoding == "protobuf"
            parsed = schemas.MESSAGES[schema.name].FromString(message.data)
            assert parsed.DESCRIPTOR.full_name == schema.name
            seen += 1
        assert seen == summary.statistics.message_count
        times = [m.log_time for _, _, m in reader.iter_messages(topics="companion/rover/nav/state")]
        assert times == solution.t_ns.tolist()


@pytest.mark.parametrize("name", sorted(schemas.MESSAGES))
def test_schema_stands_alone(name: str) -> None:
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(schemas.descriptor_set(name)).file:
        pool.Add(file)
    assert GetMessageClass(pool.FindMessageTypeByName(name)).DESCRIPTOR.full_name == name


def test_closing_twice_is_closing_once(tmp_path: Path) -> None:
    log = writer(tmp_path / "run.mcap")
    log.samples(make_baro(3), "v")
    log.close({"digest": "a"})
    size = log.path.stat().st_size
    log.close({"digest": "b"})
    assert log.path.stat().st_size == size
    assert read_solution(log.path).digest == "a"


def test_writing_after_close_is_refused(tmp_path: Path) -> None:
    log = writer(tmp_path / "run.mcap")
    log.close({})
    with pytest.raises(LogWriteError, match="closed"):
        log.event(Event(T0, "x", "text"), "v")


def test_live_samples_do_not_cost_a_message_each(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    block = make_baro(200)
    with writer(path) as log:
        for i in range(200):
            log.samples(block.take(slice(i, i + 1)), "v")
    assert same(read_run(path).vehicles[0].baro[0], block)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        topics = {c.topic: i for i, c in summary.channels.items()}
        batches = summary.statistics.channel_message_counts[topics["companion/v/input/baro"]]
    assert batches <= 11  # ten seconds at 20 Hz, a batch a second, and the rest


def test_killed_process_leaves_all_but_the_last_second(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    script = f"""
import os, sys
sys.path[:0] = {[str(Path(__file__).parent), *sys.path]!r}
from pathlib import Path
from test_logbook import make_baro, writer
log = writer(Path({str(path)!r}))
block = make_baro(400)
for i in range(400):
    log.samples(block.take(slice(i, i + 1)), "v")
os._exit(9)
"""
    done = subprocess.run([sys.executable, "-c", script], timeout=60, check=False)
    assert done.returncode == 9
    recording = read_run(path)
    found = recording.vehicles[0].baro[0]
    # 20 s at 20 Hz: a second held back and a second in the open chunk may be missing
    assert 400 - 42 <= len(found) < 400
    assert same(found, make_baro(400).take(slice(0, len(found))))
    assert "without a summary" in recording.notes[0]


@contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """No file of this process grows beyond ``size`` bytes, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("size", [20_000, 100_000, 100_001])
def test_full_disk_is_one_line_and_keeps_what_was_written(tmp_path: Path, size: int) -> None:
    path = tmp_path / "run.mcap"
    solution = make_solution(2000)
    log = writer(path)
    steps: list[int] = []

    def fly() -> None:
        for i in range(0, 2000, 10):
            part = Solution(*(getattr(solution, f.name)[i : i + 10] for f in fields(solution)))
            log.outputs(empty_outputs(published=part), "v")
            steps.append(i + 10)

    with file_size_limit(size), pytest.raises(LogWriteError) as caught:
        fly()
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    with pytest.raises(LogWriteError):
        log.event(Event(T0, "x", "text"), "v")
    log.close({})
    kept = read_solution(path)
    n = len(kept.solution)
    # Two seconds at 50 Hz may be gone; the call that failed brought ten more rows.
    written = steps[-1]
    assert written - 100 <= n <= written + 10
    head = Solution(*(getattr(solution, f.name)[:n] for f in fields(solution)))
    assert same(kept.solution, head)
    assert kept.notes


def test_path_that_cannot_be_opened_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LogWriteError, match="cannot be opened"):
        writer(tmp_path / "absent" / "run.mcap")


def test_vehicle_names_become_safe_topics() -> None:
    assert schemas.topic("rover", "nav/state") == "companion/rover/nav/state"
    assert schemas.topic("a/b *", "x") == "companion/a_b__/x"
    assert schemas.topic("", "x") == "companion/_/x"
