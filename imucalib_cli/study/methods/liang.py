"""Camera-IMU hand-eye calibration with RANSAC, from standstill to standstill.

The method of Liang, Cheng, Tan, Huang and Li, "Camera-IMU extrinsic calibration method based on
intermittent sampling and RANSAC optimization", Measurement Science and Technology, 2024, doi
10.1088/1361-6501/ad4dd2, as far as known from its abstract and the description in Sensors 2026,
26(6), 1788: keyframes where the IMU changes from motion to standstill, displacements of the camera
by PnP and of the IMU by integration between them, a robot's hand-eye calibration on both, RANSAC
on their difference.

Two variants, because the text leaves much open; their numbers are in configs/studies/methods.yaml.
As published, it integrates with the gyroscope bias from the first standstill, gravity from the
values before each move, and zero velocity at its start. ``tuned`` uses all that start-stop motion
offers: biases and gravity from the standstills at both ends, velocity zero at both, all images of a
standstill, the optimal rotation.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.robot.rotations import (
    matrix_from_rotvec,
    nearest_rotation,
    rotvec_from_matrix,
    skew,
)
from imucalib_cli.signals.samples import STANDARD_GRAVITY
from imucalib_cli.signals.stretches import stretches_of
from imucalib_cli.study.method_runs import Answer, Pose
from imucalib_cli.study.methods.camera import target_pose

if TYPE_CHECKING:
    from collections.abc import Callable

    from imucalib_cli.arrays import Bools, Floats, Indices
    from imucalib_cli.signals.samples import ImuSamples
    from imucalib_cli.simulate.recording import CameraRecord

FEWEST_MOTIONS = 3
_SINGULAR = 1e-4
"""Ratio of singular values below which motions do not determine X."""
_ONE_AXIS = "the motions turn about one axis only: hand-eye calibration needs two"


@dataclass(frozen=True, kw_only=True)
class LiangOptions:
    """Options of the hand-eye method."""

    tuned: bool = False
    """Use both ends of each move, all images of a standstill, and the optimal rotation."""
    ransac: Ransac
    still: StillOptions
    gravity_norm: float = STANDARD_GRAVITY
    """m/s²."""


def calibrate_liang(imu: ImuSamples, camera: CameraRecord, options: LiangOptions) -> Answer:
    """Find the IMU's pose in the camera's optical frame; the target does not move.

    Raises:
        InputError: OpenCV is missing; too few moves between standstills at which the target is
            seen; or turns about one axis only.
    """
    stills = standstills(imu.t, imu.gyro, imu.accel, options.still)
    if not stills:
        raise InputError("the IMU never stands still: this method needs start-stop motion")
    seen = [_camera_pose(camera, still, tuned=options.tuned) for still in stills]
    # As published, the accelerometer's bias is part of the gravity measured before each move.
    accel_bias, gyro_bias = np.zeros(3), stills[0].gyro
    if options.tuned:
        accel_bias = static_accel_bias(stills, options.gravity_norm)
        gyro_bias = np.mean([still.gyro for still in stills], axis=0)
    moved = []
    for (start, first), (end, last) in pairwise(zip(stills, seen, strict=True)):
        if first is not None and last is not None:
            R = first.R @ last.R.T  # of the camera's later frame in its earlier one
            by_imu = _displaced(imu, start, end, (accel_bias, gyro_bias), tuned=options.tuned)
            moved.append((R, first.t - R @ last.t, by_imu.R, by_imu.t))
    motions = Motions(*(np.array([each[part] for each in moved]) for part in range(4)))
    found, _ = ransac(motions, park_martin if options.tuned else tsai, options.ransac)
    return Answer(
        frame="camera",
        T_frame_imu=found,
        time_offset=None,
        evaluations=options.ransac.iterations + 1,
        accel_bias=accel_bias if options.tuned else None,
        gyro_bias=gyro_bias,
    )


def _camera_pose(camera: CameraRecord, still: Still, *, tuned: bool) -> Pose | None:
    """Pose of the target in the camera during a standstill; None where it is not seen.

    As published, one image, the middle one; tuned, the mean of each corner over all images.
    """
    # Stamps of either clock: images only have to be in the right standstill.
    inside = np.flatnonzero((camera.stamp >= still.start) & (camera.stamp <= still.end))
    if len(inside) == 0:
        return None
    seen = camera.corners[inside]
    return target_pose(camera, seen.mean(axis=0) if tuned else seen[len(inside) // 2])


def _displaced(
    imu: ImuSamples,
    start: Still,
    end: Still,
    biases: tuple[Floats, Floats],
    *,
    tuned: bool,
) -> Pose:
    """The IMU after a move in its frame before, by integration from rest between two standstills.

    Tuned, it uses both standstills. For the position, the remaining tilt at the end is distributed
    evenly over the move, and the remaining velocity is treated as a constant error of acceleration.
    The orientation is the gyroscope's, which is more accurate over a move.
    """
    rows = slice(start.rows.stop - 1, end.rows.start + 1)
    accel_bias, gyro_bias = biases
    t, gyro, accel = imu.t[rows], imu.gyro[rows] - gyro_bias, imu.accel[rows] - accel_bias
    up = start.accel - accel_bias
    R, _, p = integrate(t, gyro, accel, up)
    if not tuned:
        return Pose(R, p)
    # Up at the end, rotated back by the integration, compared with up at the start.
    carried = R @ (end.accel - accel_bias)
    tilt = np.cross(carried, up) / (np.linalg.norm(carried) * np.linalg.norm(up))
    length = float(t[-1] - t[0])
    corrections = matrix_from_rotvec(((t - t[0]) / length)[:, None] * tilt)
    _, velocity, p = integrate(t, gyro, accel, up, corrections)
    return Pose(R, p - 0.5 * length * velocity)


@dataclass(frozen=True, eq=False)
class Still:
    """A stretch of standstill."""

    rows: slice
    """Of the IMU's samples."""
    start: float
    """s, as stamped."""
    end: float
    gyro: Floats
    """(3,), mean over it: the gyroscope's bias, rad/s."""
    accel: Floats
    """(3,), mean over it: up, with the accelerometer's bias, m/s²."""


@dataclass(frozen=True, kw_only=True)
class StillOptions:
    """Options for standstills: values as steady as they get in this log."""

    window: float
    """s over which steadiness is judged."""
    over_noise: float
    """Scatter of a window over the log's quietest, up to which it is steady."""
    least_gyro: float
    """rad/s, scatter that is steady in any case."""
    least_accel: float
    """m/s², scatter that is steady in any case."""
    gyro: float
    """rad/s relative to the bias: a steady rotation is no standstill."""
    shortest: float
    """s."""
    margin: float
    """s left out at both ends, while the arm settles."""


def standstills(t: Floats, gyro: Floats, accel: Floats, options: StillOptions) -> list[Still]:
    """Find standstills from the IMU alone; t is even except for jitter."""
    samples = max(round(options.window / float(np.median(np.diff(t)))), 4)
    if len(t) < 2 * samples:
        return []
    steady = np.ones(len(t) - samples + 1, dtype=bool)
    mean_rate = _windowed(gyro, samples)
    for values, least in ((gyro, options.least_gyro), (accel, options.least_accel)):
        about = values - values.mean(axis=0)
        squares = _windowed(about * about, samples) - _windowed(about, samples) ** 2
        scatter = np.sqrt(np.maximum(squares, 0.0).sum(axis=1))
        quiet = float(np.percentile(scatter, 5))
        steady &= scatter < options.over_noise * quiet + least
    if not steady.any():
        return []
    bias = np.median(mean_rate[steady], axis=0)
    steady &= np.linalg.norm(mean_rate - bias, axis=1) < options.gyro
    # A sample is still if a steady window covers it.
    still = np.convolve(steady, np.ones(samples), mode="full") > 0
    found = []
    for first, end in stretches_of(still):
        a, b = t[first], t[end - 1]
        inside = (t >= a + options.margin) & (t <= b - options.margin)
        if b - a < options.shortest or not inside.any():
            continue
        rows = slice(int(np.argmax(inside)), int(len(t) - np.argmax(inside[::-1])))
        span = float(t[rows][0]), float(t[rows][-1])
        found.append(Still(rows, *span, gyro[rows].mean(axis=0), accel[rows].mean(axis=0)))
    return found


def _windowed(values: Floats, samples: int) -> Floats:
    """Means over windows, (N - samples + 1, 3)."""
    middle = values.mean(axis=0)  # subtract the mean first: sums over long logs lose digits
    total = np.cumsum(np.vstack([np.zeros((1, 3)), values - middle]), axis=0)
    return np.asarray((total[samples:] - total[:-samples]) / samples + middle)


def integrate(
    t: Floats, gyro: Floats, accel: Floats, up: Floats, corrections: Floats | None = None
) -> tuple[Floats, Floats, Floats]:
    """Integrate bias-free samples from rest.

    Rates are means of neighbouring samples, accelerations vary linearly between them.

    Args:
        t: (N,), s.
        gyro: (N, 3), rad/s.
        accel: (N, 3), m/s², specific force.
        up: (3,), accelerometer at rest at the start: the negative of gravity.
        corrections: (N, 3, 3), rotations of the integrated orientation in the frame of the start.

    Returns:
        R_start_end (3, 3), velocity at the end (3,), m/s, and displacement (3,), m.
    """
    dt = np.diff(t)[:, None]
    steps = matrix_from_rotvec(0.5 * (gyro[1:] + gyro[:-1]) * dt)
    R = np.empty((len(t), 3, 3))
    R[0] = np.eye(3)
    for k, step in enumerate(steps):
        R[k + 1] = R[k] @ step
    if corrections is not None:
        R = corrections @ R
    a = np.einsum("nij,nj->ni", R, accel) - up
    v = np.vstack([np.zeros(3), np.cumsum(0.5 * (a[1:] + a[:-1]) * dt, axis=0)])
    p = np.sum(v[:-1] * dt + (2.0 * a[:-1] + a[1:]) * dt**2 / 6.0, axis=0)
    return R[-1], v[-1], p


def static_accel_bias(stills: list[Still], gravity_norm: float) -> Floats:
    """Accelerometer bias with which all standstills have gravity's norm, (3,), m/s².

    Gauss-Newton from zero. Components that the orientations do not determine stay at zero.
    """
    readings = np.array([still.accel for still in stills])
    weights = np.array([still.rows.stop - still.rows.start for still in stills]) ** 0.5
    bias = np.zeros(3)
    for _ in range(10):
        unbiased = readings - bias
        norm = np.linalg.norm(unbiased, axis=1)
        J = unbiased / norm[:, None] * weights[:, None]
        bias = bias + np.linalg.lstsq(J, (norm - gravity_norm) * weights, rcond=0.03)[0]
    return bias


@dataclass(frozen=True, eq=False)
class Motions:
    """Relative motions of two frames on one body."""

    R_a: Floats
    """(N, 3, 3), A: first frame at the end of a motion as seen at its start."""
    t_a: Floats
    """(N, 3), m."""
    R_b: Floats
    """(N, 3, 3), B: second frame at the end of a motion as seen at its start."""
    t_b: Floats
    """(N, 3), m."""

    def __len__(self) -> int:
        return len(self.t_a)

    def only(self, which: Bools | Indices) -> Motions:
        """Some of them."""
        return Motions(self.R_a[which], self.t_a[which], self.R_b[which], self.t_b[which])


def apart(X: Pose, motions: Motions) -> tuple[Floats, Floats]:
    """Difference of the displacements, with the second frame at X in the first: m, rad, (N,)."""
    place = (motions.R_a - np.eye(3)) @ X.t + motions.t_a - motions.t_b @ X.R.T
    turn = np.swapaxes(motions.R_a, 1, 2) @ X.R @ motions.R_b @ X.R.T
    return np.linalg.norm(place, axis=1), np.linalg.norm(rotvec_from_matrix(turn), axis=1)


def tsai(motions: Motions) -> Pose:
    """Rotation by modified Rodrigues vectors, then translation, both linear.

    Raises:
        InputError: The motions leave X open.

    Source:
        Tsai and Lenz, IEEE Transactions on Robotics and Automation 5(3), 1989, eq. 10 to 15.
    """
    a, b = rotvec_from_matrix(motions.R_a), rotvec_from_matrix(motions.R_b)
    # 2 sin(angle / 2) along the axis; sinc is smooth at rest.
    p_a, p_b = (v * np.sinc(np.linalg.norm(v, axis=1, keepdims=True) / (2 * np.pi)) for v in (a, b))
    # tan of half the angle, along the axis of X.
    half = _solve(skew(p_b + p_a).reshape(-1, 3), (p_b - p_a).ravel())
    angle = 2.0 * np.arctan(np.linalg.norm(half))
    axis = half / max(float(np.linalg.norm(half)), np.finfo(float).tiny)
    return _with_translation(motions, matrix_from_rotvec(angle * axis))


def park_martin(motions: Motions) -> Pose:
    """Rotation by the least squares of rotation vectors (Wahba's problem), then translation.

    Raises:
        InputError: The motions leave X open.

    Source:
        Park and Martin, IEEE Transactions on Robotics and Automation 10(5), 1994.
    """
    a, b = rotvec_from_matrix(motions.R_a), rotvec_from_matrix(motions.R_b)
    s = np.linalg.svd(a.T @ b, compute_uv=False)
    if s[1] < _SINGULAR * s[0]:
        raise InputError(_ONE_AXIS)
    return _with_translation(motions, nearest_rotation(a.T @ b))


def _with_translation(motions: Motions, R: Floats) -> Pose:
    J = (motions.R_a - np.eye(3)).reshape(-1, 3)
    return Pose(R, _solve(J, (motions.t_b @ R.T - motions.t_a).ravel()))


def _solve(J: Floats, right: Floats) -> Floats:
    x, _, _, s = np.linalg.lstsq(J, right, rcond=None)
    if s[-1] < _SINGULAR * s[0]:
        raise InputError(_ONE_AXIS)
    return np.asarray(x)


@dataclass(frozen=True, kw_only=True)
class Ransac:
    """Options of RANSAC."""

    iterations: int
    samples: int
    """Motions per model."""
    threshold_m: float
    """Difference of displacements up to which a motion agrees."""
    threshold_rad: float
    seed: int = 0


def ransac(
    motions: Motions, solve: Callable[[Motions], Pose], options: Ransac
) -> tuple[Pose, Bools]:
    """The model that most motions agree with, solved again from these.

    If fewer motions agree than a model needs, the model with the least median difference.

    Returns:
        X, and the motions used for it, (N,).

    Raises:
        InputError: There are too few motions, or no sample of them determines X.
    """
    if len(motions) < FEWEST_MOTIONS:
        raise InputError(
            f"{len(motions)} moves between standstills seen by the camera, need at least "
            f"{FEWEST_MOTIONS}: record more start-stop moves before the target"
        )
    rng = np.random.default_rng(options.seed)
    size = min(options.samples, len(motions))
    best, agreeing, why = (np.inf, np.inf), np.ones(len(motions), dtype=bool), None
    for _ in range(options.iterations):
        chosen = rng.choice(len(motions), size, replace=False)
        try:
            model = solve(motions.only(chosen))
        except InputError as error:
            why = error
            continue
        place, turn = apart(model, motions)
        agree = (place < options.threshold_m) & (turn < options.threshold_rad)
        score = (-float(agree.sum()), float(np.median(place / options.threshold_m)))
        if score < best:
            best, agreeing = score, agree
            if agree.sum() < FEWEST_MOTIONS:
                agreeing = np.isin(np.arange(len(motions)), chosen)
    if why is not None and best[0] == np.inf:
        raise why
    return solve(motions.only(agreeing)), agreeing
