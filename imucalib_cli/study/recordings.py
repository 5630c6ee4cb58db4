"""Simulated recordings in memory as inputs of an estimator."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.robot.build import joint_path
from imucalib_cli.robot.path import KinematicPath, PoseStep, Track
from imucalib_cli.robot.urdf import Robot, parse_robot
from imucalib_cli.signals.samples import ImuSamples
from imucalib_cli.simulate.camera_config import load_camera
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.physics import record
from imucalib_cli.simulate.recording import JointRecord, PoseRecord, Recording
from imucalib_cli.simulate.urdf import urdf_text

if TYPE_CHECKING:
    from imucalib_cli.simulate.config import SystemConfig
    from imucalib_cli.simulate.options import PhysicsOptions


@cache
def clean_recording(system: str, physics: PhysicsOptions, camera: str = "") -> Recording:
    """Noise-free run of a system, cached per process; with a camera, in front of its pattern."""
    moved = load_system(system)
    if not camera:
        return record(moved, physics)
    moved, seen = load_camera(camera, moved)
    return record(moved, physics, camera=seen)


@cache
def robot_of(system: SystemConfig) -> Robot:
    """The system's URDF, parsed once per process."""
    return parse_robot(urdf_text(system).encode(), f"{system.name}.urdf")


def streams_of(
    recording: Recording, robot: Robot | None = None
) -> tuple[ImuSamples, KinematicPath]:
    """IMU samples and path as from a log, with the kinematics of the system or of another robot."""
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
