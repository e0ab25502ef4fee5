"""The log's writer thread against disks that are slow, full, or full for a while."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from companion.logbook import LogWriteError, LogWriter
from companion.runtime import background
from companion.runtime.background import BackgroundFile
from companion.types import ImuSamples
from replay.run_log import read_run

WAIT_S = 30.0


class Disk:
    """Stands in for ``os.write``: refuses, or waits, while it is told to."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._write: Callable[[int, bytes | memoryview], int] = os.write
        self.full = False
        self.half_written = True
        self.open = threading.Event()
        self.open.set()
        self.asked = threading.Event()
        monkeypatch.setattr(background.os, "write", self)

    def __call__(self, fd: int, data: bytes | memoryview) -> int:
        self.asked.set()
        assert self.open.wait(WAIT_S)
        if self.full:
            if self.half_written and len(data) > 1:
                self.half_written = False
                return self._write(fd, data[: len(data) // 2])
            raise OSError(errno.ENOSPC, "No space left on device")
        return self._write(fd, data)


def _imu(first: int, n: int = 500) -> ImuSamples:
    t = 1_700_000_000_000_000_000 + (first + np.arange(n)) * 1_000_000
    values = np.random.default_rng(first).normal(size=(n, 6))
    seq = first + np.arange(n)
    return ImuSamples("imu", t, t, seq, values[:, :3], values[:, 3:], np.full(n, np.nan))


def _seqs(path: Path) -> list[int]:
    (vehicle,) = read_run(path).vehicles
    return list(vehicle.imu[0].seq)


def test_pieces_come_out_in_order(tmp_path: Path) -> None:
    sink = BackgroundFile(tmp_path / "log")
    for i in range(200):
        sink.append(bytes([i]) * i)
    assert sink.settle() == []
    sink.close()
    assert (tmp_path / "log").read_bytes() == b"".join(bytes([i]) * i for i in range(200))
    assert sink.health().written_bytes == sum(range(200))


def test_a_slow_disk_keeps_nobody_waiting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Disk(monkeypatch)
    disk.open.clear()
    sink = BackgroundFile(tmp_path / "log")
    for _ in range(50):
        sink.append(b"x" * 1000)  # returns although nothing can be written
    assert sink.health().queued_bytes == 50_000
    disk.open.set()
    sink.close()
    assert (tmp_path / "log").stat().st_size == 50_000


def test_a_disk_full_for_a_while_costs_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = Disk(monkeypatch)
    path = tmp_path / "run.mcap"
    sink = BackgroundFile(path, retry_s=0.01)
    with LogWriter(path, config_toml="", metadata={}, hold_s=0.1, sink=sink) as writer:
        writer.samples(_imu(0), "v")
        writer.flush()
        sink.settle()
        disk.full, disk.half_written = True, True
        disk.asked.clear()
        writer.samples(_imu(500), "v")
        writer.flush()
        assert disk.asked.wait(WAIT_S)
        disk.full = False
        writer.samples(_imu(1000), "v")
    assert sink.health().state == "writing"
    assert sink.health().dropped_bytes == 0
    assert _seqs(path) == list(range(1500))
    assert read_run(path).notes == ()


def test_a_disk_full_for_long_costs_a_span_and_the_index_still_fits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = Disk(monkeypatch)
    path = tmp_path / "run.mcap"
    sink = BackgroundFile(path, queue_bytes=60_000, retry_s=0.01)
    with LogWriter(path, config_toml="", metadata={}, hold_s=0.1, sink=sink) as writer:
        writer.samples(_imu(0), "v")
        writer.flush()
        sink.settle()
        disk.full = True
        for first in range(500, 5000, 500):
            writer.samples(_imu(first), "v")
            writer.flush()
        health = sink.health()
        assert health.queued_bytes <= 60_000
        assert health.dropped_bytes > 0
        disk.full = False
        writer.samples(_imu(5000), "v")
    seqs = _seqs(path)
    assert seqs[:500] == list(range(500))
    assert seqs[-500:] == list(range(5000, 5500))
    assert len(seqs) < 5500
    assert read_run(path).notes == ()
    with path.open("rb") as file:  # by the index, at its corrected offsets
        reader = make_reader(file)
        found = [message for _, _, message in reader.iter_messages()]
        summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(found)


def test_declarations_survive_where_data_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = Disk(monkeypatch)
    sink = BackgroundFile(tmp_path / "log", queue_bytes=100, retry_s=0.01)
    disk.full, disk.half_written = True, False
    sink.append(b"a" * 60)
    sink.append(b"needed", needed=True)
    sink.append(b"b" * 60)
    sink.append(b"c" * 60)
    disk.full = False
    holes = sink.settle()
    sink.close()
    text = (tmp_path / "log").read_bytes()
    assert b"needed" in text
    assert holes  # of the three pieces, those that the thread had not in hand
    assert {hole.length for hole in holes} == {60}
    assert len(text) == 186 - 60 * len(holes)


def test_closing_on_a_disk_that_stays_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(background, "SETTLE_S", 0.05)
    disk = Disk(monkeypatch)
    path = tmp_path / "run.mcap"
    sink = BackgroundFile(path, retry_s=0.01)
    writer = LogWriter(path, config_toml="", metadata={}, hold_s=0.1, sink=sink)
    writer.samples(_imu(0), "v")
    writer.flush()
    sink.settle()
    disk.full = True
    writer.samples(_imu(500), "v")
    writer.close({})
    assert sink.health().state == "stopped"
    assert "No space" in sink.refused
    assert _seqs(path) == list(range(500))


def test_a_file_size_limit_is_a_full_disk(tmp_path: Path) -> None:
    """A real refusal by the kernel, half-way through a piece."""
    code = f"""
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))
from pathlib import Path
from companion.runtime import background
background.SETTLE_S = 0.2
sink = background.BackgroundFile(Path({str(tmp_path / "log")!r}), retry_s=0.01)
for _ in range(8):
    sink.append(b"x" * 999)
holes = sink.settle()
print(len(holes), sink.health().state, sink.health().written_bytes)
sink.close()
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True
    )
    assert done.stdout.split() == ["3", "stopped", "4995"]
    assert (tmp_path / "log").stat().st_size == 4995


def test_a_path_that_cannot_be_opened_is_said_at_once(tmp_path: Path) -> None:
    with pytest.raises(LogWriteError, match="cannot be opened"):
        BackgroundFile(tmp_path / "nowhere" / "log")


def test_a_disk_that_is_full_at_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refused = threading.Event()
    real = os.open

    def full(path: Path, flags: int, mode: int = 0o777) -> int:
        if not refused.is_set():
            refused.set()
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(path, flags, mode)

    monkeypatch.setattr(background.os, "open", full)
    sink = BackgroundFile(tmp_path / "log", retry_s=0.01)
    assert refused.is_set()
    assert sink.health().state == "stopped"
    sink.append(b"late, but there")
    sink.settle()
    assert sink.health().state == "writing"
    sink.close()
    assert (tmp_path / "log").read_bytes() == b"late, but there"
