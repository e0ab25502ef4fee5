"""Between gate and update: one function for each method says how far a measurement is trusted.

All that a method remembers lives in the filter's state, so that going back in time restores it
with the rest; a bank over headings, whose innovations tell of the wrong heading, is not adapted.
"""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.estimation.adaptation import baselines as bl
from companion.estimation.adaptation.flac import fade, flac_scale, small
from companion.estimation.adaptation.fuzzy import fuzzy_scale, gather_q
from companion.estimation.adaptation.layout import (
    FIRING,
    FLAC,
    FUZZY,
    HUBER,
    IGG3,
    IN_MEAN,
    INNOVATION,
    NONE,
    OUT_ALPHA,
    OUT_Q,
    OUT_R,
    TO_MODEL,
    TRACED,
)
from companion.estimation.parameters import ADAPTATION, ADAPTATION_AT, BANK
from companion.estimation.tape import RECORDER, Recorder, record_fade
from companion.navigation.layout import ADAPTED, ALPHA, L_N, Q_SCALE, R_SCALE
from companion.navigation.layout import P as P_OFFSET
from companion.types import F64, I64

ABSURD = 1e24
"""NIS of a million million deviations: its square roots are no numbers to average."""


@njit("b1(i8[::1], i8)", cache=True)
def adapts(ipar: I64, channel: int) -> bool:
    """Whether a method looks at measurements of this channel."""
    return ipar[ADAPTATION] != NONE and ipar[BANK] == 0 and channel < ADAPTED


@njit(
    "f8(f8[::1], f8[::1], i8[::1], i8, i8, f8[::1], f8[::1], f8[::1], f8[::1], f8, f8, f8[::1])",
    cache=True,
)
def adapt(
    s: F64,
    par: F64,
    ipar: I64,
    channel: int,
    m: int,
    y: F64,
    u: F64,
    foreseen: F64,
    R: F64,
    nis: float,
    gate: float,
    trace: F64,
) -> float:
    """The factor on ``R`` (3,) of this measurement; the method learns from it.

    ``y`` (3,) innovation, ``u`` (3,) the same whitened with R as it is said, ``nis`` its square,
    ``foreseen`` (3,) the diagonal of H P Hᵀ. ``trace`` (TRACE_SIZE,) is filled.
    """
    a = par[ADAPTATION_AT:]
    method = ipar[ADAPTATION]
    trace[TRACED] = 1.0
    for i in range(IN_MEAN, TO_MODEL):
        trace[i] = np.nan
    for i in range(TO_MODEL, FIRING + 9):
        trace[i] = 0.0
    scale = 1.0
    if not nis < ABSURD:
        scale = s[R_SCALE + channel]  # the gate refuses it, and nothing can be learned of it
    elif method == FUZZY:
        said, seen = 0.0, 0.0
        for i in range(m):
            said += R[i] / m
            seen += foreseen[i] / m
        scale = fuzzy_scale(s, par, a, channel, m, u, nis, gate, seen, said, trace)
        gather_q(s)
    elif method == FLAC:
        scale = flac_scale(s, a, channel, m, u, trace)
    elif method == INNOVATION:
        scale = bl.innovation_scale(s, a, channel, m, y, foreseen, R)
    elif method == HUBER:
        scale = bl.huber_scale(a, m, nis)
    elif method == IGG3:
        scale = bl.igg3_scale(a, m, nis)
    else:
        scale = bl.variational_scale(s, a, channel, m, y, foreseen, R)
    s[R_SCALE + channel] = scale
    trace[OUT_R], trace[OUT_Q], trace[OUT_ALPHA] = scale, s[Q_SCALE], s[ALPHA]
    return scale


@njit(f"void(f8[::1], i8[::1], i8[::1], {RECORDER})", cache=True)
def after_fix(s: F64, lay: I64, ipar: I64, tape: Recorder) -> None:
    """What a method does once all of a fix is in: FLAC forgets."""
    if ipar[ADAPTATION] != FLAC or ipar[BANK] == 1:
        return
    n = lay[L_N]
    P = s[P_OFFSET : P_OFFSET + n * n].reshape((n, n))
    square = fade(s, P, n, small(P))
    if square > 1.0:
        record_fade(tape, square)
