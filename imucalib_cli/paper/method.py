"""The published method, as published: Vieira, Oliveira, Arrais, Sensors 2026, 26(6), 1788.

Savitzky-Golay derivatives of the IMU's pose in the world, as it would be with the present guess,
are compared with the smoothed measurements turned into the world by the same guess. What the
paper leaves open is taken from its authors' practice: nearest-sample pairing, smoothing with the
same window and degree, scipy's trust-region solver.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.estimate.checks.judge import STANDSTILL_GYRO, UNEXPLAINED_ACCEL, UNEXPLAINED_GYRO
from imucalib_cli.estimate.estimate import Estimate, ResidualSummary
from imucalib_cli.findings import untrusted, warning
from imucalib_cli.paper.filters import filtered_instants
from imucalib_cli.robot.rotations import matrix_from_rotvec, rotvec_from_matrix

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.options import PaperOptions
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples


_FEWEST = 12
"""Instants below which nothing is solved."""


def calibrate_paper(imu: ImuSamples, path: KinematicPath, options: PaperOptions) -> Estimate:
    """Find the IMU's pose in its parent link by the published method.

    Stamps of both are as they were recorded. There is no covariance, no bias and no time offset.

    Raises:
        InputError: Too few samples, or too few left after the exclusion.
    """
    from scipy.optimize import least_squares  # slow to import, and only this method needs it

    R_initial = np.eye(3) if options.R_initial is None else options.R_initial
    t_initial = np.zeros(3) if options.t_initial is None else options.t_initial
    every, window, gaps = filtered_instants(imu, path, options, R_initial, t_initial)
    instants = every.compared()
    if len(instants.t) < max(window.samples, _FEWEST):
        raise InputError(
            f"{len(instants.t)} of {len(every.t)} samples are left after starts, stops and gaps "
            f"({gaps}) are excluded: raise --exclude, shorten --window or use --method matched"
        )

    def residuals(x: Floats) -> Floats:
        differences = instants.differences(x, options.gravity_norm)
        if options.residual == "components":
            return differences.ravel()
        return np.asarray(np.abs(differences).sum(axis=1))

    found = least_squares(
        residuals,
        np.concatenate([t_initial, rotvec_from_matrix(R_initial)]),
        method="trf",
        x_scale="jac",
        jac="2-point",
        ftol=1e-10,
        xtol=1e-10,
        gtol=1e-10,
    )
    R_parent_imu = matrix_from_rotvec(found.x[3:])
    left = instants.differences(found.x, options.gravity_norm)
    values = np.linalg.svd(np.asarray(found.jac), compute_uv=False)
    found_out = []
    if found.status <= 0:
        found_out.append(untrusted("paper.not_converged"))
    if values[-1] < 1e-6 * values[0]:
        found_out.append(untrusted("paper.undetermined"))
    force_left = float(np.sqrt(np.mean(left[:, :3] ** 2)))
    rate = float(np.sqrt(np.mean(instants.gyro**2)))
    rate_left = float(np.sqrt(np.mean(left[:, 3:] ** 2)))
    if force_left > UNEXPLAINED_ACCEL or (
        rate > STANDSTILL_GYRO and rate_left > UNEXPLAINED_GYRO * rate
    ):
        found_out.append(untrusted("paper.unexplained", force=force_left, rate=rate_left))
    if gaps:
        found_out.append(warning("paper.gaps", count=gaps))
    found_out.append(warning("paper.no_sigma"))
    return Estimate(
        method="paper",
        R_parent_imu=R_parent_imu,
        t_parent_imu=np.asarray(found.x[:3]),
        covariance=None,
        time_offset=0.0,
        time_offset_std=None,
        accel_bias=np.zeros(3),
        accel_bias_std=None,
        gyro_bias=np.zeros(3),
        gyro_bias_std=None,
        gravity_world=np.array([0.0, 0.0, -options.gravity_norm]),
        window=window,
        residuals=ResidualSummary(
            accel_rms=np.sqrt(np.mean(left[:, :3] ** 2, axis=0)),
            gyro_rms=np.sqrt(np.mean(left[:, 3:] ** 2, axis=0)),
            windows_used=len(left),
            windows_dropped=len(every.t) - len(instants.t),
            samples_replaced=0,
            gaps=gaps,
        ),
        findings=tuple(found_out),
        notes={"evaluations": float(found.nfev), "cost": float(found.cost)},
    )
