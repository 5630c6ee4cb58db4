"""Continuous-time batch estimation on B-splines, of the kind of Kalibr.

The trajectory of the IMU is a spline of degree 5 and a free unknown beside the mount, the biases,
gravity's direction and the time offset; all of it is solved for at once by Levenberg and
Marquardt's method, as in Furgale, Rehder and Siegwart, "Unified temporal and spatial calibration
for multi-sensor systems", IROS 2013. Instead of Kalibr's corners of a target, the data are poses of
the parent link, or the poses that the corners of each image determine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.signals.samples import STANDARD_GRAVITY
from imucalib_cli.signals.timing.stamps import tidy_rows
from imucalib_cli.signals.trajectory import Trajectory
from imucalib_cli.study.methods.answer import Answer
from imucalib_cli.study.methods.bordered import BorderedNormal
from imucalib_cli.study.methods.bspline_terms import ImuData, PoseData, Rows, imu_rows, pose_rows
from imucalib_cli.study.methods.camera import camera_path
from imucalib_cli.study.methods.gyro_first import GyroFirstOptions, calibrate_gyro_first
from imucalib_cli.study.methods.spline import (
    BIASES,
    OFFSET,
    ORDER,
    TILT,
    Knots,
    State,
    fitted_controls,
    middle_orientation,
    residual_std,
    unwrapped_rotvecs,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.arrays import Floats
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples
    from imucalib_cli.study.methods.camera import CameraObservations


_STD_FLOOR = 1e-7
"""m and rad: no encoder is better, and smaller values would cost the solver digits."""


_LOOSE = (1e-3, 3e-2)
"""Factors on the poses' weights in the first rounds, used if the direct solution fails."""
_TOLERANCE, _LOOSE_TOLERANCE = 1e-3, 1.0
"""The iteration ends when a step predicts a smaller decrease of chi-squared; the second in those
first rounds."""
_MOST_ITERATIONS = 30


@dataclass(frozen=True, kw_only=True)
class BSplineOptions:
    """Options of the B-spline estimator."""

    accel_std: float
    """Of a sample, m/s²: the density times sqrt(rate / 2)."""
    gyro_std: float
    """Of a sample, rad/s."""
    accel_bias_walk: float = 0.0
    """m/s²/sqrt(s); zero takes the bias as constant."""
    gyro_bias_walk: float = 0.0
    """rad/s/sqrt(s)."""
    bias_interval: float = 5.0
    """s between the nodes of biases that walk, piecewise linear."""
    knots_per_second: float = 100.0
    """Kalibr's default for poses."""
    time_offset: float | None = None
    """IMU stamp - robot stamp, s; None estimates it."""
    gravity: Literal["tilt", "fixed", "none"] = "tilt"
    gravity_norm: float = STANDARD_GRAVITY
    """m/s²."""
    biases: bool = True
    """Whether biases are unknowns."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Data and parameters of the problem."""

    knots: Knots
    R_middle: Floats
    poses: PoseData
    imu: ImuData
    options: BSplineOptions
    tolerance: float = _TOLERANCE

    def cost(self, state: State) -> float:
        """Sum of squared whitened residuals."""
        walk = self._walk(state)[1]
        rows = self._rows(state, derivatives=False)
        return float(sum(np.sum(part.r * part.r) for part in rows) + walk @ walk)

    def normal(self, state: State) -> BorderedNormal:
        """Normal equations at a state; known parameters are held."""
        borders = BIASES + 6 * len(self.imu.nodes)
        normal = BorderedNormal(self.knots.controls, 6, ORDER, borders)
        for part in self._rows(state, derivatives=True):
            normal.add(part.segment, part.local, part.border, part.columns, part.r)
        normal.add_border(*self._walk(state))
        return normal

    def _rows(self, state: State, *, derivatives: bool) -> Iterator[Rows]:
        given = self.knots, self.R_middle
        yield from pose_rows(*given, self.poses, state, derivatives=derivatives)
        yield from imu_rows(*given, self.imu, state, derivatives=derivatives)

    def known(self) -> list[int]:
        """Dense parameters that are held."""
        options, held = self.options, []
        if options.gravity != "tilt":
            held += [*range(TILT.start, TILT.stop)]
        if options.time_offset is not None:
            held.append(OFFSET)
        if not options.biases:
            held += [*range(BIASES, BIASES + 6 * len(self.imu.nodes))]
        return held

    def _walk(self, state: State) -> tuple[Floats, Floats]:
        """Rows of the biases' random walk between nodes, (rows, borders) and (rows,)."""
        nodes = self.imu.nodes
        borders = BIASES + 6 * len(nodes)
        if len(nodes) == 1:
            return np.zeros((0, borders)), np.zeros(0)
        walk = np.repeat([self.options.accel_bias_walk, self.options.gyro_bias_walk], 3)
        whiten = 1.0 / (np.maximum(walk, 1e-12) * np.sqrt(nodes[1] - nodes[0]))
        J = np.zeros((len(nodes) - 1, 6, borders))
        for k in range(len(nodes) - 1):
            at = BIASES + 6 * k
            J[k, :, at : at + 6] = -np.diag(whiten)
            J[k, :, at + 6 : at + 12] = np.diag(whiten)
        return J.reshape(-1, borders), -(np.diff(state.biases, axis=0) * whiten).ravel()

    def loosened(self, share: float) -> Problem:
        """The problem with smaller weights of the poses."""
        return replace(
            self,
            poses=replace(self.poses, whiten=share * self.poses.whiten),
            tolerance=_LOOSE_TOLERANCE,
        )


def solve(problem: Problem, state: State) -> tuple[State, int]:
    """Find the least cost from a start.

    Exact poses couple the spline and the mount so strongly that a large rotation of the mount
    follows a curved valley in tiny steps. If a step fails, poses first get smaller weights.

    Returns:
        The solution and the evaluations of all residuals.

    Raises:
        InputError: The motion does not determine an unknown.
    """
    solution, count, direct = _descend(problem, state, patient=False)
    if direct:
        return solution, count
    for share in _LOOSE:
        state, more, _ = _descend(problem.loosened(share), state, patient=True)
        count += more
    solution, more, _ = _descend(problem, state, patient=True)
    return solution, count + more


def _descend(problem: Problem, state: State, *, patient: bool) -> tuple[State, int, bool]:
    """Levenberg-Marquardt; returns the state, the evaluations, and whether it converged.

    Without patience the first failed step ends it.
    """
    cost, damping, evaluations = problem.cost(state), 1e-9, 1
    while evaluations < _MOST_ITERATIONS:
        normal = problem.normal(state)
        normal.hold(problem.known())
        while evaluations < _MOST_ITERATIONS:
            try:
                controls, border, promised = normal.step(damping)
            except np.linalg.LinAlgError as error:
                raise InputError("the motion leaves unknowns of the spline open") from error
            moved = state.moved(controls, border)
            new = problem.cost(moved)
            evaluations += 1
            if promised < problem.tolerance:
                return (moved if new < cost else state), evaluations, True
            if new < cost:
                state, cost, damping = moved, new, max(damping / 10.0, 1e-12)
                break
            if not patient:
                return state, evaluations, False
            damping *= 10.0
    return state, evaluations, False


def calibrate_bspline(imu: ImuSamples, path: KinematicPath, options: BSplineOptions) -> Answer:
    """Find the IMU's pose in its parent link.

    Raises:
        InputError: Too few samples, streams that do not overlap, turns beyond what a rotation
            vector can carry, or motion that leaves an unknown open.
    """
    return _answer(*solve(*prepare(imu, path, options)), "parent")


def calibrate_bspline_camera(
    imu: ImuSamples, camera: CameraObservations, options: BSplineOptions
) -> Answer:
    """Find the IMU's pose in the camera's optical frame, from the data that Kalibr gets.

    Each image's corners are used as their PnP pose, weighted by its information matrix. That is the
    reprojection error to second order; for noise of tenths of a pixel higher orders are negligible.

    Raises:
        InputError: OpenCV is missing, the target is hardly seen, or as calibrate_bspline.
    """
    path, whiten = camera_path(camera)
    return _answer(*solve(*prepare(imu, path, options, whiten)), "camera")


def _answer(state: State, evaluations: int, frame: Literal["parent", "camera"]) -> Answer:
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

    Poses are whitened by (N, 6, 6), or by their scatter about their own spline.

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
        stds = [max(residual_std(knots, t, values), _STD_FLOOR) for values in (p, phi)]
        whiten = 1.0 / np.repeat(stds, 3)
    offset = first.time_offset or 0.0
    rows = tidy_rows(imu.t, imu.gyro, imu.accel).rows
    # The offset may still change by a millisecond; samples must stay on the spline then.
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
    poses = PoseData(t=t, R=R, p=p, whiten=whiten)
    return Problem(knots, R_middle, poses, readings, options), state
