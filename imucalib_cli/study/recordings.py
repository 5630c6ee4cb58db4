"""Simulated recordings in memory as inputs of an estimator."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.robot.build import joint_path
from imucalib_cli.robot.path import KinematicPath, PoseStep, Track
from imucalib_cli.robot.rotations import rotvec_from_matrix
from imucalib_cli.robot.urdf import Robot, load_robot
from imucalib_cli.signals.samples import ImuSamples
from imucalib_cli.simulate.camera.config import load_camera
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.physics import record
from imucalib_cli.simulate.recording import JointRecord, PoseRecord, Recording
from imucalib_cli.simulate.urdf import urdf_text

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.simulate.config import SystemConfig
    from imucalib_cli.simulate.options import PhysicsOptions

Floats = NDArray[np.float64]


@cache
def clean_recording(system: str, physics: PhysicsOptions, camera: str = "") -> Recording:
    """Noise-free run of a system, cached per process; with a camera, in front of its pattern."""
    moved, seen = load_system(system), None
    if camera:
        moved, seen = load_camera(camera, moved)
    return record(moved, physics, camera=seen)


@cache
def robot_of(system: SystemConfig) -> Robot:
    """The system's URDF, parsed once per process."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{system.name}.urdf"
        path.write_text(urdf_text(system), encoding="utf-8")
        return load_robot(path)


def streams_of(
    recording: Recording, robot: Robot | None = None
) -> tuple[ImuSamples, KinematicPath]:
    """IMU samples and path of a recording, as read from a log.

    Args:
        recording: Noisy or not.
        robot: The kinematics to assume; default: the system's own, which an arm needs.
    """
    imu = ImuSamples(t=recording.imu.stamp, gyro=recording.imu.gyro, accel=recording.imu.accel)
    first = recording.robot[0]
    if isinstance(first, PoseRecord):
        values = np.hstack([first.position, first.quaternion_xyzw])
        track = Track(name=first.child, kind="pose", t=first.stamp, values=values)
        path = KinematicPath(
            world=first.parent, parent=first.child, steps=(PoseStep(track=0),), tracks=(track,)
        )
        return imu, path
    robot = robot_of(recording.system) if robot is None else robot
    tracks = [
        Track(
            name=f"publisher {index}",
            kind="joints",
            t=record.stamp,
            values=record.position,
            names=record.names,
        )
        for index, record in enumerate(recording.robot)
        if isinstance(record, JointRecord)
    ]
    return imu, joint_path(robot, recording.system.parent, tracks)


@dataclass(frozen=True, kw_only=True, eq=False)
class Error:
    """Estimate less truth."""

    translation: Floats
    """(3,), m, parent frame."""
    rotation: Floats
    """(3,), rad, rotation vector of estimate times inverse truth, parent frame."""
    time_offset: float
    """s."""

    @property
    def translation_norm(self) -> float:
        """Distance, m."""
        return float(np.linalg.norm(self.translation))

    @property
    def rotation_angle(self) -> float:
        """Geodesic angle, rad."""
        return float(np.linalg.norm(self.rotation))

    @property
    def pose(self) -> Floats:
        """(6,), in the tangent of the covariance."""
        return np.concatenate([self.translation, self.rotation])


def error_of(estimate: Estimate, recording: Recording) -> Error:
    """Compare an estimate with the recording's truth."""
    return Error(
        translation=estimate.t_parent_imu - recording.t_parent_imu,
        rotation=rotvec_from_matrix(estimate.R_parent_imu @ recording.R_parent_imu.T),
        time_offset=estimate.time_offset - recording.noise.time_offset,
    )


def nees(error: Floats, covariance: Floats) -> float:
    """Normalised squared error; its mean is the number of components if the covariance is true."""
    return float(error @ np.linalg.solve(covariance, error))
