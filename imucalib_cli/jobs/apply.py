"""Put calibrated poses into a URDF."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct

from imucalib_cli.errors import ChoiceError, ImucalibError
from imucalib_cli.estimate.entries import CLEAR_SIGMAS
from imucalib_cli.jobs.result_files import read_result_files, results_of
from imucalib_cli.results.fields import mm_and_deg
from imucalib_cli.results.formats import refuse_untrusted
from imucalib_cli.results.kinematics import corrected_origins
from imucalib_cli.results.pose import pose_error
from imucalib_cli.results.urdf_edit import (
    JointOrigin,
    MissingJointError,
    insert_last,
    joint_for,
    replace_origin,
)
from imucalib_cli.robot.rotations import matrix_from_rpy
from imucalib_cli.robot.urdf import load_robot, read_urdf

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from imucalib_cli.results.result import Result
    from imucalib_cli.robot.urdf import Robot


class Applied(Struct, frozen=True, kw_only=True):
    """A URDF with new origins, and how each result was used."""

    content: bytes | None
    """None if no result could be applied."""
    changes: tuple[str, ...]
    """The changes, one sentence for each joint."""
    failures: tuple[ImucalibError, ...]
    """Why results were left out; their joints are unchanged."""
    origins: tuple[JointOrigin, ...] = ()
    """The results that were applied."""
    snippets: tuple[str, ...] = ()
    """Joints that were added."""

    def made(self, path: Path) -> bool:
        """Whether a URDF differs only in these origins, so that an earlier run wrote it."""
        try:
            return not self.snippets and _with_origins(read_urdf(path), self.origins) == (
                self.content
            )
        except ImucalibError:
            return False


def apply(
    names: Sequence[str],
    urdf: Path,
    *,
    imus: Sequence[str] = (),
    add: bool = False,
    kinematics: bool = False,
    force: bool = False,
) -> Applied:
    """Replace the origin of each result's joint; every other byte stays.

    In a xacro file the joint is changed as it is written there. Results that cannot be used are
    left out and reported. The options are those of ``imucalib apply``; no file is written.

    Raises:
        InputError: A file cannot be used.
        ChoiceError: An IMU is in no file, two results are for the same joint, or two results
            correct a joint of the robot differently.
    """
    found, failures = read_result_files(names)
    robot = load_robot(urdf)
    # robot.xml of a xacro file is its expansion, not the file
    written = robot.xml if str(urdf) == "-" else read_urdf(urdf)
    snippets: list[str] = []
    origins: dict[str, JointOrigin] = {}
    changes: list[str] = []
    held: dict[str, tuple[str, Result]] = {}
    used: list[Result] = []
    for file, each in results_of(found, imus if found else ()):
        try:
            refuse_untrusted(each, "URDF", force=force)
            robot.require_link(each.parent)
            used.append(each)
            origin = joint_for(robot, each.parent, each.child, each.pose.R, each.pose.t)
            joint, change = origin.joint, _change(robot, origin)
            origins[joint] = origin
        except MissingJointError as error:
            if not add or each.child in robot.links:
                failures.append(error)
                continue
            joint = each.child
            change = f"a joint that holds '{each.child}' on '{each.parent}' was added"
            snippets.append(error.snippet)
        except ImucalibError as error:
            failures.append(error)
            continue
        if joint in held:
            raise _two_for_one(joint, held[joint], (file, each))
        held[joint] = (file, each)
        changes.append(change)
    if kinematics and used:
        corrected = corrected_origins(robot, used)
        origins |= {each.joint: each for each in corrected}
        changes += [_change(robot, each) for each in corrected]
        if not corrected:
            changes.append(
                "no correction of the robot: no joint zero, origin or axis is "
                f"{CLEAR_SIGMAS:g} sigma off"
            )
    content = _with_origins(written, origins.values())
    if snippets:
        content = insert_last(content, "".join(snippets))
    return Applied(
        content=content if origins or snippets else None,
        changes=tuple(changes),
        failures=tuple(failures),
        origins=tuple(origins.values()),
        snippets=tuple(snippets),
    )


def _two_for_one(joint: str, *two: tuple[str, Result]) -> ChoiceError:
    files = ", ".join(dict.fromkeys(file for file, _ in two))
    topics = dict.fromkeys(each.imu_topic for _, each in two)
    remedy = f"choose one with --imu, of: {', '.join(topics)}"
    if len(topics) == 1:
        remedy = "give one of them"
    return ChoiceError(f"{files}: two results are for joint '{joint}': {remedy}")


def _with_origins(content: bytes, origins: Iterable[JointOrigin]) -> bytes:
    for origin in origins:
        content = replace_origin(content, origin.joint, origin.xyz, origin.rpy)
    return content


def _change(robot: Robot, origin: JointOrigin) -> str:
    joint, R = robot.joint_by_name[origin.joint], matrix_from_rpy(origin.rpy)
    moved = pose_error(R, np.array(origin.xyz), joint.R_origin, joint.p_origin)
    # rounding of the URDF's numbers is no change
    mm, deg = round(moved.translation * 1e3, 6), round(math.degrees(moved.rotation), 6)
    return (
        f"joint '{origin.joint}' ({joint.child} on {joint.parent}): its origin moved by "
        f"{mm_and_deg(mm, deg, 3)}"
    )
