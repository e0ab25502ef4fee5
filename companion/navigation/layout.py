"""Where everything lies: the filter's state as one flat float64 vector beside one int64 vector.

One vector holds all that a moment of the filter is: nominal state, the sums of the running
covariance interval, the standstill detector, the adaptation, and P. Copying it is a snapshot,
restoring it is going back in time, storing it is a checkpoint for a smoother. Kernels index it with
the offsets below; the error state is indexed with :data:`POS` … :data:`GYRO_BIAS` and, for optional
states, with the :class:`Layout` of a configuration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.types import I64

# --- nominal state, offsets into s
Q = 0  # q_nb (4): first, so that the rotation kernels take the whole vector
LAT, LON, HEIGHT = 4, 5, 6
VEL_N = 7  # (3)
ACCEL_BIAS_B = 10  # (3)
GYRO_BIAS_B = 13  # (3)
ACCEL_SCALE_B = 16  # (3) f_true = f_measured − bias − scale·f_measured
GYRO_SCALE_B = 19  # (3)
LEVER_B = 22  # (3) IMU to antenna
BARO_BIAS = 25  # pressure height − height
GNSS_BIAS = 26  # (3) slow error of the receiver's position, NED
CLOCK = 29  # (5) receiver clock [m], drift [m/s]; biases of Galileo, BeiDou [m]; ramp [m/s²]
# --- previous inertial sample as measured
LAST_GYRO = 34  # (3)
LAST_ACCEL = 37  # (3)
# --- sums over the running covariance interval
SUM_T = 40  # T
SUM_V = 41  # (3) ∫ f_n dt
SUM_P = 44  # (3) ∫∫ f_n dt dt
SUM_C = 47  # (9) ∫ C_nb dt
SUM_CF = 56  # (9) ∫ C_nb diag(f) dt
SUM_CW = 65  # (9) ∫ C_nb diag(ω) dt
SUM_XV = 74  # extra velocity variance of bridged gaps [m²/s²]
SUM_XA = 75  # extra attitude variance of bridged gaps [rad²]
SUM_XC = 76  # how often the receiver's clock was let go
# --- running likelihood of the aiding, for the bank over headings
LOG_LIKELIHOOD = 77
# --- Earth rotation rate in force [rad/s]: earth.RATE; its negative where time runs backwards
EARTH_RATE = 78
# --- total error state in feedforward mode
DX = 79  # (MAX_STATES)
MAX_STATES = 33
# --- last GNSS speed, for the standstill veto and COASTING
GNSS_SPEED = DX + MAX_STATES
GNSS_SPEED_SD = GNSS_SPEED + 1
GNSS_GROUND_SPEED = GNSS_SPEED + 2  # horizontal: what says something of heading
# --- standstill detector (see standstill.py)
STILL = GNSS_GROUND_SPEED + 1
STILL_SUB = 4  # sub-blocks of the window
STILL_SUM = STILL  # n, sums (6), sums of squares (6) of the running sub-block
STILL_RING = STILL + 13  # per sub-block: means (6), variances (6)
STILL_LEARNED = STILL_RING + STILL_SUB * 12  # weight, variances at rest (6)
STILL_ANCHOR = STILL_LEARNED + 7  # 1 kept, 0 none, < 0 quarters since it was left; force (3)
STILL_SIZE = 13 + STILL_SUB * 12 + 7 + 4
VIBRATION = STILL + STILL_SIZE  # variance of specific force over the last full quarter [(m/s²)²]
GYRO_VIBRATION = VIBRATION + 1  # (3) variance of rate, axis by axis, likewise [(rad/s)²]
VELOCITY_FIT = VIBRATION + 4  # NIS per component of horizontal velocity, running mean
BANK_NIS = VIBRATION + 5  # sum of capped NIS over what the bank competes on
BANK_DOF = VIBRATION + 6  # and of its components
# --- what is known of the position source, horizontal and vertical (see source_faults.py)
SATURATING = VIBRATION + 7  # highest code of a sample at the end of a range, in this quarter
SATURATED = VIBRATION + 8  # and in the last full one; see estimation/saturation.py
SOURCE = VIBRATION + 9
SOURCE_SIZE = 20
# --- adaptation: what is in force, and what it is drawn from (see estimation/adaptation)
R_SCALE = SOURCE + 2 * SOURCE_SIZE  # factor on R, one a channel
CHANNELS = 16
Q_SCALE = R_SCALE + CHANNELS  # factor on the noise of the inertial unit
ALPHA = Q_SCALE + 1  # exponential weight of the running epoch of aiding
RECEPTION = ALPHA + 1  # share of it lost, usual number of satellites, usual variance
R_LEAST = RECEPTION + 3  # factor on R of the fix at hand that leaves what is configured
CLOCK_SCALE = R_LEAST + 1  # (3) factors on the noise of the receiver's clock: bias, drift, ramp
WINDOWS = CLOCK_SCALE + 3  # per adapted channel: innovations in a window, and what methods keep
ADAPTED = 6  # channels whose sensors are judged: the first ones; constraints are not sensors
WINDOW_SIZE = 8 + 3 * 32
# --- covariance, last because its size varies
P = WINDOWS + ADAPTED * WINDOW_SIZE

# --- integer state, offsets into k
T_NOW = 0  # time of the nominal state
T_IMU = 1  # time of the last inertial sample
HAVE_IMU = 2  # 1 once LAST_GYRO is valid
T_POSITION_AID = 3  # last accepted GNSS position
T_VELOCITY_AID = 4  # last accepted GNSS velocity
T_GNSS_SPEED = 5  # last usable GNSS velocity, accepted or not
T_OUTPUT = 6  # grid cell of the last output row
T_CONSTRAINT = 7  # grid cell of the last non-holonomic update
STANDING = 8  # detector's verdict
STILL_COUNT = 9  # full sub-blocks in the ring
STILL_CELL = 10  # grid cell of the running sub-block
T_COVARIANCE = 11  # grid cell of the last covariance step
T_SNAPSHOT = 12  # grid cell of the last snapshot
RESETS = 13  # declared resets so far
T_CHECK = 14  # sample at which the last decision above the kernel was taken
TAPE_AT = 15  # (6) where the smoother's tape stands, see tape.py
SOURCE_K = 21  # as SOURCE
SOURCE_INTS = 10
REFUSED_SINCE = SOURCE_K + 2 * SOURCE_INTS  # time from which on most ranges of epochs were refused
INT_SIZE = REFUSED_SINCE + 1

# --- error state
POS, VEL, ATT, ACCEL_BIAS, GYRO_BIAS = 0, 3, 6, 9, 12
CORE_STATES = 15
# --- of the clock's states, which come in one block
BIAS, DRIFT, SYSTEM, RAMP, CLOCK_STATES = 0, 1, 2, 4, 5

# --- entries of the layout vector handed to kernels
L_N, L_ACCEL_SCALE, L_GYRO_SCALE, L_LEVER, L_BARO, L_GNSS, L_CLOCK = range(7)


@dataclass(frozen=True, slots=True)
class Layout:
    """Error-state indices of the optional states; −1 where one is absent."""

    n: int
    accel_scale: int
    gyro_scale: int
    lever: int
    baro: int
    gnss: int
    clock: int

    @classmethod
    def build(
        cls, *, scale: bool, lever: bool, baro: bool, gnss: bool, clock: bool = False
    ) -> Layout:
        """Lay out the chosen optional states behind the fifteen of the core."""
        at = CORE_STATES
        names = ("accel_scale", "gyro_scale", "lever", "baro", "gnss", "clock")
        index = dict.fromkeys(names, -1)
        for name, wanted, size in (
            ("accel_scale", scale, 3),
            ("gyro_scale", scale, 3),
            ("lever", lever, 3),
            ("baro", baro, 1),
            ("gnss", gnss, 3),
            ("clock", clock, CLOCK_STATES),
        ):
            if wanted:
                index[name] = at
                at += size
        return cls(n=at, **index)

    @property
    def size(self) -> int:
        """Length of the float state vector."""
        return P + self.n * self.n

    def vector(self) -> I64:
        """For kernels: n and the optional indices, by the ``L_`` names."""
        optional = (self.accel_scale, self.gyro_scale, self.lever, self.baro, self.gnss, self.clock)
        return np.array([self.n, *optional], dtype=np.int64)
