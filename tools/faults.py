"""Simulated recordings with one fault of robot or log each, to test that it is recognised.

Either the recording is correct and its description is wrong (the URDF, a publisher, a clock), or
the sensor, its mount or its base has the fault.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs
from numpy.typing import NDArray
from scipy.signal import bilinear, lfilter

from imucalib_cli.diagnose.diagnose import diagnose, explained
from imucalib_cli.diagnose.hypotheses import PoorFit
from imucalib_cli.errors import InputError
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.robot.build import joint_path
from imucalib_cli.robot.rotations import matrix_from_quaternion, matrix_from_rotvec
from imucalib_cli.study.recordings import robot_of, streams_of

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.findings import Finding
    from imucalib_cli.robot.path import KinematicPath, Track
    from imucalib_cli.robot.urdf import Robot
    from imucalib_cli.signals.samples import ImuSamples
    from imucalib_cli.simulate.recording import ImuRecord, Recording

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One fault."""

    kind: str
    """none, offset, publishers; of arms link, sign, zero, length, order, degrees, ringing, hum,
    base; of poses inverse, quaternion, conjugate, millimetres; of IMUs accel scale, gyro scale,
    handed."""
    names: tuple[str, ...] = ()
    """Joints or links at fault."""
    size: float = 0.0
    """rad, share of a length, s, Hz, rad/s, share of a scale, rad or m between publishers."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Judged:
    """An estimate, and what is wrong with it."""

    plain: Estimate
    """As the estimator returns it."""
    found: tuple[Finding, ...]
    """By the diagnosis."""

    @property
    def explained(self) -> Estimate:
        """The estimate with the findings of the diagnosis."""
        return explained(self.plain, self.found)


@dataclass(frozen=True, kw_only=True, eq=False)
class EstimatorInputs:
    """Data and robot model that an estimator gets."""

    imu: ImuSamples
    path: KinematicPath
    robot: Robot | None = None

    def poor_fit(self, estimate: Estimate, options: MatchedOptions) -> PoorFit:
        """The question why an estimate is poor."""
        robot, tracks = self.robot, self.path.tracks
        return PoorFit(
            samples=self.imu,
            path=self.path,
            options=options,
            estimate=estimate,
            frames=() if robot is None else robot.links,
            path_to=None if robot is None else lambda link: joint_path(robot, link, tracks),
        )

    def judged(self, options: MatchedOptions) -> Judged:
        """Estimate the pose and diagnose the fit.

        Raises:
            ImucalibError: The estimator refuses the data.
        """
        plain = calibrate_matched(self.imu, self.path, options)
        return Judged(plain=plain, found=diagnose(self.poor_fit(plain, options)))


def misdescribed(recording: Recording, fault: Fault) -> EstimatorInputs:
    """A recording, noisy or not, whose description has one fault.

    Raises:
        InputError: The kind of fault does not exist for this system.
    """
    imu, path = streams_of(recording)
    if fault.kind == "offset":
        imu = structs.replace(imu, t=imu.t + fault.size)
    if fault.kind == "publishers":
        path = structs.replace(
            path, tracks=tuple(_two_publishers(t, fault.size) for t in path.tracks)
        )
    if recording.system.arm is None:
        return EstimatorInputs(imu=imu, path=_poses(path, fault.kind))
    robot, parent, tracks = robot_of(recording.system), recording.system.parent, path.tracks
    match fault.kind:
        case "link":
            parent = fault.names[0]
        case "sign" | "zero" | "length":
            robot = _mistaken(robot, fault)
        case "order":
            tracks = tuple(_reordered(track, fault.names) for track in tracks)
        case "degrees":
            tracks = tuple(
                structs.replace(track, values=np.degrees(track.values)) for track in tracks
            )
    return EstimatorInputs(imu=imu, path=joint_path(robot, parent, tracks), robot=robot)


def _mistaken(robot: Robot, fault: Fault) -> Robot:
    """A URDF that is wrong: an axis reversed, an origin turned about its axis, or scaled."""
    joints = list(robot.joints)
    for index, joint in enumerate(joints):
        if joint.name not in fault.names:
            continue
        if fault.kind == "sign":
            joints[index] = structs.replace(joint, axis=-joint.axis)
        elif fault.kind == "zero":
            turn = matrix_from_rotvec(fault.size * joint.axis)
            joints[index] = structs.replace(joint, R_origin=joint.R_origin @ turn)
        else:
            joints[index] = structs.replace(joint, p_origin=joint.p_origin * (1.0 + fault.size))
    return structs.replace(robot, joints=tuple(joints))


def _two_publishers(track: Track, apart: float) -> Track:
    """Half the messages of another publisher, whose first column has a constant offset."""
    values = track.values.copy()
    other = np.random.default_rng(len(values)).random(len(values)) < 0.5
    values[other, 0] += apart
    return structs.replace(track, values=values)


def _reordered(track: Track, names: tuple[str, ...]) -> Track:
    """Names of joints exchanged; without names, sorted, as one well-known driver has them."""
    exchanged = dict(zip(names, names[::-1], strict=True))
    listed = [exchanged.get(name, name) for name in track.names] if names else sorted(track.names)
    return structs.replace(track, names=tuple(listed))


def _poses(path: KinematicPath, kind: str) -> KinematicPath:
    """A path whose tracked poses are wrong."""
    (track,) = path.tracks
    p, q = track.values[:, :3], track.values[:, 3:]
    conjugate = q * np.array([-1.0, -1.0, -1.0, 1.0])
    match kind:
        case "inverse":
            p, q = -np.einsum("nij,nj->ni", matrix_from_quaternion(conjugate), p), conjugate
        case "quaternion":
            q = q[:, [3, 0, 1, 2]]
        case "conjugate":
            q = conjugate
        case "millimetres":
            p = 1e3 * p
    return structs.replace(path, tracks=(structs.replace(track, values=np.hstack([p, q])),))


def with_faulty_sensor(recording: Recording, fault: Fault) -> Recording:
    """A clean recording whose IMU has the fault, if it is one of the IMU, its mount or its base.

    Before noise is added: what swings is the sensor, not its noise.
    """
    imu = recording.imu
    match fault.kind:
        case "accel scale":
            imu = replace(imu, accel=imu.accel * (1.0 + fault.size))
        case "gyro scale":
            imu = replace(imu, gyro=imu.gyro * (1.0 + fault.size))
        case "handed":
            mirror = np.array([1.0, -1.0, 1.0])
            imu = replace(imu, accel=imu.accel * mirror, gyro=imu.gyro * mirror)
        case "hum":
            # A motor on the link that runs all the time.
            hum = np.sin(2.0 * np.pi * fault.size * imu.t)[:, None]
            accel, gyro = imu.accel + hum * [0.5, 0.2, 0.3], imu.gyro + hum * [0.01, 0.02, 0.01]
            imu = replace(imu, accel=accel, gyro=gyro)
        case "ringing":
            imu = _ringing(recording, fault.size)
        case "base":
            imu = _on_turning_base(recording, fault.size)
    return replace(recording, imu=imu)


def _true_poses(recording: Recording) -> tuple[Floats, Floats]:
    """R_world_imu and p_world_imu at the IMU's samples, from the engine's own state."""
    if recording.system.arm is None:
        raise InputError("only an arm can ring or stand on a base that turns")
    _, path = streams_of(recording, robot_of(recording.system))
    at = np.searchsorted(recording.state.t, recording.imu.t)
    position = recording.state.position[np.minimum(at, len(recording.state.t) - 1)]
    (track,) = path.tracks
    order = [[j.name for j in recording.system.arm.joints].index(name) for name in track.names]
    R, p = path.poses((position[:, order],))
    return R @ recording.R_parent_imu, p + R @ recording.t_parent_imu


def _ringing(recording: Recording, frequency: float) -> ImuRecord:
    """An IMU on a spring, 4 % damped, alike to all sides: its sag rests in the world."""
    imu = recording.imu
    R, _ = _true_poses(recording)
    pushed = np.einsum("nij,nj->ni", R, imu.accel) + recording.gravity_world
    rate, w = 1.0 / float(np.median(np.diff(imu.t))), 2.0 * np.pi * frequency
    w = 2.0 * rate * np.tan(w / (2.0 * rate))
    own = [1.0, 2.0 * 0.04 * w, w**2]
    b, a = bilinear([-1.0, 0.0, 0.0], own, rate)
    swing = np.einsum("nji,nj->ni", R, lfilter(b, a, pushed, axis=0))
    b, a = bilinear([-1.0, 0.0], own, rate)
    # 2 rad of twist for a metre of swing.
    turning = 2.0 * lfilter(b, a, np.einsum("nji,nj->ni", R, pushed), axis=0)
    return replace(imu, accel=imu.accel + swing, gyro=imu.gyro + turning[:, [1, 2, 0]])


def _on_turning_base(recording: Recording, rate: float) -> ImuRecord:
    """An arm on a base that swings about the vertical, rad/s, once in seven seconds."""
    imu = recording.imu
    R, p = _true_poses(recording)
    w, z = 2.0 * np.pi / 7.0, np.array([0.0, 0.0, 1.0])
    omega = rate * np.sin(w * imu.t)[:, None] * z
    alpha = rate * w * np.cos(w * imu.t)[:, None] * z
    v = np.gradient(p, imu.t, axis=0)
    more = np.cross(alpha, p) + np.cross(omega, np.cross(omega, p)) + 2.0 * np.cross(omega, v)
    # Seen in the IMU, the base's own angle drops out: gravity is along its axis.
    return replace(
        imu,
        gyro=imu.gyro + np.einsum("nji,nj->ni", R, omega),
        accel=imu.accel + np.einsum("nji,nj->ni", R, more),
    )
