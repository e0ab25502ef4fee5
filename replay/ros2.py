"""Solutions as a ROS 2 bag: one MCAP file with odometry and fixes, for RViz, rosbag2 and Foxglove.

Messages are in CDR, little endian (OMG DDSI-RTPS 2.5, chapter 10: each value at a multiple of its
size, counted after the four bytes of the encapsulation header). Frame names are of fixed length
here, so that every message of a topic has the same layout and a column of a table is a field.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray

from companion import __version__
from companion.logbook.messages import odometry, position_covariance_enu
from companion.types import NS, CompanionError, Mode, Solution

ODOMETRY, FIX = "/companion/odometry", "/companion/fix"
_MAP, _BODY = b"map\0", b"base_link\0"
_UNKNOWN_VARIANCE = 1e6
"""Of the angular rate, which a solution does not have: [rad²/s²]."""
_CDR = bytes([0, 1, 0, 0])
_KNOWN_COVARIANCE, _FIXED, _GPS = 3, 0, 1
"""NavSatFix: COVARIANCE_TYPE_KNOWN, STATUS_FIX, SERVICE_GPS."""

_ODOMETRY = np.dtype(
    {
        "names": ["cdr", "sec", "nanosec", "frame_n", "frame", "child_n", "child", "position", "q",
                  "pose_cov", "linear", "angular", "twist_cov"],
        "formats": ["V4", "<i4", "<u4", "<u4", "V4", "<u4", "V10", "3<f8", "4<f8", "36<f8",
                    "3<f8", "3<f8", "36<f8"],
        "offsets": [0, 4, 8, 12, 16, 20, 24, 36, 60, 92, 380, 404, 428],
        "itemsize": 716,
    }
)  # fmt: skip
_FIX = np.dtype(
    {
        "names": ["cdr", "sec", "nanosec", "frame_n", "frame", "status", "service", "place",
                  "cov", "kind"],
        "formats": ["V4", "<i4", "<u4", "<u4", "V10", "<i1", "<u2", "3<f8", "9<f8", "<u1"],
        "offsets": [0, 4, 8, 12, 16, 26, 28, 36, 60, 132],
        "itemsize": 133,
    }
)  # fmt: skip
"""Offsets with the encapsulation header, without which they are multiples of the sizes."""

_LINE = "=" * 80
_HEADER = f"""{_LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_DEFINITIONS = {
    "nav_msgs/msg/Odometry": f"""std_msgs/Header header
string child_frame_id
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist
{_HEADER}{_LINE}
MSG: geometry_msgs/PoseWithCovariance
geometry_msgs/Pose pose
float64[36] covariance
{_LINE}
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
{_LINE}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
{_LINE}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
{_LINE}
MSG: geometry_msgs/TwistWithCovariance
geometry_msgs/Twist twist
float64[36] covariance
{_LINE}
MSG: geometry_msgs/Twist
geometry_msgs/Vector3 linear
geometry_msgs/Vector3 angular
{_LINE}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
""",
    "sensor_msgs/msg/NavSatFix": f"""std_msgs/Header header
sensor_msgs/NavSatStatus status
float64 latitude
float64 longitude
float64 altitude
float64[9] position_covariance
uint8 position_covariance_type
{_HEADER}{_LINE}
MSG: sensor_msgs/NavSatStatus
int8 status
uint16 service
""",
}


def write_bag(solution: Solution, path: Path, *, name: str, height_datum: str) -> int:
    """Write the epochs that have a solution; how many they are.

    ``map`` is east, north, up of the first epoch, ``base_link`` forward, left, up. The altitude of
    a fix is in ``height_datum``, which the file's metadata says: ROS expects the ellipsoid.
    Raises :class:`CompanionError` when the file cannot be written, or for a time before 1970.
    """
    usable = (solution.mode != Mode.ALIGNING) & np.isfinite(solution.lat)
    flown = solution.take(np.flatnonzero(usable))
    if len(flown) and flown.t_ns[0] < 0:
        raise CompanionError(f"{path}: a ROS 2 bag has no times before 1970")
    tables = {
        ODOMETRY: ("nav_msgs/msg/Odometry", _odometry(flown)),
        FIX: ("sensor_msgs/msg/NavSatFix", _fixes(flown)),
    }
    try:
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start(profile="ros2", library=f"companion {__version__}")
            writer.add_metadata("companion", {"solution": name, "height_datum": height_datum})
            for topic, (kind, table) in tables.items():
                schema = writer.register_schema(kind, "ros2msg", _DEFINITIONS[kind].encode())
                channel = writer.register_channel(topic, "cdr", schema)
                for t_ns, row in zip(flown.t_ns.tolist(), table, strict=True):
                    writer.add_message(channel, t_ns, row.tobytes(), t_ns)
            writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it unannotated
    except OSError as error:
        raise CompanionError(f"{path}: {error.strerror or error}") from None
    return len(flown)


def _stamped(solution: Solution, layout: np.dtype[Any]) -> NDArray[Any]:
    table = np.zeros(len(solution), layout)
    table["cdr"] = np.void(_CDR)
    table["sec"], table["nanosec"] = solution.t_ns // NS, solution.t_ns % NS
    return table


def _odometry(solution: Solution) -> NDArray[Any]:
    table = _stamped(solution, _ODOMETRY)
    if not len(solution):
        return table
    origin = float(solution.lat[0]), float(solution.lon[0]), float(solution.height[0])
    o = odometry(solution, origin)
    table["frame_n"], table["frame"] = len(_MAP), np.void(_MAP)
    table["child_n"], table["child"] = len(_BODY), np.void(_BODY)
    table["position"], table["q"] = o.position, o.q[:, [1, 2, 3, 0]]
    table["linear"] = o.velocity
    table["pose_cov"] = o.pose_cov.reshape(-1, 36)
    twist = o.twist_cov.copy()
    twist[:, [3, 4, 5], [3, 4, 5]] = _UNKNOWN_VARIANCE
    table["twist_cov"] = twist.reshape(-1, 36)
    return table


def _fixes(solution: Solution) -> NDArray[Any]:
    table = _stamped(solution, _FIX)
    table["frame_n"], table["frame"] = len(_BODY), np.void(_BODY)
    table["status"], table["service"], table["kind"] = _FIXED, _GPS, _KNOWN_COVARIANCE
    degrees = np.degrees(solution.lat), np.degrees(solution.lon)
    table["place"] = np.column_stack([*degrees, solution.height])
    table["cov"] = position_covariance_enu(solution).reshape(-1, 9)
    return table
