"""What the simulated vehicle flies live, and the configuration that says so to a companion."""

from __future__ import annotations

from typing import Any

import msgspec

from companion.config import Adaptation, CanBus, CanImu, Config, Log, Mavlink, Zenoh
from replay.simulator.aids import BaroSpec, GnssSpec, MagSpec
from replay.simulator.live.vehicle import CAN_SOURCE
from replay.simulator.matching import matching_config
from replay.simulator.scenarios import Scenario, TrajectorySpec, graded

NODE_ID = 42
CAN_LATENCY_MS = 1.0
"""From the end of a CAN unit's interval to its last frame's arrival."""


def live_scenario(
    seconds: float = 300.0, rest_s: float = 8.0, imu_hz: float = 200.0, gnss_hz: float = 5.0
) -> Scenario:
    """A multirotor's mission with a unit on the CAN bus beside the autopilot's own sensors.

    The receiver's fixes are stamped on arrival, as ArduPilot does.
    """
    return Scenario(
        name="demo",
        trajectory=TrajectorySpec(kind="multirotor-mission", duration_s=seconds, rest_s=rest_s),
        imu=(
            graded(
                "mems-consumer",
                source=CAN_SOURCE,
                rate_hz=imu_hz,
                output="integral",
                arrival_ms=CAN_LATENCY_MS,
                gyro_step_dps=0.0,
                accel_step_mps2=0.0,
                vibration_mps2=0.3,
            ),
            graded("mems-consumer", rate_hz=100.0, latency_ms=10.0, vibration_mps2=0.3),
        ),
        gnss=(GnssSpec(rate_hz=gnss_hz, latency_ms=100.0, stamped="arrival"),),
        baro=BaroSpec(),
        # A field given outright: declination then does not hang on this machine's date.
        mag=MagSpec(field_n_t=(21.4e-6, 1.3e-6, 43.0e-6)),
    )


def _receiver(spec: GnssSpec) -> dict[str, Any]:
    """Its error told apart into the white and the slow part, as the simulator makes it."""
    return {
        "sd_position_m": spec.sd_position_m,
        "sd_height_m": spec.sd_height_m,
        "slow_error_sd_m": spec.correlated_sd_position_m,
        "slow_error_height_sd_m": spec.correlated_sd_height_m,
        "slow_error_tau_s": spec.correlated_tau_s,
        "sd_reported": "ignore",  # it reports both parts together
    }


def live_config(
    scenario: Scenario, mavlink: str, can: str | None, zenoh_listen: str, directory: str = "."
) -> Config:
    """The companion's configuration beside a vehicle that flies ``scenario``.

    ``mavlink`` and ``zenoh_listen`` are endpoints, ``can`` the adapter's device or None for the
    autopilot's IMU alone; runs are logged in ``directory``.
    """
    own = next(imu for imu in scenario.imu if (imu.source == CAN_SOURCE) == (can is not None))
    base = matching_config(msgspec.structs.replace(scenario, imu=(own,)))
    # A unit that never sends the time of its samples is as late as its frames are.
    late_ms = own.latency_ms + (CAN_LATENCY_MS if can is not None else 0.0)
    receiver = scenario.gnss[0]
    unit = CanImu(name=CAN_SOURCE, protocol="dronecan", node_id=NODE_ID, rate_hz=own.rate_hz)
    bus = CanBus(
        channel=can or "",
        interface="slcan",
        imu=(unit,),
    )
    replace = msgspec.structs.replace
    return replace(
        base,
        imu=replace(base.imu, source=CAN_SOURCE if can else "auto", latency_ms=late_ms),
        can=(bus,) if can else (),
        gnss=replace(base.gnss, **_receiver(receiver)),
        mavlink=Mavlink(endpoint=mavlink, gnss_rate_hz=receiver.rate_hz),
        zenoh=Zenoh(listen=(zenoh_listen,)),
        log=Log(directory=directory),
        adaptation=Adaptation(),
    )
