"""Where everything lies in the direct filter's state: one float64 vector beside one int64 vector.

As :mod:`companion.navigation.layout` for the error-state filter: copying both is a snapshot. What
the adaptation keeps lies where it does there, so that one kernel adapts both filters. The place of
the standstill detector in front of it stays empty: no inertial unit drives this model, so none is
ever strained, and what speaks for an error of the model is the receiver's velocity alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.navigation import layout as common
from companion.types import F64, I64

# --- nominal state, offsets into s
Q = common.Q  # q_nb (4)
LAT, LON, HEIGHT = common.LAT, common.LON, common.HEIGHT
VEL_N = common.VEL_N  # (3)
ACC_N = 10  # (3) acceleration over the ground, dv_n/dt
RATE_B = 13  # (3) w_nb_b
BARO_BIAS = 16
GNSS_BIAS = 17  # (3) slow error of the receiver's position, NED
ATTITUDE_BIAS = 20  # (3) slow error of another estimator's attitude, body axes
# --- running likelihood of the aiding, for the bank over headings
LOG_LIKELIHOOD, BANK_NIS, BANK_DOF = 23, 24, 25
# --- transitions (Yu eqs 40-44): specific force of the first IMU before this one
LAST_FORCE_X, LAST_FORCE_Y = 26, 27
CLOCK = 28  # (5) receiver clock, as common.CLOCK
UNITS = common.P  # per IMU: gyro bias, accelerometer bias, gyro scale, accelerometer scale (3 each)
UNIT_SIZE = 12
# behind all units' twelve, per IMU: variance of its force beyond model and density (3), and the
# innovation of the force refused last (3)
SHAKE_SIZE = 6

# --- integer state, offsets into k; the first two where the snapshots' owner expects them
T_NOW, T_IMU = common.T_NOW, common.T_IMU
(
    T_POSITION_AID,  # last accepted GNSS position
    T_VELOCITY_AID,
    T_OUTPUT,  # grid cell of the last output row
    T_REJECT,  # since when position aiding has been rejected without a break; 0 none
    T_REJECT_HEIGHT,  # the same for height, by receiver and barometer alike
    RESETS,  # declared resets so far
    T_CHECK,  # sample at which the last decision above the kernel was taken
    SNAP_CELL,  # grid cell of the last snapshot
    SNAP_COUNT,  # snapshots so far: where in the ring the next one goes
    CIRCULAR,  # 1 while the circular-motion mechanism holds the lateral acceleration
    HAVE_FORCE,  # 1 once LAST_FORCE is valid
    EPOCH_SEEN,  # ranges of the running epoch
    EPOCH_TAKEN,  # those that were accepted
    UNIT_TIMES,  # per IMU: last sample, last fused sample, refused samples in a row
) = range(2, 16)
UNIT_INTS = 3

# --- error state
POS, VEL, ACC, ATT, RATE, UNIT = 0, 3, 6, 9, 12, 15
KINEMATIC = 15
GYRO_BIAS, ACCEL_BIAS, GYRO_SCALE, ACCEL_SCALE = 0, 3, 6, 9  # inside a unit's twelve

# --- entries of the layout vector handed to kernels
L_N, L_UNITS, L_BARO, L_GNSS, L_ATTITUDE, L_CLOCK, L_P = range(7)


@dataclass(frozen=True, slots=True)
class Layout:
    """Error-state indices of the slow errors of aids; −1 where one is absent."""

    n: int
    units: int
    baro: int
    gnss: int
    attitude: int
    clock: int

    @classmethod
    def build(
        cls, units: int, *, baro: bool, gnss: bool, attitude: bool, clock: bool = False
    ) -> Layout:
        """Lay out N units and the chosen slow errors behind the fifteen of the trajectory."""
        at = KINEMATIC + UNIT_SIZE * units
        index = {"baro": -1, "gnss": -1, "attitude": -1, "clock": -1}
        for name, wanted, size in (
            ("baro", baro, 1),
            ("gnss", gnss, 3),
            ("attitude", attitude, 3),
            ("clock", clock, common.CLOCK_STATES),
        ):
            if wanted:
                index[name] = at
                at += size
        return cls(n=at, units=units, **index)

    @property
    def covariance(self) -> int:
        """Offset of P in the float state."""
        return UNITS + (UNIT_SIZE + SHAKE_SIZE) * self.units

    @property
    def size(self) -> int:
        """Length of the float state vector."""
        return self.covariance + self.n * self.n

    @property
    def int_size(self) -> int:
        """Length of the int state vector."""
        return UNIT_TIMES + UNIT_INTS * self.units

    def blank(self) -> tuple[F64, I64]:
        """States of which nothing is known yet: all zero, nothing scaled."""
        s, k = np.zeros(self.size), np.zeros(self.int_size, np.int64)
        s[common.R_SCALE : common.RECEPTION] = s[common.R_LEAST : common.WINDOWS] = 1.0
        return s, k

    def vector(self) -> I64:
        """For kernels, by the ``L_`` names."""
        return np.array(
            [
                self.n,
                self.units,
                self.baro,
                self.gnss,
                self.attitude,
                self.clock,
                self.covariance,
            ],
            dtype=np.int64,
        )
