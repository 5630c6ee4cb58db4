"""One result or several in the format that was asked for."""

from __future__ import annotations

from shlex import quote
from typing import TYPE_CHECKING, Literal
from xml.sax.saxutils import quoteattr

from imucalib_cli.errors import UntrustedError
from imucalib_cli.results.document import to_document
from imucalib_cli.results.summary import summarise
from imucalib_cli.results.text import to_json, to_yaml
from imucalib_cli.results.urdf_edit import joint_snippet
from imucalib_cli.robot.rotations import quaternion_from_matrix, rpy_from_matrix

if TYPE_CHECKING:
    from imucalib_cli.results.calibration import Calibration

Format = Literal["yaml", "json", "urdf", "tf", "summary"]
SUFFIXES: dict[Format, str] = {
    "yaml": ".yaml",
    "json": ".json",
    "urdf": ".joint.xml",
    "tf": ".txt",
    "summary": ".txt",
}
"""Of the files that ``-o FOLDER/`` writes; a <joint> alone is no URDF and is not called one."""


def render(calibrations: list[Calibration], fmt: Format, *, force: bool = False) -> str:
    """Text of the results in a format.

    Args:
        calibrations: One for each IMU, at least one.
        fmt: yaml, json and summary tell the whole result; urdf is a <joint> for each IMU; tf is
            one line for each IMU with the named arguments of ROS 2's static_transform_publisher.
        force: Give a pose as urdf or tf although it should not be trusted.

    Raises:
        UntrustedError: A pose that should not be trusted was asked for as urdf or tf.
    """
    match fmt:
        case "yaml":
            return to_yaml([to_document(calibration) for calibration in calibrations])
        case "json":
            return to_json([to_document(calibration) for calibration in calibrations])
        case "summary":
            return "\n".join(summarise(calibration) for calibration in calibrations)
        case "urdf":
            return "".join(_joint(calibration, force=force) for calibration in calibrations)
        case "tf":
            return "".join(_tf(calibration, force=force) for calibration in calibrations)


def refuse_untrusted(calibration: Calibration, use: str, *, force: bool) -> None:
    """Raise UntrustedError unless the pose may be used, or the user insists."""
    if calibration.status == "ok" or force:
        return
    estimate = calibration.estimate
    reasons = [
        *(f"{d.kind} not determined" for d in estimate.unobservable),
        *estimate.distrust,
    ]
    raise UntrustedError(
        f"{calibration.child} in {calibration.parent}: result is untrusted "
        f"({'; '.join(dict.fromkeys(reasons))}), so no {use}; --force gives it all the same"
    )


def _joint(calibration: Calibration, *, force: bool) -> str:
    refuse_untrusted(calibration, "URDF joint", force=force)
    estimate = calibration.estimate
    snippet = joint_snippet(
        calibration.parent,
        calibration.child,
        list(estimate.t_parent_imu),
        list(rpy_from_matrix(estimate.R_parent_imu)),
    )
    if calibration.nominal is None or not calibration.nominal.joint:
        return snippet
    # the URDF has the link already, and its joint has a name
    _, joint = snippet.split("\n", 1)
    made_up = quoteattr(f"{calibration.child}_joint")
    return joint.replace(made_up, quoteattr(calibration.nominal.joint), 1)


def _tf(calibration: Calibration, *, force: bool) -> str:
    refuse_untrusted(calibration, "tf arguments", force=force)
    estimate = calibration.estimate
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    values = (*estimate.t_parent_imu, *quaternion_from_matrix(estimate.R_parent_imu))
    numbers = " ".join(f"--{n} {v + 0.0:.12g}" for n, v in zip(names, values, strict=True))
    # the line is pasted into a shell
    parent, child = quote(calibration.parent), quote(calibration.child)
    return f"{numbers} --frame-id {parent} --child-frame-id {child}\n"
