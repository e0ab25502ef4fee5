"""What a run was, in numbers that a person asks for first; also the JSON of ``replay --json``."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import msgspec
import numpy as np

from companion.types import (
    NO_SATELLITES,
    NS,
    AdaptationTrace,
    AidingReports,
    Channel,
    Event,
    Mode,
    Satellites,
    Solution,
    VehicleRecording,
    Verdict,
)
from replay.adaptation_story import Episode, episodes
from replay.integrity import Source, sources
from replay.sky import Sky
from replay.sky import sky as sky_of

_MOVING_MPS = 0.3
"""Slower is taken for standing: the noise of a parked vehicle must not add up to kilometres."""
EARLIEST_DATE_NS = 946_684_800 * NS
"""2000-01-01: recordings stamped earlier carry a clock that does not know the date."""


class Flight(msgspec.Struct, frozen=True):
    """What was flown, by the published solution from alignment on."""

    duration_s: float
    """Of the solution, from the first epoch to the last."""
    start_utc: str | None
    distance_m: float
    max_speed_mps: float
    min_height_m: float | None
    max_height_m: float | None
    height_datum: str


class Sensor(msgspec.Struct, frozen=True):
    """One stream of the recording."""

    source: str
    kind: str
    count: int
    rate_hz: float
    longest_gap_s: float
    gaps: int
    note: str


class Start(msgspec.Struct, frozen=True):
    """How the solution came to be; seconds from its first epoch, None: never."""

    levelled_after_s: float | None
    heading_after_s: float | None
    heading_was_unknown: bool
    final_mode: str
    coasting_s: float
    resets: int


class Gate(msgspec.Struct, frozen=True):
    """One aiding channel: what became of its measurements."""

    accepted: int
    refused: dict[str, int]
    """By name of the verdict, those that occurred."""
    nis_per_dof: float | None
    """Mean normalised innovation squared of accepted updates per degree of freedom; about 1 for
    a filter whose covariance is honest."""


class Summary(msgspec.Struct, frozen=True):
    """Everything that ``companion replay`` says about one vehicle, but for the accuracy."""

    vehicle: str
    flight: Flight
    sensors: list[Sensor]
    start: Start
    gates: dict[str, Gate]
    events: list[dict[str, Any]]
    sources: dict[str, Source]
    """What the receiver's position and height were held to, by those names."""
    adaptation: list[Episode]
    """What the adaptation scaled, when and why."""
    sky: Sky | None
    """None without raw GNSS."""


def summarise(
    vehicle: VehicleRecording,
    solution: Solution,
    reports: AidingReports,
    events: Sequence[Event],
    adaptation: AdaptationTrace | None = None,
    satellites: Satellites = NO_SATELLITES,
) -> Summary:
    """Count and measure one vehicle's run; an empty solution gives zeros and None."""
    origin = int(solution.t_ns[0]) if len(solution) else 0
    return Summary(
        vehicle=vehicle.name,
        flight=_flight(vehicle, solution),
        sensors=[
            Sensor(s.source, s.kind, s.count, s.rate_hz, s.longest_gap_s, s.gaps, s.note)
            for s in vehicle.streams
        ],
        start=_start(solution),
        gates=_gates(reports),
        sources=sources(reports),
        events=[
            {
                "time_s": (e.t_ns - origin) / NS if len(solution) else None,
                "kind": e.kind,
                "level": e.level,
                "text": e.text,
            }
            for e in events
        ],
        adaptation=[] if adaptation is None else episodes(adaptation, origin),
        sky=sky_of(satellites, events),
    )


def _flight(vehicle: VehicleRecording, solution: Solution) -> Flight:
    aligned = solution.mode != Mode.ALIGNING
    if np.count_nonzero(aligned) < 2:
        return Flight(0.0, None, 0.0, 0.0, None, None, vehicle.height_datum)
    t_ns = solution.t_ns[aligned]
    vel_n, height = solution.vel_n[aligned], solution.height[aligned]
    dt_s = np.diff(t_ns) / NS
    speed_h = np.hypot(vel_n[:, 0], vel_n[:, 1])
    moving = np.where(speed_h > _MOVING_MPS, speed_h, 0.0)
    first = int(t_ns[0])
    return Flight(
        duration_s=float(dt_s.sum()),
        start_utc=(
            datetime.fromtimestamp(first / NS, UTC).isoformat(timespec="seconds")
            if first > EARLIEST_DATE_NS
            else None
        ),
        distance_m=float(np.sum(0.5 * (moving[1:] + moving[:-1]) * dt_s)),
        max_speed_mps=float(speed_h.max()),
        min_height_m=float(height.min()),
        max_height_m=float(height.max()),
        height_datum=vehicle.height_datum,
    )


def _start(solution: Solution) -> Start:
    mode = solution.mode

    def first(reached: np.ndarray[Any, np.dtype[np.bool_]]) -> float | None:
        where = np.flatnonzero(reached)
        return float(solution.t_ns[where[0]] - solution.t_ns[0]) / NS if len(where) else None

    coasting = np.flatnonzero(mode[:-1] == Mode.COASTING)
    coasting_ns = solution.t_ns[coasting + 1] - solution.t_ns[coasting]
    return Start(
        levelled_after_s=first(mode != Mode.ALIGNING),
        heading_after_s=first(mode >= Mode.NAVIGATING),
        heading_was_unknown=bool(np.any(mode == Mode.HEADING_UNKNOWN)),
        final_mode=Mode(int(mode[-1])).name.lower() if len(mode) else Mode.ALIGNING.name.lower(),
        coasting_s=float(coasting_ns.sum()) / NS,
        resets=int(solution.resets[-1]) if len(solution) else 0,
    )


def _gates(reports: AidingReports) -> dict[str, Gate]:
    gates: dict[str, Gate] = {}
    for channel in Channel:
        mine = reports.channel == channel
        if channel in (Channel.SOURCE_H, Channel.SOURCE_V) or not mine.any():
            continue
        verdict = reports.verdict[mine]
        accepted = mine & (reports.verdict == Verdict.ACCEPTED)
        dof = int(reports.dof[accepted].sum())
        gates[channel.name.lower()] = Gate(
            accepted=int(np.count_nonzero(accepted)),
            refused={
                v.name.lower(): int(np.count_nonzero(verdict == v))
                for v in Verdict
                if v is not Verdict.ACCEPTED and np.any(verdict == v)
            },
            nis_per_dof=float(reports.nis[accepted].sum()) / dof if dof else None,
        )
    return gates
