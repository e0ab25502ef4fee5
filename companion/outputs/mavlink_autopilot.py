"""Our solution as an input of the autopilot's own estimator: epochs to MAVLink messages. Pure.

What each autopilot takes, read in its sources and flown against:

**ArduPilot, ODOMETRY**: LOCAL_FRD with BODY_FRD and nothing else; attitude relative to north;
velocity in body axes; quality −1 is dropped; positions count from its origin, which it must have
been given (SET_GPS_GLOBAL_ORIGIN). Of the covariances it makes one position and one angle error.

**PX4, ODOMETRY**: LOCAL_NED with BODY_FRD; the estimator types GPS_INS and AUTOPILOT are refused;
of the covariances the diagonals are read; a vector with NaN counts as absent.

**ArduPilot, GPS_INPUT**: fix type 3 or more; velocities that are ignored keep their last value, so
none is; altitude above mean sea level; yaw in centidegrees, 0 for unknown and 36000 for north.

Nothing is sent that would mislead (:func:`trust`): no message before alignment, no attitude while
the heading is unknown, and while coasting the quality falls with the growing standard deviation,
until nothing is sent any more (ODOMETRY) or no fix is claimed (GPS_INPUT).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.outputs.epoch import Epoch
from companion.outputs.local_frames import Origin, ardupilot_ne, px4_ne
from companion.outputs.mavlink_ground import degrees_e7, upper_triangle
from companion.types import F64, NS, Mode

COASTING_QUALITY = 50
"""Most that a solution without aiding is said to be worth, in per cent."""
GPS_EPOCH_S = 315_964_800
"""1980-01-06 in Unix time."""
LEAP_S = 18
"""GPS − UTC since 2017; a further leap second has not been announced."""
WEEK_MS = 604_800_000
RANGE_ERROR_M = 2.5
"""Of a usual receiver: turns a standard deviation into a dilution of precision."""
LEAST_DOP = 0.5
SATELLITES = 10
"""Claimed while aided: autopilots ask for six, and the solution itself has no number."""
COASTING_SATELLITES = 6
YAW_SD = math.radians(10.0)
"""Least certain heading that is worth giving."""
_NO_FIX, _FIX_3D = 1, 3


class Trust(NamedTuple):
    """What may be said of an epoch."""

    position: bool
    """Position and velocity are there, and better than the limit."""
    heading: bool
    """The heading too."""
    quality: int
    """1 to 100 per cent; 0 with no position."""


def trust(epoch: Epoch, max_sd_m: float) -> Trust:
    """How far an epoch can be relied on.

    The quality falls from 100 at a horizontal 1σ of zero to 1 at ``max_sd_m``, beyond which there
    is no position; without aiding it is 50 at most.
    """
    sd = epoch.sd_horizontal if epoch.usable else math.inf
    if epoch.mode == Mode.ALIGNING or not sd <= max_sd_m:
        return Trust(position=False, heading=False, quality=0)
    quality = max(1, round(100 * (1 - sd / max_sd_m)))
    if epoch.mode == Mode.COASTING:
        quality = min(quality, COASTING_QUALITY)
    return Trust(True, epoch.mode != Mode.HEADING_UNKNOWN, quality)


def odometry_ardupilot(epoch: Epoch, origin: Origin, quality: int, resets: int) -> Any:
    """ODOMETRY as ArduPilot's AP_VisualOdom takes it; ``origin`` is the autopilot's own."""
    north, east = ardupilot_ne(epoch.lat, epoch.lon, origin)
    position = np.array([north, east, origin.height - epoch.height])
    frame, kind = mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_ESTIMATOR_TYPE_GPS_INS
    return _odometry(epoch, frame, kind, position, quality, resets)


def odometry_px4(epoch: Epoch, origin: Origin, quality: int, resets: int) -> Any:
    """ODOMETRY as PX4's EKF2 takes it; ``origin`` is the autopilot's own."""
    north, east = px4_ne(epoch.lat, epoch.lon, origin)
    position = np.array([north, east, origin.height - epoch.height])
    frame, kind = mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_ESTIMATOR_TYPE_UNKNOWN
    return _odometry(epoch, frame, kind, position, quality, resets)


def _odometry(epoch: Epoch, frame: int, kind: int, ned: F64, quality: int, resets: int) -> Any:
    pose, twist = np.zeros((6, 6)), np.zeros((6, 6))
    pose[:3, :3], pose[3:, 3:] = epoch.cov_pos, epoch.cov_rpy
    twist[:3, :3] = epoch.cov_vel_b
    twist[[3, 4, 5], [3, 4, 5]] = np.nan  # rates are differences of attitudes: not known how good
    return mavlink.MAVLink_odometry_message(
        epoch.t_ns // 1000,
        frame,
        mavlink.MAV_FRAME_BODY_FRD,
        *ned.tolist(),
        epoch.q_nb.tolist(),
        *epoch.vel_b.tolist(),
        *epoch.rate_b.tolist(),
        upper_triangle(pose),
        upper_triangle(twist),
        reset_counter=resets % 256,
        estimator_type=kind,
        quality=quality,
    )


def set_gps_global_origin(
    epoch_ns: int, target_system: int, origin: Origin, undulation_m: float
) -> Any:
    """SET_GPS_GLOBAL_ORIGIN; altitude above mean sea level."""
    return mavlink.MAVLink_set_gps_global_origin_message(
        target_system,
        degrees_e7(origin.lat),
        degrees_e7(origin.lon),
        round((origin.height - undulation_m) * 1e3),
        epoch_ns // 1000,
    )


def request_origin(target_system: int) -> Any:
    """Ask for GPS_GLOBAL_ORIGIN: an autopilot that had one already does not echo ours."""
    return mavlink.MAVLink_command_long_message(
        target_system,
        mavlink.MAV_COMP_ID_AUTOPILOT1,
        mavlink.MAV_CMD_REQUEST_MESSAGE,
        0,
        mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
        *(0.0,) * 6,
    )


def gps_input(epoch: Epoch, said: Trust, gps_id: int, undulation_m: float) -> Any:
    """GPS_INPUT: our solution as receiver number ``gps_id``, at the IMU's place.

    Accuracies are 1σ: horizontal of both components together, speed of all three.
    """
    week, week_ms = gps_time(epoch.t_ns)
    sd_vertical = math.sqrt(max(0.0, epoch.cov_pos[2, 2]))
    coasting = epoch.mode == Mode.COASTING
    return mavlink.MAVLink_gps_input_message(
        epoch.t_ns // 1000,
        gps_id,
        0,  # nothing is to be ignored
        week_ms,
        week,
        _FIX_3D if said.position else _NO_FIX,
        degrees_e7(epoch.lat),
        degrees_e7(math.remainder(epoch.lon, 2 * math.pi)),
        epoch.height - undulation_m,
        max(LEAST_DOP, epoch.sd_horizontal / RANGE_ERROR_M),
        max(LEAST_DOP, sd_vertical / RANGE_ERROR_M),
        *epoch.vel_n.tolist(),
        math.sqrt(max(0.0, float(np.trace(epoch.cov_vel)))),
        epoch.sd_horizontal,
        sd_vertical,
        (COASTING_SATELLITES if coasting else SATELLITES) if said.position else 0,
        yaw_cdeg(epoch.rpy[2]) if said.heading and epoch.cov_rpy[2, 2] <= YAW_SD**2 else 0,
    )


def gps_time(t_ns: int) -> tuple[int, int]:
    """GPS week and millisecond in it of a UTC time; week 0 for a clock that was never set."""
    since_ms = t_ns // (NS // 1000) + (LEAP_S - GPS_EPOCH_S) * 1000
    week, week_ms = divmod(since_ms, WEEK_MS)
    return (week, week_ms) if 0 < week < 2**16 else (0, 0)


def yaw_cdeg(yaw: float) -> int:
    """Heading as 1 to 36000 centidegrees; 0 would say that there is none."""
    return round(math.degrees(yaw) * 100) % 36_000 or 36_000
