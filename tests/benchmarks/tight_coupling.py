"""Loose against tight coupling on a real walk, in the open and with satellites withheld.

Run as ``python -m tests.benchmarks.tight_coupling``. The truth is the receiver's own RTK solution;
its base station stands some 8 m off, so the mean error in the open is taken off both. Errors inside
the windows are horizontal, 3-D for both is beside it. Withheld: all but the n highest satellites at
the window's start, of all systems. Where tight is not better, its largest error and that of loose
coupling are named.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from companion.config import Config, RawGnss, parse
from companion.gnss.corrected import S_SAT
from companion.intake.raw_gnss.receiver import Receiver
from companion.navigation.earth import ned_difference
from companion.smoothing.offline import smooth
from companion.types import F64, I64, NS, Outputs, RawGnssSamples, Solution, VehicleRecording
from replay.player import play
from replay.recorded import record
from tests.benchmarks.walk_recording import CONFIG, walk

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "rtk-walk"
STARTS_S = tuple(float(t) for t in range(40, 101, 10))
"""After the first inertial sample, every ten seconds: heading is found by 25 s, the walk ends at
132 s."""
LENGTHS_S = (10.0, 20.0, 30.0)
LEFT = (3, 2, 1, 0)
OPEN_S = 30.0
NAMES = ("loose", "tight", "smoothed")
"""The last: tight, smoothed."""


def highest(vehicle: VehicleRecording, t_ns: int, count: int) -> I64:
    """The ``count`` satellites that stand highest at ``t_ns``."""
    receiver = Receiver(RawGnss())
    receiver.listen(vehicle.broadcast[0])
    raw = vehicle.raw[0]
    upto = int(np.searchsorted(raw.t_ns, t_ns))
    for i in range(max(upto - 2, 0), upto + 1):
        seen = receiver.take(raw, i)
    order = np.argsort(-seen.sky[:, 1])
    return seen.rows[order[:count], S_SAT].astype(np.int64)


def withheld(vehicle: VehicleRecording, begin: int, end: int, keep: I64) -> VehicleRecording:
    """Only the satellites ``keep`` between two times."""
    raw = vehicle.raw[0]
    inside = (raw.t_ns >= begin) & (raw.t_ns < end)
    gone = inside[:, None] & ~np.isin(raw.sat, keep)
    part: RawGnssSamples = replace(raw, sat=np.where(gone, 0, raw.sat))
    return replace(vehicle, raw=(part,))


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


def main() -> None:
    vehicle = walk(DATA)
    origin = int(vehicle.imu[0].t_ns[0])
    configs = {name: parse(CONFIG.format(coupling=name)) for name in ("loose", "tight")}

    def solution(name: str, part: VehicleRecording) -> Solution:
        if name == "smoothed":
            return smoothed(part, configs["tight"])
        return published(part, configs[name])

    offset: dict[str, F64] = {}
    print("In the open, about the mean (the base station's offset)")
    print(f"{'':9}{'offset N E D m':>24}{'horizontal RMS m':>18}{'3-D RMS m':>12}")
    for name in NAMES:
        t, e = errors(vehicle, solution(name, vehicle))
        late = t > origin + round(OPEN_S * NS)
        offset[name] = e[late].mean(axis=0)
        d = e[late] - offset[name]
        h, r = np.sqrt((d[:, :2] ** 2).sum(1).mean()), np.sqrt((d**2).sum(1).mean())
        place = " ".join(f"{x:.2f}" for x in offset[name])
        print(f"{name:9}{place:>24}{h:18.2f}{r:12.2f}")
    print("\nSatellites withheld: largest and RMS horizontal error inside, mean over the windows")
    head = "".join(f"{f'{n} max':>14}{f'{n} RMS':>14}" for n in NAMES)
    print(f"{'left':>5}{'for s':>7}{'windows':>9}{head}   tight better in")

    @cache
    def worst(name: str, start: float, length: float, left: int) -> tuple[float, float]:
        """Largest and RMS horizontal error in one window."""
        begin = origin + round(start * NS)
        end = begin + round(length * NS)
        part = withheld(vehicle, begin, end, highest(vehicle, begin, left))
        t, e = errors(part, solution(name, part))
        inside = (t >= begin) & (t < end)
        h = np.hypot(*(e[inside] - offset[name])[:, :2].T)
        return float(h.max()), float(np.sqrt((h**2).mean()))

    for left in LEFT:
        for length in LENGTHS_S:
            # Fewer than four are nothing to loose coupling, however many.
            found = {
                "loose": [worst("loose", start, length, 0) for start in STARTS_S],
                "tight": [worst("tight", start, length, left) for start in STARTS_S],
                "smoothed": [worst("smoothed", start, length, left) for start in STARTS_S],
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


if __name__ == "__main__":
    main()
