"""The run log read back: bit for bit, after a cut, with damage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mcap.writer import Writer

from companion.logbook import LogWriter
from companion.types import (
    NS,
    AidingReports,
    BaroSamples,
    CompanionError,
    Event,
    GnssSamples,
    ImuSamples,
    LogFormatError,
    MagSamples,
    Outputs,
    ReferenceSamples,
    Solution,
    StreamInfo,
    VehicleRecording,
)
from replay.run_log import read_run, read_solution

I64_RANGE = st.integers(-(2**63), 2**63 - 1)


def columns_of(kind: type, n: int, draw: Callable[..., Any]) -> dict[str, Any]:
    """Random columns of a sample type, by its fields' documented shapes."""
    wide = {"gyro_b", "accel_b", "vel_n", "sd_pos", "sd_vel", "field_b", "rpy"}
    whole = {"t_ns", "t_rx_ns", "seq", "num_sats", "fix_type"}
    out: dict[str, Any] = {}
    for f in fields(kind):
        if f.name == "source":
            continue
        if f.name in whole:
            out[f.name] = draw(hnp.arrays(np.int64, n, elements=I64_RANGE))
        else:
            shape = (n, 3) if f.name in wide else (n,)
            # Any 64 bits: NaN with every payload, infinities, subnormals.
            bits = draw(hnp.arrays(np.uint64, shape, elements=st.integers(0, 2**64 - 1)))
            out[f.name] = bits.view(np.float64)
    return out


@st.composite
def samples(draw: Callable[..., Any], kind: type, source: str) -> Any:
    n = draw(st.integers(0, 40))
    return kind(source=source, **columns_of(kind, n, draw))


@st.composite
def vehicles(draw: Callable[..., Any]) -> VehicleRecording:
    kinds = {"imu": ImuSamples, "gnss": GnssSamples, "baro": BaroSamples, "mag": MagSamples}
    streams: dict[str, Any] = {}
    for name, kind in kinds.items():
        sources = draw(st.lists(st.text(max_size=8), unique=True, max_size=2))
        streams[name] = tuple(draw(samples(kind, s)) for s in sources)
    for name in ("truth", "autopilot"):
        present = draw(st.booleans())
        streams[name] = draw(samples(ReferenceSamples, "ref")) if present else None
    return VehicleRecording(
        name=draw(st.text(max_size=10)),
        height_datum=draw(st.sampled_from(("hae", "msl"))),
        streams=(StreamInfo("imu", "imu", 3, 200.5, 0.25, 1, "note"),),
        **streams,
    )


def write(path: Path, vehicle: VehicleRecording, blocks: int = 3, **options: Any) -> None:
    """Log a recording the way a player does: in blocks, streams in turn."""
    with LogWriter(path, config_toml="a = 1\n", metadata={"k": "ü"}, **options) as log:
        log.describe(vehicle)
        for i in range(blocks):
            for kind in ("imu", "gnss", "baro", "mag"):
                for s in getattr(vehicle, kind):
                    edges = [len(s) * j // blocks for j in (i, i + 1)]
                    log.samples(s.take(slice(*edges)), vehicle.name)
        if vehicle.truth is not None:
            log.reference(vehicle.truth, vehicle.name, "truth")
        if vehicle.autopilot is not None:
            log.reference(vehicle.autopilot, vehicle.name, "autopilot")
        log.close({"digest": "d", "digest_published": "p"})


def assert_same(a: Any, b: Any) -> None:
    assert type(a) is type(b)
    for f in fields(a):
        x, y = getattr(a, f.name), getattr(b, f.name)
        if isinstance(x, np.ndarray):
            assert (x.shape, x.dtype) == (y.shape, y.dtype), f.name
            assert x.tobytes() == y.tobytes(), f.name
        else:
            assert x == y, f.name


def assert_same_vehicle(a: VehicleRecording, b: VehicleRecording) -> None:
    assert (a.name, a.height_datum) == (b.name, b.height_datum)
    # What nobody said about the streams is found out again from their samples.
    assert a.streams == b.streams or (not b.streams and len(a.streams) > 0)
    for kind in ("imu", "gnss", "baro", "mag"):
        assert len(getattr(a, kind)) == len(getattr(b, kind)), kind
        for x, y in zip(getattr(a, kind), getattr(b, kind), strict=True):
            assert_same(x, y)
    for kind in ("truth", "autopilot"):
        x, y = getattr(a, kind), getattr(b, kind)
        assert (x is None) == (y is None), kind
        if x is not None:
            assert_same(x, y)


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(vehicle=vehicles())
def test_any_recording_comes_back_bit_for_bit(
    vehicle: VehicleRecording, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    write(path, vehicle)
    recording = read_run(path)
    assert recording.notes == ()
    assert recording.format == "mcap"
    assert recording.config_toml == "a = 1\n"
    assert recording.metadata == {"k": "ü"}
    assert_same_vehicle(recording.vehicles[0], vehicle)


def flight(seconds: int = 60, name: str = "v") -> VehicleRecording:
    """A vehicle with an IMU at 100 Hz, fixes at 5 Hz and truth."""
    rng = np.random.default_rng(3)

    def common(rate: int, first: int) -> tuple[Any, Any, Any]:
        n = seconds * rate
        t = 1_700_000_000 * NS + np.arange(n) * (NS // rate)
        return t, t + 3_000_000, first + np.arange(n)

    n, m = seconds * 100, seconds * 5
    return VehicleRecording(
        name,
        (
            ImuSamples(
                "imu",
                *common(100, 0),
                rng.normal(size=(n, 3)),
                rng.normal(size=(n, 3)),
                np.full(n, np.nan),
            ),
        ),
        (
            GnssSamples(
                "gps",
                *common(5, n),
                *(rng.normal(size=m) for _ in range(3)),
                *(rng.normal(size=(m, 3)) for _ in range(3)),
                np.full(m, 9),
                np.full(m, 3),
            ),
        ),
    )


def outputs(seconds: int = 60) -> Outputs:
    rng = np.random.default_rng(4)
    n = seconds * 50
    t = 1_700_000_000 * NS + np.arange(n) * (NS // 50)
    solution = Solution(
        t,
        *(rng.normal(size=n) for _ in range(3)),
        rng.normal(size=(n, 3)),
        rng.normal(size=(n, 4)),
        rng.normal(size=(n, 3)),
        rng.normal(size=(n, 3)),
        rng.normal(size=(n, 5, 6)) ** 2,
        np.full(n, 2),
        np.zeros(n, np.int64),
    )
    i = np.zeros(n, np.int64)
    reports = AidingReports(
        t, i, i, i + 3, *(rng.normal(size=(n, 3)) for _ in range(2)),
        *(rng.normal(size=n) for _ in range(3)), i
    )  # fmt: skip
    events = (
        Event(int(t[0]), "aligned", "Ausrichtung fertig", "info"),
        Event(int(t[-1]), "reset", "position reset", "error"),
    )
    return Outputs(solution, solution, reports, events)


def test_outputs_come_back_bit_for_bit(tmp_path: Path) -> None:
    path, out = tmp_path / "run.mcap", outputs()
    with LogWriter(path, config_toml="", metadata={}, settled=True) as log:
        log.outputs(out, "v")
        log.close({"vehicles": {"v": {"digest": "d", "digest_published": "p", "n": 3}}})
    result = read_solution(path)
    assert_same(result.solution, out.published)
    assert result.settled is not None
    assert_same(result.settled, out.settled)
    assert_same(result.reports, out.reports)
    assert result.events == out.events
    assert (result.digest, result.digest_published, result.summary["n"]) == ("d", "p", 3)
    assert result.notes == ()


def test_vehicles_are_kept_apart(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    a, b = flight(5, "a/1"), flight(7, "a*1")  # two names that give one topic
    with LogWriter(path, config_toml="", metadata={}) as log:
        for vehicle in (a, b):
            log.describe(vehicle)
            log.samples(vehicle.imu[0], vehicle.name)
            log.samples(vehicle.gnss[0], vehicle.name)
    found = read_run(path).vehicles
    assert [v.name for v in found] == ["a/1", "a*1"]
    for x, y in zip(found, (a, b), strict=True):
        assert_same_vehicle(x, y)
    with pytest.raises(LogFormatError, match="no vehicle c"):
        read_solution(path, "c")
    assert "a/1" in read_solution(path).notes[0]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[VehicleRecording, bytes]:
    """A log of a minute, written in steps of a second."""
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    vehicle, out = flight(), outputs()
    with LogWriter(path, config_toml="", metadata={}) as log:
        for i in range(60):
            for s, rate in ((vehicle.imu[0], 100), (vehicle.gnss[0], 5)):
                log.samples(s.take(slice(i * rate, (i + 1) * rate)), "v")
            cut = slice(i * 50, (i + 1) * 50)
            part = Solution(*(getattr(out.published, f.name)[cut] for f in fields(Solution)))
            log.outputs(Outputs(part, Solution.empty(), AidingReports.empty(), ()), "v")
        log.close({"digest": "d"})
    return vehicle, path.read_bytes()


def test_log_cut_anywhere_opens_up_to_its_last_whole_chunk(
    whole: tuple[VehicleRecording, bytes], tmp_path: Path
) -> None:
    vehicle, data = whole
    path = tmp_path / "cut.mcap"
    rng = np.random.default_rng(5)
    lengths = []
    for size in sorted(rng.integers(4000, len(data), 60).tolist()):
        path.write_bytes(data[:size])
        recording = read_run(path)
        assert recording.notes, size
        imu = recording.vehicles[0].imu
        n = len(imu[0]) if imu else 0
        if n:
            assert_same(imu[0], vehicle.imu[0].take(slice(0, n)))
        assert read_solution(path).digest is None or size > 0.9 * len(data)
        lengths.append(n)
    assert lengths == sorted(lengths)
    # What is read grows with the file: no cut loses more than two seconds and the open chunk.
    assert lengths[-1] > 5000
    assert sum(n > 1000 for n in lengths) > 40


def test_log_cut_in_its_head_is_refused_in_one_line(
    whole: tuple[VehicleRecording, bytes], tmp_path: Path
) -> None:
    _, data = whole
    path = tmp_path / "cut.mcap"
    for size in range(60):
        path.write_bytes(data[:size])
        with pytest.raises(LogFormatError) as caught:
            read_run(path)
        assert "\n" not in str(caught.value)


def test_damaged_logs_never_raise_anything_else(
    whole: tuple[VehicleRecording, bytes], tmp_path: Path
) -> None:
    _, data = whole
    path = tmp_path / "bad.mcap"
    rng = np.random.default_rng(6)
    read, refusals = 0, []
    for _ in range(60):
        bad = bytearray(data)
        for at in rng.integers(0, len(data), rng.integers(1, 6)):
            bad[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(bad)
        for reader in (read_run, read_solution):
            try:
                assert reader(path).notes is not None
                read += 1
            except CompanionError as error:
                refusals.append(str(error))
    assert not any("\n" in text for text in refusals)
    assert read > 80  # most damage costs a chunk, not the log


def test_damaged_chunk_costs_only_itself(
    whole: tuple[VehicleRecording, bytes], tmp_path: Path
) -> None:
    _, data = whole
    bad = bytearray(data)
    bad[len(bad) // 2] ^= 0xFF
    path = tmp_path / "bad.mcap"
    path.write_bytes(bad)
    recording = read_run(path)
    assert "1 damaged chunks left out" in recording.notes
    imu = recording.vehicles[0].imu[0]
    assert 5700 <= len(imu) < 6000  # 60 s at 100 Hz without a chunk of at most 2 s and its seam
    assert imu.seq[-1] == 5999


@pytest.mark.parametrize("content", [b"", b"hello", b"\x89MCAP0\r\n", bytes(5000)])
def test_other_files_are_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(LogFormatError):
        read_run(path)


def test_foreign_mcap_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        other = Writer(file)
        other.start()
        channel = other.register_channel("imu", "json", other.register_schema("s", "", b""))
        other.add_message(channel, 1, b"{}", 1)
        other.finish()
    with pytest.raises(LogFormatError, match="not a run log of companion"):
        read_run(path)


def test_absent_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LogFormatError, match="cannot be read"):
        read_solution(tmp_path / "absent.mcap")
