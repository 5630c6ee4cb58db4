"""The published method, as published: Vieira, Oliveira, Arrais, Sensors 2026, 26(6), 1788.

Savitzky-Golay derivatives of the IMU's pose in the world, as it would be with the present guess,
are compared with the smoothed measurements turned into the world by the same guess. What the
paper leaves open is taken from its authors' practice: nearest-sample pairing, smoothing with the
same window and degree, scipy's trust-region solver. The pose derivatives are linear in the
unknown, so they are filtered once and not at every step; the numbers are the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import InputError
from imucalib_cli.estimate.estimate import Estimate, Residuals, Window
from imucalib_cli.estimate.options import PaperOptions
from imucalib_cli.estimate.verdict import STANDSTILL_GYRO, UNEXPLAINED_ACCEL, UNEXPLAINED_GYRO
from imucalib_cli.robot.rotations import (
    matrix_from_rotvec,
    quaternion_from_matrix,
    rotvec_from_matrix,
)
from imucalib_cli.signals.stamps import gap_breaks, tidy_rows
from imucalib_cli.signals.trajectory import Trajectory

if TYPE_CHECKING:
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples

Floats = NDArray[np.float64]

DEFAULT_EXCLUSION = 6.25
"""m/s²: the authors' 1e-4 m between successive samples, at 250 Hz."""
_QUATERNION_PER_METRE = 10.0
"""1/m: their limit for quaternions, 1e-3, over the one for positions."""
_TOLERANCE = 1e-10
"""ftol, xtol and gtol of the solver."""
_SINGULAR = 1e-6
"""Ratio of the Jacobian's singular values below which the motion does not determine the pose."""


@dataclass(frozen=True, eq=False)
class Instants:
    """What is compared, at each instant kept."""

    R: Floats
    """(N, 3, 3), R_world_parent."""
    R_rate: Floats
    """(N, 3, 3), its first derivative, 1/s."""
    R_acceleration: Floats
    """(N, 3, 3), its second derivative, 1/s²."""
    p_acceleration: Floats
    """(N, 3), second derivative of p_world_parent, m/s²."""
    accel: Floats
    """(N, 3), smoothed, IMU frame, m/s²."""
    gyro: Floats
    """(N, 3), smoothed, IMU frame, rad/s."""
    excluded: int

    def differences(self, x: Floats, gravity_norm: float) -> Floats:
        """Derived minus measured acceleration and angular rate in the world, (N, 6).

        Args:
            x: (6,), t_parent_imu, m, and the rotation vector of R_parent_imu, rad.
            gravity_norm: m/s², along +z of the world as an accelerometer at rest reads it.
        """
        t, R_parent_imu = x[:3], matrix_from_rotvec(x[3:])
        R_world_imu = self.R @ R_parent_imu
        derived_accel = self.p_acceleration + self.R_acceleration @ t
        # [omega]x = dR/dt R', of the IMU's orientation; R_parent_imu cancels but for rounding.
        spin = (self.R_rate @ R_parent_imu) @ np.swapaxes(R_world_imu, 1, 2)
        derived_gyro = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        accel = np.einsum("nij,nj->ni", R_world_imu, self.accel)
        accel[:, 2] -= gravity_norm
        gyro = np.einsum("nij,nj->ni", R_world_imu, self.gyro)
        return np.hstack([derived_accel - accel, derived_gyro - gyro])


def calibrate_paper(imu: ImuSamples, path: KinematicPath, options: PaperOptions) -> Estimate:
    """Find the IMU's pose in its parent link by the published method.

    Args:
        imu: As stamped.
        path: Kinematics of the parent link, as stamped.
        options: Window, degree, exclusion, initial guess, kind of residual.

    Returns:
        The estimate: no covariance, no biases, no time offset, as the method has none.

    Raises:
        InputError: Too few samples, or too few left after the exclusion.
    """
    from scipy.optimize import least_squares  # slow to import, and only this method needs it

    R_initial = np.eye(3) if options.R_initial is None else options.R_initial
    t_initial = np.zeros(3) if options.t_initial is None else options.t_initial
    instants, window, gaps = prepare_instants(imu, path, options, R_initial, t_initial)

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
        ftol=_TOLERANCE,
        xtol=_TOLERANCE,
        gtol=_TOLERANCE,
    )
    R_parent_imu = matrix_from_rotvec(found.x[3:])
    left = instants.differences(found.x, options.gravity_norm)
    values = np.linalg.svd(np.asarray(found.jac), compute_uv=False)
    distrust = []
    if found.status <= 0:
        distrust.append("the solver did not converge: give a better --initial guess")
    if values[-1] < _SINGULAR * values[0]:
        distrust.append("the motion does not determine the pose: rotate about two axes at least")
    force_left = float(np.sqrt(np.mean(left[:, :3] ** 2)))
    rate = float(np.sqrt(np.mean(instants.gyro**2)))
    rate_left = float(np.sqrt(np.mean(left[:, 3:] ** 2)))
    if force_left > UNEXPLAINED_ACCEL or (
        rate > STANDSTILL_GYRO and rate_left > UNEXPLAINED_GYRO * rate
    ):
        distrust.append(
            f"the solution leaves {force_left:.2g} m/s² and {rate_left:.2g} rad/s unexplained, "
            "another minimum perhaps: give a better --initial guess or use --method matched"
        )
    warnings = []
    if gaps:
        warnings.append(
            f"the method assumes a constant rate; the log has {gaps} gaps, each side of which was "
            "filtered alone: prefer --method matched"
        )
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
        residuals=Residuals(
            accel_rms=np.sqrt(np.mean(left[:, :3] ** 2, axis=0)),
            gyro_rms=np.sqrt(np.mean(left[:, 3:] ** 2, axis=0)),
            windows_used=len(left),
            windows_dropped=instants.excluded,
            samples_replaced=0,
            gaps=gaps,
        ),
        distrust=tuple(distrust),
        warnings=tuple(warnings),
        notes={"evaluations": float(found.nfev), "cost": float(found.cost)},
    )


def prepare_instants(
    imu: ImuSamples,
    path: KinematicPath,
    options: PaperOptions,
    R_initial: Floats,
    t_initial: Floats,
) -> tuple[Instants, Window, int]:
    """Filter both sides, pair them, drop starts and stops.

    Raises:
        InputError: Fewer samples than a window needs, or none left.
    """
    from scipy.signal import savgol_filter  # slow to import, and only this method needs it

    trajectory = Trajectory.of(path)
    t_imu, gyro, accel = _ordered(imu)
    t = _instants(trajectory)
    dt, dt_imu = (float(np.median(np.diff(series))) for series in (t, t_imu))
    length = _window_length(options, dt)
    if min(len(t), len(t_imu)) < length:
        raise InputError(
            f"{min(len(t), len(t_imu))} samples are fewer than the window of {length}: "
            "choose a shorter --window"
        )
    R, p = trajectory.poses(t)
    whole = _stretches(t, length), _stretches(t_imu, length)

    def smooth(values: Floats, order: int, interval: float, stretches: list[slice]) -> Floats:
        smoothed = np.zeros_like(values)
        for part in stretches:
            smoothed[part] = savgol_filter(
                values[part],
                length,
                options.degree,
                deriv=order,
                delta=interval,
                axis=0,
                mode="interp",
            )
        return smoothed

    nearest = np.clip(np.searchsorted(t_imu, t), 1, len(t_imu) - 1)
    nearest -= (t - t_imu[nearest - 1] < t_imu[nearest] - t).astype(np.intp)
    flat = R.reshape(-1, 9)
    keep = _steady(p + R @ t_initial, R @ R_initial, dt, options.exclusion_threshold)
    keep &= np.abs(t_imu[nearest] - t) <= dt_imu
    keep &= _inside(len(t), whole[0]) & _inside(len(t_imu), whole[1])[nearest]
    if keep.sum() < max(length, 12):
        raise InputError(
            f"{int(keep.sum())} of {len(t)} samples are left after starts and stops are "
            "excluded: raise --exclude or use --method matched"
        )
    instants = Instants(
        R=R[keep],
        R_rate=smooth(flat, 1, dt, whole[0])[keep].reshape(-1, 3, 3),
        R_acceleration=smooth(flat, 2, dt, whole[0])[keep].reshape(-1, 3, 3),
        p_acceleration=smooth(p, 2, dt, whole[0])[keep],
        accel=smooth(accel, 0, dt_imu, whole[1])[nearest[keep]],
        gyro=smooth(gyro, 0, dt_imu, whole[1])[nearest[keep]],
        excluded=int((~keep).sum()),
    )
    window = Window(samples=length, seconds=(length - 1) * dt, reason="as asked")
    return instants, window, trajectory.gaps + len(gap_breaks(t_imu))


def _stretches(t: Floats, length: int) -> list[slice]:
    """Stretches between gaps that hold a window: a filter over a gap would be no filter."""
    edges = [0, *gap_breaks(t), len(t)]
    return [slice(a, b) for a, b in pairwise(edges) if b - a >= length]


def _inside(count: int, stretches: list[slice]) -> NDArray[np.bool_]:
    inside = np.zeros(count, dtype=bool)
    for part in stretches:
        inside[part] = True
    return inside


def _ordered(imu: ImuSamples) -> tuple[Floats, Floats, Floats]:
    rows = tidy_rows(imu.t, np.hstack([imu.gyro, imu.accel])).rows
    if len(rows) < 2:
        raise InputError(
            "the IMU has no usable samples: look at its stamps with 'imucalib inspect'"
        )
    return imu.t[rows], imu.gyro[rows], imu.accel[rows]


def _instants(trajectory: Trajectory) -> Floats:
    """Stamps of the fastest track, where every track has samples."""
    fastest = min(trajectory.tracks, key=lambda track: track.interval)
    t = fastest.t[trajectory.covered(fastest.t)]
    if len(t) < 2:
        raise InputError("the robot's streams do not overlap: nothing to differentiate")
    return t


def _window_length(options: PaperOptions, dt: float) -> int:
    """Samples, odd: the paper's L."""
    samples = options.window.samples
    if samples is None and options.window.seconds is not None:
        samples = round(options.window.seconds / dt) + 1
    if samples is None:
        samples = PaperOptions().window.samples or 0
    shortest = options.degree + 2 + (options.degree + 1) % 2
    return max(samples + (samples + 1) % 2, shortest)


def _steady(
    p_world_imu: Floats, R_world_imu: Floats, dt: float, limit: float | None
) -> NDArray[np.bool_]:
    """Samples away from starts and stops, told by second differences of the derived pose."""
    keep = np.ones(len(p_world_imu), dtype=bool)
    limit = DEFAULT_EXCLUSION if limit is None else limit
    if limit <= 0.0:
        return keep
    q = quaternion_from_matrix(R_world_imu)
    flips = np.cumsum(np.sum(q[1:] * q[:-1], axis=1) < 0) % 2
    q[1:] *= np.where(flips, -1.0, 1.0)[:, None]
    for values, most in ((p_world_imu, limit), (q, limit * _QUATERNION_PER_METRE)):
        second = np.abs(np.diff(values, n=2, axis=0)).max(axis=1) / dt**2
        keep[1:-1] &= second <= most
    return keep
