"""Put a calibrated pose into a URDF."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError
from imucalib_cli.jobs.result_files import read_results
from imucalib_cli.results.formats import refuse_untrusted
from imucalib_cli.results.urdf_edit import joint_for, replace_origin
from imucalib_cli.robot.urdf import parse_robot, read_urdf

if TYPE_CHECKING:
    from pathlib import Path


def apply(result: str, urdf: Path, *, force: bool = False) -> bytes:
    """The URDF's bytes with the origin of each result's joint replaced.

    Args:
        result: Path of a result file; ``-`` reads standard input.
        urdf: Path of the URDF; it is not changed.
        force: Use results that should not be trusted.

    Raises:
        InputError: A file cannot be used, or the URDF has no joint for the IMU.
        UntrustedError: A result should not be trusted.
    """
    calibrations = read_results(result)
    content = read_urdf(urdf)
    robot = parse_robot(content, urdf)
    seen: set[str] = set()
    for calibration in calibrations:
        refuse_untrusted(calibration, "URDF", force=force)
        estimate = calibration.estimate
        origin = joint_for(
            robot,
            calibration.parent,
            calibration.child,
            estimate.R_parent_imu,
            estimate.t_parent_imu,
        )
        if origin.joint in seen:
            raise ChoiceError(
                f"{result}: two results are for joint '{origin.joint}': keep one of them"
            )
        seen.add(origin.joint)
        content = replace_origin(content, origin.joint, origin.xyz, origin.rpy)
    return content
