"""Solutions as files that other programs read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from companion.navigation.rotation import rpy_from_quat
from companion.types import COV_ATT, COV_POS, COV_VEL, F64, Mode, Solution
from replay.sensor_folder_writer import Column, write_csv

SOLUTION_COLUMNS = (
    "t_ns", "lat_deg", "lon_deg", "alt_hae_m", "vel_n_mps", "vel_e_mps", "vel_d_mps",
    "roll_deg", "pitch_deg", "yaw_deg",
    "sd_n_m", "sd_e_m", "sd_d_m", "sd_vn_mps", "sd_ve_mps", "sd_vd_mps",
    "sd_roll_deg", "sd_pitch_deg", "sd_yaw_deg",
)  # fmt: skip
"""As INTERFACES names them for every exported solution; the first ten are those of truth.csv."""

# A hundredth of a millimetre in latitude, a tenth in lengths, 0.02 arc seconds in attitude.
_FORMATS = ("%d", "%.10f", "%.10f", *("%.4f",) * 4, *("%.5f",) * 3, *("%.4f",) * 6,
            *("%.5f",) * 3)  # fmt: skip


def export_csv(solution: Solution, path: Path) -> int:
    """Write the epochs that have a solution; how many they are.

    Heights are in the recording's datum. Standard deviations of attitude are those of the angles
    themselves, see :func:`euler_sd`. Raises :class:`~companion.types.CompanionError` when the
    file cannot be written.
    """
    index = np.flatnonzero((solution.mode != Mode.ALIGNING) & np.isfinite(solution.lat))
    cov = solution.cov[index]
    sd = np.sqrt(cov[:, :, [0, 3, 5]])
    rpy = rpy_from_quat(solution.q_nb[index])
    table = np.concatenate(
        [
            np.degrees(solution.lat[index])[:, None],
            np.degrees(solution.lon[index])[:, None],
            solution.height[index][:, None],
            solution.vel_n[index],
            np.degrees(rpy),
            sd[:, COV_POS],
            sd[:, COV_VEL],
            np.degrees(euler_sd(rpy, cov[:, COV_ATT])),
        ],
        axis=1,
    )
    values = (solution.t_ns[index], *table.T)
    columns: list[Column] = list(zip(SOLUTION_COLUMNS, _FORMATS, values, strict=True))
    write_csv(Path(path), columns)
    return len(index)


def euler_sd(rpy: F64, cov_att: F64) -> F64:
    """Standard deviations (N, 3) [rad] of roll, pitch, yaw from the covariance of a turn in n.

    For R_nb = R_z(ψ) R_y(θ) R_x(φ) and a small rotation vector a in north, east, down:
    δφ = (a_N cos ψ + a_E sin ψ) / cos θ,  δθ = −a_N sin ψ + a_E cos ψ,
    δψ = a_D + tan θ (a_N cos ψ + a_E sin ψ).  They grow without bound towards a pitch of ±90°.

    ``rpy`` (N, 3) [rad], ``cov_att`` (N, 6) [rad²] as the attitude row of Solution.cov.
    """
    nn, ne, nd, ee, ed, dd = cov_att.T
    c, s = np.cos(rpy[:, 2]), np.sin(rpy[:, 2])
    along = c * c * nn + 2.0 * c * s * ne + s * s * ee
    across = s * s * nn - 2.0 * c * s * ne + c * c * ee
    tan = np.tan(rpy[:, 1])
    yaw = dd + 2.0 * tan * (c * nd + s * ed) + tan * tan * along
    sd: F64 = np.sqrt(np.stack([along / np.cos(rpy[:, 1]) ** 2, across, yaw], axis=1))
    return sd
