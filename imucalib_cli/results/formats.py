"""One result or several in the format that was asked for."""

from __future__ import annotations

from shlex import quote
from typing import TYPE_CHECKING, Literal
from xml.sax.saxutils import quoteattr

from imucalib_cli.errors import UntrustedError
from imucalib_cli.results.codec import to_json, to_yaml
from imucalib_cli.results.summary import summarise
from imucalib_cli.results.urdf_edit import joint_snippet

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.results.result import Result

Format = Literal["yaml", "json", "urdf", "tf", "summary"]
SUFFIXES: dict[Format, str] = {
    "yaml": ".yaml",
    "json": ".json",
    "urdf": ".joint.xml",
    "tf": ".txt",
    "summary": ".txt",
}
"""Of the files that ``-o FOLDER/`` writes; a <joint> alone is no URDF and is not called one."""


def render(results: Sequence[Result], fmt: Format, *, force: bool = False) -> str:
    """Text of the results in a format.

    Args:
        results: One for each IMU, at least one.
        fmt: yaml, json and summary tell the whole result; urdf is a <joint> for each IMU; tf is
            one line for each IMU with the named arguments of ROS 2's static_transform_publisher.
        force: Give a pose as urdf or tf although it should not be trusted.

    Raises:
        UntrustedError: A pose that should not be trusted was asked for as urdf or tf.
    """
    match fmt:
        case "yaml":
            return to_yaml(results)
        case "json":
            return to_json(results)
        case "summary":
            return "\n".join(summarise(result) for result in results)
        case "urdf":
            return "".join(_joint(result, force=force) for result in results)
        case "tf":
            return "".join(_tf(result, force=force) for result in results)


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


def _joint(result: Result, *, force: bool) -> str:
    refuse_untrusted(result, "URDF joint", force=force)
    pose, nominal = result.pose, result.diagnostics.nominal
    snippet = joint_snippet(result.parent, result.child, pose.translation, pose.rotation_rpy)
    if nominal is None or not nominal.joint:
        return snippet
    # the URDF has the link already, and its joint has a name
    _, joint = snippet.split("\n", 1)
    made_up = quoteattr(f"{result.child}_joint")
    return joint.replace(made_up, quoteattr(nominal.joint), 1)


def _tf(result: Result, *, force: bool) -> str:
    refuse_untrusted(result, "tf arguments", force=force)
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    values = (*result.pose.translation, *result.pose.rotation_xyzw)
    numbers = " ".join(f"--{n} {v + 0.0:.12g}" for n, v in zip(names, values, strict=True))
    # the line is pasted into a shell
    parent, child = quote(result.parent), quote(result.child)
    return f"{numbers} --frame-id {parent} --child-frame-id {child}\n"
