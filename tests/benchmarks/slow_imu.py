"""Slow telemetry: the direct filter against the autopilot's own position, held or carried on.

    python -m tests.benchmarks.slow_imu [DATA]

Every stream of a log at 4 Hz, as a ground station has it; then all of them silent for 5 s, twice a
minute. Outages of a flight's own GNSS, 10 to 60 s in the SITL flights, are judged apart: there the
autopilot has its IMU at full rate, and on the plane an airspeed. The filter has the inertial
samples, fixes, pressure and ATTITUDE of the telemetry; it is compared with GLOBAL_POSITION_INT of
the same telemetry, held, or carried on with its velocity. *Straight on*: the filter's own place and
velocity at the time of the last GLOBAL_POSITION_INT, carried on as that is: what it loses against
*carried on* is its velocity, and what it gains over the filter is the model of acceleration.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.navigation.earth import ned_difference
from companion.types import F64, I64, NS, ReferenceSamples, Samples, Solution, VehicleRecording
from replay.configuration import ChosenConfig, choose_config
from replay.reader import read_log
from replay.session import run_session
from tests.benchmarks.common import DATA

LOGS = (
    "tlog-vtol/vtol.tlog",
    "sitl/c3_outage.tlog",
    "sitl/p1_plane_outage.tlog",
)
RATE_HZ = 4.0
EVERY_S, GAP_S = 30.0, 5.0
SETTLED_S = 20.0
"""From the start on: neither solution is judged before."""
OUTAGE_S, BACK_S = 8.0, 15.0
"""Longer without a fix is an outage of the flight's own GNSS, no gap of the telemetry; it is judged
apart, and as long behind it as it takes to return."""

Keep = Callable[[I64], NDArray[np.bool_]]


@dataclass(frozen=True)
class Way:
    """Positions over time by one method."""

    t_ns: I64
    lat: F64
    lon: F64


def thinned(t_ns: I64) -> NDArray[np.bool_]:
    """(N,) the first sample of each period of 4 Hz."""
    cell = t_ns // round(NS / RATE_HZ)
    first = np.ones(len(cell), np.bool_)
    first[1:] = cell[1:] != cell[:-1]
    return first


def kept(vehicle: VehicleRecording, keep: Keep) -> VehicleRecording:
    """The recording with only those samples of every stream but the truth."""

    def some(streams: tuple[Samples, ...]) -> tuple[Samples, ...]:
        return tuple(stream.take(keep(stream.t_ns)) for stream in streams)

    changed = {name: some(getattr(vehicle, name)) for name in ("imu", "gnss", "baro", "mag")}
    changed["attitude"] = some(vehicle.attitude)
    autopilot = vehicle.autopilot
    if autopilot is not None:
        changed["autopilot"] = autopilot.take(keep(autopilot.t_ns))  # type: ignore[assignment]
    return replace(vehicle, **changed)  # type: ignore[arg-type]


def windows(t_ns: I64, start_ns: int) -> NDArray[np.bool_]:
    """(N,) inside one of the silences."""
    phase = (t_ns - start_ns) % round(EVERY_S * NS)
    late = t_ns - start_ns > round(SETTLED_S * NS)
    inside: NDArray[np.bool_] = late & (phase >= round((EVERY_S - GAP_S) * NS))
    return inside


def without_gnss(t_ns: I64, vehicle: VehicleRecording) -> NDArray[np.bool_]:
    """(N,) where the flight itself had no fix, or had it back for less than 15 s."""
    fix = vehicle.gnss[0]
    valid = fix.t_ns[np.isfinite(fix.lat) & (fix.fix_type >= 3)]
    ends = np.flatnonzero(np.diff(valid) > round(OUTAGE_S * NS))
    found = np.zeros(len(t_ns), np.bool_)
    for end in ends:
        back = valid[end + 1] + round(BACK_S * NS)
        found |= (t_ns > valid[end] + NS) & (t_ns < back)
    return found


def of_solution(solution: Solution) -> Way:
    """The published epochs."""
    return Way(solution.t_ns, solution.lat, solution.lon)


def of_autopilot(ref: ReferenceSamples, t_ns: I64, *, carried: bool) -> Way:
    """The last position that had arrived, held or carried on with its velocity."""
    last = np.searchsorted(ref.t_rx_ns, t_ns, side="right") - 1
    t_ns, last = t_ns[last >= 0], last[last >= 0]
    ahead = (t_ns - ref.t_ns[last]) / NS * carried
    radius = 6_371_000.0
    lat = ref.lat[last] + ref.vel_n[last, 0] * ahead / radius
    return Way(t_ns, lat, ref.lon[last] + ref.vel_n[last, 1] * ahead / radius / np.cos(lat))


def straight_on(ours: Solution, ref: ReferenceSamples) -> Way:
    """Our epochs from our last state before the last position of the autopilot that had arrived."""
    last = np.searchsorted(ref.t_rx_ns, ours.t_ns, side="right") - 1
    at = np.searchsorted(ours.t_ns, ref.t_ns[last.clip(0)], side="right") - 1
    good = (last >= 0) & (at >= 0)
    t_ns, at = ours.t_ns[good], at[good]
    ahead = (t_ns - ours.t_ns[at]) / NS
    radius = 6_371_000.0
    lat = ours.lat[at] + ours.vel_n[at, 0] * ahead / radius
    return Way(t_ns, lat, ours.lon[at] + ours.vel_n[at, 1] * ahead / radius / np.cos(lat))


def errors(way: Way, truth: ReferenceSamples) -> tuple[I64, F64]:
    """Times and horizontal errors [m] at the epochs of ``way`` that the truth spans."""
    t = truth.t_ns
    i = np.searchsorted(t, way.t_ns).clip(1, len(t) - 1)
    good = (way.t_ns >= t[0]) & (way.t_ns <= t[-1]) & (t[i] - t[i - 1] < 0.5 * NS)
    i, at = i[good], way.t_ns[good]
    part = (at - t[i - 1]) / (t[i] - t[i - 1])
    lat = truth.lat[i - 1] + part * (truth.lat[i] - truth.lat[i - 1])
    lon = truth.lon[i - 1] + part * (truth.lon[i] - truth.lon[i - 1])
    zero = np.zeros(len(lat))
    d = ned_difference(way.lat[good], way.lon[good], zero, lat, lon, zero)
    return at, np.hypot(d[:, 0], d[:, 1])


def examine(path: Path, *, gaps: bool) -> list[str]:
    """Rows of the table for one log."""
    recording = read_log([path])
    vehicle = kept(recording.vehicles[0], thinned)
    assert vehicle.truth is not None
    assert vehicle.autopilot is not None
    start = int(vehicle.imu[0].t_ns[0])
    flown = vehicle
    if gaps:
        vehicle = kept(vehicle, lambda t: ~windows(t, start))
    chosen = choose_config(replace(recording, vehicles=(vehicle,)))
    config = msgspec.structs.replace(
        chosen.config, direct=msgspec.structs.replace(chosen.config.direct, attitude=True)
    )
    result = run_session(vehicle, ChosenConfig(config, "", ""))
    ours = result.solution.take(np.flatnonzero(result.solution.mode >= 2))
    ways = {
        "direct filter": of_solution(ours),
        "straight on": straight_on(ours, vehicle.autopilot),
        "held": of_autopilot(vehicle.autopilot, ours.t_ns, carried=False),
        "carried on": of_autopilot(vehicle.autopilot, ours.t_ns, carried=True),
    }
    rows = []
    for name, way in ways.items():
        t, error = errors(way, vehicle.truth)
        judged = t > start + round(SETTLED_S * NS)
        if gaps:
            judged &= windows(t, start)
        off = without_gnss(t, flown)
        for which, inside in (("5 s gaps" if gaps else "no gaps", ~off), ("GNSS off", off)):
            some = error[judged & inside]
            if len(some):
                rms = float(np.sqrt(np.mean(some**2)))
                rows.append(
                    f"{path.parent.name}/{path.stem:18} {which:9} {name:14} "
                    f"{len(some):6} {rms:8.2f} {np.percentile(some, 95):8.2f} {some.max():8.2f}"
                )
    return rows if not gaps else [row for row in rows if "GNSS off" not in row]


def main(data: Path) -> None:
    """Print the table."""
    print(f"{'log':23} {'telemetry':9} {'position':14} {'epochs':>6} {'RMS m':>8} {'95 %':>8} max")
    for name in LOGS:
        for gaps in (False, True):
            for row in examine(data / name, gaps=gaps):
                print(row, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else DATA)
