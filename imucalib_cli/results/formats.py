"""One result or several in the format that was asked for."""

from __future__ import annotations

from shlex import quote
from typing import TYPE_CHECKING, NamedTuple

from imucalib_cli.errors import UntrustedError
from imucalib_cli.results.codec import to_json, to_yaml
from imucalib_cli.results.summary import summarise
from imucalib_cli.results.urdf_edit import joint_snippet

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from imucalib_cli.results.result import Result


class Format(NamedTuple):
    """A form in which results are written."""

    suffix: str
    """Of the files that ``-o FOLDER/`` writes."""
    is_bare_pose: bool
    """Whether it cannot say that the pose should not be trusted."""
    render: Callable[[Sequence[Result]], str]
    """Text of one result for each IMU, at least one."""


def refuse_untrusted(result: Result, use: str, *, force: bool) -> None:
    """Raise UntrustedError unless the pose may be used, or the user insists."""
    if result.status == "ok" or force:
        return
    diagnostics = result.diagnostics
    reasons = [
        *(f"{each.kind} not determined" for each in diagnostics.unobservable),
        *diagnostics.distrust,
    ]
    raise UntrustedError(
        f"{result.child} in {result.parent}: result is untrusted "
        f"({'; '.join(dict.fromkeys(reasons))}), so no {use}; --force gives it all the same"
    )


def _joint(result: Result) -> str:
    """A <joint>, with its link where the URDF has none."""
    pose, nominal = result.pose, result.diagnostics.nominal
    joint = "" if nominal is None else nominal.joint
    xyz, rpy = pose.translation, pose.rotation_rpy
    return joint_snippet(result.parent, result.child, xyz, rpy, joint=joint)


def _tf(result: Result) -> str:
    """The named arguments of ROS 2's static_transform_publisher, one line."""
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    values = (*result.pose.translation, *result.pose.rotation_xyzw)
    numbers = " ".join(f"--{n} {v + 0.0:.12g}" for n, v in zip(names, values, strict=True))
    # the line is pasted into a shell
    parent, child = quote(result.parent), quote(result.child)
    return f"{numbers} --frame-id {parent} --child-frame-id {child}\n"


def _each(render: Callable[[Result], str], between: str = "") -> Callable[[Sequence[Result]], str]:
    return lambda results: between.join(map(render, results))


FORMATS: dict[str, Format] = {
    "yaml": Format(".yaml", False, to_yaml),
    "json": Format(".json", False, to_json),
    "summary": Format(".txt", False, _each(summarise, "\n")),
    # a <joint> alone is no URDF and its file is not called one
    "urdf": Format(".joint.xml", True, _each(_joint)),
    "tf": Format(".txt", True, _each(_tf)),
}
"""By name."""
