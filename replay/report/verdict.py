"""Was the navigation good? A verdict in words, each line of evidence with what to do about it.

The worst line decides. Limits are those of a vehicle that is flown by its position: they are
constants here and stand on the page beside what was found, so that another judgement is possible.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.types import (
    COV_POS,
    F64,
    I64,
    NS,
    Channel,
    GnssSamples,
    Mode,
    ReferenceSamples,
    Solution,
    Verdict,
)
from replay.adaptation_story import episodes
from replay.evaluation import as_solution, errors_against
from replay.report.charts import spoken
from replay.report.run_view import RunView

Level = Literal["good", "degraded", "bad"]
Known = NDArray[np.bool_]
_RANK: dict[Level, int] = {"good": 0, "degraded": 1, "bad": 2}

SD_DEGRADED_M, SD_BAD_M = 5.0, 30.0
"""Stated horizontal standard deviation: several times, and far beyond, what a receiver gives."""
REJECTED_DEGRADED, REJECTED_BAD = 0.05, 0.3
"""Share of a channel's measurements refused by the gate; an honest filter refuses far below 1 %."""
NIS_HIGH = 2.0
"""Normalised innovation squared per degree of freedom; 1 where the stated noise is right."""
BEYOND_DEGRADED, BEYOND_BAD = 0.05, 0.25
"""Share of epochs whose horizontal error exceeds three standard deviations; honest: 1.1 %."""
SLOW_ERROR_M = 1.5
"""What an ordinary receiver is off by for minutes: no filter sees it, and no error against truth
of this size speaks against one. Receivers with an RTK fix do without."""
APART_M = 15.0
"""Distance of two solutions of the same sensors from which on one of them is wrong."""
HEADING_OFF = np.radians(20.0)
"""A heading that is off by this much for half of the time was not found."""
UNAIDED_DEGRADED = 0.02
"""Share of the time without position or velocity aiding."""
FAULTY_BAD = 0.3
"""Share of the time for which a receiver was held for faulty."""
WORSE_DEGRADED = 0.1
"""Share of the time for which a sensor was believed less than it should be."""
CONSTRAINTS = (Channel.ZERO_VELOCITY, Channel.ZERO_RATE, Channel.NON_HOLONOMIC)
"""What is assumed of the motion, and refused where the vehicle moves otherwise: no fault."""
MINIMUM_UPDATES = 30
"""Fewer updates of a channel than this say nothing about it."""


class Evidence(msgspec.Struct, frozen=True):
    """One thing that was found."""

    level: Level
    text: str
    action: str = ""


class Judgement(msgspec.Struct, frozen=True):
    """The verdict and what it rests on, worst first."""

    level: Level
    headline: str
    evidence: tuple[Evidence, ...]


def judge(run: RunView) -> Judgement:
    """Weigh what the run shows about itself and, where there is a reference, against it."""
    found = tuple(sorted(_evidence(run), key=lambda e: -_RANK[e.level]))
    level = max((e.level for e in found), key=lambda x: _RANK[x])
    worst = [e for e in found if e.level == level]
    if level == "good":
        headline = "Good: " + worst[0].text
    else:
        more = f" (and {len(worst) - 1} more)" if len(worst) > 1 else ""
        headline = f"{level.capitalize()}: {worst[0].text}{more}"
    return Judgement(level, headline, found)


def _evidence(run: RunView) -> Iterator[Evidence]:
    aligned = run.aligned()
    if not len(aligned):
        yield Evidence(
            "bad",
            "there is no solution: alignment never finished",
            "Stand still for some seconds at the start, and see the sensors below.",
        )
        return
    yield from _against_reference(run, aligned)
    yield from _modes(run, aligned)
    yield from _stated(run, aligned)
    yield from _gates(run)
    yield from _sources(run, aligned)
    yield from _adapted(run, aligned)
    yield from _declared(run)
    yield from _sensors(run)


def horizontal_sd(solution: Solution) -> F64:
    """Larger standard deviation of the horizontal position (N,) [m]."""
    xx, xy, yy = solution.cov[:, COV_POS][:, [0, 1, 3]].T
    root = np.sqrt(np.maximum(0.25 * (xx - yy) ** 2 + xy**2, 0.0))
    sd: F64 = np.sqrt(0.5 * (xx + yy) + root)
    return sd


def _against_reference(run: RunView, aligned: Solution) -> Iterator[Evidence]:
    if run.reference is None:
        return
    kind, reference = run.reference
    errors = errors_against(aligned, reference)
    horizontal = np.hypot(errors.position_n[:, 0], errors.position_n[:, 1])
    known = np.isfinite(horizontal) & (aligned.mode >= Mode.NAVIGATING)
    if known.any():
        rms, worst = float(np.sqrt(np.mean(horizontal[known] ** 2))), float(horizontal[known].max())
        said = f"{rms:.2f} m RMS, {worst:.1f} m at worst"
        if kind == "autopilot":
            yield _against_autopilot(run, aligned, horizontal, known, said)
        else:
            yield _against_truth(run, aligned, horizontal, known, said)
    yaw = np.abs(errors.attitude[:, 2])[aligned.mode >= Mode.NAVIGATING]
    yaw = yaw[np.isfinite(yaw)]
    if len(yaw) and np.median(yaw) > HEADING_OFF:
        whose = "the truth's" if kind == "truth" else "the autopilot's"
        yield Evidence(
            "bad" if kind == "truth" else "degraded",
            f"heading is {np.degrees(np.median(yaw)):.0f}° from {whose} in the median",
            "A compass beside currents, a wrong mounting, or a heading found from too little "
            "motion.",
        )


def _against_truth(
    run: RunView, aligned: Solution, horizontal: F64, known: Known, said: str
) -> Evidence:
    sd = np.hypot(horizontal_sd(aligned), _slow_error(run))
    beyond = float(np.mean(horizontal[known] > 3.0 * sd[known]))
    level: Level = (
        "bad" if beyond > BEYOND_BAD else "degraded" if beyond > BEYOND_DEGRADED else "good"
    )
    text = f"horizontal error against truth {said}"
    if level == "good":
        alone = float(np.mean(horizontal[known] > 3.0 * horizontal_sd(aligned)[known]))
        hint = "The receiver's slow error is not in the stated one: gnss.slow_error_sd_m."
        return Evidence("good", text, hint if alone > BEYOND_DEGRADED else "")
    return Evidence(
        level,
        f"{text}; {beyond:.0%} of the time beyond three stated standard deviations",
        "The filter is surer than it should be: check sensor noise, latency and lever arm in the "
        "configuration; companion tune suggests noise from the log.",
    )


def _against_autopilot(
    run: RunView, aligned: Solution, horizontal: F64, known: Known, said: str
) -> Evidence:
    """Another filter's opinion, on much the same sensors: it shows disagreement, not error.

    Where the two disagree and the receiver has a fix, the receiver says which one is with it.
    """
    text = f"horizontally {said} from the autopilot's estimate"
    apart = known & (horizontal > APART_M)
    if not apart.any():
        return Evidence("good", text)
    found = _to_fixes(run, aligned, aligned.t_ns[apart])
    if found is None:
        action = "One of the two is wrong there, and no fix says which: look at the track."
        return Evidence("degraded", text, action)
    ours, theirs = found
    where = f"{ours:.1f} m from the fixes there, the autopilot's {theirs:.1f} m"
    if ours < theirs / 3.0:
        return Evidence("good", f"{text}: this solution is {where}")
    return Evidence("degraded", f"{text}: this solution is {where}", "Look at the innovations.")


def _to_fixes(run: RunView, aligned: Solution, t_ns: I64) -> tuple[float, float] | None:
    """Median horizontal distance [m] of the solution and of the autopilot's from those fixes of
    the first receiver that are within a second of ``t_ns`` (N,) rising; None without any."""
    if not run.vehicle.gnss or run.vehicle.autopilot is None:
        return None
    fixes = run.vehicle.gnss[0]
    t = fixes.t_ns - round(run.config.gnss.latency_ms * 1e6)
    at = np.clip(np.searchsorted(t_ns, t), 1, len(t_ns) - 1) if len(t_ns) > 1 else 0 * t
    near = np.minimum(np.abs(t_ns[at] - t), np.abs(t_ns[at - 1] - t)) <= NS
    used = near & (fixes.fix_type >= run.config.gnss.min_fix_type)
    if not used.any():
        return None
    told = as_solution(_places(t[used], fixes.take(np.flatnonzero(used))))
    off = []
    for whose in (_places(aligned.t_ns, aligned), run.vehicle.autopilot):
        errors = errors_against(told, whose).position_n
        distance = np.hypot(errors[:, 0], errors[:, 1])
        off.append(float(np.nanmedian(distance)) if np.isfinite(distance).any() else np.nan)
    return (off[0], off[1]) if np.isfinite(off).all() else None


def _places(t_ns: I64, of: Solution | GnssSamples) -> ReferenceSamples:
    """Places alone, to be held against others."""
    nothing = np.full((len(t_ns), 3), np.nan)
    return ReferenceSamples("", t_ns, t_ns, t_ns, of.lat, of.lon, of.height, nothing, nothing)


def _slow_error(run: RunView) -> float:
    """What the receiver may be off by for long [m]; 0 for one with RTK fixes."""
    fixes = run.vehicle.gnss[0].fix_type if run.vehicle.gnss else np.zeros(0)
    return 0.0 if len(fixes) and np.median(fixes) >= 5 else SLOW_ERROR_M


def _stated(run: RunView, aligned: Solution) -> Iterator[Evidence]:
    sd = horizontal_sd(aligned)
    known = sd[np.isfinite(sd)]
    if not len(known):
        yield Evidence("bad", "the filter states no standard deviation of its position")
        return
    median, worst = float(np.median(known)), float(known.max())
    level: Level = "bad" if worst > SD_BAD_M else "degraded" if worst > SD_DEGRADED_M else "good"
    at = int(aligned.t_ns[np.nanargmax(sd)])
    # A moment later: the first fix after an outage does not end it at once.
    alone = any(o.start_ns <= at <= o.end_ns + NS for o in run.outages())
    yield Evidence(
        level,
        f"stated horizontal standard deviation {median:.2f} m in the median, {worst:.1f} m at most"
        + (", without GNSS" if alone and level != "good" else ""),
        "" if level == "good" else "See where it grows: an outage, or a receiver that is refused.",
    )


def _modes(run: RunView, aligned: Solution) -> Iterator[Evidence]:
    final = Mode(int(aligned.mode[-1]))
    if not np.any(aligned.mode >= Mode.NAVIGATING):
        yield Evidence(
            "bad",
            "heading was never found",
            "Move the vehicle with some acceleration, or give it a magnetometer.",
        )
    elif final is Mode.COASTING:
        yield Evidence(
            "degraded",
            "at the end it was coasting, without aiding",
            "See why the receiver was silent or refused at the end.",
        )
    outages = run.outages()
    if outages:
        seconds = [(o.end_ns - o.start_ns) / NS for o in outages]
        share = sum(seconds) / max((aligned.t_ns[-1] - aligned.t_ns[0]) / NS, 1.0)
        yield Evidence(
            "degraded" if share > UNAIDED_DEGRADED else "good",
            f"{len(outages)} time{'s' * (len(outages) > 1)} without GNSS, "
            f"{sum(seconds):.0f} s together, the longest {max(seconds):.0f} s",
            "Withheld on purpose." if run.withheld else "Antenna, jamming, or the log itself.",
        )


def _gates(run: RunView) -> Iterator[Evidence]:
    reports = run.reports
    for channel in Channel:
        mine = reports.channel == channel
        passed = mine & (reports.verdict == Verdict.ACCEPTED)
        stopped = int(np.count_nonzero(mine & (reports.verdict == Verdict.REJECTED_GATE)))
        total = int(np.count_nonzero(passed)) + stopped
        if total < MINIMUM_UPDATES or channel in (Channel.SOURCE_H, Channel.SOURCE_V):
            continue
        name = spoken(channel)
        share = stopped / total
        if share > REJECTED_DEGRADED and channel not in CONSTRAINTS:
            yield Evidence(
                "bad" if share > REJECTED_BAD else "degraded",
                f"{share:.0%} of {name} measurements were refused by the gate",
                "Either the sensor is worse than it says or the solution was wrong: see the "
                "innovations.",
            )
        dof = int(reports.dof[passed].sum())
        nis = float(reports.nis[passed].sum()) / dof if dof else np.nan
        if nis > NIS_HIGH:
            yield Evidence(
                "degraded",
                f"innovations of {name} are {np.sqrt(nis):.1f} times what was expected",
                f"Stated noise too small, or a wrong latency (NIS {nis:.1f}, honest: 1).",
            )


def _sources(run: RunView, aligned: Solution) -> Iterator[Evidence]:
    """Receivers that contradicted themselves: refused is right, and somebody should know."""
    length_s = max((aligned.t_ns[-1] - aligned.t_ns[0]) / NS, 1.0)
    for channel in (Channel.GNSS_POSITION_H, Channel.GNSS_POSITION_V):
        mine = [f for f in run.source_faults() if f.channel == channel]
        if not mine:
            continue
        seconds = sum((f.end_ns - f.start_ns) / NS for f in mine)
        yield Evidence(
            "bad" if seconds > FAULTY_BAD * length_s else "degraded",
            f"{spoken(channel)} was held for faulty {len(mine)} time{'s' * (len(mine) > 1)}, "
            f"{seconds:.0f} s together, and not used then",
            "Reflections, jamming or spoofing: see the source faults for when and by how much.",
        )


def _adapted(run: RunView, aligned: Solution) -> Iterator[Evidence]:
    """Sensors that were worse than they said, and were believed less for it."""
    length_s = max((aligned.t_ns[-1] - aligned.t_ns[0]) / NS, 1.0)
    scaled = [e for e in episodes(run.adaptation, run.origin_ns) if e.what == "R"]
    for name in dict.fromkeys(e.channel for e in scaled):
        mine = [e for e in scaled if e.channel == name]
        seconds = sum(e.end_s - e.start_s for e in mine)
        most = max(e.greatest for e in mine)
        yield Evidence(
            "degraded" if seconds > WORSE_DEGRADED * length_s else "good",
            f"{spoken(Channel[name.upper()])} was believed less for {seconds:.0f} s, its variance "
            f"up to {most:.3g} times what it should be",
            "See when, and what the innovations looked like, under adaptation.",
        )


def _declared(run: RunView) -> Iterator[Evidence]:
    resets = int(run.solution.resets[-1]) if len(run.solution) else 0
    if resets:
        yield Evidence(
            "bad" if resets > 2 else "degraded",
            f"the filter declared {resets} reset{'s' * (resets > 1)}",
            "See the events: what did not fit, and when.",
        )
    for level, of in (("error", "bad"), ("warning", "degraded")):
        mine = [e for e in run.events if e.level == level]
        if mine:
            first = mine[0]
            yield Evidence(
                "bad" if of == "bad" else "degraded",
                f"{len(mine)} {level}{'s' * (len(mine) > 1)}, first {first.kind}: {first.text}",
                "See the events.",
            )


def _sensors(run: RunView) -> Iterator[Evidence]:
    for stream in run.vehicle.streams:
        if stream.kind == "imu" and run.vehicle.imu and stream.source == run.vehicle.imu[0].source:
            if stream.gaps:
                yield Evidence(
                    "degraded",
                    f"the IMU {stream.source} had {stream.gaps} gaps, the longest "
                    f"{stream.longest_gap_s:.2f} s",
                    "Bus load, wiring, or a logger that cannot keep up.",
                )
            else:
                yield Evidence("good", f"IMU without gaps at {stream.rate_hz:.0f} Hz")
