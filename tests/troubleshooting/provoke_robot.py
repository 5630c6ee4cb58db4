"""Robots that are not as their URDF, their publishers or their mount say."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.robot.rotations import matrix_from_rotvec
from imucalib_cli.study.faults import Fault, told_wrongly
from tests.troubleshooting.scene import (
    Scene,
    Seen,
    joint,
    noisy,
    provokes,
    robot_of,
    row,
    with_imu,
    with_robot,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from imucalib_cli.simulate.recording import Recording

ARM, BODY = "rihibot", "barbot"


def wrong_urdf(name: str, old: str, new: str) -> Callable[[Scene], Seen]:
    """The arm's log beside a URDF with one joint that is wrong."""

    def provocation(scene: Scene) -> Seen:
        scene.urdf(lambda text: joint(text, name, old, new))
        return scene.run_arm(noisy(ARM))

    return provocation


def wrong_joints(fault: Fault) -> Callable[[Scene], Seen]:
    """The arm's log whose joint states are told wrongly."""

    def provocation(scene: Scene) -> Seen:
        (track,) = told_wrongly(noisy(ARM), fault).path.tracks
        changes = {"position": track.values, "names": track.names}
        return scene.run_arm(with_robot(noisy(ARM), **changes))

    return provocation


def wrong_poses(kind: str) -> Callable[[Scene], Seen]:
    """The floating body's log whose poses are told wrongly."""

    def provocation(scene: Scene) -> Seen:
        (track,) = told_wrongly(noisy(BODY), Fault(kind=kind)).path.tracks
        p, q = track.values[:, :3], track.values[:, 3:]
        return scene.run_body(with_robot(noisy(BODY), position=p, quaternion_xyzw=q))

    return provocation


def swinging(fault: Fault) -> Callable[[Scene], Seen]:
    """The arm's log on a mount or base that moves."""
    return lambda scene: scene.run_arm(noisy(ARM, fault))


@provokes("wrong-link")
def _(scene: Scene) -> Seen:
    return scene.run_arm(noisy(ARM), "--parent", "forearm_link")


provokes("joint-sign")(wrong_urdf("elbow_joint", 'axis xyz="0 0 1"', 'axis xyz="0 0 -1"'))
provokes("joint-zero")(wrong_urdf("elbow_joint", 'rpy="0 0 0"', 'rpy="0 0 1.5708"'))
provokes("joint-zero-small")(wrong_urdf("elbow_joint", 'rpy="0 0 0"', 'rpy="0 0 0.0175"'))
provokes("link-length")(wrong_urdf("wrist_1_joint", "-0.57155 0 0.17415", "-0.57727 0 0.17589"))
provokes("joint-order")(wrong_joints(Fault(kind="order")))
provokes("joints-degrees")(wrong_joints(Fault(kind="degrees")))
provokes("poses-inverse")(wrong_poses("inverse"))
provokes("poses-quaternion")(wrong_poses("quaternion"))
provokes("poses-conjugate")(wrong_poses("conjugate"))
provokes("poses-millimetres")(wrong_poses("millimetres"))
provokes("gives")(swinging(Fault(kind="ringing", size=6.0)))
provokes("base-moves")(swinging(Fault(kind="base", size=0.2)))


@provokes("publishers")
def _(scene: Scene) -> Seen:
    position = robot_of(noisy(ARM)).position.copy()
    position[np.random.default_rng(1).random(len(position)) < 0.5, 0] += 0.2
    return scene.run_arm(with_robot(noisy(ARM), position=position))


@provokes("urdf-in-millimetres")
def _(scene: Scene) -> Seen:
    def thousandfold(found: re.Match[str]) -> str:
        return 'origin xyz="' + " ".join(f"{1e3 * float(x):g}" for x in found[1].split()) + '"'

    scene.urdf(lambda text: re.sub(r'origin xyz="([^"]*)"', thousandfold, text))
    return scene.run_arm(noisy(ARM))


@provokes("inverted-mount")
def _(scene: Scene) -> Seen:
    right = 'xyz="-0.02 0.102 0.003"'
    scene.urdf(lambda text: joint(text, "imu_joint", right, 'xyz="-0.1 0.0225 0"'))
    return scene.run_arm(noisy(ARM))


@provokes("leaps")
def _(scene: Scene) -> Seen:
    position = robot_of(noisy(ARM)).position.copy()
    position[200::400, 2] += 0.2
    return scene.run_arm(with_robot(noisy(ARM), position=position))


@provokes("robot-stands-still")
def _(scene: Scene) -> Seen:
    return scene.run_arm(_silent(15.0, 17.5))


@provokes("robot-stands-still-most")
def _(scene: Scene) -> Seen:
    return scene.run_arm(_silent(10.0, 24.1))


def _silent(start: float, stop: float) -> Recording:
    position = robot_of(noisy(ARM)).position.copy()
    position[row(start) : row(stop)] = position[row(start)]
    return with_robot(noisy(ARM), position=position)


@provokes("mount-moved")
def _(scene: Scene) -> Seen:
    imu = noisy(ARM).imu
    gyro, accel = imu.gyro.copy(), imu.accel.copy()
    R = matrix_from_rotvec(np.radians([0.0, 0.0, 1.0]))
    after = slice(row(12.0), None)
    gyro[after], accel[after] = gyro[after] @ R, accel[after] @ R
    return scene.run_arm(with_imu(noisy(ARM), gyro=gyro, accel=accel))


def loose(angle: float) -> Callable[[Scene], Seen]:
    """A link that sways in its bearing by rad, unseen by the encoder."""

    def provocation(scene: Scene) -> Seen:
        position = robot_of(noisy(ARM)).position.copy()
        position[:, 4] += angle * np.sin(2.0 * np.pi * robot_of(noisy(ARM)).t / 0.7)
        return scene.run_arm(with_robot(noisy(ARM), position=position))

    return provocation


provokes("model-not-noise")(loose(0.001))
provokes("not-what-taken-for")(loose(0.01))


@provokes("other-motion")
def _(scene: Scene) -> Seen:
    """Joint states of another robot."""
    t = robot_of(noisy(ARM)).t[:, None]
    position = np.sin(t * (0.7, 0.9, 1.1, 0.8, 1.3, 0.6) + np.arange(6.0))
    return scene.run_arm(with_robot(noisy(ARM), position=position))


@provokes("tilted-base")
def _(scene: Scene) -> Seen:
    scene.urdf(lambda text: joint(text, "shoulder_pan_joint", 'rpy="0 0 0"', 'rpy="1.57 0 0"'))
    return scene.run_arm(noisy(ARM))
