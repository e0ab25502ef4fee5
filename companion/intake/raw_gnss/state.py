"""Where a receiver's kernel keeps and finds things: settings, state, columns of an epoch."""

from __future__ import annotations

from companion.gnss.clock_noise import Q_SIZE
from companion.gnss.correction import NOISE_SIZE
from companion.gnss.systems import SYSTEMS
from companion.types import SATELLITES

# --- settings, behind the columns ``V_`` of companion.gnss.correction
W_EXCLUDE = NOISE_SIZE
"""1 where satellites at fault are left out."""
W_BEST, W_MARGIN = NOISE_SIZE + 1, NOISE_SIZE + 2
"""Size of the best set, 0 for all in view; by what part another has to be better."""
W_ADAPT, W_SLOW, W_TAU = NOISE_SIZE + 3, NOISE_SIZE + 4, NOISE_SIZE + 5
"""1 where trust in the systems is learned; part of a range's variance that lasts, and how long."""
W_LEARN = NOISE_SIZE + 6
"""1 where the noise of the receiver's clock is learned."""
W_OURS = NOISE_SIZE + 7
"""(SYSTEMS) 1 where a system is used."""
SETTINGS_SIZE = W_OURS + SYSTEMS

# --- the place that was solved last
T_POS, T_VEL, T_TIME, T_KNOWN = 0, 3, 6, 7
"""ECEF [m] and [m/s, NaN without]; GPS time [s]; 1 where there is one."""
PLACE_SIZE = 8

# --- what is remembered of the epoch before
K_UNSOLVED, K_SIGN, K_CLOCK, K_SET = range(4)
"""Epochs so far whose ranges fit no place; sign of who was used, at fault and refused; system whose
clock the noise was learned of; how many were used, and from K_SATS on who."""
K_SATS = 4
MEMORY_SIZE = K_SATS + SATELLITES

# --- of each epoch
Z_USED, Z_EXCLUDED, Z_CODE, Z_LET_GO, Z_NEWS = range(5)
"""Satellites in use and at fault; what ``solve`` said; 1 where the receiver's clock jumped in front
of it; 1 where others are used, at fault or refused than in the one before."""
EPOCH_SIZE = 5
E_DOP = 0
"""(5) GDOP, PDOP, HDOP, VDOP, TDOP of the satellites in use."""
E_TRUST = 5
"""(SYSTEMS) factors on the variances of its ranges, by how far their systems are trusted."""
E_CLOCK = E_TRUST + SYSTEMS
"""(Q_SIZE) factors on the noise of the receiver's clock, as learned up to it."""
FIGURES_SIZE = E_CLOCK + Q_SIZE
