"""The scenario suite: one flight, and everything that can go wrong with its sensors, one at a time.

A trial is a scenario and the configuration of a user who does not know what will happen. All fly
the same kind of mission; the seed varies flight and errors. What goes wrong begins at
:data:`BEGIN_S`, when the filter has long settled, and is over well before the end where it can be.
"""

from __future__ import annotations

import math
from typing import Any

import msgspec

from companion.config import Config
from replay.simulator.aids import BaroSpec, Fault, GnssSpec, Outage
from replay.simulator.disturbances import BiasStep, NoiseChange, Shaking
from replay.simulator.matching import matching_config
from replay.simulator.scenarios import Scenario, TrajectorySpec, graded

DURATION_S = 180.0
SETTLED_S = 40.0
"""Errors count from here on: what alignment leaves is another matter."""
BEGIN_S = 70.0
SPIKES_M = (20.0, 30.0, 50.0, 75.0, 100.0, 150.0, 200.0, 300.0, 400.0, 500.0)
BURST_M = (45.0, -52.0, 0.0)


class Trial(msgspec.Struct, frozen=True):
    """One row of the suite."""

    name: str
    title: str
    scenario: Scenario
    config: Config
    end_s: float = DURATION_S
    """When what began at :data:`BEGIN_S` is over."""
    twin: str = ""
    """The trial with the same errors but for a fault of position: what the fault moved is the
    difference of the two solutions."""


def _scenario(name: str, gnss: GnssSpec | None = None, **more: Any) -> Scenario:
    fields: dict[str, Any] = {
        "trajectory": TrajectorySpec(kind="multirotor-mission", duration_s=DURATION_S),
        "imu": (graded("mems-consumer", rate_hz=100.0, vibration_mps2=0.5),),
    }
    return Scenario(
        name=name, gnss=(gnss or GnssSpec(),), baro=BaroSpec(), truth_rate_hz=10.0,
        **{**fields, **more},
    )  # fmt: skip


def suite_config(scenario: Scenario, **gnss: Any) -> Config:
    """What a careful user would write for the sensors of ``scenario``, its faults not known.

    White and slow error of the receiver apart, the deviations of the good receiver, and the
    heading of the start, which a trial is not about.
    """
    replace = msgspec.structs.replace
    config, good = matching_config(scenario), GnssSpec()
    receiver: dict[str, Any] = {
        "sd_position_m": good.sd_position_m,
        "sd_height_m": good.sd_height_m,
        "slow_error_sd_m": good.correlated_sd_position_m,
        "slow_error_height_sd_m": good.correlated_sd_height_m,
        "slow_error_tau_s": good.correlated_tau_s,
        "sd_reported": "floor",
        **gnss,
    }
    return replace(
        config,
        imu=replace(config.imu, vibration_gain_rthz=0.05),
        gnss=replace(config.gnss, **receiver),
        alignment=replace(
            config.alignment,
            heading="fixed",
            fixed_heading_deg=scenario.trajectory.heading_deg,
        ),
        engine=replace(config.engine, output_rate_hz=10.0, covariance_rate_hz=25.0),
    )


def _trial(name: str, title: str, gnss: GnssSpec | None = None, **more: Any) -> Trial:
    scenario = _scenario(name, gnss)
    return Trial(name, title, scenario, suite_config(scenario), **more)


def _fault(length_s: float, **error: Any) -> GnssSpec:
    return GnssSpec(faults=(Fault(start_s=BEGIN_S, length_s=length_s, **error),))


def _ramp(speed: float) -> Trial:
    way = (0.6 * speed, 0.8 * speed, 0.0)
    gnss = _fault(60.0, ramp_n_mps=way)
    title = f"ramp of {speed:g} m/s for 60 s"
    return _trial(f"ramp-{speed:g}", title, gnss, end_s=BEGIN_S + 60.0, twin="nominal")


def _spikes() -> Trial:
    """Single fixes, 8 s apart, each in another direction; every third is off in height too."""
    faults = []
    for i, size in enumerate(SPIKES_M):
        angle = 2.4 * i
        step = (size * math.cos(angle), size * math.sin(angle), size / 2 if i % 3 == 2 else 0.0)
        faults.append(Fault(start_s=BEGIN_S + 8.0 * i - 0.1, length_s=0.2, step_n_m=step))
    end = BEGIN_S + 8.0 * len(SPIKES_M)
    gnss = GnssSpec(faults=tuple(faults))
    return _trial("spikes", "single spikes of 20-500 m", gnss, end_s=end, twin="nominal")


def _accuracy(name: str, title: str, factor: float) -> Trial:
    """The receiver's own word is taken, as some users configure it, and is wrong throughout."""
    scenario = _scenario(name, GnssSpec(reported_factor=factor))
    return Trial(name, title, scenario, suite_config(scenario, sd_reported="use"))


def _after_outage() -> tuple[Trial, Trial]:
    silent = (Outage(start_s=BEGIN_S, length_s=20.0),)
    burst = Fault(start_s=BEGIN_S + 20.0, length_s=10.0, step_n_m=BURST_M)
    end = BEGIN_S + 30.0
    return (
        _trial("outage", "outage of 20 s", GnssSpec(outages=silent), end_s=end),
        _trial(
            "burst",
            "outage of 20 s, then 10 s of fixes 69 m off",
            GnssSpec(outages=silent, faults=(burst,)),
            end_s=end,
            twin="outage",
        ),
    )


def _shaken() -> Trial:
    shaking = Shaking(start_s=BEGIN_S, length_s=20.0, accel_mps2=40.0, gyro_dps=20.0)
    imu = graded("mems-consumer", rate_hz=100.0, accel_range_mps2=78.5, shaking=(shaking,))
    scenario = _scenario("vibration", imu=(imu,))
    title = "vibration of 40 m/s² for 20 s, clipped at 8 g"
    return Trial("vibration", title, scenario, suite_config(scenario), BEGIN_S + 20.0)


def _sport() -> Trial:
    """Hard manoeuvres, scale errors of 0.2 % and a latency that is configured 30 ms too short."""
    scenario = _scenario(
        "manoeuvres",
        GnssSpec(stamped="arrival", latency_ms=100.0),
        trajectory=TrajectorySpec(kind="multirotor-sport", duration_s=DURATION_S),
    )
    title = "hard manoeuvres, latency 30 ms off"
    config = suite_config(scenario, latency_ms=70.0, latency_sd_ms=10.0)
    return Trial("manoeuvres", title, scenario, config)


def _stepped() -> Trial:
    step = BiasStep(start_s=BEGIN_S, gyro_dps=(0.5, -0.3, 0.4), accel_mps2=(0.3, -0.2, 0.2))
    imu = graded("mems-consumer", rate_hz=100.0, vibration_mps2=0.5, bias_steps=(step,))
    scenario = _scenario("bias-step", imu=(imu,))
    return Trial("bias-step", "IMU biases step 0.5 °/s, 0.3 m/s²", scenario, suite_config(scenario))


def _wandering() -> Trial:
    """A receiver whose slow error nobody configured: defaults, as most users leave them."""
    gnss = GnssSpec(correlated_sd_position_m=1.5, correlated_sd_height_m=2.5, correlated_tau_s=120)
    scenario = _scenario("wandering", gnss)
    config = suite_config(
        scenario,
        sd_position_m=1.5, sd_height_m=3.0, sd_velocity_mps=0.2, sd_velocity_down_mps=0.3,
        latency_sd_ms=10.0, slow_error_sd_m=0.0, slow_error_height_sd_m=0.0,
    )  # fmt: skip
    return Trial("wandering", "slow GNSS error 1.5 m, τ 120 s, not configured", scenario, config)


def _all() -> tuple[Trial, ...]:
    noisy = GnssSpec(noise_changes=(NoiseChange(start_s=BEGIN_S, length_s=60.0, factor=5.0),))
    multipath = _fault(40.0, step_n_m=(6.4, -4.8, 0.0))
    return (
        _trial("nominal", "nominal"),
        _wandering(),
        _trial("noise", "GNSS noise ×5 for 60 s", noisy, end_s=BEGIN_S + 60.0),
        _accuracy("overstated", "accuracy overstated ×5 (reports 1/5)", 0.2),
        _accuracy("understated", "accuracy understated ×5", 5.0),
        _trial("multipath", "bias of 8 m for 40 s", multipath, end_s=BEGIN_S + 40.0,
               twin="nominal"),
        _spikes(),
        *_after_outage(),
        *(_ramp(speed) for speed in (0.2, 0.5, 1.0, 2.0)),
        _shaken(),
        _sport(),
        _stepped(),
    )  # fmt: skip


SUITE: dict[str, Trial] = {trial.name: trial for trial in _all()}
"""Trials by name, in the order of their table."""
