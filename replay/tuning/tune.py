"""Noise parameters of one recording: what stood still gives the IMU's, what flew the aids'."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec

from companion.config import Config
from companion.types import NS, CompanionError, VehicleRecording
from replay.tuning.aiding_noise import aiding_parameters
from replay.tuning.imu_noise import MINIMUM_S, imu_parameters
from replay.tuning.parameter import Parameter
from replay.tuning.rest import longest_rest


@dataclass(frozen=True, slots=True)
class Tuned:
    """What a recording says of its sensors."""

    parameters: tuple[Parameter, ...]
    rest_s: float
    """Length of the longest stretch at rest."""
    notes: tuple[str, ...]


def tune(vehicle: VehicleRecording, config: Config) -> Tuned:
    """Every parameter that the recording can say something about.

    Raises :class:`~companion.types.CompanionError` where it can say nothing.
    """
    notes = []
    parameters: list[Parameter] = []
    rest = longest_rest(vehicle, vehicle.imu[0])
    rest_s = float(rest.t_ns[-1] - rest.t_ns[0]) / NS if len(rest) else 0.0
    if rest_s >= MINIMUM_S:
        parameters += imu_parameters(rest, msgspec.to_builtins(config.imu))
    else:
        notes.append(
            f"the longest stretch at rest has {rest_s:.0f} s; {MINIMUM_S:.0f} s give IMU noise, "
            "an hour or more its bias instability"
        )
    if vehicle.gnss and len(vehicle.gnss[0]):
        parameters += aiding_parameters(vehicle, config)
    else:
        notes.append("no GNSS: nothing to say of aiding")
    if not any(p.after is not None for p in parameters):
        raise CompanionError("nothing to tune from: " + "; ".join(notes or ["too few updates"]))
    return Tuned(tuple(parameters), rest_s, tuple(notes))
