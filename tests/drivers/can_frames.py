"""What the tests of the CAN IMU drivers share: samples, feeding frames, damaged traffic."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from companion.types import F64, ImuSamples
from drivers.can_imu import CanFrame, CanImuDecoder

T0 = 1_700_000_000_000_000_000
STEP_NS = 5_000_000


def samples_of(
    count: int,
    *,
    seed: int = 1,
    interval_s: float = float("nan"),
    step_ns: int = STEP_NS,
    gyro_sd: float = 1.0,
    accel_sd: float = 10.0,
) -> ImuSamples:
    """Random samples, evenly spaced from ``T0``."""
    rng = np.random.default_rng(seed)
    t = T0 + step_ns * np.arange(count, dtype=np.int64)
    return ImuSamples(
        "imu",
        t,
        t,
        np.arange(count, dtype=np.int64),
        gyro_sd * rng.standard_normal((count, 3)),
        accel_sd * rng.standard_normal((count, 3)),
        np.full(count, interval_s),
    )


def feed(
    decoder: CanImuDecoder, frames: Iterable[CanFrame], t_rx_ns: int = T0, seq: int = 0
) -> list[bool]:
    """Frames that arrive together; whether each was the decoder's."""
    return [decoder.feed(seq + i, t_rx_ns, *frame) for i, frame in enumerate(frames)]


def feed_each(
    decoder: CanImuDecoder, groups: Sequence[Sequence[CanFrame]], step_ns: int = STEP_NS
) -> None:
    """Groups of frames, one a step."""
    seq = 0
    for i, group in enumerate(groups):
        feed(decoder, group, T0 + i * step_ns, seq)
        seq += len(group)


def taken(decoder: CanImuDecoder) -> ImuSamples:
    """What the decoder has; there must be something."""
    out = decoder.take()
    assert out is not None
    return out


def in_groups(frames: Sequence[CanFrame], size: int) -> list[list[CanFrame]]:
    """Frames in groups of ``size``."""
    return [list(frames[i : i + size]) for i in range(0, len(frames), size)]


def damaged(
    frames: Sequence[CanFrame], rng: np.random.Generator, ids: Sequence[tuple[int, bool]]
) -> list[CanFrame]:
    """Frames dropped, doubled, swapped, cut, lengthened and with bits flipped, and random ones.

    ``ids``: identifiers (and whether extended) that random frames take.
    """
    out: list[CanFrame] = []
    for frame in frames:
        what = rng.integers(0, 24)
        data = bytearray(frame.data)
        if what == 0:
            continue
        if what == 1:
            out.append(frame)
        elif what == 2 and out:
            out[-1], frame = frame, out[-1]
        elif what == 3:
            frame = frame._replace(data=bytes(data[: rng.integers(0, len(data) + 1)]))
        elif what == 4 and data:
            data[rng.integers(0, len(data))] ^= 1 << int(rng.integers(0, 8))
            frame = frame._replace(data=bytes(data))
        elif what == 5:
            frame = frame._replace(data=bytes(data) + rng.bytes(int(rng.integers(1, 57))))
        elif what == 6:
            can_id, extended = ids[rng.integers(0, len(ids))]
            out.append(CanFrame(can_id, extended, rng.bytes(int(rng.integers(0, 9)))))
        out.append(frame)
    return out


def assert_sane(samples: ImuSamples) -> None:
    """What holds whatever was fed: finite, in order, never valid long after arrival."""
    values: F64 = np.hstack([samples.gyro_b, samples.accel_b])
    assert np.isfinite(values).all()
    assert (np.diff(samples.t_ns) > 0).all()
    assert (np.diff(samples.t_rx_ns) >= 0).all()
    assert (np.diff(samples.seq) > 0).all()
    assert (samples.t_ns <= samples.t_rx_ns + 1_000).all()
