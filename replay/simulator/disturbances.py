"""What happens to a sensor for a while: times of more noise, of shaking, and biases that step.

All of them come beside the errors that a datasheet gives, at times of the scenario's own, and draw
from a generator of their own: the other errors of a seed are the same with and without them.
"""

from __future__ import annotations

import math
from typing import Literal

import msgspec
import numpy as np

from companion.config import DEG
from companion.types import F64
from replay.simulator.noise import narrow_band


class NoiseChange(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """White errors of a receiver times ``factor`` in [start, start + length), not reported."""

    start_s: float
    length_s: float
    factor: float = 5.0


class BiasStep(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A bias that is there from ``start_s`` on: a knock, a jump of temperature, a bad solder."""

    start_s: float
    gyro_dps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    accel_mps2: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Shaking(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Vibration of an inertial unit in [start, start + length), before saturation.

    Where it reaches the end of the range it is cut off on one side more than on the other, gravity
    being there too: a bias that no calibration knows.
    """

    start_s: float
    length_s: float
    accel_mps2: float = 0.0
    """RMS on each axis."""
    gyro_dps: float = 0.0
    hz: float = 70.0


class Failure(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An inertial unit that goes wrong in [start, start + length)."""

    kind: Literal["drifting", "frozen", "saturated", "silent", "noisy", "scaled"]
    """``drifting``: a ramp; ``frozen``: the last values for ever; ``saturated``: the x axes at full
    scale; ``silent``: no samples; ``noisy``, ``scaled``: white noise, or the output, times
    ``factor``."""
    start_s: float
    length_s: float = math.inf
    factor: float = 1.0
    gyro_dps_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """How fast it drifts."""
    accel_mps2_s: tuple[float, float, float] = (0.0, 0.0, 0.0)


def inside(t: F64, start_s: float, length_s: float) -> F64:
    """(N,) 1 within [start, start + length), else 0."""
    return np.where((t >= start_s) & (t < start_s + length_s), 1.0, 0.0)


def noise_factor(changes: tuple[NoiseChange, ...], t: F64) -> F64:
    """(N, 1) factor on white errors at times ``t`` (N,); where two overlap they multiply."""
    factor = np.ones(len(t))
    for change in changes:
        factor *= 1.0 + (change.factor - 1.0) * inside(t, change.start_s, change.length_s)
    return factor[:, None]


def shaken(
    shaking: tuple[Shaking, ...], rng: np.random.Generator, t: F64, step_s: float
) -> tuple[F64, F64]:
    """Added angular rate [rad/s] and specific force [m/s²], each (N, 3), at times ``t`` (N,)."""
    gyro, accel = np.zeros((len(t), 3)), np.zeros((len(t), 3))
    for one in shaking:
        window = inside(t, one.start_s, one.length_s)[:, None]
        accel += window * narrow_band(rng, len(t), step_s, one.accel_mps2, one.hz, 3)
        gyro += window * narrow_band(rng, len(t), step_s, one.gyro_dps * DEG, one.hz, 3)
    return gyro, accel


def stepped(steps: tuple[BiasStep, ...], t: F64) -> tuple[F64, F64]:
    """Added gyro bias [rad/s] and accelerometer bias [m/s²], each (N, 3), at times ``t`` (N,)."""
    gyro, accel = np.zeros((len(t), 3)), np.zeros((len(t), 3))
    for one in steps:
        after = np.where(t >= one.start_s, 1.0, 0.0)
        gyro += np.outer(after, one.gyro_dps) * DEG
        accel += np.outer(after, one.accel_mps2)
    return gyro, accel


def failed(
    failures: tuple[Failure, ...],
    rng: np.random.Generator,
    t: F64,
    gyro: F64,
    accel: F64,
    *,
    white: tuple[float, float],
    limits: tuple[float, float],
) -> None:
    """Let ``gyro`` and ``accel`` (N, 3) at times ``t`` (N,) go wrong, in place.

    ``white``: deviation of a sample's noise, ``limits``: full scale, both of gyro and
    accelerometer. A unit that falls silent is for the caller to cut.
    """
    for one in failures:
        window = inside(t, one.start_s, one.length_s)[:, None]
        at = np.flatnonzero(window)
        if not len(at):
            continue
        since = np.maximum(t - one.start_s, 0.0)[:, None]
        for out, drift, sd, limit in (
            (gyro, np.array(one.gyro_dps_s) * DEG, white[0], limits[0]),
            (accel, np.array(one.accel_mps2_s), white[1], limits[1]),
        ):
            if one.kind == "drifting":
                out += window * since * drift
            elif one.kind == "noisy":
                more = math.sqrt(max(one.factor**2 - 1.0, 0.0)) * sd
                out += window * rng.standard_normal(out.shape) * more
            elif one.kind == "scaled":
                out *= 1.0 + (one.factor - 1.0) * window
            elif one.kind == "frozen":
                out[at] = out[max(at[0] - 1, 0)]
            elif one.kind == "saturated":
                out[at, 0] = limit
