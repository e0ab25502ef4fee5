"""Local coordinates as each autopilot counts them.

An autopilot turns local metres into latitude and longitude with a formula of its own, on a sphere.
Metres of the ellipsoid would come out displaced: by up to 0.7 % of the distance from the origin.
So positions are given in the metres of whoever reads them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

ARDUPILOT_RADIUS = 6_378_100.0
"""0.011131884502145034 m for 1e-7 degrees: AP_Common/Location.h."""
PX4_RADIUS = 6_371_000.0
"""CONSTANTS_RADIUS_OF_EARTH of lib/geo/geo.h."""


class Origin(NamedTuple):
    """Where local coordinates begin."""

    lat: float
    """[rad]"""
    lon: float
    height: float
    """[m], datum of the solution."""


def ardupilot_ne(lat: float, lon: float, origin: Origin) -> tuple[float, float]:
    """North and east of ``origin`` [m], as ``Location::get_distance_NE`` has them."""
    dlon = math.remainder(lon - origin.lon, 2 * math.pi)
    scale = math.cos(0.5 * (lat + origin.lat))
    return (lat - origin.lat) * ARDUPILOT_RADIUS, dlon * scale * ARDUPILOT_RADIUS


def px4_ne(lat: float, lon: float, origin: Origin) -> tuple[float, float]:
    """North and east of ``origin`` [m]: azimuthal equidistant, as ``MapProjection::project``."""
    dlon = lon - origin.lon
    sin0, cos0, sin, cos = (
        math.sin(origin.lat),
        math.cos(origin.lat),
        math.sin(lat),
        math.cos(lat),
    )
    north = cos0 * sin - sin0 * cos * math.cos(dlon)
    east = cos * math.sin(dlon)
    # The angle from both of its parts: an arc cosine has no digits left near the origin.
    sine = math.hypot(north, east)
    angle = math.atan2(sine, sin0 * sin + cos0 * cos * math.cos(dlon))
    k = PX4_RADIUS * (angle / sine if sine > 0 else 1.0)
    return k * north, k * east
