"""The live process at rising IMU rates, until samples are lost.

``python -m tests.benchmarks.live_rate [--seconds 30] [--rates 200,1000,2000]``: for each rate a
simulated vehicle (DroneCAN IMU behind an slcan adapter, fixes at 10 Hz over UDP) and ``companion
run`` as processes of this machine. CPU is the share of one core over the whole run; latency is from
the arrival of a sample to the hand-over of what came of it.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from replay.simulator.live.client import VehicleProcess

UNIT = "imu"
_CONFIG = """\
[vehicle]
name = "bench"
[gnss]
latency_ms = 100.0
[[can]]
channel = "{can}"
interface = "slcan"
[[can.imu]]
name = "imu"
protocol = "dronecan"
[mavlink]
endpoint = "{mavlink}"
imu = false
[zenoh]
listen = ["tcp/127.0.0.1:0"]
[log]
directory = "{directory}"
[live]
warm_start = false
"""
_SETTLED_S = 10.0
"""Memory is compared from here on: kernels, buffers and rings are there by then."""


def measure(rate_hz: int, seconds: float) -> dict[str, Any]:
    """One run; the process's own summary, and its memory [MB] once settled and at the end."""
    with tempfile.TemporaryDirectory() as folder:
        directory = Path(folder)
        can = directory / "can"
        arguments = ["--mavlink", "udpin:127.0.0.1:0", "--can", str(can), "--gnss-rate", "10"]
        arguments += ["--imu-rate", str(rate_hz), "--seconds", str(seconds + 60)]
        with VehicleProcess(arguments) as vehicle:
            text = _CONFIG.format(can=can, mavlink=vehicle.ready["mavlink"], directory=directory)
            (directory / "live.toml").write_text(text, encoding="utf-8")
            return _run(directory, seconds)


def _run(directory: Path, seconds: float) -> dict[str, Any]:
    command = [sys.executable, "-m", "companion", "run", str(directory / "live.toml")]
    command += ["--for", str(seconds), "--json"]
    errors = directory / "errors"
    with errors.open("wb") as err:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=err)
        begun, settled, last = time.monotonic(), 0.0, 0.0
        while process.poll() is None:
            last = _resident_mb(process.pid) or last
            if not settled and time.monotonic() - begun > _SETTLED_S:
                settled = last
            time.sleep(0.5)
        out = process.stdout.read() if process.stdout else b""
    if process.returncode:
        sys.exit(errors.read_text(encoding="utf-8").strip().splitlines()[-1])
    summary: dict[str, Any] = json.loads(out)
    return {**summary, "memory_mb": (settled, last)}


def _resident_mb(pid: int) -> float:
    """Resident memory of a process; 0 when it has just ended."""
    try:
        status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    except OSError:
        return 0.0
    found = [line.split()[1] for line in status.splitlines() if line.startswith("VmRSS")]
    return int(found[0]) / 1024 if found else 0.0


def main() -> None:
    """Measure and print one line a rate; stop after the first that loses samples."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30.0, help="of each run")
    parser.add_argument("--rates", default="200,1000,1500,2000,3000", help="Hz, rising")
    given = parser.parse_args()
    print("IMU Hz  samples  missing  not stepped  CPU %  latency ms: p50    p99    max  memory MB")
    for rate in map(int, given.rates.split(",")):
        run = measure(rate, given.seconds)
        counters, latency = run["counters"], run["latency_ms"]
        samples, missing = counters[f"{UNIT}.samples"], counters[f"{UNIT}.lost"]
        first, last = run["memory_mb"]
        print(
            f"{rate:6d}  {samples:7d}  {missing:7d}  {samples - counters['engine.imu']:11d}  "
            f"{100 * run['load']:5.1f}  {latency['p50']:15.2f}  {latency['p99']:5.2f}  "
            f"{latency['max']:5.1f}  {first:.0f} to {last:.0f}",
            flush=True,
        )
        if missing > samples // 100:
            print(f"More than one sample in a hundred is lost at {rate} Hz")
            break


if __name__ == "__main__":
    main()
