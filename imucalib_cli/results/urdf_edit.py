"""Write a pose into a URDF without changing any other byte.

The reader of URDFs says at which byte each element begins, and only the start tag of the origin is
parsed here. So comments, CDATA, and joints of transmissions or controllers are never taken for the
joint.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

from msgspec import Struct

from imucalib_cli.errors import InputError
from imucalib_cli.results.names import numbered
from imucalib_cli.robot.mount import rigid_transform
from imucalib_cli.robot.rotations import rpy_from_matrix
from imucalib_cli.robot.urdf_xml import read_elements

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Floats
    from imucalib_cli.robot.urdf import Robot
    from imucalib_cli.robot.urdf_xml import Element

_DECIMALS = 13
"""Decimal places of metres and radians: exact to 1e-13, and no rounding noise is shown."""
_SOURCE = "the URDF"
_SPACE = r"[ \t\r\n]"
_ATTRIBUTE = rf"{_SPACE}+(?P<name>[^ \t\r\n=/>]+){_SPACE}*={_SPACE}*(?P<value>\"[^\"]*\"|'[^']*')"
_START_TAG = re.compile(
    r"<[^ \t\r\n/>]+(?:" + re.sub(r"\?P<\w+>", "?:", _ATTRIBUTE) + rf")*{_SPACE}*/?>"
)


class MissingJointError(InputError):
    """The URDF has no joint to put the pose into; carries the snippet to add."""

    def __init__(self, message: str, snippet: str) -> None:
        self.snippet = snippet
        super().__init__(message)


class JointOrigin(Struct, frozen=True, kw_only=True):
    """A joint's name and its new origin."""

    joint: str
    xyz: tuple[float, ...]
    """m, in the joint's parent link."""
    rpy: tuple[float, ...]
    """rad, URDF convention: Rz(yaw) Ry(pitch) Rx(roll)."""


def joint_for(
    robot: Robot, parent: str, child: str, R_parent_imu: Floats, t_parent_imu: Floats
) -> JointOrigin:
    """Find the fixed joint that holds ``child``, and its new origin from R (3, 3) and t (3,), m.

    Where the joint has another parent than the result, the pose is expressed in that parent through
    the fixed joints between the two.

    Raises:
        MissingJointError: No fixed joint holds ``child``.
        InputError: ``parent`` is not there, or moves relative to the joint's parent.
    """
    joint = robot.joint_above.get(child)
    if joint is None or joint.kind != "fixed":
        said = "is the root" if child == robot.root else "is not there"
        if joint is not None:
            said = f"hangs on the {joint.kind} joint '{joint.name}'"
        name = child if child not in robot.links else f"{child}_imu"
        taken = [each.name for each in robot.joints]
        rpy = rpy_from_matrix(R_parent_imu)
        raise MissingJointError(
            f"{robot.source}: no fixed joint holds '{child}' (it {said}): add one (--add), or, if "
            "the IMU's frame has another name there, run again with --imu-link",
            joint_snippet(parent, name, t_parent_imu, rpy, taken=taken),
        )
    robot.require_link(parent)
    between = rigid_transform(robot, joint.parent, parent)
    if between is None:
        raise InputError(
            f"{robot.source}: joint '{joint.name}' holds '{child}' on '{joint.parent}', which "
            f"moves relative to the result's parent '{parent}': run again with "
            f"--parent {joint.parent}"
        )
    R, p = between
    return joint_origin(joint.name, R @ R_parent_imu, p + R @ t_parent_imu)


def joint_origin(joint: str, R: Floats, p: Floats) -> JointOrigin:
    """The origin of a joint: R (3, 3) and p (3,), m, in its parent link."""
    return JointOrigin(joint=joint, xyz=tuple(p.tolist()), rpy=tuple(rpy_from_matrix(R).tolist()))


def replace_origin(urdf: bytes, joint: str, xyz: Sequence[float], rpy: Sequence[float]) -> bytes:
    """Set one joint's origin (xyz m, rpy rad) and keep every other byte.

    The file may have any encoding that expat reads; the joint is a child of <robot>. A missing
    <origin> is written before the joint's first element, with the same indentation. Raises
    InputError where there is not exactly one such joint, or the XML is not well-formed.
    """
    elements = _joint_of(urdf, joint).children
    if not elements:
        raise InputError(f"joint '{joint}' of the URDF is empty: give it a <parent> and a <child>")
    codec = _codec(urdf)
    values = {"xyz": _words(xyz), "rpy": _words(rpy)}
    start = next((each.start for each in elements if each.tag == "origin"), None)
    if start is None:
        start = elements[0].start
        before = urdf[:start].decode(codec, "surrogatepass")
        indent = before[len(before.rstrip(" \t\r\n")) :]
        tag, changed = "", f'<origin xyz="{values["xyz"]}" rpy="{values["rpy"]}"/>{indent}'
    else:
        found = _START_TAG.match(urdf[start:].decode(codec, "surrogatepass"))
        if found is None:  # expat has read it, so this is XML of a form unknown here
            raise InputError("the joint's <origin> cannot be parsed: write it in one plain tag")
        tag = found.group()
        if "$" in tag:
            raise InputError(
                f"the origin of joint '{joint}' is computed by xacro ({tag}): write the numbers of "
                "`imucalib run --format xacro` where xacro takes its numbers from"
            )
        changed = _with_attributes(tag, values)
    rest = start + len(tag.encode(codec, "surrogatepass"))
    return urdf[:start] + changed.encode(codec, "surrogatepass") + urdf[rest:]


def insert_last(urdf: bytes, elements: str) -> bytes:
    """Add lines of XML after all other elements of <robot>, indented by two blanks.

    Raises InputError where the XML is not well-formed, or <robot> has no end tag of its own.
    """
    at = read_elements(urdf, _SOURCE, expanded=False).end
    codec = _codec(urdf)
    if not urdf[at:].decode(codec, "surrogatepass").startswith("</"):
        raise InputError("the URDF's <robot> has no end tag: write </robot>")
    text = "".join(f"  {line}\n" for line in elements.splitlines())
    plain = text.encode("ascii", "xmlcharrefreplace").decode("ascii")  # whatever the encoding
    return urdf[:at] + plain.encode(codec) + urdf[at:]


def joint_snippet(
    parent: str,
    child: str,
    xyz: Sequence[float] | Floats,
    rpy: Sequence[float] | Floats,
    *,
    joint: str = "",
    taken: Sequence[str] = (),
) -> str:
    """A fixed joint (xyz m, rpy rad), ready to paste into a URDF.

    Without a name it gets a new link, and a name that is not ``taken``.

    Raises:
        InputError: A name is an expression of xacro, which would evaluate it.
    """
    for each in (parent, child, joint):
        if "${" in each or "$(" in each:
            raise InputError(
                f"'{each}' is no name for a URDF: xacro would evaluate it; correct the driver's "
                "frame_id, or name the IMU's frame with --imu-link"
            )
    link = "" if joint else f"<link name={quoteattr(child)}/>\n"
    name = joint or next(each for each in numbered(f"{child}_joint", "") if each not in taken)
    return (
        f'{link}<joint name={quoteattr(name)} type="fixed">\n'
        f"  <parent link={quoteattr(parent)}/>\n"
        f"  <child link={quoteattr(child)}/>\n"
        f'  <origin xyz="{_words(xyz)}" rpy="{_words(rpy)}"/>\n'
        "</joint>\n"
    )


def _joint_of(urdf: bytes, name: str) -> Element:
    """The only joint with this name that is a child of <robot>."""
    root = read_elements(urdf, _SOURCE, expanded=False)
    joints = [
        each
        for each in (root.children if root.tag == "robot" else ())
        if each.tag == "joint" and each.attributes.get("name") == name
    ]
    if not joints and b"xacro:" in urdf:
        raise InputError(
            f"joint '{name}' is made by a macro of xacro: apply to the expanded URDF, or give the "
            "macro its numbers (`imucalib run --format xacro`)"
        )
    if len(joints) != 1:
        raise InputError(f"the URDF has {len(joints)} joints '{name}', it must have one")
    origins = sum(each.tag == "origin" for each in joints[0].children)
    if origins > 1:
        raise InputError(f"the URDF has {origins} origins in joint '{name}', it must have one")
    return joints[0]


def _codec(urdf: bytes) -> str:
    """A codec that maps every byte of the file to text and back.

    In all encodings that expat reads, but for UTF-16, characters of markup are ASCII bytes.
    """
    if urdf[:2] in (b"\xff\xfe", b"<\x00"):
        return "utf-16-le"
    if urdf[:2] in (b"\xfe\xff", b"\x00<"):
        return "utf-16-be"
    return "latin-1"


def _with_attributes(tag: str, values: dict[str, str]) -> str:
    """The start tag with new values of these attributes, each in its old quotes."""
    missing = dict(values)
    quote, end = '"', len(tag.rstrip("/>").rstrip())

    def replaced(match: re.Match[str]) -> str:
        nonlocal quote
        quote = match["value"][0]
        if match["name"] not in missing:
            return match[0]
        before = match[0].removesuffix(match["value"])
        return f"{before}{quote}{missing.pop(match['name'])}{quote}"

    attributes = re.sub(_ATTRIBUTE, replaced, tag[:end])
    added = "".join(f" {name}={quote}{value}{quote}" for name, value in missing.items())
    return attributes + added + tag[end:]


def _words(values: Sequence[float] | Floats) -> str:
    return " ".join(
        repr(round(float(value), _DECIMALS) + 0.0).removesuffix(".0") for value in values
    )
