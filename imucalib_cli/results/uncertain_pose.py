"""A pose with what is and is not known of it, and the same pose seen from other frames."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import ChoiceError
from imucalib_cli.robot.mount import rigid_transform
from imucalib_cli.robot.rotations import skew

if TYPE_CHECKING:
    from imucalib_cli.results.calibration import Calibration
    from imucalib_cli.robot.urdf import Robot

Floats = NDArray[np.float64]

_ROUNDING = 1e-6
"""Of a correlation."""


@dataclass(frozen=True, kw_only=True, eq=False)
class UncertainPose:
    """T_parent_child with its covariance, in the tangent of docs/conventions.md."""

    parent: str
    child: str
    R: Floats
    """(3, 3), R_parent_child."""
    t: Floats
    """(3,), m."""
    covariance: Floats | None
    """(6, 6), wide along what is not known; None where nothing is known of the error."""
    unknown_translation: Floats
    """(m, 3), unit vectors of the parent along which the translation was not determined."""
    unknown_rotation: Floats
    """(n, 3), unit vectors of the parent about which the rotation was not determined."""


def is_covariance(matrix: Floats) -> bool:
    """Whether a matrix is symmetric and no combination of components has a negative variance.

    Rounding in the last digits that a file keeps is allowed for.
    """
    scale = np.sqrt(np.abs(np.diag(matrix)))
    scale = np.where(scale > 0.0, scale, 1.0)
    correlation = matrix / np.outer(scale, scale)
    if not np.allclose(correlation, correlation.T, rtol=0.0, atol=_ROUNDING):
        return False
    return bool(np.linalg.eigvalsh(correlation)[0] > -_ROUNDING)


def pose_of(calibration: Calibration) -> UncertainPose:
    """The pose of a result; a covariance with numbers missing counts as none."""
    estimate = calibration.estimate
    covariance = estimate.covariance
    if covariance is not None and not np.isfinite(covariance).all():
        covariance = None
    axes: dict[str, list[Floats]] = {"translation": [], "rotation": []}
    for direction in estimate.unobservable:
        axes[direction.kind].append(direction.direction_parent)
    return UncertainPose(
        parent=calibration.parent,
        child=calibration.child,
        R=estimate.R_parent_imu,
        t=estimate.t_parent_imu,
        covariance=covariance,
        unknown_translation=np.reshape(axes["translation"], (-1, 3)),
        unknown_rotation=np.reshape(axes["rotation"], (-1, 3)),
    )


def seen_from(pose: UncertainPose, parent: str, robot: Robot) -> UncertainPose:
    """Express a pose in another parent, through fixed joints alone.

    Raises:
        ChoiceError: A frame is not in the URDF, or a joint between the parents moves.
    """
    if pose.parent == parent:
        return pose
    R, p = fixed_transform(robot, parent, pose.parent)
    turn = np.kron(np.eye(2), R)
    return replace(
        pose,
        parent=parent,
        R=R @ pose.R,
        t=p + R @ pose.t,
        covariance=None if pose.covariance is None else turn @ pose.covariance @ turn.T,
        unknown_translation=pose.unknown_translation @ R.T,
        unknown_rotation=pose.unknown_rotation @ R.T,
    )


def of_child(pose: UncertainPose, child: str, robot: Robot) -> UncertainPose:
    """The pose of another frame of the same sensor, which hangs on fixed joints below or above it.

    Frames of which neither is below the other are two mounts, and the URDF's opinion of both is
    just what is in question.

    Raises:
        ChoiceError: They are such frames, or a frame is not in the URDF, or a joint between them
            moves.
    """
    if pose.child == child:
        return pose
    R, p = fixed_transform(robot, pose.child, child)
    if len({upwards for _, upwards in robot.route(pose.child, child)}) != 1:
        raise ChoiceError(
            f"'{pose.child}' and '{child}' hang on {robot.source} each by its own joint, so they "
            "are two mounts: compare results of the same IMU"
        )
    lever = pose.R @ p
    J = np.eye(6)
    J[:3, 3:] = -skew(lever)
    return replace(
        pose,
        child=child,
        R=pose.R @ R,
        t=pose.t + lever,
        covariance=None if pose.covariance is None else J @ pose.covariance @ J.T,
    )


def fixed_transform(robot: Robot, a: str, b: str) -> tuple[Floats, Floats]:
    """R_a_b and p_a_b of a URDF where fixed joints alone lie between two links.

    Raises:
        ChoiceError: A link is not there, or a joint between them moves.
    """
    from imucalib_cli.robot.urdf import near_matches

    for link in (a, b):
        if link not in robot.links:
            raise ChoiceError(f"'{link}' is not in {robot.source}{near_matches(link, robot.links)}")
    between = rigid_transform(robot, a, b)
    if between is None:
        moving = next(joint for joint, _ in robot.route(a, b) if joint.kind != "fixed")
        raise ChoiceError(
            f"'{b}' moves relative to '{a}' in {robot.source}: the {moving.kind} joint "
            f"'{moving.name}' is between them"
        )
    return between
