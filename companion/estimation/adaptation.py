"""Behind the gate: where adaptation tells the update how far to trust a channel.

The scales live in the filter's state, so that going back in time restores them with the rest. The
plain filter leaves them at 1.
"""

from __future__ import annotations

from numba import njit

from companion.navigation.layout import R_SCALE
from companion.types import F64


@njit("f8(f8[::1], i8)", cache=True)
def scale_of(s: F64, channel: int) -> float:
    """Factor on the measurement variance of ``channel`` in force."""
    return float(s[R_SCALE + channel])
