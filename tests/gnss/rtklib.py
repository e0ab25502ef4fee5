"""RTKLIB (through pyrtklib) as an independent judge of orbits and atmosphere."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyrtklib as rk

from companion.gnss import orbit as ob
from companion.gnss.systems import BEIDOU, GALILEO, GPS
from companion.types import F64

_SYSTEM = {GPS: rk.SYS_GPS, GALILEO: rk.SYS_GAL, BEIDOU: rk.SYS_CMP}
_FIELDS = (
    ("e", ob.E_ECC), ("i0", ob.E_I0), ("OMG0", ob.E_OMEGA0), ("omg", ob.E_OMEGA),
    ("M0", ob.E_M0), ("deln", ob.E_DELTA_N), ("OMGd", ob.E_OMEGA_DOT), ("idot", ob.E_IDOT),
    ("crc", ob.E_CRC), ("crs", ob.E_CRS), ("cuc", ob.E_CUC), ("cus", ob.E_CUS),
    ("cic", ob.E_CIC), ("cis", ob.E_CIS), ("toes", ob.E_TOE_OWN), ("f0", ob.E_AF0),
    ("f1", ob.E_AF1), ("f2", ob.E_AF2),
)  # fmt: skip


def as_rtklib(row: F64) -> Any:
    """The same ephemeris in RTKLIB's terms."""
    eph = rk.eph_t()
    sat = int(row[ob.E_SAT])
    eph.sat = rk.satno(_SYSTEM[sat // 100 - 1], sat % 100)
    eph.A = float(row[ob.E_SQRT_A]) ** 2
    for name, column in _FIELDS:
        setattr(eph, name, float(row[column]))
    eph.toe = rk.gpst2time(int(row[ob.E_WEEK]), float(row[ob.E_TOE]))
    eph.toc = rk.gpst2time(int(row[ob.E_TOC_WEEK]), float(row[ob.E_TOC]))
    return eph


def position_and_clock(row: F64, dt: float) -> tuple[F64, float]:
    """ECEF position [m] and clock with relativity [s], ``dt`` seconds after the reference."""
    eph = as_rtklib(row)
    place, clock, var = rk.Arr1Ddouble(3), rk.Arr1Ddouble(1), rk.Arr1Ddouble(1)
    rk.eph2pos(rk.timeadd(eph.toe, dt), eph, place, clock, var)
    return np.array([place[i] for i in range(3)]), clock[0]


def vector(values: Any) -> Any:
    """A C array of doubles."""
    out = rk.Arr1Ddouble(len(values))
    for i, value in enumerate(values):
        out[i] = float(value)
    return out
