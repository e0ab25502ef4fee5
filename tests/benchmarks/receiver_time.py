"""A receiver whose stamps are off: how far its place goes, and whether anything says so.

    python -m tests.benchmarks.receiver_time

Three recordings, each epoch alone, with the second of week moved.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from companion.config import Config
from replay.raw_gnss.positions import read_receiver, solve
from tests.benchmarks.single_point import DATA, TCKF

RECORDINGS = {
    "rtk-walk": [DATA / "rtk-walk" / "gnss_1730.ubx"],
    "instinct-static": [
        TCKF / "reach-m2-01_raw_202306291111.23O", TCKF / "reach-m2-01_raw_202306291111.nav",
    ],
    "android": [DATA / "android-gnss"],
}  # fmt: skip
SHIFTS_S = (0.0, 0.02, -0.03, 0.05, 0.1, 0.2, 0.5)
EARTH_M = 6.371e6
KINDS = ("receiver-time", "ranges-contradict")


def main() -> None:
    """Print one line a recording and shift."""
    print(f"{'recording':16}{'off by s':>9}{'solved':>13}{'place off m':>13}  says")
    for name, paths in RECORDINGS.items():
        found = read_receiver(paths, "utc")
        true = solve(found, Config()).fixes
        assert true is not None
        for shift in SHIFTS_S:
            moved = replace(found, raw=replace(found.raw, tow=found.raw.tow + shift))
            made = solve(moved, Config())
            off, count = np.nan, 0
            if made.fixes is not None:
                both, a, b = np.intersect1d(made.fixes.t_ns, true.t_ns, return_indices=True)
                north = made.fixes.lat[a] - true.lat[b]
                east = (made.fixes.lon[a] - true.lon[b]) * np.cos(true.lat[b])
                off, count = float(np.median(EARTH_M * np.hypot(north, east))), len(both)
            said = [e.text.split(": its place")[0] for e in made.events if e.kind in KINDS]
            first = said[0].split(": the receiver")[0] if said else "nothing"
            print(f"{name:16}{shift:9.2f}{count:6d} of {len(true):3d}{off:13.1f}  {first}")


if __name__ == "__main__":
    main()
