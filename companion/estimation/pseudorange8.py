"""The eight-state filter of Sasiadek and Hartana beside an INS that somebody else runs.

States (their eq. 9): east, north and up position error [m], each with its rate [m/s], clock bias
[m] and drift [m/s]; the INS's error is driven by white acceleration:

    x_{k+1} = Φ x_k + w_k,   Φ = exp(F T),   z = measured − predicted pseudorange = H x + v

*Feedforward*: the INS is never told; ranges are predicted where it says it is, and the output is
INS + estimated error. *Feedback*: the estimated error is taken out of what the INS says, so that
ranges are predicted where the vehicle is. The two are one filter but for where H is taken, which is
why feedforward gets worse as the INS drifts off: (9 km)² / 2 ρ are 2 m. Any number of satellites
aids, one too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.gnss.corrected import S_RANGE, S_RANGE_VAR, expected_range
from companion.gnss.geometry import geodetic, ned_axes
from companion.navigation.earth import ecef
from companion.types import F64

E, E_RATE, N, N_RATE, U, U_RATE, CLOCK, DRIFT = range(8)
STATES = 8
_PLACES = (E, N, U)


@dataclass(frozen=True, slots=True)
class Tuning:
    """Noise that drives the filter, and what it knows at the start; 1σ."""

    accel_mps2_rthz: float = 0.05
    """White acceleration of the INS's error, each axis [m/s²/√Hz]."""
    clock_m_rts: float = 0.3
    drift_mps_rts: float = 0.1
    position_m: float = 5_000.0
    velocity_mps: float = 30.0
    clock_m: float = 1e5
    drift_mps: float = 1e3


@dataclass(frozen=True, slots=True)
class Estimate:
    """What an epoch gives out."""

    ecef: F64
    """(3,) [m]."""
    velocity_error: F64
    """(3,) estimated error of the INS's velocity, east, north, up [m/s]."""
    clock: tuple[float, float]
    variances: F64
    """(8,) diagonal of P."""
    gain: float
    """Norm of the gain's east position row: what a metre of range moves the place by."""
    used: int


class EightState:
    """The filter; epochs in order."""

    def __init__(self, tuning: Tuning, *, feedback: bool) -> None:
        self.tuning = tuning
        self.feedback = feedback
        self.x = np.zeros(STATES)
        """Error of the INS; with feedback, error of the corrected INS, zero behind each epoch."""
        self.P = np.zeros((STATES, STATES))
        for at, sd in ((0, tuning.position_m), (1, tuning.velocity_mps)):
            self.P[range(at, 6, 2), range(at, 6, 2)] = sd**2
        self.P[CLOCK, CLOCK], self.P[DRIFT, DRIFT] = tuning.clock_m**2, tuning.drift_mps**2
        self._fed = np.zeros(STATES)
        """What the INS has been told so far, carried on as it carries it: by its own rates."""

    def step(self, dt: float, place: F64, rows: F64) -> Estimate:
        """Carry on by ``dt`` [s] and take the satellites ``rows`` (M, 12) of an epoch.

        ``place`` (3,): latitude, longitude [rad], height [m] as the INS has them.
        """
        phi, q = transition(dt), process_noise(dt, self.tuning)
        self.x, self._fed = phi @ self.x, phi @ self._fed
        self.P = phi @ self.P @ phi.T + q
        axes = np.empty((3, 3))
        ned_axes(float(place[0]), float(place[1]), axes)
        east_north_up = np.stack([axes[1], axes[0], -axes[2]])
        ins = ecef(place[:1], place[1:2], place[2:3])[0]
        base = ins + east_north_up.T @ self._fed[[E, N, U]]
        gain = self._update(base, east_north_up, rows)
        if self.feedback:
            self._fed += self.x
            self.x = np.zeros(STATES)
        total = self._fed + self.x
        return Estimate(
            ins + east_north_up.T @ total[[E, N, U]],
            total[[E_RATE, N_RATE, U_RATE]],
            (float(total[CLOCK]), float(total[DRIFT])),
            np.diag(self.P).copy(),
            gain,
            len(rows),
        )

    def _update(self, base: F64, axes: F64, rows: F64) -> float:
        """All ranges of an epoch at once; the norm of the gain's east row."""
        m = len(rows)
        if m == 0:
            return 0.0
        here, u = np.empty(3), np.empty(3)
        geodetic(base[0], base[1], base[2], here)
        H, z = np.zeros((m, STATES)), np.empty(m)
        for i, row in enumerate(rows):
            z[i] = row[S_RANGE] - expected_range(row, base, here, u) - self._fed[CLOCK]
            H[i, list(_PLACES)] = -(axes @ u)
            H[i, CLOCK] = 1.0
        S = H @ self.P @ H.T + np.diag(rows[:, S_RANGE_VAR])
        K = np.linalg.solve(S, H @ self.P).T
        self.x = self.x + K @ (z - H @ self.x)
        A = np.eye(STATES) - K @ H
        self.P = A @ self.P @ A.T + (K * rows[:, S_RANGE_VAR]) @ K.T
        return float(np.linalg.norm(K[E]))


def transition(dt: float) -> F64:
    """Φ = exp(F dt): each of the four pairs by its rate; exact, F² being zero."""
    phi = np.eye(STATES)
    for i in range(0, STATES, 2):
        phi[i, i + 1] = dt
    return phi


def process_noise(dt: float, tuning: Tuning) -> F64:
    """Q_k = ∫ exp(Fτ) Q exp(Fᵀτ) dτ, their eq. 12."""
    q = np.zeros((STATES, STATES))
    for i in range(0, STATES, 2):
        psd = (tuning.drift_mps_rts if i == CLOCK else tuning.accel_mps2_rthz) ** 2
        q[i, i] = psd * dt**3 / 3.0
        q[i, i + 1] = q[i + 1, i] = psd * dt**2 / 2.0
        q[i + 1, i + 1] = psd * dt
    q[CLOCK, CLOCK] += tuning.clock_m_rts**2 * dt
    return q
