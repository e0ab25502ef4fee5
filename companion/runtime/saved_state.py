"""Biases kept from run to run, so that a start need not find them again.

They enter a run only through its configuration (``imu.gyro_bias_dps``, ``imu.accel_bias_mps2`` and
their deviations), which the log keeps: a replay of a warm start needs no state file.
"""

from __future__ import annotations

import math
import os
import tomllib
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np

from companion.config import DEG, Config, to_toml
from companion.config.section import Section
from companion.types import (
    COV_ACCEL_BIAS,
    COV_GYRO_BIAS,
    NS,
    CompanionError,
    Mode,
    Solution,
)

Row = tuple[float, float, float]

STALE_NS = 24 * 3600 * NS
"""After a day saved biases say no more than the datasheet's turn-on deviation: the unit was
switched off, cooled and warmed. Before, their variance grows in proportion to their age."""
LEARNED = 0.5
"""Biases are kept once their deviation is below this share of the turn-on deviation."""


class StateError(CompanionError):
    """A state file that cannot be used; the run starts without it."""


class SavedBiases(Section, frozen=True):
    """What is kept; the file has these keys."""

    source: str
    """Inertial unit that they belong to."""
    axes: tuple[tuple[float, ...], ...]
    """``imu.axes`` that they were found with: biases are kept in body axes."""
    saved_ns: int
    """UTC [ns]."""
    gyro_bias_dps: Row
    gyro_bias_sd_dps: float
    """Of the worst axis."""
    accel_bias_mps2: Row
    accel_bias_sd_mps2: float


def learned(config: Config, source: str, last: Solution) -> SavedBiases | None:
    """What the newest epoch knows about the biases; None if that is not worth keeping."""
    if not len(last) or last.mode[-1] not in (Mode.NAVIGATING, Mode.COASTING):
        return None
    sd = last.sd[-1]
    gyro_sd = float(sd[COV_GYRO_BIAS].max()) / DEG
    accel_sd = float(sd[COV_ACCEL_BIAS].max())
    values = (*last.gyro_bias_b[-1], *last.accel_bias_b[-1], gyro_sd, accel_sd)
    if not np.isfinite(values).all() or min(gyro_sd, accel_sd) <= 0:
        return None
    # Deviations of a warm start are small from the beginning: what it began with is learned too.
    if gyro_sd > LEARNED * config.imu.gyro_bias_sd_dps and not any(config.imu.gyro_bias_dps):
        return None
    return SavedBiases(
        source=source,
        axes=config.imu.axes,
        saved_ns=int(last.t_ns[-1]),
        gyro_bias_dps=_row(last.gyro_bias_b[-1] / DEG),
        gyro_bias_sd_dps=gyro_sd,
        accel_bias_mps2=_row(last.accel_bias_b[-1]),
        accel_bias_sd_mps2=accel_sd,
    )


def _row(values: np.ndarray) -> Row:
    x, y, z = values.tolist()
    return x, y, z


def save(path: Path, biases: SavedBiases) -> None:
    """Write the file anew; a crash leaves the old one or the new one, never half of one.

    Raises :class:`StateError`.
    """
    text = f"# Sensor biases, kept by companion from run to run.\n{to_toml(biases)}"
    fresh = path.with_name(f"{path.name}.new")
    try:
        with fresh.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(path)
    except OSError as error:
        with suppress(OSError):
            fresh.unlink()
        raise StateError(f"{path}: biases not kept: {error.strerror or error}") from None


def read(path: Path) -> SavedBiases | None:
    """What an earlier run kept; None without a file. Raises :class:`StateError`."""
    try:
        saved = msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), SavedBiases)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise StateError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, msgspec.ValidationError) as error:
        raise StateError(f"{path}: not a state file: {' '.join(str(error).split())}") from None
    deviations = (saved.gyro_bias_sd_dps, saved.accel_bias_sd_mps2)
    values = (*saved.gyro_bias_dps, *saved.accel_bias_mps2, *deviations)
    if not all(map(math.isfinite, values)) or min(deviations) <= 0:
        raise StateError(f"{path}: not a state file: values that are no numbers or not positive")
    return saved


def warmed(config: Config, source: str, saved: SavedBiases, now_ns: int) -> Config:
    """The configuration with biases as they were left, and deviations as large as their age asks.

    var = saved² + walk² age + turn-on² min(1, age / day), at most turn-on². Raises
    :class:`StateError` where they are not of this unit and mounting.
    """
    imu = config.imu
    if saved.source != source:
        raise StateError(f"biases of '{saved.source}' are not those of '{source}'")
    if saved.axes != imu.axes:
        raise StateError("biases were found with other 'imu.axes'")
    for name, bias, sd in (
        ("gyro", saved.gyro_bias_dps, imu.gyro_bias_sd_dps),
        ("accelerometer", saved.accel_bias_mps2, imu.accel_bias_sd_mps2),
    ):
        if max(map(abs, bias)) > 6 * sd:
            raise StateError(f"{name} biases {bias} are beyond six turn-on deviations of {sd:g}")
    # A clock that is behind the file's says nothing about its age.
    age_ns = now_ns - saved.saved_ns
    age_s = max(age_ns, 0) / NS
    share = min(1.0, age_ns / STALE_NS) if age_ns >= 0 else 1.0

    def widened(sd: float, walk: float, turn_on: float) -> float:
        return math.sqrt(min(turn_on**2, sd**2 + walk**2 * age_s + turn_on**2 * share))

    gyro_sd = widened(saved.gyro_bias_sd_dps, imu.gyro_bias_walk_dps_rts, imu.gyro_bias_sd_dps)
    accel_sd = widened(
        saved.accel_bias_sd_mps2, imu.accel_bias_walk_mps2_rts, imu.accel_bias_sd_mps2
    )
    return msgspec.structs.replace(
        config,
        imu=msgspec.structs.replace(
            imu,
            gyro_bias_dps=saved.gyro_bias_dps,
            gyro_bias_sd_dps=gyro_sd,
            accel_bias_mps2=saved.accel_bias_mps2,
            accel_bias_sd_mps2=accel_sd,
        ),
    )
