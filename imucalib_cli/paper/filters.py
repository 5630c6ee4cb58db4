"""The two sides that the published method compares: filtered alike and paired by instant.

The pose derivatives are linear in the unknown, and so are the differences: they are filtered once
and not at every step of the solver, with the same numbers.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import asdict

from imucalib_cli.errors import InputError
from imucalib_cli.estimate.entries import WindowEntry
from imucalib_cli.estimate.model.windows import shortest_length
from imucalib_cli.estimate.options import PaperOptions
from imucalib_cli.robot.rotations import matrix_from_rotvec, quaternion_from_matrix
from imucalib_cli.signals.stretches import Stretches
from imucalib_cli.signals.timing.stamps import gap_breaks
from imucalib_cli.signals.trajectory import Trajectory, continuous

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples


DEFAULT_EXCLUSION = 6.25
"""m/s²: the authors' 1e-4 m between successive samples, at 250 Hz."""
_QUATERNION_PER_METRE = 10.0
"""1/m: their limit for quaternions, 1e-3, over the one for positions."""


class Instants(Struct, frozen=True, eq=False, dict=True):
    """Both sides at N instants."""

    t: Floats
    """(N,), on the robot's clock, s."""
    kept: Bools
    """(N,), whether it is no start or stop, and has a measurement."""
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

    def compared(self) -> Instants:
        """Only the kept instants."""
        parts = {name: values[self.kept] for name, values in asdict(self).items()}
        return Instants(**parts)

    def accelerations(self, x: Floats, gravity_norm: float) -> tuple[Floats, Floats]:
        """Derived and measured acceleration of the IMU in the world, (N, 3) each, m/s².

        At x (6,): t_parent_imu, m, and the rotation vector of R_parent_imu, rad. Gravity, m/s², is
        along +z of the world, as an accelerometer at rest reads it.
        """
        accel = np.einsum("nij,nj->ni", self.R @ matrix_from_rotvec(x[3:]), self.accel)
        accel[:, 2] -= gravity_norm
        return self.p_acceleration + self.R_acceleration @ x[:3], accel

    def differences(self, x: Floats, gravity_norm: float) -> Floats:
        """Derived minus measured acceleration and rate, (N, 6), as :meth:`accelerations`."""
        constant, slope = self.linear
        at = np.concatenate([x[:3], matrix_from_rotvec(x[3:]).ravel()])
        differences = (slope.reshape(-1, len(at)) @ at).reshape(-1, 6)
        differences += constant
        differences[:, 2] += gravity_norm
        return np.asarray(differences)

    @cached_property
    def linear(self) -> tuple[Floats, Floats]:
        """(N, 6) and (N, 6, 12): without gravity constant + slope @ (t, vec R row by row)."""
        # [omega]x = dR/dt R' of the IMU's orientation, in which R_parent_imu cancels.
        spin = self.R_rate @ np.swapaxes(self.R, 1, 2)
        derived_gyro = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        slope = np.zeros((len(self.t), 6, 12))
        slope[:, :3, :3] = self.R_acceleration
        for part, measured in ((slice(0, 3), self.accel), (slice(3, 6), self.gyro)):
            turned = self.R[:, :, :, None] * measured[:, None, None, :]
            slope[:, part, 3:] = -turned.reshape(-1, 3, 9)
        return np.hstack([self.p_acceleration, derived_gyro]), slope


def filtered_instants(
    imu: ImuSamples,
    path: KinematicPath,
    options: PaperOptions,
    R_initial: Floats,
    t_initial: Floats,
) -> tuple[Instants, WindowEntry, int]:
    """Filter both sides, pair them, mark starts and stops by a first guess of the pose.

    Returns:
        All instants, the window, and the number of gaps in the streams.

    Raises:
        InputError: Fewer samples than a window needs.
    """
    from scipy.signal import savgol_filter  # slow to import, and only this method needs it

    t_imu, trajectory = imu.t, Trajectory.of(path)
    fastest = min(trajectory.tracks, key=lambda track: track.interval)
    t = fastest.t[trajectory.covered(fastest.t)]
    if len(t) < 2:
        raise InputError("the robot's streams do not overlap: nothing to differentiate")
    dt, dt_imu = (float(np.median(np.diff(series))) for series in (t, t_imu))
    length = _window_length(options, dt)
    if min(len(t), len(t_imu)) < length:
        raise InputError(
            f"{min(len(t), len(t_imu))} samples are fewer than the window of {length}: "
            "choose a shorter --window"
        )
    R, p = trajectory.poses(t)
    whole, whole_imu = _between_gaps(t, length), _between_gaps(t_imu, length)

    def smooth(values: Floats, order: int, interval: float, stretches: Stretches) -> Floats:
        smoothed = np.zeros_like(values)
        for part in map(slice, stretches.first, stretches.end):
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
    keep &= whole.mask(len(t)) & whole_imu.mask(len(t_imu))[nearest]
    instants = Instants(
        t=t,
        kept=keep,
        R=R,
        R_rate=smooth(flat, 1, dt, whole).reshape(-1, 3, 3),
        R_acceleration=smooth(flat, 2, dt, whole).reshape(-1, 3, 3),
        p_acceleration=smooth(p, 2, dt, whole),
        accel=smooth(imu.accel, 0, dt_imu, whole_imu)[nearest],
        gyro=smooth(imu.gyro, 0, dt_imu, whole_imu)[nearest],
    )
    window = WindowEntry(samples=length, seconds=(length - 1) * dt, reason="as asked")
    return instants, window, trajectory.gaps + len(gap_breaks(t_imu))


def _between_gaps(t: Floats, length: int) -> Stretches:
    """Stretches between gaps that are long enough for a window."""
    edges = np.array([0, *gap_breaks(t), len(t)], dtype=np.intp)
    return Stretches(edges[:-1], edges[1:]).where(np.diff(edges) >= length)


def _window_length(options: PaperOptions, dt: float) -> int:
    """Samples, odd: the paper's L."""
    samples = options.window.samples
    if samples is None and options.window.seconds is not None:
        samples = round(options.window.seconds / dt) + 1
    if samples is None:
        samples = PaperOptions().window.samples or 0
    return max(samples + (samples + 1) % 2, shortest_length(options.degree))


def _steady(p_world_imu: Floats, R_world_imu: Floats, dt: float, limit: float | None) -> Bools:
    """(N,), samples away from starts and stops, by second differences of the derived pose."""
    keep = np.ones(len(p_world_imu), dtype=bool)
    limit = DEFAULT_EXCLUSION if limit is None else limit
    if limit <= 0.0:
        return keep
    poses = continuous("pose", np.hstack([p_world_imu, quaternion_from_matrix(R_world_imu)]))
    for values, most in ((poses[:, :3], limit), (poses[:, 3:], limit * _QUATERNION_PER_METRE)):
        second = np.linalg.norm(np.diff(values, n=2, axis=0), axis=1) / dt**2
        keep[1:-1] &= second <= most
    return keep
