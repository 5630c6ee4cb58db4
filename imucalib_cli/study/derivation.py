"""Derived against measured acceleration of the IMU along the world's x axis, by two filters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate.options import PaperOptions, WindowChoice
from imucalib_cli.estimate.paper_filters import filtered_instants
from imucalib_cli.robot.rotations import rotvec_from_matrix
from imucalib_cli.signals.kernels import MARGIN, convolve_at, matched_filter
from imucalib_cli.signals.trajectory import Trajectory
from imucalib_cli.study.systems import robot_model
from imucalib_cli.study.trial import streams_of

if TYPE_CHECKING:
    from imucalib_cli.simulate.recording import Recording
    from imucalib_cli.study.guesses import Guess

Floats = NDArray[np.float64]
Kept = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """What one filter holds against each other along x, at each instant."""

    t: Floats
    """(N,), s."""
    position: Floats
    """(N,), m, of the IMU as the guess has it."""
    derived: Floats
    """(N,), m/s²."""
    measured: Floats
    """(N,), m/s², as this filter smooths it, without gravity."""
    kept: Kept
    """(N,), whether the filter's method uses the instant."""

    @property
    def mismatch(self) -> Floats:
        """(N,), derived less measured, m/s²."""
        return self.derived - self.measured


def compared_by_paper(
    recording: Recording, guess: Guess, window: int, exclusion: float
) -> Comparison:
    """The published filter: derivatives of the pose, and measurements smoothed likewise.

    Args:
        recording: Noise-free or not.
        guess: Pose of the IMU to assume.
        window: Samples.
        exclusion: m/s², of the second difference over which a sample is dropped.
    """
    imu, path = streams_of(recording, robot_model(recording.system.name))
    options = PaperOptions(
        window=WindowChoice(samples=window), degree=_DEGREE, exclusion_threshold=exclusion
    )
    instants, _, _ = filtered_instants(imu, path, options, guess.R_parent_imu, guess.t_parent_imu)
    x = np.concatenate([guess.t_parent_imu, rotvec_from_matrix(guess.R_parent_imu)])
    norm = float(np.linalg.norm(recording.gravity_world))
    derived, measured = instants.accelerations(x, norm)
    _, p = Trajectory.of(path).poses(instants.t)
    return Comparison(
        t=instants.t,
        position=(p + instants.R @ guess.t_parent_imu)[:, 0],
        derived=derived[:, 0],
        measured=measured[:, 0],
        kept=instants.kept,
    )


def compared_by_matched(recording: Recording, guess: Guess, window: int) -> Comparison:
    """The matched filters: the measurements are averaged by the kernel of the derivative.

    Args:
        recording: With an even IMU rate and no gaps.
        guess: Pose of the IMU to assume.
        window: Samples.
    """
    imu, path = streams_of(recording, robot_model(recording.system.name))
    trajectory = Trajectory.of(path)
    inside = trajectory.covered(imu.t)
    t = imu.t[inside]
    R, p = trajectory.poses(t)
    p_world_imu = p + R @ guess.t_parent_imu
    accel = np.einsum("nij,nj->ni", R @ guess.R_parent_imu, imu.accel[inside])
    accel += recording.gravity_world
    filters = matched_filter(window, _DEGREE, 2, float(np.median(np.diff(t))))
    first = np.arange(MARGIN, len(t) - window - MARGIN + 1)
    centres = first + window // 2
    derived = convolve_at(p_world_imu, filters.derivative, first)
    measured = convolve_at(accel, filters.average, first - MARGIN)
    return Comparison(
        t=t[centres],
        position=p_world_imu[centres, 0],
        derived=derived[:, 0],
        measured=measured[:, 0],
        kept=np.ones(len(centres), dtype=bool),
    )


_DEGREE = PaperOptions().degree


def near_changes(t: Floats, accel: Floats, jerk: float, margin: float) -> Kept:
    """Where an acceleration changes brusquely: starts and stops of motion.

    Args:
        t: (N,), s, even.
        accel: (N,), m/s².
        jerk: m/s³, above which it changes brusquely.
        margin: s, to either side, that belongs to it.
    """
    dt = float(np.median(np.diff(t)))
    sudden = np.abs(np.gradient(accel, dt)) > jerk
    reach = np.ones(2 * max(round(margin / dt), 1) + 1)
    return np.asarray(np.convolve(sudden, reach, mode="same") > 0.0)
