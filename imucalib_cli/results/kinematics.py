"""New origins of a URDF's joints from the errors of the robot's geometry in a result."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import UNSET

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.estimate.entries import CLEAR_SIGMAS
from imucalib_cli.results.urdf_edit import joint_origin
from imucalib_cli.robot.rotations import matrix_from_rotvec

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.estimate.entries import ParameterEntry
    from imucalib_cli.results.result import Result
    from imucalib_cli.results.urdf_edit import JointOrigin
    from imucalib_cli.robot.urdf import Joint, Robot

_ROUNDING: Final = 1e-9
"""m and rad: rounding between the values of one solution for several IMUs."""
ZERO: Final = "joint_zero"
ORIGIN: Final = "origin"
AXIS: Final = "joint_axis"
KINDS: Final = (ORIGIN, AXIS, ZERO)
"""Errors of a joint's place in its parent link, by their names in the table of unknowns."""


def joint_of(entry: ParameterEntry) -> str:
    """The joint whose zero, origin or axis an entry is about."""
    return entry.label if entry.name == ZERO else entry.label.rpartition(" ")[0]


def sigmas(entry: ParameterEntry) -> float:
    """Distance of an entry from its nominal value, zero, in sigmas."""
    if entry.value is None or not entry.std:
        return 0.0
    return abs(entry.value) / entry.std


def corrected_origins(robot: Robot, results: Sequence[Result]) -> tuple[JointOrigin, ...]:
    """New origins of the joints whose errors, by results of one or several IMUs, are significant.

    The error of a joint's zero becomes a rotation of its origin about its axis, so that the
    positions that the robot reports do not change. That of its axis is a rotation of its origin.

    Raises:
        ChoiceError: A result is of another URDF, or results disagree on a joint that carries their
            IMUs.
        InputError: An error cannot be written into this URDF.
    """
    by_result = [_corrections(robot, each) for each in results]
    found = {joint: origin for own in by_result for joint, origin in own.items()}
    for joint, origin in found.items():
        carried = [
            (each.imu_topic, own.get(joint))
            for each, own in zip(results, by_result, strict=True)
            if joint in _chain(robot, each)
        ]
        numbers = origin.xyz + origin.rpy
        if not all(
            other and np.allclose(numbers, other.xyz + other.rpy, rtol=0.0, atol=_ROUNDING)
            for _, other in carried
        ):
            topics = ", ".join(topic for topic, _ in carried)
            raise ChoiceError(
                f"--kinematics: joint '{joint}' carries several IMUs, and their results do not "
                f"agree on it: choose one with --imu, of: {topics}"
            )
    return tuple(found.values())


def _chain(robot: Robot, result: Result) -> dict[str, Joint]:
    return {joint.name: joint for joint, _ in robot.route(robot.root, result.parent)}


def _corrections(robot: Robot, result: Result) -> dict[str, JointOrigin]:
    by_joint: dict[str, list[ParameterEntry]] = {}
    for entry in result.diagnostics.parameters:
        if entry.name in KINDS and sigmas(entry) >= CLEAR_SIGMAS:
            by_joint.setdefault(joint_of(entry), []).append(entry)
    if not by_joint:
        return {}
    source = result.provenance.urdf
    if source is None or source.sha256 != robot.sha256:
        of = "none" if source is None else f"{source.path} at the time of the run"
        raise ChoiceError(
            f"{robot.source} is not the URDF of the result ({of}): the errors that were "
            "found belong to its origins; run again with this URDF"
        )
    chain = _chain(robot, result)
    followed = {joint.mimic.joint for joint in robot.joints if joint.mimic is not None}
    found = {}
    for name, errors in by_joint.items():
        if any(each.name != ZERO and each.axis is UNSET for each in errors):
            raise InputError(
                f"the result does not give the direction of '{errors[0].label}', because an "
                "earlier version wrote it: run again"
            )
        if name not in chain:
            raise InputError(
                f"{robot.source}: an error of '{errors[0].label}' was found, which is not a joint "
                f"between '{robot.root}' and '{result.parent}': write it by hand"
            )
        if name in followed and any(each.name == ZERO for each in errors):
            raise InputError(
                f"{robot.source}: the zero of joint '{name}' has an error, and other joints follow "
                "it (mimic): write it by hand, into the joint or into those that follow"
            )
        found[name] = _corrected(chain[name], errors)
    return found


def _corrected(joint: Joint, errors: Sequence[ParameterEntry]) -> JointOrigin:
    by_kind = {kind: np.zeros(3) for kind in KINDS}
    for entry in errors:
        axis = joint.axis if entry.axis is UNSET else np.array(entry.axis)
        by_kind[entry.name] = by_kind[entry.name] + (entry.value or 0.0) * axis
    # As the model has it: the axis is turned first, and the zero is a turn about the turned one.
    R = joint.R_origin @ matrix_from_rotvec(by_kind[AXIS]) @ matrix_from_rotvec(by_kind[ZERO])
    return joint_origin(joint.name, R, joint.p_origin + joint.R_origin @ by_kind[ORIGIN])
