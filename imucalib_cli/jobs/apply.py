"""Put a calibrated pose into a URDF."""

from __future__ import annotations

import sys
from pathlib import Path

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.results.formats import refuse_untrusted
from imucalib_cli.results.reader import read_calibrations
from imucalib_cli.results.urdf_edit import joint_for, replace_origin
from imucalib_cli.robot.urdf import load_robot


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
    text = _read(result)
    calibrations = read_calibrations(text, "standard input" if result == "-" else result)
    robot = load_robot(urdf)
    content = urdf.read_bytes()
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


def _read(result: str) -> str:
    try:
        if result == "-":
            if sys.stdin is None:
                raise InputError("standard input is closed: name the result's file")
            return sys.stdin.buffer.read().decode("utf-8")
        return Path(result).read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{result}: cannot be read ({error.strerror}): check the path") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{result}: is not text: it should be a result of imucalib run") from error
