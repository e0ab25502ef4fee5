"""Klobuchar's and Saastamoinen's delays against RTKLIB."""

from __future__ import annotations

import math

import numpy as np
import pyrtklib as rk
import pytest

from companion.gnss.atmosphere import klobuchar, troposphere
from tests.gnss.rtklib import vector

IONO = np.array(
    [1.4901e-8, 2.2352e-8, -1.1921e-7, -1.1921e-7, 1.1469e5, 1.6384e5, -6.5536e4, -4.58752e5]
)


def test_klobuchar_is_that_of_rtklib_at_all_places_and_hours() -> None:
    rng = np.random.default_rng(3)
    for _ in range(200):
        lat, lon, azimuth = rng.uniform([-1.4, -3.1, -3.1], [1.4, 3.1, 3.1])
        elevation, second = rng.uniform(0.1, 1.57), rng.uniform(0, 604_800)
        ours = klobuchar(IONO, lat, lon, azimuth, elevation, second)
        theirs = rk.ionmodel(
            rk.gpst2time(2300, second), vector(IONO), vector([lat, lon, 100.0]),
            vector([azimuth, elevation]),
        )  # fmt: skip
        assert ours == pytest.approx(theirs, abs=1e-6)


@pytest.mark.parametrize("height", [0.0, 500.0, 3_000.0])
@pytest.mark.parametrize("lat", [0.0, 0.8, -1.2])
def test_zenith_delay_is_that_of_rtklib(height: float, lat: float) -> None:
    theirs = rk.tropmodel(
        rk.gpst2time(2300, 0.0), vector([lat, 0.0, height]), vector([0.0, math.pi / 2]), 0.7
    )
    # The mapping function is 5e-7 from one at the zenith.
    assert troposphere(lat, height, math.pi / 2) == pytest.approx(theirs, rel=1e-6)


def test_low_satellites_are_mapped_as_do_229_says() -> None:
    # 1.001 / sqrt(0.002001 + sin² 5°) = 10.218, where 1/sin 5° would be 11.474.
    ratio = troposphere(0.8, 0.0, math.radians(5.0)) / troposphere(0.8, 0.0, math.pi / 2)
    assert ratio == pytest.approx(10.218, abs=2e-3)
