"""Satellite systems: numbers and names of satellites, signals, physical constants of the ICDs."""

from __future__ import annotations

C = 299_792_458.0
"""Speed of light [m/s]."""
GPS, GALILEO, BEIDOU = 0, 1, 2
SYSTEMS = 3
SYSTEM_NAMES = ("GPS", "Galileo", "BeiDou")
LETTERS = "GEC"
"""RINEX letter of each system."""
MOST_PRN = (32, 36, 63)

L1_HZ = 1_575.42e6
CARRIER_HZ = (L1_HZ, L1_HZ, 1_561.098e6)
"""Carrier of the signal used of each system: L1 C/A, E1, B1I."""
B3_HZ = 1_268.52e6
PRIMARY, B3I = 0, 1
"""Signals of an observation: that of :data:`CARRIER_HZ`, or BeiDou's B3I, which its broadcast
clocks refer to, so that it has no group delay."""
BDT_BEHIND_GPST_S = 14.0
"""BeiDou time is GPS time of 2006-01-01: 14 s behind for ever."""
BDS_WEEK_0 = 1356
"""GPS week in which BeiDou's week 0 began."""


def satellite(system: int, prn: int) -> int:
    """Number of a satellite; 0 where the system's range of numbers does not hold ``prn``."""
    return 100 * (system + 1) + prn if 1 <= prn <= MOST_PRN[system] else 0


def satellite_name(sat: int) -> str:
    """``G07``, ``E12``, ``C29``."""
    return f"{LETTERS[sat // 100 - 1]}{sat % 100:02d}"


def satellite_number(name: str) -> int:
    """The reverse of :func:`satellite_name`; 0 for what is none of ours. `` `` or ``G`` is GPS."""
    letter, digits = name[:1], name[1:].strip()
    system = LETTERS.find("G" if letter in ("", " ") else letter)
    if system < 0 or not (digits.isascii() and digits.isdigit()):
        return 0
    return satellite(system, int(digits))
