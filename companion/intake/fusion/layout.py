"""Where the fusion of inertial units keeps what it knows: columns of its arrays.

Six axes everywhere: gyro x, y, z [rad/s], accelerometer x, y, z [m/s²]; two sensors: gyro 0,
accelerometer 1. All axes are those of the first unit.
"""

from __future__ import annotations

RING = 512
"""Samples kept of a unit: a tenth of a second of waiting at 5 kHz."""

# --- parameters of a unit (U, PAR_SIZE)
LEVER = 0  # 3: from the first unit [m]
VAR_0 = 3  # 2: variance that its datasheet gives the mean over a window
BIAS_VAR = 5  # 2: variance of its bias against the others at the start
BIAS_STEP = 7  # 2: variance that this bias gains from window to window
RANGE = 9  # 2: full scale; infinity: not known
PAR_SIZE = 11

TERMS = 4
"""Of how a unit differs from the others on an axis: its bias, and its share of x, y, z."""

# --- what is known of a unit (U, STATE_SIZE)
LAST = 0  # 6: integral up to the last epoch
SUM_E = 6  # 6: deviations from the centre, summed over the window, then their mean
SUM_EE = 12  # 2: their squares
SLOW = 14  # 6: exponential mean of the windows' deviations
BEFORE = 20  # 6: deviation in the window before
RATIO = 26  # largest squared deviation of the last window over what is allowed
WORST = 27  # axis of that, and by how much
WEIGHT = 29  # 2: inverse variance, bounded
PROOF = 31  # seconds of agreement that bring it back
PERIOD = 32  # usual time between samples [s]
ONSET = 33  # 6: deviation in the last window that was not too far off
NOW = 39  # 6: low-passed deviation, a few epochs long
PULL = 45  # 6: what it did to the integral of the mean lately [rad, m/s]
MOVED = 51  # 6: how far the mean moved lately with what was learned of its bias
TOOK = 57  # 6: what it moved the mean by where it took part, summed over the window
STATE_SIZE = 63

# --- integers of a unit (U, COUNT_SIZE)
FIRST, END = 0, 1  # samples of the ring in use: [FIRST, END), modulo RING
GAPS = 2  # of the ring at the last epoch
KNOWN = 3  # whether LAST holds
WHY = 4  # why it is excluded; 0: it is trusted
SAMPLES = 5  # epochs of the window
OVER = 6  # windows in a row that were too far off
NOISY = 7  # windows in a row that were too noisy
GOOD_SINCE = 8  # time [ns]
T_CHANGE = 9  # last time at which its output changed
SAME = 10  # samples since
T_RAIL = 11  # last time at which an axis was at full scale
RAILED = 12  # samples of the window at full scale
EXCLUSIONS = 13
HAVE_BEFORE = 14
OUTLIERS = 15  # epochs at which it was left out for being far off
MISSED = 16  # epochs at which it had nothing to say
OUT_OF_ORDER = 17
TOLD = 18  # that it is the last one, and wrong
COUNT_SIZE = 19

# --- common to all: floats
OMEGA, ALPHA = 0, 3  # 3 each: rate and its low-passed derivative
SCATTER = 6  # 2: variance of a sample about the centre, by sensor
DISCORD = 8  # 2: squared half difference of two units that disagree
EXCESS = 10  # 2: what that adds to the noise density
CENTRE = 12  # 6: summed over the window, then its mean
CENTRE_BEFORE = 18  # 6: mean over the window before
PULLED = 24  # 2: variance that one just excluded left behind, to be handed on once
COMMON_SIZE = 26

# --- common to all: integers
T_LAST, CELL, DISAGREE, AGREE_SINCE, WINDOWS, EPOCHS = 0, 1, 2, 3, 4, 5
CLOCK_SIZE = 6

# --- of the configuration
C_WAIT_NS, C_PROOF_S, C_EXCLUDE, C_MISMATCH = 0, 1, 2, 3
CONFIG_SIZE = 4

# --- why
TRUSTED, SILENT, FROZEN, SATURATED, NOISY_UNIT, SCALED, DRIFTING, STEPPED = range(8)

# --- columns of a fused row
ROW_INTERVAL, ROW_EXCESS = 6, 7
FUSED_SIZE = 9

# --- columns of a piece of news: what, unit, why, worst axis, by how much
NEWS_SIZE = 5
EXCLUDED, RETURNED, DISAGREED, AGREED, LAST_ONE = range(5)
