"""Put calibrated poses into a URDF."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.digits import figures
from imucalib_cli.errors import ChoiceError, ImucalibError, UntrustedError
from imucalib_cli.jobs.result_files import display_name, read_result_file, results_of
from imucalib_cli.results.formats import refuse_untrusted
from imucalib_cli.results.kinematics import CLEAR, corrected_origins
from imucalib_cli.results.urdf_edit import (
    JointOrigin,
    MissingJointError,
    insert_last,
    joint_for,
    replace_origin,
)
from imucalib_cli.robot.rotations import matrix_from_rpy, rotation_angle
from imucalib_cli.robot.urdf import load_robot, read_urdf

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from imucalib_cli.robot.urdf import Robot


@dataclass(frozen=True, kw_only=True)
class Applied:
    """A URDF with new origins, and how each result was used."""

    content: bytes | None
    """None where no result could be applied."""
    changes: tuple[str, ...]
    """The changes, one sentence for each joint."""
    failures: tuple[ImucalibError, ...]
    """Findings of results left out, whose joints are unchanged."""
    origins: tuple[JointOrigin, ...] = ()
    """The results that were applied."""
    snippets: tuple[str, ...] = ()
    """Joints that were added."""

    def made(self, path: Path) -> bool:
        """Whether an existing URDF differs only in these origins: then an earlier run wrote it."""
        try:
            return not self.snippets and _with_origins(read_urdf(path), self.origins) == (
                self.content
            )
        except ImucalibError:
            return False


def apply(
    result: str,
    urdf: Path,
    *,
    imus: Sequence[str] = (),
    add: bool = False,
    kinematics: bool = False,
    force: bool = False,
) -> Applied:
    """Replace the origin of each result's joint; every other byte stays.

    Of a xacro file, it is the joint as it stands there that is changed.

    Of several results the usable ones are applied; the others are left out and reported.

    Args:
        result: Path of a result file; ``-`` reads standard input.
        urdf: Path of the URDF; it is not changed.
        imus: Frames or topics of the IMUs to take from the file; empty takes all.
        add: Write the joint and the link of an IMU that the URDF does not have.
        kinematics: Write the errors of the robot that stand clear of zero, too.
        force: Use untrusted results too.

    Raises:
        InputError: A file cannot be used.
        ChoiceError: An IMU is not in the file, or two results are for the same joint.
    """
    results = results_of(read_result_file(result), imus, display_name(result))
    if kinematics and len(results) > 1:
        topics = ", ".join(each.imu_topic for each in results)
        raise ChoiceError(f"--kinematics takes the result of one IMU, by --imu, of: {topics}")
    robot = load_robot(urdf)
    # of xacro the robot is what it expands to
    written = robot.xml if str(urdf) == "-" else read_urdf(urdf)
    snippets: list[str] = []
    origins: dict[str, JointOrigin] = {}
    changes: list[str] = []
    failures: list[ImucalibError] = []
    for each in results:
        try:
            refuse_untrusted(each, "URDF", force=force)
            origin = joint_for(robot, each.parent, each.child, each.pose.R, each.pose.t)
        except MissingJointError as error:
            if not add or each.child in robot.links:
                failures.append(error)
                continue
            robot.require_link(error.parent)
            snippets.append(error.snippet)
            changes.append(f"a joint that holds '{each.child}' on '{each.parent}' was added")
            continue
        except ImucalibError as error:
            failures.append(error)
            continue
        if origin.joint in origins:
            topics = ", ".join(each.imu_topic for each in results)
            raise ChoiceError(
                f"{display_name(result)}: two results are for joint '{origin.joint}': choose one "
                f"with --imu, of: {topics}"
            )
        origins[origin.joint] = origin
        changes.append(_change(robot, origin))
    if kinematics and results and not any(map(_is_refused, failures)):
        corrected = corrected_origins(robot, results[0])
        origins |= {each.joint: each for each in corrected}
        changes += [_change(robot, each) for each in corrected]
        if not corrected:
            changes.append(
                f"nothing of the robot itself: no joint zero or origin stands {CLEAR:g} sigma off"
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


def _with_origins(content: bytes, origins: Iterable[JointOrigin]) -> bytes:
    for origin in origins:
        content = replace_origin(content, origin.joint, origin.xyz, origin.rpy)
    return content


def _is_refused(failure: ImucalibError) -> bool:
    return isinstance(failure, UntrustedError)


def _change(robot: Robot, origin: JointOrigin) -> str:
    joint = robot.joint_by_name[origin.joint]
    shift = float(np.linalg.norm(np.array(origin.xyz) - joint.p_origin))
    turn = float(rotation_angle(joint.R_origin.T @ matrix_from_rpy(origin.rpy)))
    return (
        f"joint '{origin.joint}' ({joint.child} on {joint.parent}): its origin moved by "
        f"{figures(shift * 1e3, 3)} mm and {figures(math.degrees(turn), 3)} deg"
    )
