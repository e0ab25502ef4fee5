"""Mutated logs: whatever a reader is given, it reads, or refuses in one line, in bounded time.

Base files are small and made here, so that each mutation hits structure and not payload; slices
of real logs join them where those are present. The long form (10⁴ files) has the ``slow`` marker.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from companion.types import CompanionError, Recording
from replay.reader import read_log

from . import logs

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
SLOWEST_S = 2.0
"""A mutated file of some kilobytes takes milliseconds; a hang or a quadratic walk takes more."""
LARGEST = 64
"""Samples per byte of file that a reader may at most give: a bound on what it allocates."""


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """One of: bit flips, a cut, a splice, a run of zeros, a run of 0xFF, inserted noise."""
    raw = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(0, max(len(raw), 1)))
        length = int(rng.integers(1, 200))
        match int(rng.integers(0, 6)):
            case 0:
                for i in rng.integers(0, max(len(raw), 1), int(rng.integers(1, 30))):
                    if raw:
                        raw[i] ^= 1 << int(rng.integers(0, 8))
            case 1:
                del raw[at:]
            case 2:
                other = int(rng.integers(0, max(len(raw), 1)))
                raw[at : at + length] = raw[other : other + int(rng.integers(1, 400))]
            case 3:
                raw[at : at + length] = bytes(length)
            case 4:
                raw[at : at + length] = b"\xff" * length
            case _:
                raw[at:at] = rng.bytes(length)
    return bytes(raw)


def check(recording: Recording, size: int) -> None:
    """What every reader promises of whatever it gives."""
    for vehicle in recording.vehicles:
        for group in (vehicle.imu, vehicle.baro, vehicle.mag):
            for stream in group:
                assert len(stream) <= LARGEST * size
                assert (np.diff(stream.t_ns) > 0).all()
                assert (np.diff(stream.t_rx_ns) >= 0).all()
                assert (np.diff(stream.seq) > 0).all()
        for fix in vehicle.gnss:
            assert np.isfinite(fix.lat).all()
            assert (np.diff(fix.t_rx_ns) >= 0).all()


def one_line(error: CompanionError) -> None:
    text = str(error)
    assert text
    assert "\n" not in text
    assert len(text) < 1000


def size_of(path: Path) -> int:
    """Bytes of a file, or of all files of a folder."""
    files = path.iterdir() if path.is_dir() else [path]
    return max(sum(file.stat().st_size for file in files), 1)


def run(bases: list[bytes], place: Callable[[bytes], Path], count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    read_log([place(bases[0])])  # imports and kernels are not what is timed below
    read = 0
    for i in range(count):
        data = mutate(bases[i % len(bases)], rng)
        path = place(data)
        start = time.perf_counter()
        try:
            check(read_log([path]), size_of(path))
            read += 1
        except CompanionError as error:
            one_line(error)
        assert time.perf_counter() - start < SLOWEST_S
    # A reader that refuses everything would pass the rest of this test.
    assert read > count // 20


def bases(kind: str) -> list[bytes]:
    made: dict[str, Callable[[], bytes]] = {
        "tlog": lambda: logs.tlog(3.0),
        "bin": lambda: logs.dataflash(3.0),
        "ulg": lambda: logs.ulog(1.0),
    }
    real = {
        "tlog": ("tlog-vtol/vtol.tlog", 200_000, 6000),
        "bin": ("bin-odd/test.BIN", 0, 40_000),
        "ulg": ("ulg/sample_appended_multiple.ulg", 0, 40_000),
    }
    name, start, length = real[kind]
    out = [made[kind]()]
    if (DATA / name).is_file():
        with (DATA / name).open("rb") as file:
            file.seek(start)
            out.append(file.read(length))
    return out


QUICK = {"tlog": 300, "bin": 300, "ulg": 60, "folder": 150}
LONG = {"tlog": 4500, "bin": 3500, "ulg": 600, "folder": 1500}


def fuzz_file(kind: str, count: int, tmp_path: Path, seed: int) -> None:
    path = tmp_path / f"mutated.{kind}"

    def place(data: bytes) -> Path:
        path.write_bytes(data)
        return path

    run(bases(kind), place, count, seed)


def fuzz_folder(count: int, tmp_path: Path, seed: int) -> None:
    files = logs.folder(2.0)
    names = sorted(files)
    for name in names:
        (tmp_path / name).write_bytes(files[name])
    turn = 0

    def place(data: bytes) -> Path:
        nonlocal turn
        (tmp_path / names[(turn - 1) % len(names)]).write_bytes(
            files[names[(turn - 1) % len(names)]]
        )
        (tmp_path / names[turn % len(names)]).write_bytes(data)
        turn += 1
        return tmp_path

    run([files[name] for name in names], place, count, seed)


@pytest.mark.parametrize("kind", ["tlog", "bin", "ulg"])
def test_mutated_files_read_or_refuse(kind: str, tmp_path: Path) -> None:
    fuzz_file(kind, QUICK[kind], tmp_path, seed=1)


def test_mutated_folders_read_or_refuse(tmp_path: Path) -> None:
    fuzz_folder(QUICK["folder"], tmp_path, seed=2)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tlog", "bin", "ulg"])
def test_many_mutated_files_read_or_refuse(kind: str, tmp_path: Path) -> None:
    fuzz_file(kind, LONG[kind], tmp_path, seed=3)


@pytest.mark.slow
def test_many_mutated_folders_read_or_refuse(tmp_path: Path) -> None:
    fuzz_folder(LONG["folder"], tmp_path, seed=4)
