"""``raw_gnss/`` of a sensor folder: one receiver's raw measurements and navigation messages.

RINEX observation and navigation files, u-blox ``.ubx``, RTCM 3 ``.rtcm3``, GnssLogger ``.txt``. All
that the files broadcast is known from the start, as to whoever works on a recording afterwards;
live, and in the log of a live run, messages come when they come.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from companion.gnss.gps_time import GPS_EPOCH_POSIX_S, WEEK_S, leap_seconds, week_and_tow
from companion.types import (
    NS,
    BroadcastSamples,
    LogFormatError,
    RawGnssSamples,
    Samples,
)
from drivers.receiver_session import RTCM_SINCE_S
from replay.raw_gnss.android import read_gnss_logger
from replay.raw_gnss.rinex_navigation import read_navigation
from replay.raw_gnss.rinex_observations import read_observations, text_lines, version_and_type
from replay.raw_gnss.rtcm import SUFFIXES, read_rtcm
from replay.raw_gnss.ubx import read_ubx
from replay.streams import GnssClock

S = TypeVar("S", bound=Samples)
_OTHERS = {"G": "GLONASS navigation", "H": "SBAS navigation", "M": "meteorology"}
"""RINEX files that stand beside those of use here, by type."""
_NEAR_TURN = 0.01
_TOGETHER_S = 5.0
"""Two files of one logger begin and end within this."""


@dataclass(frozen=True, slots=True)
class RawFolder:
    """What a folder of raw GNSS holds, on the recording's clock; unnumbered."""

    raw: RawGnssSamples
    broadcast: BroadcastSamples
    notes: tuple[str, ...]


def read_raw_folder(folder: Path, clock: GnssClock, near_ns: int | None = None) -> RawFolder:
    """Read every file of ``folder``; see :func:`read_raw_files`."""
    paths = sorted(p for p in folder.iterdir() if p.is_file() and p.suffix != ".md")
    return read_raw_files(paths, str(folder), clock, near_ns)


def read_raw_files(
    paths: Sequence[Path], where: str, clock: GnssClock, near_ns: int | None = None
) -> RawFolder:
    """Read what one receiver recorded; its stamps are of a POSIX clock that runs on ``clock`` time.

    ``where``: what errors call them all. ``near_ns``: where on that clock the recording begins;
    RTCM 3 does not tell the week. Raises :class:`LogFormatError` where a file is none of the
    formats or broken, where there are several receivers, and where measurements or navigation
    messages are missing.
    """
    raws: list[RawGnssSamples] = []
    broadcasts: list[BroadcastSamples] = []
    notes: list[str] = []
    for path in paths:
        if path.suffix.lower() == ".ubx":
            raw, broadcast, _, said = read_ubx(path)
            raws.append(raw)
            broadcasts.append(broadcast)
        elif path.suffix.lower() in SUFFIXES:
            raw, broadcast, said = read_rtcm(path, _gps_time(near_ns))
            raws.append(raw)
            broadcasts.append(broadcast)
        elif path.suffix.lower() == ".txt":
            raw, said = read_gnss_logger(path)
            raws.append(raw)
        elif (kind := version_and_type(path, text_lines(path)[:1])[1]) == "O":
            raw, said = read_observations(path)
            raws.append(raw)
        elif kind in _OTHERS:
            said = [f"{path.name}: {_OTHERS[kind]} is not used, left out"]
        else:
            broadcast, said = read_navigation(path)
            broadcasts.append(broadcast)
        notes += said
    if len(raws) != 1:
        names = ", ".join(r.source for r in raws) or "none"
        raise LogFormatError(f"{where}: measurements of one receiver are expected; there: {names}")
    if not any((b.sat > 0).any() for b in broadcasts):
        raise LogFormatError(f"{where}: no ephemerides; a navigation file is missing")
    raw = on_clock(raws[0], clock)
    return RawFolder(raw, _from_the_start(broadcasts, int(raw.t_rx_ns[0])), tuple(notes))


def _gps_time(near_ns: int | None) -> tuple[int, float] | None:
    """Week and second of a stamp; None for one that tells nothing, as of a clock from zero."""
    # Leap seconds do not matter to within half a week.
    gps_ns = 0 if near_ns is None else near_ns - GPS_EPOCH_POSIX_S * NS
    return week_and_tow(gps_ns) if gps_ns > RTCM_SINCE_S * NS else None


def on_clock(samples: S, clock: GnssClock) -> S:
    """GPS time stamps as those of a POSIX clock in UTC, or in GPS time without leap seconds."""
    seconds = samples.t_ns[0] / NS if len(samples) else 0.0
    late = GPS_EPOCH_POSIX_S - (leap_seconds(seconds) if clock == "utc" else 0)
    moved: S = replace(samples, t_ns=samples.t_ns + late * NS, t_rx_ns=samples.t_rx_ns + late * NS)
    return moved


def _gap(seconds: float) -> str:
    """In words; what a lost count of weeks makes, as such."""
    weeks = seconds / WEEK_S
    turns = round(weeks / 1024.0)
    if turns and abs(weeks / 1024.0 - turns) < _NEAR_TURN:
        return f"{weeks:.0f} weeks ({turns} times 1024, after which some clocks begin anew)"
    return f"{weeks:.0f} weeks" if weeks > 1.0 else f"{seconds:.0f} s"


def doubted_clock(raw: RawGnssSamples, beside: Samples, clock: GnssClock) -> str | None:
    """A doubt where two recordings of a folder have no time in common, or would fit better.

    That is where both would begin and end together on the other ``clock``: leap seconds off, a
    vehicle is where it was a quarter of a minute ago, and every gate says no without saying why.
    """
    if not (len(raw) and len(beside)):
        return None
    leap = leap_seconds(raw.week[0] * WEEK_S + raw.tow[0])
    ends = np.array([raw.t_ns[0] - beside.t_ns[0], raw.t_ns[-1] - beside.t_ns[-1]]) / NS
    other: GnssClock = "gps" if clock == "utc" else "utc"
    moved = ends + (leap if clock == "utc" else -leap)
    if np.abs(moved).max() < _TOGETHER_S and np.abs(ends).max() >= leap - _TOGETHER_S:
        where = "ahead of" if ends.mean() < 0 else "behind"
        return (
            f"raw_gnss/ runs {abs(ends.mean()):.0f} s {where} {beside.source}.csv, "
            "as leap seconds do: are its stamps of the other clock? "
            f'raw_gnss.clock = "{other}" would say so'
        )
    apart = max(beside.t_ns[0] - raw.t_ns[-1], raw.t_ns[0] - beside.t_ns[-1]) / NS
    if apart > 0:
        return f"raw_gnss/ and {beside.source}.csv have no time in common: {_gap(apart)} apart"
    return None


def _from_the_start(parts: list[BroadcastSamples], t_ns: int) -> BroadcastSamples:
    """All messages at once, each but once."""
    sat = np.concatenate([p.sat for p in parts])
    values = np.concatenate([p.values for p in parts])
    _, first = np.unique(np.column_stack([sat, values]), axis=0, return_index=True)
    keep = np.sort(first)
    t = np.full(len(keep), t_ns, np.int64)
    number = np.arange(len(keep), dtype=np.int64)
    return BroadcastSamples(parts[0].source, t, t, number, sat[keep], values[keep])
