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
NEGLIGIBLE = 1e-6
"""Weight below which a hypothesis adds nothing to what is published."""
_TRIANGLE = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def mixture(log_likelihood: F64, misfit: F64, yaw: F64, var: F64) -> tuple[int, float, F64]:
    """Likeliest hypothesis, the heading's standard deviation over all [rad], and their weights.

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
    return best, math.sqrt(spread), weight


def widen_heading(phase: Phase, rows: F64) -> None:
    """Publish in output ``rows`` the bank's heading uncertainty, not one hypothesis' own."""
    var = rows[:, w.O_COV + 2 * 6 + 5]
    np.maximum(var, phase.checks[-1].heading_sd ** 2, out=var)


def widen_rest(phase: Phase, published: F64, hypotheses: list[F64]) -> None:
    """Publish of level, velocity and biases what the bank knows, not what one hypothesis claims.

    P + Σ w d dᵀ with d what a hypothesis differs by: at rest each takes another part of the gyro's
    mean for Earth's rate, and is surer of the rest than the heading allows any of them to be.
    ``published`` (N, ROW_SIZE) are rows of the likeliest filter, ``hypotheses`` those of every
    filter at the same times.
    """
    check = phase.checks[-1]
    n = min(len(rows) for rows in (published, *hypotheses))
    own = published[:n]
    cov = own[:, w.O_COV : w.O_COV + 30].reshape(-1, 5, 6)
    for weight, rows in zip(check.weights, hypotheses, strict=True):
        if weight < NEGLIGIBLE:
            continue
        for block, apart in enumerate(_apart(own, rows[:n]), 1):
            for at, (i, j) in enumerate(_TRIANGLE):
                cov[:, block, at] += weight * apart[i] * apart[j]
    own[:, w.O_COV : w.O_COV + 30] = cov.reshape(-1, 30)


def _apart(own: F64, other: F64) -> tuple[F64, F64, F64, F64]:
    """What two filters differ by in velocity, level (n axes, 0 about down) and biases, (3, N)."""
    here, there = own.T, other.T
    down, its_down = _down(here[w.O_Q : w.O_Q + 4]), _down(there[w.O_Q : w.O_Q + 4])
    x = down[1] * its_down[2] - down[2] * its_down[1]
    y = down[2] * its_down[0] - down[0] * its_down[2]
    z = down[0] * its_down[1] - down[1] * its_down[0]
    q0, q1, q2, q3 = here[w.O_Q : w.O_Q + 4]
    # The first two rows of C_nb turn the small rotation from body axes.
    north = (q0 * q0 + q1 * q1 - q2 * q2 - q3 * q3) * x
    north += 2 * (q1 * q2 - q0 * q3) * y + 2 * (q1 * q3 + q0 * q2) * z
    east = 2 * (q1 * q2 + q0 * q3) * x + (q0 * q0 - q1 * q1 + q2 * q2 - q3 * q3) * y
    east += 2 * (q2 * q3 - q0 * q1) * z
    velocity, accel, gyro = (
        there[at : at + 3] - here[at : at + 3] for at in (w.O_VEL, w.O_ACCEL_BIAS, w.O_GYRO_BIAS)
    )
    return velocity, np.stack([north, east, np.zeros_like(north)]), accel, gyro


def _down(q: F64) -> F64:
    """The direction of gravity in body axes (3, N) of attitudes ``q`` (4, N)."""
    return np.stack(
        [
            2 * (q[1] * q[3] - q[0] * q[2]),
            2 * (q[2] * q[3] + q[0] * q[1]),
            q[0] * q[0] - q[1] * q[1] - q[2] * q[2] + q[3] * q[3],
        ]
    )


def find_heading(setup: Setup, phase: Phase, t: int) -> tuple[Phase, Event] | None:
    """Judge the bank at ``t``: the phase of its likeliest filter once the heading is known."""
    states = [f.s for f in phase.filters]
    best, sd, weights = mixture(
        np.array([s[lo.LOG_LIKELIHOOD] for s in states]),
        np.array([s[lo.BANK_NIS] / max(s[lo.BANK_DOF], 1.0) for s in states]),
        np.array([yaw_of(s) for s in states]),
        np.array([setup.covariance(s)[8, 8] for s in states]),
    )
    phase.checks = [*phase.checks[-8:], Check(t, best, sd, tuple(weights.tolist()))]
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
