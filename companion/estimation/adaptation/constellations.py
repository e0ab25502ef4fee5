"""Adaptation of ranges: each satellite system's range and rate has a window and a factor on its R.

What goes in is how far the satellites of a system scatter about each epoch's own solution
(:mod:`companion.gnss.scatter`); of the rules of :mod:`fuzzy`, those for a mean of zero say what R
does: what moves all satellites of an epoch at once is in its solution, and not in what is left.
The factor is in force from the epoch on that it was learned of, for the test of faults as well.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.config import Config
from companion.estimation.adaptation.fuzzy import conclude, fire, slew
from companion.estimation.adaptation.layout import (
    FIRING,
    IN_SPREAD,
    OUT_R,
    TRACE_SIZE,
    TRACED,
)
from companion.estimation.adaptation.parameters import (
    LENGTH,
    R_MAX,
    R_MIN,
    R_TABLE,
    adaptation_vector,
)
from companion.estimation.adaptation.window import FEWEST, deviate_of_chi2
from companion.gnss.systems import SYSTEMS
from companion.types import F64, I64, AdaptationTrace, Channel

CHANNELS = 2 * SYSTEMS
_EVERY = np.array([*range(Channel.RANGE_GPS, Channel.RANGE_GPS + CHANNELS)])
_LONE_S = 1.0
"""Taken for the interval in front of the first epoch."""


@njit(
    "void(f8[:, :, ::1], f8[:, :, ::1], i8[:, ::1], f8[::1], f8[::1], f8[:, ::1], f8[:, ::1])",
    cache=True,
)
def judge(
    found: F64, rings: F64, at: I64, fresh: F64, a: F64, factors: F64, traces: F64
) -> None:  # fmt: skip
    """Take one epoch into the windows, and move the ``factors`` (2, SYSTEMS) on R.

    ``found`` as of :func:`companion.gnss.scatter.scatter`, measured with R as it is scaled;
    ``rings`` (6, window, 2) the same as said of R unscaled; ``at`` (6, 2): filled, next;
    ``fresh`` (2,): share of an epoch's redundancy that the one before did not tell already; ``a``:
    :mod:`parameters`. ``traces`` (6, TRACE_SIZE): row by row why, TRACED 0 where nothing came in.
    """
    length, shares = int(a[LENGTH]), np.ones(3)
    for c in range(rings.shape[0]):
        kind, system = c // SYSTEMS, c % SYSTEMS
        trace, ring = traces[c], rings[c]
        trace[TRACED] = 0.0
        if not found[kind, system, 1] > 0.0:
            continue
        now = factors[kind, system]
        ring[at[c, 1], 0] = min(now * found[kind, system, 0], a[R_MAX] * found[kind, system, 1])
        ring[at[c, 1], 1] = found[kind, system, 1]
        at[c, 0], at[c, 1] = min(at[c, 0] + 1, length), (at[c, 1] + 1) % length
        if at[c, 0] < FEWEST:
            continue
        total, dof, largest, second = 0.0, 0.0, 0.0, 0.0
        for k in range(at[c, 0]):
            total += ring[k, 0]
            dof += ring[k, 1]
            if ring[k, 0] > largest:
                largest, second = ring[k, 0], largest
            elif ring[k, 0] > second:
                second = ring[k, 0]
        # No single epoch decides either.
        v = (total - largest + second) / dof
        spread = deviate_of_chi2(v, max(dof * fresh[kind], 1.0))
        weights = trace[FIRING : FIRING + 9]
        fire(a, 0.0, spread, weights)
        match = min(max(v, a[R_MIN]), a[R_MAX])
        target = conclude(a, R_TABLE, weights, shares, now, match, now)
        factors[kind, system] = slew(now, target, a, a[R_MIN], a[R_MAX])
        trace[TRACED], trace[IN_SPREAD], trace[OUT_R] = 1.0, spread, factors[kind, system]


@njit("f8(f8, f8, i8)", cache=True, counted=False)
def fresh_share(slow: float, phi: float, length: int) -> float:
    """Effective part of ``length`` squares of an error with autocorrelation ``slow``·``phi``^k.

    1 / (1 + 2 Σ (1 − k/n) ρ_k²): the variance of their mean against that of independent ones.
    """
    total, rho = 0.0, slow
    for k in range(1, length):
        rho *= phi
        total += (1.0 - k / length) * rho * rho
    return 1.0 / (1.0 + 2.0 * total)


@njit("void(i8, f8, f8, i8, i8[::1], f8[::1])", cache=True, counted=False)
def news(t_ns: int, slow: float, tau_s: float, length: int, last: I64, fresh: F64) -> None:
    """``fresh`` (2,): what of range and of rate an epoch at ``t_ns`` tells that is new.

    ``last`` (2,): whether there was one before, and when; it goes on. Intervals count by the
    millisecond: a receiver's clock wanders.
    """
    apart_ms = _LONE_S * 1e3
    if last[0] == 1:
        apart_ms = max(np.rint(abs(t_ns - last[1]) * 1e-6), 1.0)
    last[0], last[1] = 1, t_ns
    fresh[0] = fresh_share(slow, math.exp(-1e-3 * apart_ms / tau_s), length)
    fresh[1] = 1.0


class Constellations:
    """How far the ranges and rates of each system are trusted, epoch by epoch in their order.

    The state is in arrays: who solves epochs (:mod:`companion.intake.raw_gnss`) moves it on.
    """

    def __init__(self, config: Config) -> None:
        raw = config.raw_gnss
        self.factors: F64 = np.ones((2, SYSTEMS))
        """On R of ranges and of rates, system by system."""
        self.parameters = adaptation_vector(config.adaptation)
        self.rings = np.zeros((CHANNELS, config.adaptation.window, 2))
        """And where in them is written, ``at``: as :func:`judge` takes them."""
        self.at = np.zeros((CHANNELS, 2), np.int64)
        self.last = np.zeros(2, np.int64)
        """As :func:`news` takes it."""
        self.slow = raw.sd_multipath_m**2 / (raw.sd_range_m**2 + raw.sd_multipath_m**2)
        """Part of a range's variance that lasts from epoch to epoch."""
        self._told: list[tuple[I64, F64]] = []

    def tell(self, t_ns: I64, traces: F64) -> None:
        """Keep the ``traces`` (N, CHANNELS, TRACE_SIZE) of epochs for people."""
        self._told.append((t_ns, traces.reshape(-1, TRACE_SIZE)))

    def take_trace(self) -> AdaptationTrace:
        """What was learned since the last call, for people: one row an epoch and channel."""
        told, self._told = self._told, []
        if not told:
            return AdaptationTrace.empty()
        t = np.repeat(np.concatenate([t_ns for t_ns, _ in told]), CHANNELS)
        rows = np.concatenate([rows for _, rows in told])
        some = rows[:, TRACED] == 1.0
        channel = np.tile(_EVERY, len(t) // CHANNELS)[some]
        t, rows, n = t[some], rows[some], int(some.sum())
        none, zero = np.full(n, np.nan), np.zeros(n)
        return AdaptationTrace(
            t_ns=t, channel=channel, source=np.zeros(n, np.int64),
            mean=none, spread=rows[:, IN_SPREAD].copy(), correlation=none, to_model=zero,
            to_source=zero, firing=rows[:, FIRING : FIRING + 9].copy(),
            r_scale=rows[:, OUT_R].copy(), q_scale=none, alpha=none,
        )  # fmt: skip
