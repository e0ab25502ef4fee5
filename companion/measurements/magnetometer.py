"""Magnetometer: declination from the World Magnetic Model, heading from the horizontal field.

Only the direction of the horizontal field is used: it is what hard-iron calibration leaves good,
and a wrong dip or strength then does not tilt the solution.
"""

from __future__ import annotations

import datetime as dt
import math

from companion.types import NS

_MODELS = (
    (2025, "WMM_2025.COF"),
    (2020, "WMM_2020.COF"),
    (2015, "WMM_2015v2.COF"),
    (2010, "WMM_2010.COF"),
)
"""First year of validity, of five, and file."""


def declination(lat: float, lon: float, height: float, t_ns: int) -> float:
    """Magnetic declination [rad, east positive] at a place [rad, m] and unix time.

    World Magnetic Model through pygeomag; a date outside every model (a log with a boot clock only)
    takes the newest.
    """
    from pygeomag import GeoMag

    when = dt.datetime.fromtimestamp(t_ns / NS, tz=dt.UTC)
    year = when.year + (when.timetuple().tm_yday - 1) / 365.25
    model = _MODELS[0][1]
    for first, name in _MODELS:
        if first <= year < first + 5:
            model = name
            break
    else:
        year = 2027.5
    result = GeoMag(coefficients_file=f"wmm/{model}").calculate(
        glat=math.degrees(lat), glon=math.degrees(lon), alt=height / 1000.0, time=year
    )
    return math.radians(result.d)
