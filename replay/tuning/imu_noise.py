"""Inertial noise parameters from a stretch at rest."""

from __future__ import annotations

from collections.abc import Iterator

from companion.config import DEG
from companion.types import NS, ImuSamples
from replay.tuning.allan import AllanCurve, NoiseModel, allan_deviation, fit
from replay.tuning.parameter import Parameter

MINIMUM_S = 20.0
"""Shorter rests give no density that is good to some ten percent at the times that count."""
BRIDGED_S = 60.0
"""The random walk of the configuration grows as the bias does in a minute without aiding."""


def curves(rest: ImuSamples) -> tuple[AllanCurve, AllanCurve]:
    """Of gyro [rad/s] and accelerometer [m/s²]; samples are taken for evenly spaced."""
    step_s = float(rest.t_ns[-1] - rest.t_ns[0]) / NS / (len(rest) - 1)
    return allan_deviation(rest.gyro_b, step_s), allan_deviation(rest.accel_b, step_s)


def imu_parameters(rest: ImuSamples, before: dict[str, float]) -> Iterator[Parameter]:
    """What the rest says of the ``[imu]`` section; ``before`` has its present values."""
    gyro, accel = curves(rest)
    for curve, prefix, unit, scale in (
        (gyro, "gyro", "dps", 1.0 / DEG),
        (accel, "accel", "mps2", 1.0),
    ):
        model = fit(curve)
        seconds = f"Allan deviation over {curve.seconds:.0f} s at rest"
        name = f"{prefix}_noise_{unit}_rthz"
        yield Parameter("imu", name, before[name], scale * model.density, seconds)
        name = f"{prefix}_bias_walk_{unit}_rts"
        walk = model.walk_between(BRIDGED_S)
        if walk is None or curve.seconds < 10.0 * BRIDGED_S:
            yield Parameter(
                "imu", name, before[name], None, f"{curve.seconds:.0f} s are too short to see it"
            )
        else:
            yield Parameter("imu", name, before[name], scale * walk, _why_walk(model, scale, unit))


def _why_walk(model: NoiseModel, scale: float, unit: str) -> str:
    parts = []
    if model.instability is not None and model.instability_tau_s is not None:
        parts.append(
            f"bias wanders by {scale * model.instability:.2g} {unit} 1σ "
            f"with τ = {model.instability_tau_s:.0f} s"
        )
    if model.walk is not None:
        parts.append(f"random walk {scale * model.walk:.2g}")
    return " and ".join(parts) + f"; as a walk over {BRIDGED_S:.0f} s"
