"""What a run leaves for the next one: biases, heading, and which streams it used.

Biases and heading enter a run only through its configuration (``imu.gyro_bias_dps``,
``alignment.last_heading``, …), which the log keeps: a replay of a warm start needs no state file.
The streams only say what need not be waited for; which were used, the log says anyway.

Two files: one that is safe on the disk, written once a minute and at the end, and beside it one of
the last second, which a killed process leaves and a power cut may spoil. The newer good one counts.
"""

from __future__ import annotations

import math
import os
import tomllib
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np

from companion.config import DEG, Config, LastHeading, to_toml
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
    """Biases of one inertial unit."""

    source: str
    """Unit that they belong to."""
    saved_ns: int
    """UTC [ns]."""
    gyro_bias_dps: Row
    gyro_bias_sd_dps: float
    """Of the worst axis."""
    accel_bias_mps2: Row
    accel_bias_sd_mps2: float


class SavedState(Section, frozen=True):
    """What is kept; the file has these keys."""

    saved_ns: int
    """UTC [ns]."""
    axes: tuple[tuple[float, ...], ...]
    """``imu.axes`` of the run: biases and heading are those of body axes."""
    biases: SavedBiases | None = None
    heading: LastHeading | None = None
    inputs: dict[str, str] = msgspec.field(default_factory=dict)
    """Stream that was used of each kind."""
    autopilot: tuple[int, int] | None = None
    """System and component of the autopilot."""


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
        saved_ns=int(last.t_ns[-1]),
        gyro_bias_dps=_row(last.gyro_bias_b[-1] / DEG),
        gyro_bias_sd_dps=gyro_sd,
        accel_bias_mps2=_row(last.accel_bias_b[-1]),
        accel_bias_sd_mps2=accel_sd,
    )


def _row(values: np.ndarray) -> Row:
    x, y, z = values.tolist()
    return x, y, z


# ------------------------------------------------------------------ files


def of_last_second(path: Path) -> Path:
    """The file beside ``path`` that is written every second."""
    return path.with_name(f"{path.name}.now")


def save(path: Path, state: SavedState, *, durable: bool = True) -> None:
    """Write a file anew; a crash leaves the old one or the new one, never half of one.

    After a power cut that holds for a ``durable`` one only. Raises :class:`StateError`.
    """
    text = f"# State kept by companion from run to run.\n{to_toml(state)}"
    path = path if durable else of_last_second(path)
    fresh = path.with_name(f"{path.name}.new")
    try:
        with fresh.open("w", encoding="utf-8") as file:
            file.write(text)
            if durable:
                file.flush()
                os.fsync(file.fileno())
        fresh.replace(path)
    except OSError as error:
        with suppress(OSError):
            fresh.unlink()
        raise StateError(f"{path}: state not kept: {error.strerror or error}") from None


def read(path: Path) -> SavedState | None:
    """What an earlier run kept; None without a file. Raises :class:`StateError`."""
    newest = None
    with suppress(StateError):  # what a power cut spoiled is no news: the other one is there
        newest = _read(of_last_second(path))
    kept = _read(path) if newest is None or path.exists() else None
    found = [state for state in (kept, newest) if state is not None]
    return max(found, key=lambda state: state.saved_ns, default=None)


def _read(path: Path) -> SavedState | None:
    try:
        saved = msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), SavedState)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise StateError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, msgspec.ValidationError) as error:
        raise StateError(f"{path}: not a state file: {' '.join(str(error).split())}") from None
    if not (_sound_biases(saved.biases) and _sound_heading(saved.heading)):
        raise StateError(f"{path}: not a state file: values that are no numbers or not positive")
    return saved


def _sound_biases(biases: SavedBiases | None) -> bool:
    if biases is None:
        return True
    deviations = (biases.gyro_bias_sd_dps, biases.accel_bias_sd_mps2)
    values = (*biases.gyro_bias_dps, *biases.accel_bias_mps2, *deviations)
    return all(map(math.isfinite, values)) and min(deviations) > 0


def _sound_heading(heading: LastHeading | None) -> bool:
    if heading is None:
        return True
    return math.isfinite(heading.heading_deg) and 0 < heading.sd_deg < math.inf


# ------------------------------------------------------------------ a start from them


def warmed(config: Config, source: str, saved: SavedState, now_ns: int) -> Config:
    """The configuration with biases and heading as they were left.

    ``source``: the inertial unit of the configuration; empty where the autopilot's is used, which
    has no biases to keep. Raises :class:`StateError` for a state of another unit or mounting.
    """
    if saved.axes != config.imu.axes:
        raise StateError("what was kept was found with other 'imu.axes'")
    if saved.biases is not None and source:
        config = _with_biases(config, source, saved.biases, now_ns)
    if saved.heading is not None:
        alignment = msgspec.structs.replace(config.alignment, last_heading=saved.heading)
        config = msgspec.structs.replace(config, alignment=alignment)
    return config


def _with_biases(config: Config, source: str, saved: SavedBiases, now_ns: int) -> Config:
    """Biases as they were left, their deviations as large as their age asks.

    var = saved² + walk² age + turn-on² min(1, age / day), at most turn-on².
    """
    imu = config.imu
    if saved.source != source:
        raise StateError(f"biases of '{saved.source}' are not those of '{source}'")
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
