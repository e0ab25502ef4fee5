"""Navigation outputs as protobuf messages, one an epoch: for the log and for subscribers.

Own messages (``NavState``, ``AidingReport``) keep SI, radians and exact bits. Foxglove's
(``LocationFix``, ``Odometry``) are what map and 3-D panels draw: degrees, east-north-up, body
forward-left-up.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from companion.logbook.rows import (
    U8,
    RowTemplate,
    nested,
    packed,
    scalar,
    text,
    timestamp,
    timestamp_columns,
)
from companion.navigation.earth import ned_difference
from companion.navigation.rotation import rpy_from_quat
from companion.proto import navigation_pb2
from companion.types import (
    COV_ATT,
    COV_POS,
    COV_VEL,
    F64,
    NS,
    AidingReports,
    LogFormatError,
    Mode,
    Smoothed,
    Solution,
)

_COV_BLOCKS = ("cov_pos", "cov_vel", "cov_att", "cov_accel_bias", "cov_gyro_bias")
"""Fields of NavState in the order of :attr:`Solution.cov`'s rows."""

_STATE_PARTS = (
    scalar(1, "sfixed64", "t_ns"),
    scalar(2, "enum", "mode"),
    scalar(3, "fixed32", "resets"),
    scalar(4, "double", "lat"),
    scalar(5, "double", "lon"),
    scalar(6, "double", "height"),
    packed(7, "double", "vel_n", 3),
    packed(8, "double", "q_nb", 4),
    packed(9, "double", "accel_bias_b", 3),
    packed(10, "double", "gyro_bias_b", 3),
    *(packed(11 + i, "double", name, 6) for i, name in enumerate(_COV_BLOCKS)),
    packed(16, "float", "sd_pos_m", 3),
    packed(17, "float", "sd_vel_mps", 3),
    packed(18, "float", "sd_att_deg", 3),
    scalar(19, "float", "roll_deg"),
    scalar(20, "float", "pitch_deg"),
    scalar(21, "float", "yaw_deg"),
)
_STATE = RowTemplate(*_STATE_PARTS)
_SMOOTHED = RowTemplate(
    *_STATE_PARTS, scalar(23, "float", "lag_s"), scalar(24, "sfixed32", "as_filtered")
)
_REPORT = RowTemplate(
    scalar(1, "sfixed64", "t_ns"),
    scalar(2, "enum", "channel"),
    scalar(3, "enum", "verdict"),
    scalar(4, "sfixed32", "source"),
    scalar(5, "fixed32", "dof"),
    packed(6, "double", "innovation", 3),
    packed(7, "double", "innovation_sd", 3),
    scalar(8, "double", "nis"),
    scalar(9, "double", "gate"),
    scalar(10, "double", "scale"),
)
_STATE_FIELDS = ("t_ns", "mode", "resets", "lat", "lon", "height", "vel_n", "q_nb",
                 "accel_bias_b", "gyro_bias_b")  # fmt: skip
_REPORT_FIELDS = ("t_ns", "channel", "verdict", "source", "dof", "innovation", "innovation_sd",
                  "nis", "gate", "scale")  # fmt: skip


def _vector(number: int, prefix: str, axes: str = "xyz") -> list[Any]:
    """Foxglove's Vector3 or Quaternion."""
    return nested(
        number, [p for i, a in enumerate(axes) for p in scalar(i + 1, "double", prefix + a)]
    )


_FIX = RowTemplate(
    timestamp(6),
    text(7, "wgs84"),
    scalar(1, "double", "latitude"),
    scalar(2, "double", "longitude"),
    scalar(3, "double", "altitude"),
    packed(4, "double", "position_covariance", 9),
    [b"\x28\x03"],  # position_covariance_type = KNOWN
    scalar(10, "double", "heading"),
    _vector(11, "vel_"),
)
_ODOMETRY = RowTemplate(
    timestamp(1),
    text(2, "origin_enu"),
    text(3, "body_flu"),
    nested(4, [*_vector(1, "pos_"), *_vector(2, "q_", "xyzw")]),
    _vector(5, "vel_"),
    packed(7, "double", "pose_covariance", 36),
    packed(8, "double", "velocity_covariance", 36),
)

_ENU = np.array([1, 0, 2])
"""Picks north-east-down as east-north-down; the third axis then changes its sign."""
_ENU_SIGN = np.array([1.0, 1.0, -1.0])
_FLU_SIGN = np.array([1.0, -1.0, -1.0])


def encode_states(solution: Solution) -> U8:
    """One ``NavState`` an epoch: bytes (N, length)."""
    return _STATE.encode(_state_columns(solution), len(solution))


def encode_smoothed(smoothed: Smoothed) -> U8:
    """One ``NavState`` with its lag an epoch: bytes (N, length)."""
    columns = _state_columns(smoothed.solution)
    columns["lag_s"] = (smoothed.lag_ns / NS).astype(np.float32)
    columns["as_filtered"] = ~smoothed.smoothed
    return _SMOOTHED.encode(columns, len(smoothed))


def _state_columns(solution: Solution) -> dict[str, Any]:
    columns: dict[str, Any] = {name: getattr(solution, name) for name in _STATE_FIELDS}
    for i, name in enumerate(_COV_BLOCKS):
        columns[name] = solution.cov[:, i]
    with np.errstate(invalid="ignore", over="ignore"):
        sd = solution.sd
        rpy = np.degrees(rpy_from_quat(solution.q_nb))
        columns["sd_pos_m"] = sd[:, COV_POS].astype(np.float32)
        columns["sd_vel_mps"] = sd[:, COV_VEL].astype(np.float32)
        columns["sd_att_deg"] = np.degrees(sd[:, COV_ATT]).astype(np.float32)
    for i, name in enumerate(("roll_deg", "pitch_deg", "yaw_deg")):
        columns[name] = rpy[:, i]
    return columns


def decode_states(payloads: Sequence[bytes]) -> Solution:
    """The epochs of ``NavState`` messages, in the order given.

    Raises :class:`LogFormatError` when one is not a NavState.
    """
    if not payloads:
        return Solution.empty()
    template = _SMOOTHED if len(payloads[0]) == _SMOOTHED.size else _STATE
    rows = template.decode(payloads)
    get = _getter(rows, payloads, navigation_pb2.NavState)
    try:
        cov = np.stack([get(name, 6) for name in _COV_BLOCKS], axis=1)
        return Solution(
            t_ns=get("t_ns").astype(np.int64),
            lat=get("lat"),
            lon=get("lon"),
            height=get("height"),
            vel_n=get("vel_n", 3),
            q_nb=get("q_nb", 4),
            accel_bias_b=get("accel_bias_b", 3),
            gyro_bias_b=get("gyro_bias_b", 3),
            cov=cov,
            mode=get("mode").astype(np.int64),
            resets=get("resets").astype(np.int64),
        )
    except ValueError:
        raise LogFormatError("a navigation state with fields of the wrong length") from None


def encode_reports(reports: AidingReports) -> U8:
    """One ``AidingReport`` an update: bytes (N, length)."""
    return _REPORT.encode({n: getattr(reports, n) for n in _REPORT_FIELDS}, len(reports))


def decode_reports(payloads: Sequence[bytes]) -> AidingReports:
    """The rows of ``AidingReport`` messages, in the order given.

    Raises :class:`LogFormatError` when one is not an AidingReport.
    """
    if not payloads:
        return AidingReports.empty()
    rows = _REPORT.decode(payloads)
    get = _getter(rows, payloads, navigation_pb2.AidingReport)
    integer = ("t_ns", "channel", "verdict", "source", "dof")
    try:
        return AidingReports(
            **{n: get(n).astype(np.int64) for n in integer},
            **{n: get(n, 3) for n in ("innovation", "innovation_sd")},
            **{n: get(n) for n in ("nis", "gate", "scale")},
        )
    except ValueError:
        raise LogFormatError("an aiding report with fields of the wrong length") from None


def _getter(rows: NDArray[Any] | None, payloads: Sequence[bytes], message: Any) -> Any:
    """Column access: by view for rows of our own layout, by parsing for anybody else's."""

    def view(name: str, _width: int = 1) -> NDArray[Any]:
        assert rows is not None
        return np.ascontiguousarray(rows[name])

    def parse(name: str, width: int = 1) -> NDArray[Any]:
        values = np.array([getattr(m, name) for m in parsed])
        return values if width == 1 else values.reshape(len(parsed), width)

    if rows is not None:
        return view
    try:
        parsed = [message.FromString(p) for p in payloads]
    except DecodeError:
        raise LogFormatError(f"not a {message.DESCRIPTOR.full_name} message") from None
    return parse


def encode_fixes(solution: Solution) -> U8:
    """One ``foxglove.LocationFix`` an epoch: bytes (N, length)."""
    return _FIX.encode(
        {
            **timestamp_columns(solution.t_ns),
            "latitude": np.degrees(solution.lat),
            "longitude": np.degrees(solution.lon),
            "altitude": solution.height,
            "position_covariance": position_covariance_enu(solution).reshape(-1, 9),
            "heading": rpy_from_quat(solution.q_nb)[:, 2],
            "vel_x": solution.vel_n[:, 1],
            "vel_y": solution.vel_n[:, 0],
            "vel_z": -solution.vel_n[:, 2],
        },
        len(solution),
    )


def encode_odometry(solution: Solution, origin: tuple[float, float, float]) -> U8:
    """One ``foxglove.Odometry`` an epoch: bytes (N, length), as :func:`odometry` has it."""
    n, o = len(solution), odometry(solution, origin)
    return _ODOMETRY.encode(
        {
            **timestamp_columns(solution.t_ns),
            **{"pos_" + a: o.position[:, i] for i, a in enumerate("xyz")},
            **{"q_" + a: o.q[:, i] for i, a in enumerate("wxyz")},
            **{"vel_" + a: o.velocity[:, i] for i, a in enumerate("xyz")},
            "pose_covariance": o.pose_cov.reshape(n, 36),
            "velocity_covariance": o.twist_cov.reshape(n, 36),
        },
        n,
    )


class Odometry(NamedTuple):
    """A solution in the axes that ROS and Foxglove use."""

    position: F64
    """(N, 3) east, north, up of the origin [m]."""
    q: F64
    """(N, 4) scalar first, forward-left-up to east-north-up."""
    velocity: F64
    """(N, 3) forward, left, up [m/s]."""
    pose_cov: F64
    """(N, 6, 6) of position and attitude error, east, north, up [m², rad²]."""
    twist_cov: F64
    """(N, 6, 6) of the velocity [m²/s²]; zero where it is of the angular rate."""


def odometry(solution: Solution, origin: tuple[float, float, float]) -> Odometry:
    """The solution about ``origin`` (latitude, longitude [rad], height [m])."""
    n = len(solution)
    lat0, lon0, height0 = (np.full(n, v) for v in origin)
    ned = ned_difference(solution.lat, solution.lon, solution.height, lat0, lon0, height0)
    C_bf = _body_from_nav(solution.q_nb) * _FLU_SIGN[:, None]
    pose, twist = np.zeros((n, 6, 6)), np.zeros((n, 6, 6))
    pose[:, :3, :3] = _ned_to_enu(_symmetric(solution.cov[:, COV_POS]))
    pose[:, 3:, 3:] = _ned_to_enu(_symmetric(solution.cov[:, COV_ATT]))
    twist[:, :3, :3] = C_bf @ _symmetric(solution.cov[:, COV_VEL]) @ C_bf.transpose(0, 2, 1)
    return Odometry(
        position=ned[:, _ENU] * _ENU_SIGN,
        q=_enu_flu_quaternion(solution.q_nb),
        velocity=np.einsum("nij,nj->ni", C_bf, solution.vel_n),
        pose_cov=pose,
        twist_cov=twist,
    )


def position_covariance_enu(solution: Solution) -> F64:
    """Of the position (N, 3, 3), rows and columns east, north, up [m²]."""
    return _ned_to_enu(_symmetric(solution.cov[:, COV_POS]))


def drawable(solution: Solution, interval_ns: int, last_slot: int) -> tuple[Solution, int]:
    """Epochs with a solution, at most one in each ``interval_ns``, and the last slot used."""
    slot = solution.t_ns // interval_ns
    previous = np.concatenate(([last_slot], slot[:-1]))
    usable = (slot != previous) & (solution.mode != Mode.ALIGNING)
    for name in ("lat", "lon", "height", "vel_n", "q_nb"):
        finite = np.isfinite(getattr(solution, name))
        usable &= finite if finite.ndim == 1 else finite.all(axis=1)
    index = np.flatnonzero(usable)
    return solution.take(index), int(slot[-1]) if len(slot) else last_slot


def _symmetric(upper: F64) -> F64:
    """(N, 3, 3) of upper triangles (N, 6)."""
    full: F64 = upper[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    return full


def _ned_to_enu(matrix: F64) -> F64:
    """Covariance (N, 3, 3) with rows and columns east, north, up."""
    swapped: F64 = matrix[:, _ENU][:, :, _ENU] * _ENU_SIGN[:, None] * _ENU_SIGN
    return swapped


def _body_from_nav(q_nb: F64) -> F64:
    """C_bn (N, 3, 3) of quaternions (N, 4)."""
    w, x, y, z = q_nb.T
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)],
        [2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)],
        [2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _enu_flu_quaternion(q_nb: F64) -> F64:
    """(N, 4) scalar first, forward-left-up to east-north-up.

    q = (0, √½, √½, 0) ⊗ q_nb ⊗ (0, 1, 0, 0): the half turn about the north-east diagonal that
    takes NED to ENU, and the half turn about the forward axis that takes FLU to FRD.
    """
    w, x, y, z = q_nb.T
    h = np.sqrt(0.5)
    first = h * np.stack([-x - y, w + z, w - z, y - x], axis=1)
    a, b, c, d = first.T
    return np.stack([-b, a, d, -c], axis=1)
