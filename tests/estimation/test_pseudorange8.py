"""The eight-state filter: its noise by their integral, its modes, fewer than four ranges."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad_vec

from companion.config import RawGnss
from companion.estimation.pseudorange8 import EightState, Tuning, process_noise, transition
from companion.intake.raw_gnss.receiver import Receiver
from companion.navigation.earth import ecef
from companion.types import F64
from replay.reproduce.sasiadek import flight as air

TUNING = Tuning(accel_mps2_rthz=0.01, clock_m_rts=0.3, drift_mps_rts=0.2)


@pytest.fixture(scope="module")
def flown() -> air.Flight:
    hours, air.HOURS = air.HOURS, 0.2
    try:
        return air.fly(4)
    finally:
        air.HOURS = hours


def _errors(flown: air.Flight, feedback: bool, left: int | None = None) -> F64:
    receiver = Receiver(RawGnss(sd_range_m=air.SD_RANGE_M, sd_multipath_m=0.0, iono_residual=0.0))
    receiver.listen(flown.sky.broadcast)
    filter_ = EightState(TUNING, feedback=feedback)
    truth = ecef(*flown.truth.T)
    out = []
    for i in range(len(flown.seconds)):
        rows = receiver.take(flown.sky.raw, i).rows
        rows = rows[:left] if left is not None and i >= 400 else rows
        estimate = filter_.step(1.0, flown.ins[i], rows)
        out.append(np.linalg.norm(estimate.ecef - truth[i]))
    return np.array(out)


def test_process_noise_is_the_papers_integral() -> None:
    Q = np.zeros((8, 8))
    Q[range(1, 6, 2), range(1, 6, 2)] = TUNING.accel_mps2_rthz**2
    Q[6, 6], Q[7, 7] = TUNING.clock_m_rts**2, TUNING.drift_mps_rts**2
    numeric = quad_vec(lambda t: transition(t) @ Q @ transition(t).T, 0.0, 2.0)[0]
    assert process_noise(2.0, TUNING) == pytest.approx(numeric, abs=1e-12)


def test_both_modes_hold_a_drifting_ins(flown: air.Flight) -> None:
    ins = np.linalg.norm(ecef(*flown.ins.T) - ecef(*flown.truth.T), axis=1)
    for feedback in (False, True):
        error = _errors(flown, feedback)
        # Ranges of 1.8 m with a GDOP of 2 to 3: 3-D errors of 4 m; the INS is hundreds off.
        assert np.sqrt((error[100:] ** 2).mean()) < 8.0
    assert ins[-1] > 500.0


def test_two_satellites_are_better_than_none(flown: air.Flight) -> None:
    two, none = _errors(flown, True, left=2), _errors(flown, True, left=0)
    assert np.sqrt((two[400:] ** 2).mean()) < 0.8 * np.sqrt((none[400:] ** 2).mean())
