"""The bank over an unknown heading: a filter a hypothesis, weighed by how it foresees the aids."""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.config import DEG
from companion.estimation.output_row import O_ACCEL_BIAS, O_COV, O_Q, O_VEL
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


def mixture(log_likelihood: F64, misfit: F64, yaw: F64, var: F64) -> tuple[int, float, F64]:
    """Likeliest hypothesis, the heading's deviation from it over all [rad], and their weights.

    sd² = Σ w (var + d²) with d what a heading differs by from the likeliest one's: that one is
    published, and carried on once the heading is found, so the spread is not about the mean.
    All (N,), one entry a hypothesis: log-likelihood, NIS per component of what they compete on,
    heading [rad] and its variance.
    """
    # Evidence counts less where even the best hypothesis fits worse than its covariance says.
    worse = max(1.0, float(misfit[int(np.argmax(log_likelihood))]))
    weight = np.exp((log_likelihood - log_likelihood.max()) / (OVERLAP * worse))
    weight /= weight.sum()
    best = int(np.argmax(weight))
    off = np.remainder(yaw - yaw[best] + math.pi, 2 * math.pi) - math.pi
    spread = float(weight @ (np.minimum(worse * var, math.pi**2) + off**2))
    return best, math.sqrt(spread), weight


def widen_heading(phase: Phase, rows: F64) -> None:
    """Publish in output ``rows`` the bank's heading uncertainty, not one hypothesis' own."""
    var = rows[:, O_COV + 2 * 6 + 5]
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
    for weight, rows in zip(check.weights, hypotheses, strict=True):
        if weight >= NEGLIGIBLE:
            _spread(published, rows, n, weight)


@njit("void(f8[:, ::1], f8[:, ::1], i8, f8)", cache=True, entry=True)
def _spread(own: F64, other: F64, count: int, weight: float) -> None:
    """Add ``weight`` d dᵀ to the blocks of the first ``count`` rows of ``own``.

    d is what rows of another filter differ by: velocity, level (n axes, 0 about down), biases.
    """
    for row in range(count):
        here, there = own[row], other[row]
        for block in range(1, 5):
            if block == 2:
                x, y = _tilt(here, there)
                z = 0.0
            else:
                at = O_VEL if block == 1 else O_ACCEL_BIAS + 3 * (block - 3)
                x = there[at] - here[at]
                y = there[at + 1] - here[at + 1]
                z = there[at + 2] - here[at + 2]
            at = O_COV + 6 * block
            here[at] += weight * x * x
            here[at + 1] += weight * x * y
            here[at + 2] += weight * x * z
            here[at + 3] += weight * y * y
            here[at + 4] += weight * y * z
            here[at + 5] += weight * z * z


@njit("UniTuple(f8, 2)(f8[::1], f8[::1])", cache=True)
def _tilt(here: F64, there: F64) -> tuple[float, float]:
    """The small rotation about north and east between the levels of two output rows [rad]."""
    down0, down1, down2 = _down(here)
    its0, its1, its2 = _down(there)
    x = down1 * its2 - down2 * its1
    y = down2 * its0 - down0 * its2
    z = down0 * its1 - down1 * its0
    q0, q1, q2, q3 = here[O_Q], here[O_Q + 1], here[O_Q + 2], here[O_Q + 3]
    # The first two rows of C_nb turn the small rotation from body axes.
    north = (q0 * q0 + q1 * q1 - q2 * q2 - q3 * q3) * x
    north += 2 * (q1 * q2 - q0 * q3) * y + 2 * (q1 * q3 + q0 * q2) * z
    east = 2 * (q1 * q2 + q0 * q3) * x + (q0 * q0 - q1 * q1 + q2 * q2 - q3 * q3) * y
    east += 2 * (q2 * q3 - q0 * q1) * z
    return north, east


@njit("UniTuple(f8, 3)(f8[::1])", cache=True)
def _down(row: F64) -> tuple[float, float, float]:
    """The direction of gravity in body axes of an output row's attitude."""
    q0, q1, q2, q3 = row[O_Q], row[O_Q + 1], row[O_Q + 2], row[O_Q + 3]
    return (
        2 * (q1 * q3 - q0 * q2),
        2 * (q2 * q3 + q0 * q1),
        q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3,
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
