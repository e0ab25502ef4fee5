"""Navigation as a ground station reads it: epochs to MAVLink messages. Pure.

=========================  ===================================================================
ATTITUDE_QUATERNION        body to north-east-down, mean rates since the epoch before
GLOBAL_POSITION_INT_COV    altitude above mean sea level; states north, east, **up**, vel NED [m]
LOCAL_POSITION_NED_COV     from the origin, 9×9 upper triangle of position, velocity, acceleration
ESTIMATOR_STATUS           flags, NIS over gate of each kind of aid, 1σ of position
STATUSTEXT                 events, in chunks of 50 bytes
HEARTBEAT                  onboard computer; its state says how the estimator is
=========================  ===================================================================

Times are of the run's clock. What is not known is NaN where the message has a way to say so.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.outputs.epoch import Epoch
from companion.types import F64, AidingReports, Channel, Event, Mode, Verdict

CHUNK = 50
"""Bytes of one STATUSTEXT."""
_SEVERITY = {
    "info": mavlink.MAV_SEVERITY_INFO,
    "warning": mavlink.MAV_SEVERITY_WARNING,
    "error": mavlink.MAV_SEVERITY_ERROR,
}
_STATE = {
    Mode.ALIGNING: mavlink.MAV_STATE_CALIBRATING,
    Mode.HEADING_UNKNOWN: mavlink.MAV_STATE_CALIBRATING,
    Mode.NAVIGATING: mavlink.MAV_STATE_ACTIVE,
    Mode.COASTING: mavlink.MAV_STATE_CRITICAL,
}
_LEVELLED = (
    mavlink.ESTIMATOR_ATTITUDE | mavlink.ESTIMATOR_VELOCITY_VERT | mavlink.ESTIMATOR_POS_VERT_ABS
)
_HORIZONTAL = (
    mavlink.ESTIMATOR_VELOCITY_HORIZ
    | mavlink.ESTIMATOR_POS_HORIZ_REL
    | mavlink.ESTIMATOR_PRED_POS_HORIZ_REL
)
_ABSOLUTE = mavlink.ESTIMATOR_POS_HORIZ_ABS | mavlink.ESTIMATOR_PRED_POS_HORIZ_ABS
_RATIOS = {
    "velocity": (Channel.GNSS_VELOCITY_H, Channel.GNSS_VELOCITY_V),
    "horizontal": (Channel.GNSS_POSITION_H,),
    "vertical": (Channel.GNSS_POSITION_V, Channel.BARO),
    "mag": (Channel.MAG,),
}


def heartbeat(mode: Mode) -> Any:
    """HEARTBEAT of an onboard computer without an autopilot of its own."""
    kind, none = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
    return mavlink.MAVLink_heartbeat_message(kind, none, 0, 0, _STATE[mode], 3)


def attitude_quaternion(epoch: Epoch, start_ns: int) -> Any:
    """ATTITUDE_QUATERNION; ``start_ns`` is when the process began."""
    return mavlink.MAVLink_attitude_quaternion_message(
        boot_ms(epoch.t_ns, start_ns), *epoch.q_nb.tolist(), *epoch.rate_b.tolist()
    )


def global_position_int_cov(epoch: Epoch, undulation_m: float, ground_height: float) -> Any:
    """GLOBAL_POSITION_INT_COV.

    ``undulation_m``: the solution's datum above mean sea level; ``ground_height``: what relative
    altitude counts from, in the solution's datum [m].
    """
    cov = np.zeros((6, 6))
    cov[:3, :3], cov[3:, 3:] = epoch.cov_pos, epoch.cov_vel
    cov[2, :] *= -1.0  # third state: altitude, upwards
    cov[:, 2] *= -1.0
    return mavlink.MAVLink_global_position_int_cov_message(
        epoch.t_ns // 1000,
        mavlink.MAV_ESTIMATOR_TYPE_GPS_INS,
        degrees_e7(epoch.lat),
        degrees_e7(math.remainder(epoch.lon, 2 * math.pi)),
        round((epoch.height - undulation_m) * 1e3),
        round((epoch.height - ground_height) * 1e3),
        *epoch.vel_n.tolist(),
        cov.ravel().tolist(),
    )


def local_position_ned_cov(epoch: Epoch, ned: tuple[float, float, float]) -> Any:
    """LOCAL_POSITION_NED_COV at ``ned`` from the origin [m].

    Accelerations are means since the epoch before; their variances are not known (NaN).
    """
    cov = np.zeros((9, 9))
    cov[:3, :3], cov[3:6, 3:6] = epoch.cov_pos, epoch.cov_vel
    cov[[6, 7, 8], [6, 7, 8]] = np.nan
    return mavlink.MAVLink_local_position_ned_cov_message(
        epoch.t_ns // 1000,
        mavlink.MAV_ESTIMATOR_TYPE_GPS_INS,
        *ned,
        *epoch.vel_n.tolist(),
        *epoch.accel_n.tolist(),
        upper_triangle(cov),
    )


class TestRatios:
    """Of each kind of aid, the latest normalised innovation over its gate; above 1: rejected."""

    def __init__(self) -> None:
        self._latest: dict[int, float] = {}
        self._gnss_rejected = False

    def update(self, reports: AidingReports) -> None:
        """Take what became of the latest measurements."""
        for channel, verdict, nis, gate in zip(
            reports.channel.tolist(),
            reports.verdict.tolist(),
            reports.nis.tolist(),
            reports.gate.tolist(),
            strict=True,
        ):
            if verdict not in (Verdict.ACCEPTED, Verdict.REJECTED_GATE) or not gate > 0:
                continue
            self._latest[channel] = nis / gate
            if channel == Channel.GNSS_POSITION_H:
                self._gnss_rejected = verdict == Verdict.REJECTED_GATE

    def ratio(self, kind: str) -> float:
        """The larger of the channels of a kind; NaN before the first."""
        known = [self._latest[c] for c in _RATIOS[kind] if c in self._latest]
        return max(known, default=math.nan)

    @property
    def gnss_rejected(self) -> bool:
        """The latest position fix was outside its gate."""
        return self._gnss_rejected


def estimator_status(epoch: Epoch, ratios: TestRatios) -> Any:
    """ESTIMATOR_STATUS. While coasting, position is relative only and heights are predicted."""
    flags = 0
    if epoch.mode != Mode.ALIGNING:
        flags = _LEVELLED | _HORIZONTAL
        if epoch.mode == Mode.COASTING:
            flags &= ~mavlink.ESTIMATOR_POS_VERT_ABS
        else:
            flags |= _ABSOLUTE
    if epoch.mode == Mode.HEADING_UNKNOWN:
        flags &= ~mavlink.ESTIMATOR_ATTITUDE
    if ratios.gnss_rejected:
        flags |= mavlink.ESTIMATOR_GPS_GLITCH
    return mavlink.MAVLink_estimator_status_message(
        epoch.t_ns // 1000,
        flags,
        ratios.ratio("velocity"),
        ratios.ratio("horizontal"),
        ratios.ratio("vertical"),
        ratios.ratio("mag"),
        math.nan,  # no height above ground
        math.nan,  # no airspeed
        epoch.sd_horizontal,
        math.sqrt(max(0.0, epoch.cov_pos[2, 2])),
    )


def statustext(event: Event, number: int) -> list[Any]:
    """STATUSTEXT chunks of an event; ``number`` tells texts in several chunks apart."""
    data = f"nav: {event.text}".encode("ascii", "replace")
    chunks = [data[i : i + CHUNK] for i in range(0, len(data), CHUNK)]
    # An id of zero says that the text is whole.
    identity = 0 if len(chunks) == 1 else number % 0xFFFF + 1
    return [
        mavlink.MAVLink_statustext_message(_SEVERITY[event.level], chunk, identity, i)
        for i, chunk in enumerate(chunks[:256])
    ]


def boot_ms(t_ns: int, start_ns: int) -> int:
    """Milliseconds since the start, as 32 bits hold them."""
    return max(0, t_ns - start_ns) // 1_000_000 % 2**32


def degrees_e7(angle: float) -> int:
    """Radians as 1e-7 degrees."""
    return round(math.degrees(angle) * 1e7)


def upper_triangle(matrix: F64) -> list[float]:
    """Rows of the upper triangle, one after the other."""
    entries: list[float] = matrix[np.triu_indices(len(matrix))].tolist()
    return entries
