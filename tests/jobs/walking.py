"""A robot on legs with an IMU on its trunk and one on a shank, and no pose of its base."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin

from tests.jobs.robots import SHAPES, Shape, messages, random_mount
from tests.logs.logs_samples import Said, write_log

TRUNK, LEG = "/imu/trunk", "/imu/leg"
LONG, SHORT = 20.0, 14.0
"""s, of a log."""
ON_TRUNK = pin.SE3(np.eye(3), np.array([0.04, -0.02, 0.06]))
ON_LEG = random_mount(4)
OTHER, ON_OTHER = "/imu/other", random_mount(5)
ROBOT = replace(
    SHAPES["quadruped"],
    joints=(
        *SHAPES["quadruped"].joints,
        ("trunk_imu_joint", "fixed", "trunk", "trunk_imu", "0.04 -0.02 0.06", ""),
        ("leg_imu_joint", "fixed", "FL_calf_link", "leg_imu", "0 0 -0.1", ""),
    ),
)


def of_imu(
    shape: Shape, topic: str, frame: str, mount: pin.SE3, seconds: float = SHORT
) -> list[Said]:
    """The messages of the robot's log with an IMU there, and no pose of the base."""
    said = messages(shape, mount=mount, imu_frame=frame, seconds=seconds, seed=2)
    named = {"/imu": topic}
    return [replace(each, topic=named.get(each.topic, each.topic)) for each in said]


@cache
def walk(seconds: float = SHORT) -> tuple[Said, ...]:
    trunk = of_imu(ROBOT, TRUNK, "trunk_imu", ON_TRUNK, seconds)
    leg = of_imu(replace(ROBOT, carrier="FL_calf_link"), LEG, "leg_imu", ON_LEG, seconds)
    only = [each for each in leg if each.topic == LEG]
    return tuple(sorted([*trunk, *only], key=lambda each: each.log_ns))


@cache
def walk_on_two_legs(seconds: float = SHORT) -> tuple[Said, ...]:
    """With an IMU on a shank of another leg too."""
    shape = replace(ROBOT, carrier="FR_calf_link")
    said = (*walk(seconds), *of_imu(shape, OTHER, "other_imu", ON_OTHER, seconds))
    once = {(each.topic, each.log_ns): each for each in said}.values()
    return tuple(sorted(once, key=lambda each: each.log_ns))


def log_of(folder: Path, *topics: str, said: tuple[Said, ...] | None = None) -> Path:
    kept = (each for each in said or walk() if each.topic in topics)
    write_log(folder / "log", kept, "mcap2")
    return folder / "log"
