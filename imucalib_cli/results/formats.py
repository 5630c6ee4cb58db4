"""The formats of a result, one entry each; the command line takes its choices from them.

Modules that a format needs are imported when it is used, so that ``--help`` is fast.
"""

from __future__ import annotations

from shlex import quote
from typing import TYPE_CHECKING, Any, NamedTuple

from imucalib_cli.errors import UntrustedError
from imucalib_cli.shown import printable

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from imucalib_cli.results.result import Result


class Format(NamedTuple):
    """A format in which results are written."""

    suffix: str
    """Of the files that ``-o FOLDER/`` writes."""
    is_bare_pose: bool
    """Whether it is only a pose, so that it cannot say that the result is untrusted."""
    render: Callable[[Sequence[Result]], str]
    """The text of results of one or several IMUs."""
    words: str = ""
    """Description for the help; empty where the name says it."""
    command: str = ""
    """Command that takes it in a shell."""


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
        f"({'; '.join(dict.fromkeys(reasons))}), so no {use} is written; --force writes it anyway"
    )


def _yaml(results: Sequence[Result]) -> str:
    from imucalib_cli.results.codec import to_yaml

    return to_yaml(results)


def _json(results: Sequence[Result]) -> str:
    from imucalib_cli.results.codec import to_json

    return to_json(results)


def _summary(results: Sequence[Result]) -> str:
    from imucalib_cli.results.fields import summarise

    return "\n".join(summarise(result) for result in results)


def _joint(result: Result) -> str:
    """A <joint>, with its link if the URDF has none."""
    from imucalib_cli.results.urdf_edit import joint_snippet

    pose, nominal = result.pose, result.diagnostics.nominal
    joint = "" if nominal is None else nominal.joint
    xyz, rpy = pose.translation, pose.rotation_rpy
    return joint_snippet(result.parent, result.child, xyz, rpy, joint=joint)


def _tf(result: Result) -> str:
    """The named arguments of ROS 2's static_transform_publisher, one line."""
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    values = (*result.pose.translation, *result.pose.rotation_xyzw)
    numbers = " ".join(f"--{n} {_number(v)}" for n, v in zip(names, values, strict=True))
    # the line is pasted into a shell
    parent, child = quote(printable(result.parent)), quote(printable(result.child))
    return f"{numbers} --frame-id {parent} --child-frame-id {child}\n"


def _tf1(result: Result) -> str:
    """The arguments of ROS 1's static_transform_publisher, one line."""
    numbers = " ".join(map(_number, (*result.pose.translation, *result.pose.rotation_xyzw)))
    return f"{numbers} {quote(printable(result.parent))} {quote(printable(result.child))}\n"


def _launch(result: Result) -> str:
    """A node of ROS 2's XML launch files."""
    from xml.sax.saxutils import quoteattr

    # a launch file would run what a name says in $(command ...)
    arguments = _tf(result).rstrip().replace("\\", "\\\\").replace("$", "\\$")
    node = '<node pkg="tf2_ros" exec="static_transform_publisher"'
    return f"{node} args={quoteattr(arguments)}/>\n"


def _xacro(results: Sequence[Result]) -> str:
    """Two properties of each IMU, to paste."""
    from imucalib_cli.results.names import names_of

    lines = []
    for name, result in zip(names_of(results, r"\W+"), results, strict=True):
        # an identifier of Python, for expressions of xacro
        name = name if name[0].isalpha() else f"imu_{name}"  # noqa: PLW2901
        pose = {"xyz": result.pose.translation, "rpy": result.pose.rotation_rpy}
        lines += [
            f'<xacro:property name="{name}_{what}" value="{" ".join(map(_number, values))}"/>\n'
            for what, values in pose.items()
        ]
    return "".join(lines)


def _matrix(results: Sequence[Result]) -> str:
    """T_parent_imu, four rows of four numbers; of several IMUs, each below its name."""
    lines = []
    for result in results:
        if len(results) > 1:
            lines.append(f"# {printable(result.child)} in {printable(result.parent)}")
        lines += [" ".join(map(_number, row)) for row in _matrix4(result)]
    return "".join(f"{line}\n" for line in lines)


def _kalibr(result: Result) -> str:
    """As in a Kalibr camchain, for a parent that is a camera."""
    offset = result.time_offset
    shift = {} if offset.std is None else {"timeshift_cam_imu": offset.seconds}
    return _commented(
        result, "T_cam_imu, the camera being", {"T_cam_imu": _matrix4(result)} | shift
    )


def _fast_lio(result: Result) -> str:
    """As in FAST-LIO's configurations, for a parent that is a LiDAR: its pose in the IMU."""
    R, t = result.pose.R.T, -result.pose.R.T @ result.pose.t
    tree = {"extrinsic_T": t, "extrinsic_R": R.ravel()}
    return _commented(result, "pose of the LiDAR in the IMU, the LiDAR being", tree)


def _commented(result: Result, words: str, tree: dict[str, Any]) -> str:
    """YAML of numbers and lists of numbers, below a comment."""
    import yaml

    text = yaml.safe_dump(
        {name: _rounded(value) for name, value in tree.items()},
        default_flow_style=None,
        sort_keys=False,
        width=1000,
    )
    return f"# {words} {printable(result.parent)}, the IMU {printable(result.child)}\n{text}"


def _rounded(value: Any) -> Any:
    """Plain floats with twelve digits."""
    if isinstance(value, float):  # numpy's too
        return float(_number(value))
    return [_rounded(each) for each in value]


def _matrix4(result: Result) -> list[list[float]]:
    rows = zip(result.pose.R.tolist(), result.pose.translation, strict=True)
    return [*([*row, place] for row, place in rows), [0.0, 0.0, 0.0, 1.0]]


def _number(value: float) -> str:
    return f"{value + 0.0:.12g}"


def _each(render: Callable[[Result], str], between: str = "") -> Callable[[Sequence[Result]], str]:
    return lambda results: between.join(map(render, results))


FORMATS: dict[str, Format] = {
    "yaml": Format(".yaml", False, _yaml),
    "json": Format(".json", False, _json),
    # a <joint> alone is no URDF and its file is not called one
    "urdf": Format(".joint.xml", True, _each(_joint), "a <joint> to paste"),
    "tf": Format(
        ".txt",
        True,
        _each(_tf),
        "named arguments of ROS 2's static_transform_publisher",
        "ros2 run tf2_ros static_transform_publisher ",
    ),
    "tf1": Format(
        ".txt",
        True,
        _each(_tf1),
        "arguments of ROS 1's static_transform_publisher of tf2_ros",
        "rosrun tf2_ros static_transform_publisher ",
    ),
    "launch": Format(".launch.xml", True, _each(_launch), "a <node> of a ROS 2 launch file"),
    "xacro": Format(".xacro", True, _xacro, "xacro properties to paste"),
    "matrix": Format(".txt", True, _matrix, "4x4, T_parent_imu"),
    "kalibr": Format(
        ".kalibr.yaml", True, _each(_kalibr, "---\n"), "for a parent that is a camera"
    ),
    "fast-lio": Format(".yaml", True, _each(_fast_lio, "---\n"), "for a parent that is a LiDAR"),
    "summary": Format(".txt", False, _summary, "plain text"),
}
"""By name."""
