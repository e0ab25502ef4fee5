"""Range with the Earth's rotation, azimuth and elevation against RTKLIB."""

from __future__ import annotations

import numpy as np
import pyrtklib as rk
import pytest

from companion.gnss.corrected import ROW_SIZE, line_of_sight
from companion.gnss.geometry import geodetic, ned_axes
from companion.navigation.earth import ecef
from tests.gnss.rtklib import vector


def test_range_direction_and_elevation_are_those_of_rtklib() -> None:
    rng, u, here, axes = np.random.default_rng(5), np.empty(3), np.empty(3), np.empty((3, 3))
    for _ in range(200):
        lat, lon, height = rng.uniform([-1.5, -3.1, -100.0], [1.5, 3.1, 12_000.0])
        x = ecef(np.array([lat]), np.array([lon]), np.array([height]))[0]
        row = np.zeros(ROW_SIZE)
        row[:3] = rng.normal(size=3)
        row[:3] *= rng.uniform(2.6e7, 4.3e7) / np.linalg.norm(row[:3])
        direction = vector(np.zeros(3))
        theirs = rk.geodist(vector(row[:3]), vector(x), direction)
        # 30 m of rotation are in it; the same first order, rounded at 4e7 m.
        assert line_of_sight(row, x[0], x[1], x[2], u) == pytest.approx(theirs, abs=1e-6)
        assert u == pytest.approx([direction[i] for i in range(3)], abs=1e-12)
        geodetic(x[0], x[1], x[2], here)
        ned_axes(here[0], here[1], axes)
        n, e, d = axes @ u
        angles = vector(np.zeros(2))
        rk.satazel(vector([lat, lon, height]), direction, angles)
        assert np.arctan2(-d, np.hypot(n, e)) == pytest.approx(angles[1], abs=1e-9)
        assert np.arctan2(e, n) % (2.0 * np.pi) == pytest.approx(angles[0], abs=1e-7)
