"""Broadcast orbits and clocks against the final ones that IGS centres published, term by term.

    python -m tests.benchmarks.published_orbits

The records and values of :mod:`tests.gnss.test_published_orbits`, which names their sources.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from companion.gnss import orbit as ob
from companion.gnss.systems import C
from tests.gnss.test_published_orbits import SP3, broadcast_row


def main() -> None:
    """Print one line a satellite and published epoch."""
    print(f"{'':5}{'second':>8}{'off m':>8}{'radial':>8}{'clock m':>9}{'relativity m':>14}")
    for name, (broadcast, week, published) in SP3.items():
        with tempfile.TemporaryDirectory() as folder:
            row = broadcast_row(name, broadcast, Path(folder))
        out = np.empty(8)
        for second, text in published:
            *km, clock_us = (float(word) for word in text.split())
            ob.satellite_at(row, float(week), second, out)
            off = out[:3] - 1e3 * np.array(km)
            radial = off @ out[:3] / np.linalg.norm(out[:3])
            relativity = -2.0 * float(out[:3] @ out[3:6]) / C
            clock = out[6] + C * row[ob.E_GROUP_DELAY] - 1e-6 * clock_us * C - relativity
            print(
                f"{name:5}{second:8.0f}{np.linalg.norm(off):8.2f}{radial:8.2f}{clock:9.2f}"
                f"{relativity:14.2f}"
            )


if __name__ == "__main__":
    main()
