"""What is settled about a recording before the engine sees it; nothing here loads its kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from companion.config import Config
from companion.types import (
    NS,
    CompanionError,
    LogFormatError,
    Recording,
    Samples,
    VehicleRecording,
)
from replay.reader import require_inputs
from replay.streams import SLOW_HZ
from replay.window import Window

S = TypeVar("S", bound=Samples)


@dataclass(frozen=True, slots=True)
class Refused:
    """A vehicle that cannot be navigated, and why."""

    name: str
    reason: str


def start_ns(vehicle: VehicleRecording) -> int:
    """The time that windows count from: the first inertial sample or fix of the vehicle."""
    first = [int(s.t_ns[0]) for s in (*vehicle.imu[:1], *vehicle.gnss[:1]) if len(s)]
    if not first:
        raise LogFormatError(f"vehicle '{vehicle.name}' has neither inertial samples nor fixes")
    return min(first)


def withhold_gnss(vehicle: VehicleRecording, windows: Sequence[Window]) -> VehicleRecording:
    """The recording without the fixes valid inside any of ``windows``; start included, end not.

    Of raw GNSS the satellites are left that a window leaves.
    """
    if not windows:
        return vehicle
    origin = start_ns(vehicle)
    fixes = tuple(_outside(samples, windows, origin) for samples in vehicle.gnss)
    # Without ephemerides nobody knows which stand high, and none is of use.
    known = len(vehicle.raw) == len(vehicle.broadcast)
    some = [window for window in windows if window.left and known]
    raws = [_outside(raw, [w for w in windows if w not in some], origin) for raw in vehicle.raw]
    if some and raws:
        from replay.raw_gnss.withheld import with_few

        for window in some:
            begin = origin + round(window.start_s * NS)
            end = begin + round(window.seconds * NS)
            raws = [
                with_few(raw, messages, begin, end, window.left)
                for raw, messages in zip(raws, vehicle.broadcast, strict=True)
            ]
    return replace(vehicle, gnss=fixes, raw=tuple(raws))


def _outside(samples: S, windows: Sequence[Window], origin: int) -> S:
    """What is valid in none of ``windows``, which count from ``origin`` [ns]."""
    keep = np.ones(len(samples), np.bool_)
    for window in windows:
        begin = origin + round(window.start_s * NS)
        keep &= (samples.t_ns < begin) | (samples.t_ns >= begin + round(window.seconds * NS))
    return samples.take(keep)


def navigable(
    recording: Recording, config: Config | None, name: str | None = None
) -> tuple[list[VehicleRecording], list[Refused]]:
    """The vehicles that a filter can be run on, and the others with the reason.

    ``config`` says which filter; None: only a strapdown one will do.

    Raises the one reason where nothing is left, and :class:`LogFormatError` for an unknown name.
    """
    known = [v.name for v in recording.vehicles]
    if name is not None and name not in known:
        raise LogFormatError(f"{recording.path}: no vehicle '{name}'; it has {', '.join(known)}")
    direct = config is not None and config.engine.estimator == "direct"
    minimum_hz = 0.0 if direct else SLOW_HZ
    ranges = config is None or config.raw_gnss.coupling != "off"
    fit: list[VehicleRecording] = []
    refused: list[Refused] = []
    errors: list[CompanionError] = []
    for vehicle in recording.vehicles:
        if name in (None, vehicle.name):
            try:
                require_inputs(vehicle, minimum_hz, ranges)
                fit.append(vehicle)
            except CompanionError as error:
                refused.append(Refused(vehicle.name, str(error)))
                errors.append(error)
    if not fit:
        raise errors[0] if errors else LogFormatError(f"{recording.path}: no vehicle in it")
    return fit, refused
