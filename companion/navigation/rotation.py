"""Rotations: quaternions, matrices, Euler angles. Hamilton, scalar first, body to navigation.

The jitted functions take and fill preallocated arrays; the others are for people's edges.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.types import F64


@njit("void(f8[::1], f8[:, ::1])", cache=True, entry=True, counted=False)
def quat_to_matrix(q: F64, C: F64) -> None:
    """Fill ``C`` (3, 3) with the rotation of unit quaternion ``q`` (4,)."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    C[0, 0] = w * w + x * x - y * y - z * z
    C[0, 1] = 2.0 * (x * y - w * z)
    C[0, 2] = 2.0 * (x * z + w * y)
    C[1, 0] = 2.0 * (x * y + w * z)
    C[1, 1] = w * w - x * x + y * y - z * z
    C[1, 2] = 2.0 * (y * z - w * x)
    C[2, 0] = 2.0 * (x * z - w * y)
    C[2, 1] = 2.0 * (y * z + w * x)
    C[2, 2] = w * w - x * x - y * y + z * z


@njit("void(f8[::1], f8, f8, f8)", cache=True, counted=False)
def rotate_body(q: F64, ax: float, ay: float, az: float) -> None:
    """``q`` ← q ⊗ exp(a/2) in place: the body turns by the rotation vector a [rad] in its own axes.

    Normalised by the first-order factor, enough at a relative error of 1e-16 a step.
    """
    t2 = ax * ax + ay * ay + az * az
    # sin(t/2)/t and cos(t/2) by series: exact to double precision below 0.1 rad, no division by t.
    if t2 < 1e-2:
        s = 0.5 - t2 * (1.0 / 48.0 - t2 * (1.0 / 3840.0 - t2 / 645120.0))
        c = 1.0 - t2 * (0.125 - t2 * (1.0 / 384.0 - t2 * (1.0 / 46080.0 - t2 / 10321920.0)))
    else:
        t = math.sqrt(t2)
        s = math.sin(0.5 * t) / t
        c = math.cos(0.5 * t)
    x, y, z = s * ax, s * ay, s * az
    w0, x0, y0, z0 = q[0], q[1], q[2], q[3]
    w1 = w0 * c - x0 * x - y0 * y - z0 * z
    x1 = w0 * x + x0 * c + y0 * z - z0 * y
    y1 = w0 * y - x0 * z + y0 * c + z0 * x
    z1 = w0 * z + x0 * y - y0 * x + z0 * c
    k = 1.5 - 0.5 * (w1 * w1 + x1 * x1 + y1 * y1 + z1 * z1)
    q[0], q[1], q[2], q[3] = w1 * k, x1 * k, y1 * k, z1 * k


@njit("void(f8[::1], f8, f8, f8)", cache=True, entry=True, counted=False)
def rotate_nav(q: F64, ax: float, ay: float, az: float) -> None:
    """``q`` ← exp(a/2) ⊗ q in place: a rotation vector a [rad] resolved in n."""
    t2 = ax * ax + ay * ay + az * az
    if t2 < 1e-2:
        s = 0.5 - t2 * (1.0 / 48.0 - t2 * (1.0 / 3840.0 - t2 / 645120.0))
        c = 1.0 - t2 * (0.125 - t2 * (1.0 / 384.0 - t2 * (1.0 / 46080.0 - t2 / 10321920.0)))
    else:
        t = math.sqrt(t2)
        s = math.sin(0.5 * t) / t
        c = math.cos(0.5 * t)
    x, y, z = s * ax, s * ay, s * az
    w0, x0, y0, z0 = q[0], q[1], q[2], q[3]
    w1 = c * w0 - x * x0 - y * y0 - z * z0
    x1 = c * x0 + x * w0 + y * z0 - z * y0
    y1 = c * y0 - x * z0 + y * w0 + z * x0
    z1 = c * z0 + x * y0 - y * x0 + z * w0
    k = 1.5 - 0.5 * (w1 * w1 + x1 * x1 + y1 * y1 + z1 * z1)
    q[0], q[1], q[2], q[3] = w1 * k, x1 * k, y1 * k, z1 * k


def quat_from_rpy(roll: float, pitch: float, yaw: float) -> F64:
    """Unit quaternion q_nb (4,) of roll, pitch, yaw [rad] (intrinsic z-y-x)."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def rpy_from_quat(q_nb: F64) -> F64:
    """Roll, pitch, yaw (..., 3) [rad] of quaternions (..., 4)."""
    w, x, y, z = np.moveaxis(np.asarray(q_nb), -1, 0)
    roll = np.arctan2(2 * (w * x + y * z), w * w - x * x - y * y + z * z)
    pitch = np.arcsin(np.clip(2 * (w * y - x * z), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return np.stack([roll, pitch, yaw], axis=-1)


def yaw_of(q_nb: F64) -> float:
    """Yaw [rad] of one quaternion, the first four of ``q_nb``; as :func:`rpy_from_quat`."""
    w, x, y, z = q_nb[:4].tolist()
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)


def matrix_from_quat(q_nb: F64) -> F64:
    """C_nb (3, 3) of one quaternion (4,)."""
    C = np.empty((3, 3))
    quat_to_matrix(np.ascontiguousarray(q_nb, dtype=np.float64), C)
    return C


def attitude_error_n(q_true: F64, q_est: F64) -> F64:
    """φ (..., 3) [rad] with C_true = exp([φ×]) C_est: the rotation vector of q_true ⊗ q_est*."""
    w0, x0, y0, z0 = np.moveaxis(np.asarray(q_true), -1, 0)
    w1, x1, y1, z1 = np.moveaxis(np.asarray(q_est), -1, 0)
    w = w0 * w1 + x0 * x1 + y0 * y1 + z0 * z1
    v = np.stack(
        [
            -w0 * x1 + x0 * w1 - y0 * z1 + z0 * y1,
            -w0 * y1 + x0 * z1 + y0 * w1 - z0 * x1,
            -w0 * z1 - x0 * y1 + y0 * x1 + z0 * w1,
        ],
        axis=-1,
    )
    v = np.where((w < 0)[..., None], -v, v)
    s = np.linalg.norm(v, axis=-1)
    angle = 2 * np.arctan2(s, np.abs(w))
    factor = np.where(s > 1e-12, angle / np.where(s > 1e-12, s, 1.0), 2.0)
    return np.asarray(v * factor[..., None])
