"""RINEX 2 and 3 observation files: pseudorange, Doppler and C/N0 of one signal a satellite.

RINEX 2.11 table A1 and 3.05 tables A2-A3. A broken epoch or line is counted and left out; only a
header that cannot be meant is an error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from companion.gnss.gps_time import gps_from_calendar
from companion.gnss.systems import CARRIER_HZ, LETTERS, C, satellite_number
from companion.types import LogFormatError, RawGnssSamples
from replay.raw_gnss.epochs import Epoch, Observation, in_order, possible, raw_samples

SIGNALS = {"G": ("1C",), "E": ("1C", "1X", "1B"), "C": ("2I", "1I")}
"""Band and attribute of the signals that fit the group delays, best first; 1I is B1 in 3.02."""
_OWN_TIME = {"C": "BDT", "R": "GLO"}
_WIDTH = 16
_HEADER_LINES = 2000


@dataclass(slots=True)
class Header:
    """What of a header is needed: version, and where each system's observations stand."""

    version: float
    columns: dict[str, tuple[int, int, int]] = field(default_factory=dict)
    """System letter → places of pseudorange, Doppler and C/N0 in a satellite's row; −1 none."""
    count: int = 0
    """Version 2: observations a satellite."""
    time: str = "GPS"
    """System of the epochs' time; where a header does not say it, that of its satellites."""


def text_lines(path: Path) -> list[str]:
    """A file's lines; raises :class:`LogFormatError` where it is no text."""
    try:
        return path.read_text(encoding="latin-1").splitlines()
    except OSError as error:
        raise LogFormatError(f"{path}: cannot be read: {error.strerror}") from None


def version_and_type(path: Path, lines: list[str]) -> tuple[float, str]:
    """From the first line of any RINEX file; raises :class:`LogFormatError` otherwise."""
    first = lines[0] if lines else ""
    if first[60:80].strip() == "CRINEX VERS   / TYPE":
        raise LogFormatError(f"{path}: compact RINEX (Hatanaka); crx2rnx unpacks it")
    if first[60:80].strip() != "RINEX VERSION / TYPE":
        raise LogFormatError(f"{path}:1: no RINEX file: 'RINEX VERSION / TYPE' is missing")
    try:
        version = float(first[:9])
    except ValueError:
        raise LogFormatError(
            f"{path}:1: RINEX version '{first[:9].strip()}' is no number"
        ) from None
    if not 2.0 <= version < 4.0:
        raise LogFormatError(f"{path}:1: RINEX version {version:g}; readable are 2 and 3")
    return version, first[20:21]


def _header(path: Path, lines: list[str]) -> tuple[Header, int]:
    """Header and the number of its lines."""
    version, kind = version_and_type(path, lines)
    if kind != "O":
        raise LogFormatError(f"{path}:1: RINEX file of type '{kind}', not observations")
    # RINEX 3.05, table A2: a file of one system is in its time unless it says otherwise.
    head = Header(version, time=_OWN_TIME.get(lines[0][40:41], "GPS"))
    types: dict[str, list[str]] = {}
    letter = ""
    for number, line in enumerate(lines[:_HEADER_LINES]):
        label = line[60:80].strip()
        if label == "SYS / # / OBS TYPES":
            letter = line[0].strip() or letter
            types.setdefault(letter, []).extend(line[7:60].split())
        elif label == "# / TYPES OF OBSERV":
            types.setdefault("", []).extend(line[6:60].split())
        elif label == "TIME OF FIRST OBS":
            head.time = line[48:51].strip() or head.time
        elif label == "SYS / SCALE FACTOR" and line[2:6].strip() not in ("", "1"):
            factor = line[2:6].strip()
            raise LogFormatError(f"{path}:{number + 1}: numbers scaled by {factor}: not readable")
        elif label == "END OF HEADER":
            _place(path, head, types)
            return head, number + 1
    raise LogFormatError(f"{path}: the RINEX header does not end")


def _place(path: Path, head: Header, types: dict[str, list[str]]) -> None:
    """Find the columns of the signals that are used."""
    if head.time not in ("GPS", "GAL"):
        raise LogFormatError(f"{path}: epochs in {head.time} time; GPS time is expected")
    if head.version < 3:
        names = types.get("", [])
        head.count = len(names)
        if "C1" in names:
            at = [names.index(n) if n in names else -1 for n in ("C1", "D1", "S1")]
            head.columns["G"] = head.columns["E"] = (at[0], at[1], at[2])
    else:
        for letter, signals in SIGNALS.items():
            names = types.get(letter, [])
            for signal in signals:
                if "C" + signal in names:
                    at = [names.index(k + signal) if k + signal in names else -1 for k in "CDS"]
                    head.columns[letter] = (at[0], at[1], at[2])
                    break
    if not head.columns:
        raise LogFormatError(f"{path}: no pseudoranges of GPS L1 C/A, Galileo E1 or BeiDou B1I")


def _number(text: str) -> float:
    """A cell's value; NaN where it is empty or no number."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def _observation(head: Header, name: str, cells: str) -> Observation | None:
    """One satellite's row; None where the satellite, or what it holds, is not for us."""
    sat = satellite_number(name)
    letter = LETTERS[sat // 100 - 1] if sat else ""
    if letter not in head.columns:
        return None
    values = [
        _number(cells[_WIDTH * at : _WIDTH * at + 14]) if at >= 0 else math.nan
        for at in head.columns[letter]
    ]
    doppler = values[1] if values[1] != 0.0 else math.nan
    rate = -doppler * C / CARRIER_HZ[sat // 100 - 1]
    return Observation(sat, values[0], rate, values[2] if values[2] > 0 else math.nan)


def _time(fields: list[str]) -> tuple[int, float]:
    """Week and second of year, month, day, hour, minute, second; raises :class:`ValueError`."""
    year, month, day, hour, minute = map(int, fields[:5])
    second = float(fields[5])
    if not (0 <= hour < 24 and 0 <= minute < 60 and 0.0 <= second < 61.0):
        raise ValueError(fields)
    if year < 100:
        year += 1900 if year >= 80 else 2000
    return gps_from_calendar(year, month, day, hour * 3600 + minute * 60 + second)


def _epochs_3(head: Header, lines: list[str], bad: list[int]) -> Iterator[Epoch]:
    at = 0
    while at < len(lines):
        line = lines[at]
        at += 1
        if not line.startswith(">"):
            bad[0] += 1
            continue
        try:
            flag, count = int(line[31:32] or "0"), int(line[32:35])
            if count < 0:
                raise ValueError(count)
            if flag > 1:
                at += count  # events and their header lines
                continue
            epoch = Epoch(*_time(line[1:29].split()))
        except (ValueError, IndexError):
            bad[0] += 1
            continue
        for _ in range(count):
            if at >= len(lines) or lines[at].startswith(">"):
                bad[0] += 1
                break
            _add(head, epoch, lines[at][:3], lines[at][3:], bad)
            at += 1
        yield epoch


def _epochs_2(head: Header, lines: list[str], bad: list[int]) -> Iterator[Epoch]:
    rows = (head.count + 4) // 5
    at = 0
    while at < len(lines):
        line = lines[at]
        at += 1
        try:
            flag, count = int(line[26:29]), int(line[29:32])
            if flag > 1:
                at += count
                continue
            epoch = Epoch(*_time(line[:26].split()))
            names = line[32:68]
            for _ in range((count - 1) // 12):
                names += lines[at][32:68]
                at += 1
        except (ValueError, IndexError):
            bad[0] += 1
            continue
        for k in range(count):
            cells = "".join(row.ljust(80)[:80] for row in lines[at : at + rows])
            at += rows
            _add(head, epoch, names[3 * k : 3 * k + 3], cells, bad)
        yield epoch


def _add(head: Header, epoch: Epoch, name: str, cells: str, bad: list[int]) -> None:
    o = _observation(head, name, cells)
    if o is None or math.isnan(o.pseudorange):
        return
    if not possible(o):
        bad[0] += 1
    elif all(o.sat != other.sat for other in epoch.satellites):
        epoch.satellites.append(o)


def read_observations(path: Path) -> tuple[RawGnssSamples, list[str]]:
    """Epochs of a RINEX 2 or 3 observation file, stamped in GPS time, and notes for people.

    Raises :class:`LogFormatError` where it is none, or holds no pseudoranges that can be used.
    """
    lines = text_lines(path)
    head, start = _header(path, lines)
    bad = [0]
    read = _epochs_3 if head.version >= 3 else _epochs_2
    epochs = [e for e in read(head, lines[start:], bad) if e.satellites]
    if not epochs:
        raise LogFormatError(f"{path}: not one epoch with a pseudorange in it")
    ordered, back = in_order(epochs)
    bad[0] += back
    notes = [f"{path.name}: {bad[0]} lines or epochs that cannot be, left out"] if bad[0] else []
    return raw_samples(path.stem, ordered), notes
