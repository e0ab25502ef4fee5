"""u-blox files (.ubx): what :mod:`drivers.ublox` decodes, as columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from companion.types import (
    BroadcastSamples,
    GnssSamples,
    LogFormatError,
    RawGnssSamples,
)
from drivers.ublox.decoder import UbxDecoder
from replay.raw_gnss.epochs import Epoch, broadcast_samples, in_order, one_epoch, raw_samples


def read_ubx(path: Path) -> tuple[RawGnssSamples, BroadcastSamples, GnssSamples | None, list[str]]:
    """Raw epochs, navigation messages, the receiver's own fixes, and notes; GPS time.

    Raises :class:`LogFormatError` where the file cannot be read or has no RXM-RAWX in it.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise LogFormatError(f"{path}: cannot be read: {error.strerror}") from None
    decoder = UbxDecoder(path.stem)
    raws: list[Epoch] = []
    messages, times = [], []
    fixes: list[GnssSamples] = []
    for sample in decoder.feed(data):
        if isinstance(sample, GnssSamples):
            fixes.append(sample)
        elif isinstance(sample, BroadcastSamples):
            messages.append((int(sample.sat[0]), sample.values[0]))
            times.append(int(sample.t_ns[0]))
        else:
            raws.append(one_epoch(sample))
    epochs, back = in_order(raws)
    if not epochs:
        raise LogFormatError(f"{path}: no raw measurements (RXM-RAWX) in {len(data)} bytes")
    notes = []
    bad = decoder.framer.bad + decoder.counters.malformed + back
    if bad:
        notes.append(f"{path.name}: {bad} frames that are broken or go back in time, left out")
    return (
        raw_samples(path.stem, epochs),
        broadcast_samples(path.stem, messages, times),
        _all(fixes),
        notes,
    )


def _all(fixes: list[GnssSamples]) -> GnssSamples | None:
    """One block of many of one."""
    if not fixes:
        return None
    names = ("lat", "lon", "height", "vel_n", "sd_pos", "sd_vel", "num_sats", "fix_type",
             "interference")  # fmt: skip
    t = np.concatenate([f.t_ns for f in fixes])
    return GnssSamples(
        fixes[0].source, t, np.maximum.accumulate(t), np.arange(len(t), dtype=np.int64),
        *(np.concatenate([getattr(f, name) for f in fixes]) for name in names),
    )  # fmt: skip
