"""RTCM 3 files: a recorded walk said in RTCM 3 gives the same places, whole and spoiled."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from companion.config import RawGnss
from companion.gnss.single_point import P_POS
from companion.intake.raw_gnss.receiver import Receiver
from companion.types import F64, BroadcastSamples, LogFormatError, RawGnssSamples
from replay.raw_gnss.folder import read_raw_folder
from replay.raw_gnss.rtcm import read_rtcm
from replay.raw_gnss.ubx import read_ubx
from replay.simulator.live import rtcm

EVERY = 10


@pytest.fixture(scope="module")
def walk(data_dir: Path) -> tuple[RawGnssSamples, BroadcastSamples]:
    """Epochs with only the signals that both formats are written with here: no B3I."""
    raw, broadcast, _, _ = read_ubx(data_dir / "rtk-walk" / "gnss_1730.ubx")
    return raw.take(slice(None, None, EVERY)), broadcast


def _stream(walk: tuple[RawGnssSamples, BroadcastSamples]) -> list[bytes]:
    """Ephemerides behind the first epoch, as a receiver has them soon, not at once."""
    raw, broadcast = walk
    out = []
    for i in range(len(raw)):
        seen = np.flatnonzero((raw.sat[i] > 0) & (raw.signal[i] == 0))
        out += rtcm.epoch(
            float(raw.tow[i]), raw.sat[i, seen], raw.pseudorange[i, seen], raw.rate[i, seen],
            cn0=raw.cn0[i, seen],
        )  # fmt: skip
        if i == 0:
            rows = zip(broadcast.sat.tolist(), broadcast.values, strict=True)
            out += [rtcm.ephemeris(row) for sat, row in rows if sat]
    return out


def _places(raw: RawGnssSamples, broadcast: BroadcastSamples) -> dict[int, F64]:
    receiver = Receiver(RawGnss())
    receiver.listen(broadcast)
    prepared = [receiver.take(raw, i) for i in range(len(raw))]
    return {
        round(float(tow) * 1e3): p.point[P_POS : P_POS + 3]
        for tow, p in zip(raw.tow, prepared, strict=True)
        if p.point is not None
    }


def test_a_recorded_walk_said_in_rtcm_has_the_same_places(
    walk: tuple[RawGnssSamples, BroadcastSamples], tmp_path: Path
) -> None:
    path = tmp_path / "walk.rtcm3"
    path.write_bytes(b"".join(_stream(walk)))
    raw, broadcast, notes = read_rtcm(path)
    assert notes == []
    # All the weeks are the ephemerides', also of the epochs in front of them.
    assert set(raw.week.tolist()) == set(walk[0].week.tolist())
    ours = _places(raw, broadcast)
    # What is not in these messages: the other signal, the receiver's own deviations, ionosphere.
    unknown = np.full_like(walk[0].sd_range, np.nan)
    sat = np.where(walk[0].signal == 0, walk[0].sat, 0)
    expected = replace(walk[0], sat=sat, sd_range=unknown, sd_rate=unknown)
    theirs = _places(expected, walk[1].take(walk[1].sat > 0))
    assert set(ours) == set(theirs)
    assert len(ours) > 50
    # Ranges to 0.3 mm, ephemerides as sent.
    assert max(np.linalg.norm(ours[t] - theirs[t]) for t in ours) < 2e-3


def test_a_spoiled_stream_is_noted_and_gives_no_wrong_place(
    walk: tuple[RawGnssSamples, BroadcastSamples], tmp_path: Path
) -> None:
    path, rng = tmp_path / "spoiled.rtcm3", np.random.default_rng(2)
    whole = _stream(walk)
    path.write_bytes(b"".join(whole))
    truth = _places(*read_rtcm(path)[:2])
    middle = np.median(list(truth.values()), axis=0)
    places = 0
    for _ in range(6):
        frames = [bytearray(f) for f in whole]
        for k in rng.integers(0, len(frames), len(frames) // 5).tolist():
            frames[k][int(rng.integers(len(frames[k])))] ^= 1 << int(rng.integers(8))
        data = b"".join(frames)
        path.write_bytes(data[: int(rng.integers(len(data) // 2, len(data)))])
        raw, broadcast, notes = read_rtcm(path)
        assert "messages that are broken" in notes[0]
        found = _places(raw, broadcast)
        places += len(found)
        # The walk stays within 50 m of its middle.
        assert all(np.linalg.norm(place - middle) < 100.0 for place in found.values())
    assert places > 100


@pytest.mark.parametrize(
    ("keep", "says"),
    [
        (lambda _: b"", "no observations of GPS"),
        (lambda _: b"$GNGGA,1*00\r\n" * 50, "no observations of GPS"),
        (lambda frames: frames[0][:-1], "no observations of GPS"),
        (lambda frames: b"".join(frames[:2]), "nothing tells the week"),
    ],
)
def test_files_that_cannot_be_are_one_clear_line(
    keep: object, says: str, walk: tuple[RawGnssSamples, BroadcastSamples], tmp_path: Path
) -> None:
    path = tmp_path / "test.rtcm3"
    assert callable(keep)
    path.write_bytes(keep(_stream(walk)))
    with pytest.raises(LogFormatError, match=says):
        read_rtcm(path)


def test_a_folder_takes_the_week_from_the_recording_and_the_ionosphere_from_rinex(
    walk: tuple[RawGnssSamples, BroadcastSamples], tmp_path: Path, data_dir: Path
) -> None:
    (tmp_path / "walk.rtcm3").write_bytes(b"".join(_stream(walk)[:2]))
    rinex = (data_dir / "android-gnss" / "hour0530.23n").read_text()
    (tmp_path / "hour.23n").write_text(rinex)
    t_ns = int(walk[0].t_ns[0]) + 315_964_800 * 10**9
    found = read_raw_folder(tmp_path, "gps", t_ns)
    assert found.raw.week.tolist() == walk[0].week[:1].tolist()
    assert found.raw.t_ns[0] == pytest.approx(t_ns, abs=2e6)
    assert (found.broadcast.sat == 0).sum() == 1
