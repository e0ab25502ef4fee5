"""Every log of the data directory through ``companion batch``, in five ways; and the same bits.

``python -m tests.benchmarks.batch [DIR]``; a quarter of an hour on two cores. Wall clock, whole
processes: what else runs on the machine counts. A log of random bytes and one that was cut and
overwritten are put beside the others.
"""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from replay.children import free_port
from tests.benchmarks.common import need_data

PATIENCE_S = 1200.0
_POLL_S = 0.2


@dataclass(frozen=True, slots=True)
class Ran:
    """One batch: how long it took, what it said, and the digests of all solutions by log."""

    wall_s: float
    said: dict[str, Any]
    digests: dict[tuple[str, str], str]


def command(logs: Sequence[Path], out: Path, *more: str) -> list[str]:
    """The command line of a batch."""
    return [sys.executable, "-m", "companion", "batch", *map(str, logs), "-o", str(out), "--json",
            *more]  # fmt: skip


def ran(logs: Sequence[Path], out: Path, *more: str) -> Ran:
    """Run a batch to its end."""
    begin = time.monotonic()
    done = subprocess.run(
        command(logs, out, *more), capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    wall_s = time.monotonic() - begin
    if done.returncode:
        sys.exit(done.stderr.strip()[-500:])
    with (out / "logs.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["ended"] == "done"]
    digests = {(row["log"], row["vehicle"]): row["digest"] for row in rows}
    return Ran(wall_s, json.loads(done.stdout), digests)


def corrupt(folder: Path, good: Path) -> list[Path]:
    """Random bytes by a log's name; and a log whose last third is random bytes."""
    rng = np.random.default_rng(8)
    noise, damaged = folder / "noise.tlog", folder / "damaged.tlog"
    noise.write_bytes(rng.bytes(1_000_000))
    whole = good.read_bytes()
    damaged.write_bytes(whole[: 2 * len(whole) // 3] + rng.bytes(len(whole) // 3))
    return [noise, damaged]


def interrupt(logs: Sequence[Path], out: Path, share: float, total: int) -> int:
    """Kill a batch once ``share`` of ``total`` logs is done; how many were."""
    child = subprocess.Popen(
        command(logs, out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    until = time.monotonic() + PATIENCE_S
    while (done := len(list((out / "done").glob("*.json")))) < share * total:
        if child.poll() is not None or time.monotonic() > until:
            sys.exit("the batch that was to be interrupted ended by itself")
        time.sleep(_POLL_S)
    child.send_signal(signal.SIGKILL)
    child.wait()
    return done


def cluster(stack: ExitStack, folder: Path) -> str:
    """A scheduler and two worker processes of one thread; its address."""
    address = f"tcp://127.0.0.1:{free_port()}"
    port = address.rpartition(":")[2]
    parts = [["scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard"]]
    parts += 2 * [["worker", address, "--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1"]]
    for at, words in enumerate(parts):
        log = stack.enter_context((folder / f"dask{at}.log").open("w"))
        child = subprocess.Popen(
            [sys.executable, "-m", "dask", *words], stdout=log, stderr=log, cwd=folder
        )
        stack.callback(child.wait)
        stack.callback(child.terminate)
    return address


def main(data: Path) -> None:
    """The five batches, one after the other, and a table of them."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        logs = [data, *corrupt(folder, data / "tlog-vtol" / "vtol.tlog")]
        if not logs[0].is_dir():
            sys.exit(f"{data} is no folder")
        one = ran(logs, folder / "one", "--workers", "1")
        two = ran(logs, folder / "two", "--workers", "2")
        total = one.said["logs"]
        done = interrupt(logs, folder / "cut", 0.5, total)
        resumed = ran(logs, folder / "cut", "--workers", "2")
        again = ran(logs, folder / "two", "--workers", "2")
        dask = ran(logs, folder / "cluster", "--scheduler", cluster(stack, folder))
        pages = sum(page.stat().st_size for page in (folder / "two" / "reports").iterdir())
        if len(sys.argv) > 2:
            shutil.copytree(folder / "two", sys.argv[2], dirs_exist_ok=True)
    print(f"{total} logs, {one.said['flights']} flights, {len(one.said['refused'])} refused, "
          f"{len(one.said['failed'])} failed; {pages / 1e6:.0f} MB of pages")  # fmt: skip
    for words, batch in (("one at a time", one), ("two at a time", two), ("Dask cluster", dask)):
        print(
            f"  {words:16} {batch.wall_s:6.1f} s, {one.wall_s / batch.wall_s:.2f} times as fast; "
            f"the logs' own time {batch.said['log_wall_s']:.0f} s; largest process "
            f"{batch.said['peak_mb']:.0f} MB; digests equal: {batch.digests == one.digests}"
        )
    print(
        f"  killed with {done} logs done; resumed: {resumed.said['reused']} taken as they were, "
        f"{total - resumed.said['reused']} worked on, {resumed.wall_s:.1f} s; digests equal: "
        f"{resumed.digests == one.digests}"
    )
    print(
        f"  the same command again: {again.said['reused']} taken as they were, {again.wall_s:.1f} s"
    )
    for log in ("noise.tlog", "damaged.tlog"):
        words = next((r for n, r in one.said["refused"].items() if n.endswith(log)), "replayed")
        print(f"  {log}: {words.rpartition('/')[2]}")
    print(f"Machine: {os.cpu_count()} cores, load {os.getloadavg()[2]:.1f} over 15 minutes")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else need_data())
