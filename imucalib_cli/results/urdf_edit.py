"""Put a pose into a URDF without touching any other byte of it.

Expat tells at which byte the joint's elements begin; only that start tag is taken apart, so
comments, CDATA, and joints of transmissions or controllers are never mistaken for the joint.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from imucalib_cli.errors import InputError
from imucalib_cli.results.names import numbered
from imucalib_cli.robot.mount import rigid_transform
from imucalib_cli.robot.rotations import rpy_from_matrix

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Floats
    from imucalib_cli.robot.urdf import Robot

_DECIMALS = 13
"""Digits after the point of metres and radians: round-trips to 1e-13, hides rounding noise."""
_SPACE = r"[ \t\r\n]"
_ATTRIBUTE = rf"{_SPACE}+(?P<name>[^ \t\r\n=/>]+){_SPACE}*={_SPACE}*(?P<value>\"[^\"]*\"|'[^']*')"
_START_TAG = re.compile(
    r"<[^ \t\r\n/>]+(?:" + re.sub(r"\?P<\w+>", "?:", _ATTRIBUTE) + rf")*{_SPACE}*/?>"
)


class MissingJointError(InputError):
    """The URDF has no joint to put the pose into; carries the snippet to add."""

    def __init__(self, message: str, snippet: str, *, parent: str) -> None:
        self.snippet = snippet
        self.parent = parent
        super().__init__(message)


@dataclass(frozen=True, kw_only=True)
class JointOrigin:
    """A joint's name and its new origin."""

    joint: str
    xyz: tuple[float, float, float]
    """m, in the joint's parent link."""
    rpy: tuple[float, float, float]
    """rad, URDF convention: Rz(yaw) Ry(pitch) Rx(roll)."""


def joint_for(
    robot: Robot,
    parent: str,
    child: str,
    R_parent_imu: Floats,
    t_parent_imu: Floats,
) -> JointOrigin:
    """Find the fixed joint that holds ``child`` and what its origin becomes: (3, 3) and (3,), m.

    Where the joint has another parent than the result, the pose is re-expressed in it through
    the fixed joints between the two. Raises MissingJointError where no fixed joint holds ``child``;
    InputError where its joint's parent moves relative to the result's, or that is not there.
    """
    joint = robot.joint_above.get(child)
    if joint is None or joint.kind != "fixed":
        said = "is the root" if child == robot.root else "is not there"
        if joint is not None:
            said = f"hangs on the {joint.kind} joint '{joint.name}'"
        name = child if child not in robot.links else f"{child}_imu"
        raise MissingJointError(
            f"{robot.source}: no fixed joint holds '{child}' (it {said}): add one (--add), or, if "
            "the IMU's frame has another name there, run again with --imu-link",
            joint_snippet(
                parent,
                name,
                _triple(t_parent_imu),
                _triple(rpy_from_matrix(R_parent_imu)),
                taken=[each.name for each in robot.joints],
            ),
            parent=parent,
        )
    robot.require_link(parent)
    between = rigid_transform(robot, joint.parent, parent)
    if between is None:
        raise InputError(
            f"{robot.source}: joint '{joint.name}' holds '{child}' on '{joint.parent}', which "
            f"moves relative to the result's parent '{parent}': run again with "
            f"--parent {joint.parent}"
        )
    R_joint_parent, p_joint_parent = between
    return joint_origin(
        joint.name,
        R_joint_parent @ R_parent_imu,
        p_joint_parent + R_joint_parent @ t_parent_imu,
    )


def joint_origin(joint: str, R: Floats, p: Floats) -> JointOrigin:
    """The origin of a joint: R (3, 3) and p (3,), m, in its parent link."""
    return JointOrigin(joint=joint, xyz=_triple(p), rpy=_triple(rpy_from_matrix(R)))


def replace_origin(urdf: bytes, joint: str, xyz: Sequence[float], rpy: Sequence[float]) -> bytes:
    """Set one joint's origin (xyz m, rpy rad) and leave every other byte as it was.

    The file may have any encoding that expat reads, the joint is a child of <robot>. A missing
    <origin> is put before the joint's first element, indented as that one is. Raises InputError
    where there is not exactly one such joint, or the XML is not sound.
    """
    elements = _elements(urdf, joint)
    if not elements:
        raise InputError(f"joint '{joint}' of the URDF is empty: give it a <parent> and a <child>")
    codec = _codec(urdf)
    values = {"xyz": _words(xyz), "rpy": _words(rpy)}
    start = next((at for tag, at in elements if tag == "origin"), None)
    if start is None:
        start = elements[0][1]
        before = urdf[:start].decode(codec, "surrogatepass")
        indent = before[len(before.rstrip(" \t\r\n")) :]
        tag, changed = "", f'<origin xyz="{values["xyz"]}" rpy="{values["rpy"]}"/>{indent}'
    else:
        tag = _start_tag(urdf[start:].decode(codec, "surrogatepass"))
        if "$" in tag:
            raise InputError(
                f"the origin of joint '{joint}' is computed by xacro ({tag}): put the numbers of "
                "`imucalib run --format xacro` where it takes its own from"
            )
        changed = _with_attributes(tag, values)
    rest = start + len(tag.encode(codec, "surrogatepass"))
    return urdf[:start] + changed.encode(codec, "surrogatepass") + urdf[rest:]


def insert_last(urdf: bytes, elements: str) -> bytes:
    """Put lines of XML behind all other elements of <robot>, indented by two blanks.

    Raises InputError where the XML is not sound, or <robot> has no end tag of its own.
    """
    at, depth = 0, 0
    parser = expat.ParserCreate()

    def start(*_: object) -> None:
        nonlocal depth
        depth += 1

    def end(_: str) -> None:
        nonlocal at, depth
        depth -= 1
        at = parser.CurrentByteIndex

    parser.StartElementHandler, parser.EndElementHandler = start, end
    _parse(parser, urdf)
    codec = _codec(urdf)
    if not urdf[at:].decode(codec, "surrogatepass").startswith("</"):
        raise InputError("the URDF's <robot> has no end tag: write </robot>")
    text = "".join(f"  {line}\n" for line in elements.splitlines())
    plain = text.encode("ascii", "xmlcharrefreplace").decode("ascii")  # whatever the encoding
    return urdf[:at] + plain.encode(codec) + urdf[at:]


def joint_snippet(
    parent: str,
    child: str,
    xyz: Sequence[float],
    rpy: Sequence[float],
    *,
    joint: str = "",
    taken: Sequence[str] = (),
) -> str:
    """A fixed joint (xyz m, rpy rad), ready to paste into a URDF.

    Without a name it gets one that is not taken, and a new link.
    """
    link = "" if joint else f"<link name={quoteattr(child)}/>\n"
    name = joint or next(each for each in numbered(f"{child}_joint", "") if each not in taken)
    return (
        f'{link}<joint name={quoteattr(name)} type="fixed">\n'
        f"  <parent link={quoteattr(parent)}/>\n"
        f"  <child link={quoteattr(child)}/>\n"
        f'  <origin xyz="{_words(xyz)}" rpy="{_words(rpy)}"/>\n'
        "</joint>\n"
    )


def _elements(urdf: bytes, joint: str) -> list[tuple[str, int]]:
    """Tags and byte offsets of the elements of a joint that is a child of <robot>."""
    joints: list[list[tuple[str, int]]] = []
    path: list[str | None] = []  # None is the joint
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        is_joint = path == ["robot"] and tag == "joint" and attributes.get("name") == joint
        if is_joint:
            joints.append([])
        elif len(path) == 2 and path[1] is None:
            joints[-1].append((tag, parser.CurrentByteIndex))
        path.append(None if is_joint else tag)

    def doctype(*_: object) -> None:
        raise InputError("the URDF has a DOCTYPE, whose entities could hide the joint: remove it")

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: path.pop()
    parser.StartDoctypeDeclHandler = doctype
    _parse(parser, urdf)
    if not joints and b"xacro:" in urdf:
        raise InputError(
            f"joint '{joint}' is made by a macro of xacro: apply to the expanded URDF, or give the "
            "macro its numbers (`imucalib run --format xacro`)"
        )
    if len(joints) != 1:
        raise InputError(f"the URDF has {len(joints)} joints '{joint}', it must have one")
    origins = sum(tag == "origin" for tag, _ in joints[0])
    if origins > 1:
        raise InputError(f"the URDF has {origins} origins in joint '{joint}', it must have one")
    return joints[0]


def _parse(parser: expat.XMLParserType, urdf: bytes) -> None:
    try:
        parser.Parse(urdf, True)
    except expat.ExpatError as error:
        raise InputError(f"the URDF is not well-formed XML ({error}): repair it") from None
    except (ValueError, LookupError) as error:
        raise InputError(f"the URDF's encoding cannot be read ({error})") from None


def _codec(urdf: bytes) -> str:
    """A codec that maps every byte of the file to text and back.

    In all encodings of expat but UTF-16 the characters of markup are their ASCII bytes.
    """
    if urdf[:2] in (b"\xff\xfe", b"<\x00"):
        return "utf-16-le"
    if urdf[:2] in (b"\xfe\xff", b"\x00<"):
        return "utf-16-be"
    return "latin-1"


def _start_tag(text: str) -> str:
    match = _START_TAG.match(text)
    if match is None:  # expat has read it, so this is a form of XML we do not know
        raise InputError("the joint's <origin> cannot be taken apart: write it in one plain tag")
    return match.group()


def _with_attributes(tag: str, values: dict[str, str]) -> str:
    """The start tag with these attributes' values, each in the quotes it had."""
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


def _triple(values: Sequence[float] | Floats) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _words(values: Sequence[float]) -> str:
    return " ".join(
        repr(round(float(value), _DECIMALS) + 0.0).removesuffix(".0") for value in values
    )
