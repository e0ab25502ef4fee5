"""RTCM 3 files (.rtcm3, .rtcm, .rtc): what :mod:`drivers.rtcm` decodes, as columns."""

from __future__ import annotations

from pathlib import Path

from companion.gnss.orbit import E_TOE, E_WEEK
from companion.types import BroadcastSamples, LogFormatError, RawGnssSamples
from drivers.rtcm.decoder import UNKNOWN, RtcmDecoder
from replay.raw_gnss.epochs import Epoch, broadcast_samples, in_order, one_epoch, raw_samples

SUFFIXES = (".rtcm3", ".rtcm", ".rtc")


def read_rtcm(
    path: Path, near: tuple[int, float] | None = None
) -> tuple[RawGnssSamples, BroadcastSamples, list[str]]:
    """Raw epochs, navigation messages, and notes; GPS time.

    ``near``: GPS week and second of it, at about the beginning of the file; None where nobody
    knows: an ephemeris in the file says it then. Raises :class:`LogFormatError` where the file
    cannot be read or has no observations that can be used.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise LogFormatError(f"{path}: cannot be read: {error.strerror}") from None
    decoder = RtcmDecoder(path.stem, near or UNKNOWN)
    found = decoder.feed(data)
    if decoder.dated:
        # What came before the ephemeris that told the week is of that week, too.
        first = next(s for s in found if isinstance(s, BroadcastSamples))
        decoder = RtcmDecoder(
            path.stem, (int(first.values[0, E_WEEK]), float(first.values[0, E_TOE]))
        )
        found = decoder.feed(data)
    messages = [s for s in found if isinstance(s, BroadcastSamples)]
    epochs, back = in_order([one_epoch(s) for s in found if isinstance(s, RawGnssSamples)])
    if not epochs:
        raise LogFormatError(
            f"{path}: no observations of GPS, Galileo or BeiDou (MSM4 to MSM7) in {len(data)} "
            f"bytes with {decoder.framer.frames} RTCM 3 messages"
        )
    if near is None and not messages:
        raise LogFormatError(f"{path}: nothing tells the week of its epochs: no ephemeris in it")
    return (
        raw_samples(path.stem, epochs),
        broadcast_samples(
            path.stem,
            [(int(s.sat[0]), s.values[0]) for s in messages],
            [int(s.t_ns[0]) for s in messages],
        ),
        _notes(path.name, decoder, epochs, back),
    )


def _notes(name: str, decoder: RtcmDecoder, epochs: list[Epoch], back: int) -> list[str]:
    notes = []
    bad = decoder.framer.bad + decoder.counters.malformed + back
    if bad:
        notes.append(f"{name}: {bad} messages that are broken or go back in time, left out")
    if decoder.assembly.foreign:
        notes.append(f"{name}: {decoder.assembly.foreign} messages of another station, left out")
    if not any(o.rate == o.rate for e in epochs for o in e.satellites):
        notes.append(f"{name}: no Doppler (MSM5 or MSM7 have it), so no velocity from it")
    return notes
