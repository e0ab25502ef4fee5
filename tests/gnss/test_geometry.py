"""Geodetic coordinates, dilution of precision, the best set of satellites."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from companion.gnss.geometry import NO_DOP, best_set, dilution, geodetic, ned_axes
from companion.navigation.earth import ecef
from companion.types import F64, I64


def test_geodetic_is_the_reverse_of_ecef() -> None:
    rng, out = np.random.default_rng(1), np.empty(3)
    for _ in range(200):
        lat, lon, height = rng.uniform([-1.57, -3.14, -5_000], [1.57, 3.14, 40_000])
        x = ecef(np.array([lat]), np.array([lon]), np.array([height]))[0]
        geodetic(*x, out)
        assert out == pytest.approx([lat, lon, height], abs=1e-6)


def _sky(seed: int, count: int) -> tuple[F64, I64]:
    rng = np.random.default_rng(seed)
    azimuth, elevation = rng.uniform(-3.1, 3.1, count), rng.uniform(0.1, 1.5, count)
    flat = np.cos(elevation)
    lines = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), -np.sin(elevation)], 1)
    return np.ascontiguousarray(lines), rng.integers(0, 2, count)


def _textbook(lines: F64, systems: I64) -> F64:
    """√ of traces of (HᵀH)⁻¹ with numpy."""
    clocks = np.stack([systems == s for s in np.unique(systems)], 1).astype(float)
    H = np.concatenate([-lines, clocks], 1)
    if np.linalg.matrix_rank(H) < H.shape[1]:
        return np.full(5, NO_DOP)
    d = np.diag(np.linalg.inv(H.T @ H))
    groups = (d, d[:3], d[:2], d[2:3], d[3:])
    return np.sqrt([g.sum() for g in groups])


def test_dilution_is_the_textbooks_with_one_clock_and_with_two() -> None:
    out, scratch = np.empty(5), np.empty((8, 8))
    for seed in range(20):
        lines, systems = _sky(seed, 9)
        for kinds in (systems, np.zeros(9, np.int64)):
            dilution(lines, kinds, 9, scratch, out)
            assert out == pytest.approx(_textbook(lines, kinds), rel=1e-9)
    dilution(lines[:3].copy(), np.zeros(3, np.int64), 3, scratch, out)
    assert (out == NO_DOP).all()


def test_best_set_is_that_of_all_combinations() -> None:
    best = np.empty(4, np.int64)
    for seed in range(5):
        lines, _ = _sky(seed, 9)
        systems = np.zeros(9, np.int64)
        gdop = best_set(lines, systems, 9, 4, best)
        every = {
            c: _textbook(lines[list(c)], systems[:4])[0]
            for c in itertools.combinations(range(9), 4)
        }
        assert tuple(best.tolist()) == min(every, key=every.__getitem__)
        assert gdop == pytest.approx(min(every.values()), rel=1e-9)


def test_axes_are_a_rotation_with_down_along_the_ellipsoids_normal() -> None:
    R = np.empty((3, 3))
    ned_axes(0.7, -1.9, R)
    assert pytest.approx(np.eye(3), abs=1e-15) == R @ R.T
    one = np.array([0.7]), np.array([-1.9])
    up = ecef(*one, np.array([1.0])) - ecef(*one, np.array([0.0]))
    assert R @ up[0] == pytest.approx([0, 0, -1], abs=1e-8)
