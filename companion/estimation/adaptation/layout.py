"""Where the adaptation keeps things: a window inside the filter's state, a row of its trace."""

from __future__ import annotations

# --- codes of adaptation.method, in the order of config.adaptation.METHODS
NONE, FUZZY, FLAC, INNOVATION, VARIATIONAL, HUBER, IGG3 = range(7)
# --- codes of a rule's actions, in the order of config.adaptation.ACTIONS
NOMINAL, HOLD, MATCH = range(3)

# --- entries of a channel's window
COUNT = 0  # innovations in it
NEXT = 1  # slot of the next one
SHAPE, RATE = 2, 3  # variational: of the inverse gamma of the factor on R, less 1 and 0
Q_WISH = 4  # factor on Q that this channel asks for, less 1
DRIFT = 5  # how far its mean is correlated and not zero, 0 to 1
MOTION = 6  # how far the inertial unit was strained lately, 0 to 1
FADE = 7  # FLAC: α that this channel asks for, less 1
RING = 8  # (LONGEST_WINDOW, 3) whitened innovations, or what else a method averages

# --- columns of a trace, at the end of a report row
TRACED = 0  # 1 where a method looked at the measurement
IN_MEAN, IN_SPREAD, IN_CORRELATION = 1, 2, 3  # standard normal for a healthy sensor; NaN: too few
TO_MODEL, TO_SOURCE = 4, 5  # shares of a mean that are the inertial unit's and the source's
FIRING = 6  # (9) strengths of the rules, spread by spread or covariance by covariance
OUT_R, OUT_Q, OUT_ALPHA = 15, 16, 17  # what is in force after it
TRACE_SIZE = 18
