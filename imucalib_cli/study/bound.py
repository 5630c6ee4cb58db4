"""The Cramér-Rao bound: the best accuracy of any estimator for a motion, with white sensor noise.

Computed from the noise-free recording, sample by sample, with none of the estimator's filters:

    a_m = R' (R_wf' (p'' - g) + ([alpha]x + [omega]x²) t) + b_a
    w_m = R' omega + b_g

R is R_parent_imu, omega and alpha the parent link's rate and acceleration in its own frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.robot.rotations import skew
from imucalib_cli.signals.trajectory import Trajectory
from imucalib_cli.simulate.noise import white_std
from imucalib_cli.study.recordings import streams_of

if TYPE_CHECKING:
    from collections.abc import Collection

    from imucalib_cli.arrays import Floats
    from imucalib_cli.simulate.options import NoiseOptions
    from imucalib_cli.simulate.recording import Recording
    from imucalib_cli.study.tables import Row


NUISANCES = {"accel_bias": 3, "gyro_bias": 3, "tilt": 2, "time_offset": 1}
"""Possible unknowns besides the pose, with their numbers of parameters."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Bound:
    """Least covariance of the pose and the time offset."""

    pose: Floats
    """(6, 6), m², rad²; translation, rotation, parent frame."""
    time_offset: float
    """s, standard deviation; zero if it is known."""

    @property
    def translation(self) -> float:
        """Root of the trace, m: least root-mean-square distance."""
        return float(np.sqrt(np.trace(self.pose[:3, :3])))

    @property
    def rotation(self) -> float:
        """Root of the trace, rad."""
        return float(np.sqrt(np.trace(self.pose[3:, 3:])))


def cramer_rao(
    clean: Recording, accel_std: float, gyro_std: float, unknown: Collection[str] = tuple(NUISANCES)
) -> Bound:
    """Bound for white noise of accel_std, m/s², and gyro_std, rad/s, on each sample and axis.

    In the published method all NUISANCES are known. Infinite where the motion does not determine
    the pose.
    """
    imu, path = streams_of(clean)
    inside = slice(2, len(imu.t) - 2)
    t = imu.t[inside]
    R_world_parent, _ = Trajectory.of(path).poses(t)
    R = clean.R_parent_imu
    omega = imu.gyro @ R.T
    alpha = np.gradient(omega, imu.t, axis=0, edge_order=2)[inside]
    omega = omega[inside]
    force = imu.accel[inside] @ R.T
    J = np.zeros((len(t), 6, 15))
    J[:, :3, 0:3] = R.T @ (skew(alpha) + skew(omega) @ skew(omega))
    J[:, :3, 3:6] = R.T @ skew(force)
    J[:, 3:, 3:6] = R.T @ skew(omega)
    J[:, :3, 6:9] = R.T
    J[:, 3:, 9:12] = R.T
    for index, axis in enumerate(np.eye(3)[:2]):
        turned = np.cross(axis, clean.gravity_world)
        J[:, :3, 12 + index] = -(np.swapaxes(R_world_parent, 1, 2) @ turned) @ R
    J[:, :3, 14] = -np.gradient(imu.accel, imu.t, axis=0)[inside]
    J[:, 3:, 14] = -np.gradient(imu.gyro, imu.t, axis=0)[inside]
    J[:, :3] /= accel_std
    J[:, 3:] /= gyro_std
    free = set(unknown) - (set() if np.any(clean.gravity_world) else {"tilt"})
    used = np.repeat([name in free for name in NUISANCES], list(NUISANCES.values()))
    columns = np.r_[:6, 6 + np.flatnonzero(used)]
    flat = J[:, :, columns].reshape(-1, len(columns))
    information = flat.T @ flat
    if not np.diag(information).all():  # nothing turns about an axis
        return Bound(pose=np.full((6, 6), np.inf), time_offset=np.inf)
    scale = 1.0 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    offset = float(np.sqrt(covariance[-1, -1])) if "time_offset" in free else 0.0
    return Bound(pose=covariance[:6, :6], time_offset=offset)


@cache  # a study needs the same for every seed
def bound_columns(clean: Recording, noise: NoiseOptions, *, alone: bool) -> Row:
    """Least errors of any estimator, root mean square.

    None without white noise of the IMU, and where the motion does not determine the pose.
    """
    accel, gyro = white_std(noise, clean.imu)
    if accel == 0.0 or gyro == 0.0:
        return {"bound_translation": None, "bound_rotation": None}
    bound = cramer_rao(clean, accel, gyro, () if alone else tuple(NUISANCES))
    found = {"bound_translation": bound.translation, "bound_rotation": bound.rotation}
    return {name: value if isfinite(value) else None for name, value in found.items()}
