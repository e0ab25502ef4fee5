"""RINEX 2 and 3 navigation files: ephemerides of GPS, Galileo and BeiDou, and the ionosphere.

RINEX 2.11 tables A3-A4, 3.05 tables A5-A14. Galileo's I/NAV is used: its clock belongs to the pair
E1 and E5b, whose group delay the single-frequency user of E1 takes off.
"""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np

from companion.gnss.broadcast import possible
from companion.gnss.gps_time import gps_from_calendar
from companion.gnss.orbit import (
    E_ACCURACY,
    E_AF0,
    E_CIC,
    E_CIS,
    E_CRC,
    E_CRS,
    E_CUC,
    E_CUS,
    E_DELTA_N,
    E_ECC,
    E_GROUP_DELAY,
    E_HEALTH,
    E_I0,
    E_IDOT,
    E_ISSUE,
    E_M0,
    E_OMEGA,
    E_OMEGA0,
    E_OMEGA_DOT,
    E_SAT,
    E_SQRT_A,
    E_TOC,
    E_TOC_WEEK,
    E_TOE,
    E_TOE_OWN,
    E_WEEK,
    EPHEMERIS_SIZE,
)
from companion.gnss.systems import (
    BDS_WEEK_0,
    BDT_BEHIND_GPST_S,
    BEIDOU,
    GALILEO,
    satellite_number,
)
from companion.types import F64, BroadcastSamples, LogFormatError
from replay.raw_gnss.epochs import broadcast_samples
from replay.raw_gnss.rinex_observations import text_lines, version_and_type

_ORBIT = (
    E_ISSUE, E_CRS, E_DELTA_N, E_M0, E_CUC, E_ECC, E_CUS, E_SQRT_A, E_TOE_OWN, E_CIC, E_OMEGA0,
    E_CIS, E_I0, E_CRC, E_OMEGA, E_OMEGA_DOT, E_IDOT,
)  # fmt: skip
"""Columns of the numbers behind the clock, in file order."""
_INAV = 0b101
"""Data sources: I/NAV from E1-B or E5b-I."""
_E1_HEALTH = 0b111
WEEK_S = 604_800.0


def _number(text: str) -> float:
    text = text.strip()
    if not text:
        return 0.0
    return float(text.replace("D", "E").replace("d", "E"))


def ephemeris(system_sat: int, toc: tuple[int, float], numbers: list[float]) -> F64 | None:
    """One record as a row; None where it is not for us (F/NAV), raises ValueError if too short.

    ``toc``: week and second in the system's own time; ``numbers``: clock (3), then orbit.
    """
    if len(numbers) < 27:
        raise ValueError("record too short")
    system = system_sat // 100 - 1
    row = np.zeros(EPHEMERIS_SIZE)
    row[E_SAT] = system_sat
    row[E_AF0 : E_AF0 + 3] = numbers[:3]
    for column, value in zip(_ORBIT, numbers[3:], strict=False):
        row[column] = value
    source, week, accuracy, health, delay_1, delay_2 = (
        numbers[20], numbers[21], numbers[23], numbers[24], numbers[25], numbers[26],
    )  # fmt: skip
    late = 0.0
    row[E_GROUP_DELAY] = delay_1
    if system == GALILEO:
        if not int(source) & _INAV:
            return None
        # BGD of E1 and E5b is the second; without an accuracy (−1) the satellite is not to be used.
        row[E_GROUP_DELAY] = delay_2
        health = float(int(health) & _E1_HEALTH) if accuracy >= 0 else 1.0
        accuracy = max(accuracy, 0.0)
    elif system == BEIDOU:
        late = BDT_BEHIND_GPST_S
        week += BDS_WEEK_0
    row[E_WEEK], row[E_TOE] = _carry(week, row[E_TOE_OWN] + late)
    row[E_TOC_WEEK], row[E_TOC] = _carry(toc[0], toc[1] + late)
    row[E_HEALTH], row[E_ACCURACY] = health, accuracy
    return row


def _carry(week: float, second: float) -> tuple[float, float]:
    turns = math.floor(second / WEEK_S)
    return week + turns, second - turns * WEEK_S


def _record(lines: list[str], version: float) -> tuple[int, F64 | None]:
    """(satellite, row) of one record; satellite 0 for another system."""
    head = lines[0]
    if version >= 3:
        name, stamp, first, rest = head[:3], head[3:23], 23, 4
    else:
        name, stamp, first, rest = "G" + head[:2], head[2:22], 22, 3
    sat = satellite_number(name)
    if sat == 0:
        return 0, None
    parts = stamp.split()
    year, month, day, hour, minute = map(int, parts[:5])
    if year < 100:
        year += 1900 if year >= 80 else 2000
    toc = gps_from_calendar(year, month, day, hour * 3600 + minute * 60 + float(parts[5]))
    numbers = [_number(head[first + 19 * k : first + 19 * k + 19]) for k in range(3)]
    for line in lines[1:]:
        numbers += [_number(line[rest + 19 * k : rest + 19 * k + 19]) for k in range(4)]
    return sat, ephemeris(sat, toc, numbers)


def _ionosphere(line: str, found: dict[str, list[float]]) -> None:
    """α and β from a header line of either version."""
    label = line[60:80].strip()
    if label in ("ION ALPHA", "ION BETA"):
        found[label[4]] = [_number(line[2 + 12 * k : 14 + 12 * k]) for k in range(4)]
    elif label == "IONOSPHERIC CORR" and line[:4] in ("GPSA", "GPSB"):
        found[line[3]] = [_number(line[5 + 12 * k : 17 + 12 * k]) for k in range(4)]


def read_navigation(path: Path) -> tuple[BroadcastSamples, list[str]]:
    """Ephemerides and ionosphere of a RINEX 2 (GPS) or 3 navigation file, and notes for people.

    Raises :class:`LogFormatError` where it is none or holds no ephemeris that can be used.
    """
    lines = text_lines(path)
    version, kind = version_and_type(path, lines)
    if kind != "N":
        raise LogFormatError(f"{path}:1: RINEX file of type '{kind}', not navigation messages")
    end = next((i for i, line in enumerate(lines) if line[60:80].strip() == "END OF HEADER"), -1)
    if end < 0:
        raise LogFormatError(f"{path}: the RINEX header does not end")
    broken = 0
    iono: dict[str, list[float]] = {}
    for line in lines[1:end]:
        try:
            _ionosphere(line, iono)
        except ValueError:
            broken += 1
    messages: list[tuple[int, F64]] = []
    if "A" in iono and "B" in iono:
        messages.append((0, np.array(iono["A"] + iono["B"])))
    starts = [
        i for i in range(end + 1, len(lines)) if lines[i].strip() and not lines[i].startswith("   ")
    ]
    for i, j in pairwise([*starts, len(lines)]):
        try:
            sat, row = _record([line for line in lines[i:j] if line.strip()], version)
        except (ValueError, IndexError):
            broken += 1
            continue
        if sat and row is not None:
            if possible(row):
                messages.append((sat, row))
            else:
                broken += 1
    if not any(sat for sat, _ in messages):
        raise LogFormatError(f"{path}: no ephemeris of GPS, Galileo or BeiDou that can be used")
    notes = [f"{path.name}: {broken} records that cannot be, left out"] if broken else []
    return broadcast_samples(path.stem, messages), notes
