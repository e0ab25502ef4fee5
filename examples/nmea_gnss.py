"""A receiver that speaks NMEA, in the place of a flight's own GNSS: nmea_gnss.py LOG NMEA

NMEA: a sentence a line, behind its time of arrival in Unix nanoseconds.
"""

import sys
from dataclasses import replace
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np

from companion.types import GnssSamples
from replay.assessment import assess
from replay.configuration import choose_config
from replay.reader import read_log
from replay.session import run_session
from replay.streams import numbered

FIX_TYPE = {"1": 3, "2": 4, "4": 6, "5": 5}  # GGA's quality, as GnssSamples.fix_type has it


def decode(lines: list[str]) -> tuple[GnssSamples, int]:
    """Fixes of all GGA sentences, and how many of those were broken: left out, never raised."""
    rows, malformed = [], 0
    for line in lines:
        arrival, _, sentence = line.strip().partition(" $")
        text, _, checksum = sentence.partition("*")
        try:
            if text[2:5] != "GGA" or text.split(",")[6] == "0":
                continue  # another sentence, or no fix
            if reduce(xor, text.encode()) != int(checksum, 16):
                raise ValueError("checksum")
            _, _, lat, ns, lon, ew, quality, used, _, msl, _, geoid, *_ = text.split(",")
            north = (int(lat[:2]) + float(lat[2:]) / 60.0) * (-1.0 if ns == "S" else 1.0)
            east = (int(lon[:3]) + float(lon[3:]) / 60.0) * (-1.0 if ew == "W" else 1.0)
            height = float(msl) + float(geoid)  # above the ellipsoid
            rows.append((int(arrival), north, east, height, int(used), FIX_TYPE[quality]))
        except (ValueError, LookupError):
            malformed += 1
    columns = list(zip(*rows, strict=True)) or [()] * 6
    t_ns, lat_deg, lon_deg, height_m, used_n, fix = map(np.array, columns)
    none = np.full((len(rows), 3), np.nan)  # neither velocity nor standard deviations in GGA
    # Stamped at arrival: the configuration's gnss.latency_ms takes the delay off.
    made = GnssSamples("NMEA", t_ns, t_ns, np.arange(len(rows)), np.radians(lat_deg),
                       np.radians(lon_deg), height_m, none, none, none, used_n, fix)  # fmt: skip
    return made, malformed


if __name__ == "__main__":
    recording = read_log([Path(sys.argv[1])])
    gnss, malformed = decode(Path(sys.argv[2]).read_text(encoding="ascii").splitlines())
    flown = recording.vehicles[0]
    imu, baro, fixes = numbered([flown.imu, flown.baro, [gnss]])
    mine = replace(flown, imu=tuple(imu), baro=tuple(baro), gnss=tuple(fixes), mag=())
    result = run_session(mine, choose_config(recording))
    print(f"{len(gnss)} fixes by NMEA, {malformed} broken sentences")
    print(assess(mine, result.chosen.config, result.solution, result.reports).json_text())
