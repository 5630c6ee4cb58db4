"""Continuous-time batch estimation on B-splines, of the kind of Kalibr, from kinematic poses.

The trajectory of the IMU is a spline of degree 5 and a free unknown beside the mount, the biases,
gravity's direction and the time offset; all of it is solved for at once by Levenberg and
Marquardt's method, as in Furgale, Rehder and Siegwart, "Unified temporal and spatial calibration
for multi-sensor systems", IROS 2013. Where Kalibr sees corners of a target, here are poses of the
parent link.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import InputError
from imucalib_cli.signals.stamps import tidy_rows
from imucalib_cli.signals.trajectory import Trajectory
from imucalib_cli.study.methods.answer import Answer
from imucalib_cli.study.methods.bspline_problem import BSplineOptions, Problem, solve
from imucalib_cli.study.methods.bspline_state import (
    State,
    fitted_controls,
    middle_orientation,
    residual_std,
    unwrapped_rotvecs,
)
from imucalib_cli.study.methods.bspline_terms import ImuData, PoseData
from imucalib_cli.study.methods.gyro_first import GyroFirstOptions, calibrate_gyro_first
from imucalib_cli.study.methods.spline_basis import Knots

if TYPE_CHECKING:
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples

Floats = NDArray[np.float64]

_STD_FLOOR = 1e-7
"""m and rad: no encoder is better, and smaller ones cost the solver its digits."""


def calibrate_bspline(imu: ImuSamples, path: KinematicPath, options: BSplineOptions) -> Answer:
    """Find the IMU's pose in its parent link.

    Args:
        imu: As stamped.
        path: Kinematics of the parent link.
        options: Noise of the sensors, knots, what is unknown.

    Raises:
        InputError: Too few samples, streams that do not overlap, turns beyond what a rotation
            vector can carry, or motion that leaves an unknown open.
    """
    return answer_of(*solve(*prepare(imu, path, options)), "parent")


def answer_of(state: State, evaluations: int, frame: Literal["parent", "camera"]) -> Answer:
    """What a solution says."""
    mean = state.biases.mean(axis=0)
    return Answer(
        frame=frame,
        R_frame_imu=state.R_parent_imu,
        t_frame_imu=state.t_parent_imu,
        time_offset=state.time_offset,
        evaluations=evaluations,
        accel_bias=mean[:3],
        gyro_bias=mean[3:],
        gravity_world=state.gravity,
    )


def prepare(
    imu: ImuSamples,
    path: KinematicPath,
    options: BSplineOptions,
    whiten: Floats | None = None,
) -> tuple[Problem, State]:
    """Data, and a start: rotation, time offset and biases of the gyro-first method, no lever arm.

    Args:
        imu: As stamped.
        path: Kinematics of the parent link.
        options: Noise of the sensors, knots, what is unknown.
        whiten: (N, 6, 6), for each pose of the path, in place of the options' deviations.

    Raises:
        InputError: As calibrate_bspline.
    """
    trajectory = Trajectory.of(path)
    first = calibrate_gyro_first(
        imu,
        path,
        GyroFirstOptions(
            window_seconds=max(0.1, 6.0 * trajectory.interval),
            time_offset=options.time_offset,
            max_offset=options.max_offset,
            gravity="none" if options.gravity == "none" else "tilt",
            gravity_norm=options.gravity_norm,
        ),
    )
    t = max((track.t for track in trajectory.tracks), key=len)
    t = t[trajectory.covered(t)]
    R, p = trajectory.poses(t)
    knots = Knots.over(float(t[0]), float(t[-1]), options.knots_per_second)
    R_imu = R @ first.R_frame_imu
    R_middle = middle_orientation(R_imu)
    phi = unwrapped_rotvecs(R_middle.T @ R_imu)
    if whiten is None:
        stds = (
            _or(options.position_std, residual_std(knots, t, p)),
            _or(options.rotation_std, residual_std(knots, t, phi)),
        )
        whiten = 1.0 / np.repeat(stds, 3)
    poses = PoseData(
        t=t,
        R=R,
        p=p,
        whiten=whiten,
    )
    offset = first.time_offset or 0.0
    rows = tidy_rows(imu.t, imu.gyro, imu.accel).rows
    # The offset may still move by a millisecond or so; readings stay on the spline all the same.
    margin = 0.01
    inside = (imu.t[rows] - offset > t[0] + margin) & (imu.t[rows] - offset < t[-1] - margin)
    rows = rows[inside]
    if len(rows) == 0:
        raise InputError("the IMU's samples and the robot's do not overlap in time")
    walks = options.biases and max(options.accel_bias_walk, options.gyro_bias_walk) > 0.0
    span = float(imu.t[rows[-1]] - imu.t[rows[0]])
    count = max(round(span / options.bias_interval), 1) + 1 if walks else 1
    readings = ImuData(
        t=imu.t[rows],
        accel=imu.accel[rows],
        gyro=imu.gyro[rows],
        accel_std=options.accel_std,
        gyro_std=options.gyro_std,
        nodes=np.linspace(imu.t[rows[0]], imu.t[rows[-1]], count),
    )
    down = np.array([0.0, 0.0, -options.gravity_norm])
    gravity = {"none": np.zeros(3), "fixed": down, "tilt": first.gravity_world}[options.gravity]
    start = np.concatenate([first.accel_bias, first.gyro_bias])
    state = State(
        controls=fitted_controls(knots, t, np.hstack([p, phi])),
        R_parent_imu=first.R_frame_imu,
        t_parent_imu=np.zeros(3),
        gravity=np.asarray(gravity),
        time_offset=offset,
        biases=np.tile(start if options.biases else np.zeros(6), (count, 1)),
    )
    return Problem(knots, R_middle, poses, readings, options), state


def _or(stated: float | None, found: float) -> float:
    return stated if stated is not None else max(found, _STD_FLOOR)
