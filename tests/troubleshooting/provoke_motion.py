"""Motion that does not tell, and what was known beforehand and is contradicted."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.robot.rotations import quaternion_from_matrix
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.options import PhysicsOptions
from imucalib_cli.simulate.physics import record
from tests.estimate.estimate_arm import Mount, Moves, parent_motion, readings
from tests.troubleshooting.scene import (
    RATE,
    Scene,
    Seen,
    clean,
    noisy,
    provokes,
    robot_of,
    with_imu,
    with_robot,
)

if TYPE_CHECKING:
    from imucalib_cli.simulate.recording import Recording

ARM, BODY = "rihibot", "barbot"
IMU = ("t", "stamp", "received", "gyro", "accel")
JOINTS = ("t", "stamp", "received", "position")


def part(recording: Recording, start: float, stop: float) -> Recording:
    """Some seconds of a recording."""
    imu, robot = recording.imu, robot_of(recording)
    rows = (imu.t >= start) & (imu.t < stop)
    also = (robot.t >= start) & (robot.t < stop)
    return replace(
        recording,
        imu=replace(imu, **{name: getattr(imu, name)[rows] for name in IMU}),
        robot=(replace(robot, **{name: getattr(robot, name)[also] for name in JOINTS}),),
    )


@provokes("too-short")
def _(scene: Scene) -> Seen:
    """The IMU stopped when the robot's stream had just begun."""
    early, late = part(noisy(ARM), 5.0, 5.7), part(noisy(ARM), 5.4, 6.1)
    return scene.run_arm(replace(noisy(ARM), imu=early.imu, robot=late.robot))


@provokes("between-gaps")
def _(scene: Scene) -> Seen:
    """A third of a second of the robot's messages is lost in every 0.8 s."""
    recording = noisy(ARM)
    robot = robot_of(recording)
    kept = robot.t % 0.8 > 0.35
    return scene.run_arm(
        with_robot(recording, **{name: getattr(robot, name)[kept] for name in JOINTS})
    )


@provokes("too-few-samples")
def _(scene: Scene) -> Seen:
    return scene.run_arm(part(noisy(ARM), 3.0, 3.2))


@provokes("standstill")
def _(scene: Scene) -> Seen:
    # Two seconds of rest begin the arm's plan.
    return scene.run_arm(part(noisy(ARM), 0.0, 2.0))


def moving_only(*joints: int) -> Recording:
    """The arm's plan, the other joints held where they start."""
    system = load_system(ARM)
    assert system.arm is not None
    start = system.arm.start_deg
    moves = [
        replace(
            move,
            to_deg=tuple(
                90.0 * (-1.0) ** i + 30.0 * j if j in joints else angle
                for j, angle in enumerate(start)
            ),
        )
        for i, move in enumerate(system.arm.moves)
    ]
    few = replace(system, arm=replace(system.arm, moves=tuple(moves)))
    return record(few, PhysicsOptions(duration=20.0, imu_rate=RATE, robot_rate=RATE))


@provokes("one-axis")
def _(scene: Scene) -> Seen:
    return scene.run_arm(moving_only(5))


@provokes("joints-still")
def _(scene: Scene) -> Seen:
    return scene.run_arm(moving_only(3, 4))


@provokes("stated-contradicted")
def _(scene: Scene) -> Seen:
    return scene.run_arm(noisy(ARM), "--gravity", "9.7")


@provokes("require")
def _(scene: Scene) -> Seen:
    return scene.run_arm(noisy(ARM), "--require", "0.001mm")


@provokes("accel-sign")
def _(scene: Scene) -> Seen:
    """Turned about one point, an IMU on the other side of it reads the opposite."""
    t = np.arange(0.0, 20.0, 0.008)
    moving = parent_motion(Moves(seconds=20.0), t)
    turning = replace(moving, acceleration=np.zeros_like(moving.acceleration))
    mount = Mount(t=np.array([0.05, -0.02, 0.08]), R=np.eye(3))
    gyro, accel = readings(turning, mount, np.array([0.0, 0.0, -9.80665]))
    noise = np.random.default_rng(1).normal(0.0, 1.0, (2, len(t), 3))
    stamps = {"t": t, "stamp": t, "received": t}
    values = {"gyro": gyro + 1e-3 * noise[0], "accel": -accel + 0.02 * noise[1]}
    recording = with_imu(clean(BODY), **stamps, **values)
    poses = {
        "position": np.zeros((len(t), 3)),
        "quaternion_xyzw": np.stack([quaternion_from_matrix(R) for R in moving.R]),
    }
    log = scene.log(with_robot(recording, **stamps, **poses))
    return scene.cli("run", log, "--parent", "bar_link")
