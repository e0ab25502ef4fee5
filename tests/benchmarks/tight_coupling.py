"""Loose against tight coupling on a real walk, in the open and with satellites withheld.

Run as ``python -m tests.benchmarks.tight_coupling``. The truth is the receiver's own RTK solution;
its base station stands some 8 m off, so the mean error in the open is taken off both. Errors inside
the windows are horizontal, 3-D for both is beside it. Withheld: all but the n highest satellites at
the window's start, of all systems. Where tight is not better, its largest error and that of loose
coupling are named. The highest satellite is the one that says least of the horizontal place, so
each one in view is kept alone as well: how far off, and how often better than loose coupling and
than tight coupling with none. Seven windows are few: there are windows every two seconds as well.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from companion.config import Config, parse
from companion.navigation.earth import ned_difference
from companion.smoothing.offline import smooth
from companion.types import (
    F64,
    I64,
    NS,
    SATELLITES,
    Outputs,
    Solution,
    VehicleRecording,
)
from replay.player import play
from replay.raw_gnss.withheld import highest as stand_highest
from replay.raw_gnss.withheld import only
from replay.recorded import record
from tests.benchmarks.walk_recording import CONFIG, walk

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "rtk-walk"
STARTS_S = tuple(float(t) for t in range(40, 101, 10))
"""After the first inertial sample, every ten seconds: heading is found by 25 s, the walk ends at
132 s."""
OFTEN_S = tuple(float(t) for t in range(30, 101, 2))
LENGTHS_S = (10.0, 20.0, 30.0)
LEFT = (3, 2, 1, 0)
NO_SATELLITE = np.zeros(0, np.int64)
OPEN_S = 30.0
NAMES = ("loose", "tight", "smoothed")
"""The last: tight, smoothed."""


def highest(vehicle: VehicleRecording, t_ns: int, count: int) -> I64:
    """The ``count`` satellites that stand highest at ``t_ns``."""
    return stand_highest(vehicle.raw[0], vehicle.broadcast[0], t_ns, count)


def withheld(vehicle: VehicleRecording, begin: int, end: int, keep: I64) -> VehicleRecording:
    """Only the satellites ``keep`` between two times."""
    return replace(vehicle, raw=(only(vehicle.raw[0], begin, end, keep),))


def in_view(vehicle: VehicleRecording, t_ns: int) -> I64:
    """All satellites above the mask at ``t_ns``."""
    sats: I64 = np.sort(highest(vehicle, t_ns, SATELLITES))
    return sats


def published(vehicle: VehicleRecording, config: Config) -> Solution:
    """What a user had at the time."""
    parts: list[Solution] = []

    def keep(_: object, out: Outputs) -> None:
        if len(out.published):
            parts.append(out.published)

    play(vehicle, config, keep)
    return Solution.concatenate(parts)


def smoothed(vehicle: VehicleRecording, config: Config) -> Solution:
    """The same from all measurements, by Bryson-Frazier."""
    run = record(vehicle, config, rate_hz=10.0)
    return smooth(run.tapes, run.config)


def errors(vehicle: VehicleRecording, s: Solution) -> tuple[I64, F64]:
    """Times and NED errors (N, 3) [m] of a solution."""
    truth = vehicle.truth
    assert truth is not None
    known = (s.t_ns >= truth.t_ns[0]) & (s.t_ns <= truth.t_ns[-1])
    s = s.take(np.flatnonzero(known))
    at = [np.interp(s.t_ns, truth.t_ns, x) for x in (truth.lat, truth.lon, truth.height)]
    return s.t_ns, ned_difference(s.lat, s.lon, s.height, *at)


class Walk:
    """The recording under each way of solving it, with errors about the mean in the open."""

    def __init__(self) -> None:
        self.vehicle = walk(DATA)
        self.origin = int(self.vehicle.imu[0].t_ns[0])
        self._configs = {name: parse(CONFIG.format(coupling=name)) for name in ("loose", "tight")}
        self.offset: dict[str, F64] = {}
        self.errors_in = cache(self._errors_in)

    def solution(self, name: str, part: VehicleRecording) -> Solution:
        if name == "smoothed":
            return smoothed(part, self._configs["tight"])
        return published(part, self._configs[name])

    def time(self, seconds: float) -> int:
        """[ns] after the first inertial sample."""
        return self.origin + round(seconds * NS)

    def _errors_in(self, name: str, start: float, length: float, keep: bytes) -> tuple[I64, F64]:
        """Times and horizontal errors [m] in a window with only the satellites ``keep``."""
        begin, end = self.time(start), self.time(start + length)
        part = withheld(self.vehicle, begin, end, np.frombuffer(keep, np.int64))
        t, e = errors(part, self.solution(name, part))
        inside = (t >= begin) & (t < end)
        return t[inside], np.hypot(*(e[inside] - self.offset[name])[:, :2].T)

    def worst(self, name: str, start: float, length: float, keep: I64) -> tuple[float, float]:
        """Largest and RMS horizontal error [m] in a window with only the satellites ``keep``."""
        # What was published does not depend on how long the window was to last.
        lasts = length if name == "smoothed" else LENGTHS_S[-1]
        t, h = self.errors_in(name, start, lasts, keep.tobytes())
        h = h[t < self.time(start + length)]
        return float(h.max()), float(np.sqrt((h**2).mean()))


def print_open(run: Walk) -> None:
    """Errors with all satellites; fills the offsets that windows are judged about."""
    print("In the open, about the mean (the base station's offset)")
    print(f"{'':9}{'offset N E D m':>24}{'horizontal RMS m':>18}{'3-D RMS m':>12}")
    for name in NAMES:
        t, e = errors(run.vehicle, run.solution(name, run.vehicle))
        late = t > run.time(OPEN_S)
        run.offset[name] = e[late].mean(axis=0)
        d = e[late] - run.offset[name]
        h, r = np.sqrt((d[:, :2] ** 2).sum(1).mean()), np.sqrt((d**2).sum(1).mean())
        place = " ".join(f"{x:.2f}" for x in run.offset[name])
        print(f"{name:9}{place:>24}{h:18.2f}{r:12.2f}")


def print_highest(run: Walk) -> None:
    """Windows with the highest satellites left."""
    print("\nSatellites withheld: largest and RMS horizontal error inside, mean over the windows")
    head = "".join(f"{f'{n} max':>14}{f'{n} RMS':>14}" for n in NAMES)
    print(f"{'left':>5}{'for s':>7}{'windows':>9}{head}   tight better in")
    for left in LEFT:
        keep = {start: highest(run.vehicle, run.time(start), left) for start in STARTS_S}
        for length in LENGTHS_S:
            # Fewer than four are nothing to loose coupling, however many.
            found = {
                "loose": [run.worst("loose", start, length, NO_SATELLITE) for start in STARTS_S],
                "tight": [run.worst("tight", start, length, keep[start]) for start in STARTS_S],
                "smoothed": [
                    run.worst("smoothed", start, length, keep[start]) for start in STARTS_S
                ],
            }
            mean = {n: np.mean(v, axis=0) for n, v in found.items()}
            lost = [
                f"{start:.0f} s {a[0]:.1f} m ({b[0]:.1f})"
                for start, a, b in zip(STARTS_S, found["tight"], found["loose"], strict=True)
                if a[0] >= b[0]
            ]
            wins = f"{len(STARTS_S) - len(lost)} of {len(STARTS_S)}"
            if lost:
                wins += f"; not from {', '.join(lost)}"
            cells = "".join(f"{m[0]:14.2f}{m[1]:14.2f}" for m in mean.values())
            print(f"{left:5d}{length:7.0f}{len(STARTS_S):9d}{cells}   {wins}")
            sys.stdout.flush()


def print_each(run: Walk) -> None:
    """Windows with each of the satellites in view alone."""
    print("\nEach satellite in view alone: largest horizontal error, mean over all such cases")
    print(f"{'for s':>7}{'cases':>7}{'loose':>9}{'tight, none':>13}{'tight, one':>12}"
          f"{'one better than loose':>23}{'than none':>11}")  # fmt: skip
    cases = [
        (start, np.array([sat]))
        for start in STARTS_S
        for sat in in_view(run.vehicle, run.time(start)).tolist()
    ]
    for length in LENGTHS_S:
        one = np.array([run.worst("tight", start, length, sat)[0] for start, sat in cases])
        loose, none = (
            np.array([run.worst(name, start, length, NO_SATELLITE)[0] for start, _ in cases])
            for name in ("loose", "tight")
        )
        print(f"{length:7.0f}{len(cases):7d}{loose.mean():9.2f}{none.mean():13.2f}{one.mean():12.2f}"
              f"{int((one < loose).sum()):23d}{int((one < none).sum()):11d}")  # fmt: skip


def print_often(run: Walk) -> None:
    """Windows every two seconds, with the highest satellites left: less a matter of chance."""
    print(
        "\nWindows every 2 s, overlapping: mean of the largest error, and in how many below loose"
    )
    print(f"{'for s':>7}{'windows':>9}{'loose':>9}"
          + "".join(f"{f'tight, {left}':>18}" for left in LEFT))  # fmt: skip
    keep = {start: highest(run.vehicle, run.time(start), max(LEFT)) for start in OFTEN_S}
    for length in LENGTHS_S:
        loose = np.array([run.worst("loose", start, length, NO_SATELLITE)[0] for start in keep])
        cells = ""
        for left in LEFT:
            tight = [run.worst("tight", start, length, k[:left])[0] for start, k in keep.items()]
            better = int((np.array(tight) < loose).sum())
            cells += f"{f'{np.mean(tight):.2f} ({better})':>18}"
        print(f"{length:7.0f}{len(keep):9d}{loose.mean():9.2f}{cells}")
        sys.stdout.flush()


def main() -> None:
    run = Walk()
    print_open(run)
    print_highest(run)
    print_often(run)
    print_each(run)


if __name__ == "__main__":
    main()
