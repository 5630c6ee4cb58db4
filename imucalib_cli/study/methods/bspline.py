"""Continuous-time batch estimation on B-splines, of the kind of Kalibr.

The trajectory of the IMU is a spline of degree 5 and a free unknown beside the mount, the biases,
gravity's direction and the time offset; all of it is solved for at once by Levenberg and
Marquardt's method, as in Furgale, Rehder and Siegwart, "Unified temporal and spatial calibration
for multi-sensor systems", IROS 2013. Instead of Kalibr's corners of a target, the data are poses of
the parent link, or the poses that the corners of each image determine.

The spline is of the IMU's pose in the world: R_world_imu(t) = R_middle exp(phi(t)), p_world_imu(t).
Poses are on the robot's clock, IMU samples on the IMU's clock. Derivatives are analytic.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.robot.rotations import (
    matrix_from_rotvec,
    nearest_rotation,
    rotvec_from_matrix,
    skew,
)
from imucalib_cli.signals.samples import STANDARD_GRAVITY
from imucalib_cli.signals.trajectory import Trajectory
from imucalib_cli.study.method_runs import Answer, Pose
from imucalib_cli.study.methods.bordered import BorderedNormal, Rows
from imucalib_cli.study.methods.camera import camera_path
from imucalib_cli.study.methods.gyro_first import GyroFirstOptions, calibrate_gyro_first
from imucalib_cli.study.methods.spline import (
    BIASES,
    OFFSET,
    ORDER,
    TILT,
    Knots,
    State,
    evaluate,
    fitted_controls,
    level_axes,
    rate_jacobian,
    residual_std,
    right_jacobian,
    unwrapped_rotvecs,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples
    from imucalib_cli.simulate.recording import CameraRecord

_NONE = np.zeros((0, 0, 0))
_CHUNK = 1024
"""Number of instants whose Jacobians are in memory at a time."""
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


def _whitened(whiten: Floats, rows: Floats) -> Floats:
    """Rows (N, 6, C) scaled so that their noise is white and of unit size."""
    return np.asarray(rows * whiten[:, None] if whiten.ndim == 1 else whiten @ rows)


def _spread(of_value: Floats, weights: Floats) -> Floats:
    """By control points, (N, rows, ORDER, C), what is by the spline's value, (N, rows, C)."""
    return of_value[:, :, None, :] * weights[:, None, :, None]


def _between(nodes: Floats, t: Floats) -> tuple[Indices, Floats]:
    """Node before each instant, and the weight of the node after it."""
    x = np.interp(t, nodes, np.arange(len(nodes)))
    first = np.minimum(x.astype(np.intp), max(len(nodes) - 2, 0))
    return first, x - first


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """Poses of the parent link, samples of the IMU, and parameters of the problem."""

    knots: Knots
    R_middle: Floats
    """(3, 3), of the IMU in the world: its orientations are rotation vectors from there."""
    t: Floats
    """(N,), of the poses, robot's clock, s."""
    R: Floats
    """(N, 3, 3), R_world_parent."""
    p: Floats
    """(N, 3), m."""
    pose_whiten: Floats
    """Weights of the residuals, per m and rad: (6,) for all, or (N, 6, 6); position in the
    world, then rotation in the parent frame."""
    imu: ImuSamples
    imu_whiten: Floats
    """(6,), weights of the residuals, per m/s² and rad/s."""
    nodes: Floats
    """(B,), instants at which biases are unknowns, on the IMU's clock; one is constant biases."""
    options: BSplineOptions
    tolerance: float = _TOLERANCE

    def cost(self, state: State) -> float:
        """Sum of squared whitened residuals."""
        walk = self._walk(state)[1]
        rows = self._rows(state, derivatives=False)
        return float(sum(np.sum(part.r * part.r) for part in rows) + walk @ walk)

    def normal(self, state: State) -> BorderedNormal:
        """Normal equations at a state; known parameters are held."""
        borders = BIASES + 6 * len(self.nodes)
        normal = BorderedNormal(self.knots.controls, 6, ORDER, borders)
        for part in self._rows(state, derivatives=True):
            normal.add(part)
        normal.add_border(*self._walk(state))
        held: list[int] = []
        if self.options.gravity != "tilt":
            held += range(TILT.start, TILT.stop)
        if self.options.time_offset is not None:
            held.append(OFFSET)
        if not self.options.biases:
            held += range(BIASES, borders)
        normal.hold(held)
        return normal

    def _rows(self, state: State, *, derivatives: bool) -> Iterator[Rows]:
        for t, rows in ((self.t, self.pose_rows), (self.imu.t, self.imu_rows)):
            for start in range(0, len(t), _CHUNK):
                yield rows(state, slice(start, start + _CHUNK), derivatives=derivatives)

    def pose_rows(self, state: State, part: slice, *, derivatives: bool) -> Rows:
        """Rows of some poses: position in the world, rotation in the parent frame."""
        knots, R_fs, t_fs = self.knots, state.R_parent_imu, state.t_parent_imu
        back = R_fs.T @ t_fs
        columns = np.arange(6)
        segment, u = knots.at(self.t[part])
        weights = knots.weights(u, 1)
        x = evaluate(state.controls, segment, weights)[0]
        phi = x[:, 3:]
        R = self.R_middle @ matrix_from_rotvec(phi)
        apart = rotvec_from_matrix(R_fs @ np.swapaxes(R, 1, 2) @ self.R[part])
        whiten = self.pose_whiten
        whiten = whiten if whiten.ndim == 1 else whiten[part]
        r = np.hstack([self.p[part] - x[:, :3] + R @ back, apart])
        r = _whitened(whiten, r[:, :, None])[:, :, 0]
        if not derivatives:
            return Rows(segment, r, _NONE, _NONE, columns)
        J = right_jacobian(phi)
        n = len(segment)
        of_value = np.zeros((n, 6, 6))
        of_value[:, :3, :3] = np.eye(3)
        of_value[:, :3, 3:] = R @ skew(back) @ J
        of_value[:, 3:, 3:] = R_fs @ J
        border = np.zeros((n, 6, 6))
        border[:, :3, :3] = -R @ R_fs.T
        border[:, :3, 3:] = -R @ R_fs.T @ skew(t_fs)
        border[:, 3:, 3:] = -np.eye(3)
        local = _spread(_whitened(whiten, of_value), weights[0]).reshape(n, 6, -1)
        return Rows(segment, r, local, _whitened(whiten, border), columns)

    def imu_rows(self, state: State, part: slice, *, derivatives: bool) -> Rows:
        """Rows of some samples of the IMU: accelerometer, gyroscope."""
        knots, whiten, imu, nodes = self.knots, self.imu_whiten, self.imu, self.nodes
        t = imu.t[part]
        segment, u = knots.at(t - state.time_offset)
        weights = knots.weights(u, 4 if derivatives else 3)
        x = evaluate(state.controls, segment, weights)
        phi, rate = x[0][:, 3:], x[1][:, 3:]
        R_t = np.swapaxes(self.R_middle @ matrix_from_rotvec(phi), 1, 2)
        J = right_jacobian(phi)
        force = (R_t @ (x[2][:, :3] - state.gravity)[:, :, None])[:, :, 0]
        omega = (J @ rate[:, :, None])[:, :, 0]
        before, share = _between(nodes, t)
        after = np.minimum(before + 1, len(nodes) - 1)
        of_nodes = np.arange(BIASES + 6 * before.min(), BIASES + 6 * (after.max() + 1))
        columns = np.concatenate([[*range(TILT.start, TILT.stop), OFFSET], of_nodes])
        bias = state.biases[before] * (1.0 - share)[:, None] + state.biases[after] * share[:, None]
        r = np.hstack([imu.accel[part] - force, imu.gyro[part] - omega]) - bias
        r *= whiten
        if not derivatives:
            return Rows(segment, r, _NONE, _NONE, columns)
        bent = rate_jacobian(phi, rate)
        local = np.zeros((len(t), 6, ORDER, 6))
        local[:, :3, :, :3] = _spread(R_t, weights[2])
        local[:, :3, :, 3:] = _spread(skew(force) @ J, weights[0])
        local[:, 3:, :, 3:] = _spread(bent, weights[0]) + _spread(J, weights[1])
        local = local.reshape(len(t), 6, -1) * whiten[:, None]
        border = np.zeros((len(t), 6, len(columns)))
        border[:, :3, :2] = R_t @ (skew(state.gravity) @ level_axes(state.gravity))
        jerk = (R_t @ x[3][:, :3, None])[:, :, 0] - np.cross(omega, force)
        border[:, :3, 2] = -jerk
        border[:, 3:, 2] = -((J @ x[2][:, 3:, None])[:, :, 0] + (bent @ rate[:, :, None])[:, :, 0])
        rows, axes = np.arange(len(t))[:, None], np.arange(6)
        for node, weight in ((before, 1.0 - share), (after, share)):
            at = 3 + 6 * (node - before.min())[:, None] + axes
            border[rows, axes, at] += weight[:, None]
        return Rows(segment, r, local, border * whiten[:, None], columns)

    def _walk(self, state: State) -> tuple[Floats, Floats]:
        """Rows of the biases' random walk between nodes, (rows, borders) and (rows,)."""
        walk = np.repeat([self.options.accel_bias_walk, self.options.gyro_bias_walk], 3)
        whiten = 1.0 / np.outer(np.sqrt(np.diff(self.nodes)), np.maximum(walk, 1e-12))
        steps = np.kron(np.diff(np.eye(len(self.nodes)), axis=0), np.eye(6))
        J = np.hstack([np.zeros((len(steps), BIASES)), steps * whiten.reshape(-1, 1)])
        return J, -(np.diff(state.biases, axis=0) * whiten).ravel()


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
        whiten = share * problem.pose_whiten
        loose = replace(problem, pose_whiten=whiten, tolerance=_LOOSE_TOLERANCE)
        state, more, _ = _descend(loose, state, patient=True)
        count += more
    solution, more, _ = _descend(problem, state, patient=True)
    return solution, count + more


def _descend(problem: Problem, state: State, *, patient: bool) -> tuple[State, int, bool]:
    """Levenberg-Marquardt; returns the state, the evaluations, and whether it converged.

    Without patience the first failed step ends it.
    """
    cost, normal = problem.cost(state), problem.normal(state)
    damping, evaluations = 1e-9, 1
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
            normal = problem.normal(state)
        elif patient:
            damping *= 10.0
        else:
            break
    return state, evaluations, False


def calibrate_bspline(imu: ImuSamples, path: KinematicPath, options: BSplineOptions) -> Answer:
    """Find the IMU's pose in its parent link.

    Raises:
        InputError: Too few samples, streams that do not overlap, turns beyond what a rotation
            vector can carry, or motion that leaves an unknown open.
    """
    return _answer(*solve(*prepare(imu, path, options)), "parent")


def calibrate_bspline_camera(
    imu: ImuSamples, camera: CameraRecord, options: BSplineOptions
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
        T_frame_imu=Pose(state.R_parent_imu, state.t_parent_imu),
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
    R_imu = R @ first.T_frame_imu.R
    R_middle = nearest_rotation(R_imu.sum(axis=0))  # rotation vectors from it are short
    phi = unwrapped_rotvecs(R_middle.T @ R_imu)
    if whiten is None:
        stds = [max(residual_std(knots, t, values), _STD_FLOOR) for values in (p, phi)]
        whiten = 1.0 / np.repeat(stds, 3)
    offset = first.time_offset or 0.0
    # The offset may still change by a millisecond; samples must stay on the spline then.
    margin = 0.01
    imu = imu.at((imu.t - offset > t[0] + margin) & (imu.t - offset < t[-1] - margin))
    if len(imu.t) == 0:
        raise InputError("the IMU's samples and the robot's do not overlap in time")
    walks = options.biases and max(options.accel_bias_walk, options.gyro_bias_walk) > 0.0
    span = float(imu.t[-1] - imu.t[0])
    count = max(round(span / options.bias_interval), 1) + 1 if walks else 1
    down = np.array([0.0, 0.0, -options.gravity_norm])
    gravity = {"none": np.zeros(3), "fixed": down, "tilt": first.gravity_world}[options.gravity]
    start = np.concatenate([first.accel_bias, first.gyro_bias])
    state = State(
        controls=fitted_controls(knots, t, np.hstack([p, phi])),
        R_parent_imu=first.T_frame_imu.R,
        t_parent_imu=np.zeros(3),
        gravity=np.asarray(gravity),
        time_offset=offset,
        biases=np.tile(start if options.biases else np.zeros(6), (count, 1)),
    )
    problem = Problem(
        knots=knots,
        R_middle=R_middle,
        t=t,
        R=R,
        p=p,
        pose_whiten=whiten,
        imu=imu,
        imu_whiten=1.0 / np.repeat([options.accel_std, options.gyro_std], 3),
        nodes=np.linspace(imu.t[0], imu.t[-1], count),
        options=options,
    )
    return problem, state
