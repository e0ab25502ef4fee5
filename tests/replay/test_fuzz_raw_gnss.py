"""Mutated raw GNSS files: read or refused in one line, in bounded time, and never a wrong place.

A recorded receiver at rest (RINEX) and a walk (UBX, the same said in RTCM 3). Text has no check
bytes: a digit turned over in a pseudorange is one of the faults that the other satellites tell.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from companion.config import RawGnss
from companion.gnss.single_point import P_DOF, P_POS
from companion.intake.raw_gnss.receiver import Receiver
from companion.types import F64, BroadcastSamples, CompanionError, RawGnssSamples
from replay.raw_gnss.android import read_gnss_logger
from replay.raw_gnss.rinex_navigation import read_navigation
from replay.raw_gnss.rinex_observations import read_observations
from replay.raw_gnss.rtcm import read_rtcm
from replay.raw_gnss.ubx import read_ubx
from replay.simulator.live import rtcm

from .test_fuzz_readers import SLOWEST_S, mutate, one_line

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
TCKF = "instinct-static-vn310/test/data/DataProcessor/tckf/reach-m2-01_raw_202306291111"
NEAR_M = 150.0
"""The walk's extent and ten times what its ranges scatter: a wrong place is further off."""
EPOCHS = 3
QUICK, LONG = 30, 1_000

Found = tuple[RawGnssSamples | None, BroadcastSamples | None]


@cache
def _bytes(name: str, size: int) -> bytes:
    return (DATA / name).read_bytes()[:size]


def _observations(path: Path) -> Found:
    return read_observations(path)[0], None


def _navigation(path: Path) -> Found:
    return None, read_navigation(path)[0]


def _ubx(path: Path) -> Found:
    return read_ubx(path)[:2]


def _rtcm(path: Path) -> Found:
    return read_rtcm(path, (2381, 400_000.0))[:2]


def _android(path: Path) -> Found:
    return read_gnss_logger(path)[0], None


@cache
def _said_in_rtcm() -> bytes:
    raw, broadcast, _, _ = read_ubx(DATA / "rtk-walk" / "gnss_1730.ubx")
    newest = dict(zip(broadcast.sat.tolist(), broadcast.values, strict=True))
    out = [rtcm.ephemeris(row) for sat, row in newest.items() if sat]
    for i in range(EPOCHS):
        seen = np.flatnonzero((raw.sat[i] > 0) & (raw.signal[i] == 0))
        columns = (x[i, seen] for x in (raw.sat, raw.pseudorange, raw.rate))
        out += rtcm.epoch(float(raw.tow[i]), *columns, cn0=raw.cn0[i, seen])
    return b"".join(out)


READERS: dict[str, tuple[Callable[[], bytes], Callable[[Path], Found]]] = {
    "observations": (lambda: _bytes(TCKF + ".23O", 60_000), _observations),
    "navigation": (lambda: _bytes(TCKF + ".nav", 100_000), _navigation),
    "ubx": (lambda: _bytes("rtk-walk/gnss_1730.ubx", 60_000), _ubx),
    "rtcm": (_said_in_rtcm, _rtcm),
    "android": (lambda: _bytes("android-gnss/gnss_log_raw_data_2.txt", 30_000), _android),
}


@cache
def _whole(kind: str) -> tuple[RawGnssSamples, BroadcastSamples]:
    """What the other half of a place is made of."""
    if kind in ("observations", "navigation"):
        raw, _ = read_observations(DATA / (TCKF + ".23O"))
        return raw.take(slice(0, EPOCHS)), read_navigation(DATA / (TCKF + ".nav"))[0]
    raw, broadcast, _, _ = read_ubx(DATA / "rtk-walk" / "gnss_1730.ubx")
    return raw.take(slice(0, EPOCHS)), broadcast


def _places(raw: RawGnssSamples, *broadcasts: BroadcastSamples) -> list[F64]:
    """Places of epochs with more ranges than unknowns: of no others can a digit be told wrong."""
    receiver = Receiver(RawGnss())
    for broadcast in broadcasts:
        receiver.listen(broadcast)
    prepared = [receiver.take(raw, i) for i in range(min(len(raw), EPOCHS))]
    points = [p.point for p in prepared if p.point is not None]
    return [point[P_POS : P_POS + 3] for point in points if point[P_DOF] >= 1]


def _fuzz(kind: str, count: int, folder: Path, seed: int) -> None:
    made, read = READERS[kind]
    base, rng, path = made(), np.random.default_rng(seed), folder / f"mutated.{kind}"
    good = _whole(kind)
    middle = np.mean(_places(*good), axis=0) if kind != "android" else None
    done = places = 0
    for _ in range(count):
        path.write_bytes(mutate(base, rng))
        start = time.perf_counter()
        try:
            raw, broadcast = read(path)
        except CompanionError as error:
            one_line(error)
            continue
        finally:
            assert time.perf_counter() - start < SLOWEST_S
        done += 1
        if middle is None:
            continue
        # A few seconds of UBX hold no whole ephemeris; a file of them is used by itself.
        own = [] if kind == "navigation" else [good[1]]
        own += [] if broadcast is None else [broadcast]
        for place in _places(good[0] if raw is None else raw, *own):
            assert np.linalg.norm(place - middle) < NEAR_M
            places += 1
    # Readers that refuse everything, and places that are never found, would pass the rest.
    assert done > count // 3
    assert places > count // 3 or middle is None


@pytest.mark.parametrize("kind", list(READERS))
def test_mutated_files_read_or_refuse_and_give_no_wrong_place(
    kind: str, tmp_path: Path, data_dir: Path
) -> None:
    assert data_dir.is_dir()
    _fuzz(kind, QUICK, tmp_path, seed=11)


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(READERS))
def test_many_mutated_files_read_or_refuse_and_give_no_wrong_place(
    kind: str, tmp_path: Path, data_dir: Path
) -> None:
    assert data_dir.is_dir()
    _fuzz(kind, LONG, tmp_path, seed=12)
