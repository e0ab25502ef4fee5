"""The bank over an unknown heading: a filter a hypothesis, weighed by how it foresees the aids."""

from __future__ import annotations

import math

import numpy as np

from companion.config import DEG
from companion.estimation import walk as w
from companion.estimation.phases import Check, Filter, Phase, Setup
from companion.estimation.recording import Tape
from companion.estimation.source_faults import forget
from companion.navigation import layout as lo
from companion.navigation.rotation import rotate_nav, yaw_of
from companion.types import F64, I64, NS, Event, Mode

OVERLAP = 2.0
"""Neighbouring innovations share errors: half of their evidence on the heading is repetition."""


def mixture(log_likelihood: F64, misfit: F64, yaw: F64, var: F64) -> tuple[int, float]:
    """Likeliest hypothesis and the heading's standard deviation over all of them [rad].

    All (N,), one entry a hypothesis: log-likelihood, NIS per component of what they compete on,
    heading [rad] and its variance.
    """
    # Evidence counts less where even the best hypothesis fits worse than its covariance says.
    worse = max(1.0, float(misfit[int(np.argmax(log_likelihood))]))
    weight = np.exp((log_likelihood - log_likelihood.max()) / (OVERLAP * worse))
    weight /= weight.sum()
    best = int(np.argmax(weight))
    off = np.remainder(yaw - yaw[best] + math.pi, 2 * math.pi) - math.pi
    mean = float(weight @ off)
    spread = float(weight @ (np.minimum(worse * var, math.pi**2) + (off - mean) ** 2))
    return best, math.sqrt(spread)


def widen_heading(phase: Phase, rows: F64) -> None:
    """Publish in output ``rows`` the bank's heading uncertainty, not one hypothesis' own."""
    var = rows[:, w.O_COV + 2 * 6 + 5]
    np.maximum(var, phase.checks[-1].heading_sd ** 2, out=var)


def find_heading(setup: Setup, phase: Phase, t: int) -> tuple[Phase, Event] | None:
    """Judge the bank at ``t``: the phase of its likeliest filter once the heading is known."""
    states = [f.s for f in phase.filters]
    best, sd = mixture(
        np.array([s[lo.LOG_LIKELIHOOD] for s in states]),
        np.array([s[lo.BANK_NIS] / max(s[lo.BANK_DOF], 1.0) for s in states]),
        np.array([yaw_of(s) for s in states]),
        np.array([setup.covariance(s)[8, 8] for s in states]),
    )
    phase.checks = [*phase.checks[-8:], Check(t, best, sd)]
    if sd > setup.config.alignment.heading_found_sd_deg * DEG:
        return None
    f = phase.filters[best]
    s, k = f.s.copy(), f.k.copy()
    P = setup.covariance(s)
    P[8, 8] = max(P[8, 8], sd * sd)
    s[lo.LOG_LIKELIHOOD] = s[lo.BANK_NIS] = s[lo.BANK_DOF] = s[lo.VELOCITY_FIT] = 0.0
    forget(s, k)
    if f.tape is None:
        found = setup.new_filter(s, k)
    else:
        assert isinstance(f.tape, Tape)
        found = Filter.start(s, k, setup.slots)
        # A smoother goes on through the hypothesis that won; P was widened: a new chunk.
        f.tape.cut(s, k, widened=True)
        found.tape, f.tape = f.tape, None
    new = Phase(t + 1, Mode.NAVIGATING, [found], resets=phase.resets)
    new.checks = [Check(t)]
    yaw = math.degrees(yaw_of(s)) % 360
    text = (
        f"heading {yaw:.0f}° ± {math.degrees(sd):.1f}° found from motion "
        f"{(t - phase.start_ns) / NS:.1f} s after the start"
    )
    return new, Event(t, "heading-found", text)


def spread_headings(setup: Setup, s: F64, k: I64) -> list[Filter]:
    """Filters that begin at one state, turned to every hypothesis of the heading."""
    count = setup.config.alignment.hypotheses
    filters = []
    for m in range(count):
        turned = s.copy()
        rotate_nav(turned, 0.0, 0.0, 2.0 * math.pi * m / count)
        filters.append(setup.new_filter(turned, k.copy(), alone=False))
    return filters
