"""Restart after kill −9: from the start of the process to its first aligned state.

``python -m tests.benchmarks.restart [--times 5]``: ``companion run`` beside a simulated vehicle on
a mission (DroneCAN IMU behind an slcan adapter, autopilot over UDP), killed and started again.
*Loop*: the first event that it prints, its links are open; *aligned*: the filter has a solution.
Times are from before the process exists, processor time is its own (of all threads).
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import tempfile
import time
from pathlib import Path

from replay.children import free_port
from tests.live.system import Companion, config_beside, vehicle_at, written

FIRST_S = 13.0
"""Of the run that leaves its state."""


def measure(config: Path, log: Path, run_s: float) -> tuple[float, float, float, float, str]:
    """One start, killed ``run_s`` after it is aligned: wall and CPU [s] to loop and to aligned."""
    begun = time.monotonic()
    with Companion(config, log) as companion:
        companion.await_event("link-up")
        loop_s, loop_cpu_s = time.monotonic() - begun, companion.cpu_s()
        said = companion.await_event("aligned")
        aligned_s, cpu_s = time.monotonic() - begun, companion.cpu_s()
        time.sleep(run_s)
        companion.send_signal(signal.SIGKILL)
        companion.wait(10.0)
    return loop_s, loop_cpu_s, aligned_s, cpu_s, said.partition("; ")[2]


def main() -> None:
    """Print one line a start, the cold one first, and the medians of the others."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--times", type=int, default=5, help="starts after the first")
    given = parser.parse_args()
    print("start  to loop s  CPU s  to aligned s  CPU s  load  heading")
    rows = []
    with tempfile.TemporaryDirectory() as directory:
        folder = Path(directory)
        with vehicle_at(folder) as vehicle:
            config = config_beside(vehicle, folder, f"tcp/127.0.0.1:{free_port()}")
            path = written(config, folder)
            for at in range(given.times + 1):
                row = measure(path, folder / f"{at}.mcap", 1.0 if at else FIRST_S)
                numbers = "  ".join(
                    f"{value:{width}.2f}"
                    for value, width in zip(row[:4], (9, 5, 12, 5), strict=True)
                )
                kind = "warm" if at else "cold"
                print(f"{kind:5s}  {numbers}  {os.getloadavg()[0]:4.1f}  {row[4]}", flush=True)
                rows.append(row[:4])
    loop, loop_cpu, aligned, cpu = (statistics.median(c) for c in zip(*rows[1:], strict=True))
    print(
        f"warm, median: loop {loop:.2f} s ({loop_cpu:.2f} CPU), aligned {aligned:.2f} ({cpu:.2f})"
    )


if __name__ == "__main__":
    main()
