"""The formats of a result: one entry each, from which the command line takes its choices.

What a format needs is imported when it is used, so that ``--help`` can list them at once.
"""

from __future__ import annotations

from shlex import quote
from typing import TYPE_CHECKING, NamedTuple

from imucalib_cli.errors import UntrustedError

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
    words: str = ""
    """What it is, for the help; nothing where the name says it."""


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


def _yaml(results: Sequence[Result]) -> str:
    from imucalib_cli.results.codec import to_yaml

    return to_yaml(results)


def _json(results: Sequence[Result]) -> str:
    from imucalib_cli.results.codec import to_json

    return to_json(results)


def _summary(results: Sequence[Result]) -> str:
    from imucalib_cli.results.summary import summarise

    return "\n".join(summarise(result) for result in results)


def _joint(result: Result) -> str:
    """A <joint>, with its link where the URDF has none."""
    from imucalib_cli.results.urdf_edit import joint_snippet

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


def _each(render: Callable[[Result], str]) -> Callable[[Sequence[Result]], str]:
    return lambda results: "".join(map(render, results))


FORMATS: dict[str, Format] = {
    "yaml": Format(".yaml", False, _yaml),
    "json": Format(".json", False, _json),
    # a <joint> alone is no URDF and its file is not called one
    "urdf": Format(".joint.xml", True, _each(_joint), "a <joint> to paste"),
    "tf": Format(".txt", True, _each(_tf), "named arguments of ROS 2's static_transform_publisher"),
    "summary": Format(".txt", False, _summary, "words"),
}
"""By name."""
