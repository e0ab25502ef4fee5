"""Full scales said once: of a CAN unit, for the filter too."""

from __future__ import annotations

import msgspec

from companion.config.estimator import FurtherImu, Imu
from companion.config.live import CanBus, CanImu


def imu_with_range(imu: Imu, can: tuple[CanBus, ...]) -> Imu:
    """``imu`` with the full scales of the CAN unit that it is, where it says none of its own.

    That is the unit that ``imu.source`` names, or the only one there is.
    """
    units = [unit for bus in can for unit in bus.imu]
    named = [unit for unit in units if unit.name == imu.source]
    if not named and imu.source == "auto" and len(units) == 1:
        named = units
    if not named:
        return imu
    gyro, accel = _ranges(imu, named[0])
    return msgspec.structs.replace(imu, gyro_range_dps=gyro, accel_range_mps2=accel)


def further_with_ranges(
    further: tuple[FurtherImu, ...], can: tuple[CanBus, ...]
) -> tuple[FurtherImu, ...]:
    """The same of the units beside the first one, by their names."""
    units = {unit.name: unit for bus in can for unit in bus.imu}
    found = []
    for one in further:
        if (unit := units.get(one.source)) is not None:
            gyro, accel = _ranges(one, unit)
            one = msgspec.structs.replace(one, gyro_range_dps=gyro, accel_range_mps2=accel)
        found.append(one)
    return tuple(found)


def _ranges(said: Imu | FurtherImu, unit: CanImu) -> tuple[float, float]:
    """Gyro [deg/s] and accelerometer [m/s²]; 0: not known."""
    return (
        said.gyro_range_dps or unit.gyro_range_dps,
        said.accel_range_mps2 or unit.accel_range_mps2,
    )
