"""A URDF as a tree of links and joints, without anything that kinematics do not need."""

from __future__ import annotations

import hashlib
import sys
from collections import Counter
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal, cast

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.robot.names import frame_name
from imucalib_cli.robot.packages import packages_near
from imucalib_cli.robot.rotations import matrix_from_rpy
from imucalib_cli.robot.urdf_check import checked_urdf
from imucalib_cli.robot.urdf_xml import SIZE_LIMIT
from imucalib_cli.shown import near_matches

if TYPE_CHECKING:
    from collections.abc import Container
    from pathlib import Path

    from imucalib_cli.arrays import Floats
    from imucalib_cli.robot.urdf_xml import Element

JointKind = Literal["fixed", "revolute", "continuous", "prismatic", "floating", "planar"]


@dataclass(frozen=True, kw_only=True)
class Mimic:
    """Position = multiplier * position of ``joint`` + offset."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Joint:
    """A joint, its origin included: T_parent_child = origin * motion about or along the axis."""

    name: str
    kind: JointKind
    parent: str
    child: str
    R_origin: Floats
    """(3, 3), R_parent_joint."""
    p_origin: Floats
    """(3,), p_parent_joint, m."""
    axis: Floats
    """(3,), unit vector in the joint frame; without meaning for a fixed joint."""
    mimic: Mimic | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Robot:
    """The tree of a URDF's links."""

    name: str
    root: str
    links: tuple[str, ...]
    joints: tuple[Joint, ...]
    sha256: str
    """Of the file's bytes."""
    source: Path | str
    xml: bytes
    """The file's bytes."""

    @cached_property
    def joint_by_name(self) -> dict[str, Joint]:
        """Every joint by its name."""
        return {joint.name: joint for joint in self.joints}

    @cached_property
    def moving_joints(self) -> tuple[str, ...]:
        """Names of the joints that are not fixed."""
        return tuple(joint.name for joint in self.joints if joint.kind != "fixed")

    @cached_property
    def joint_above(self) -> dict[str, Joint]:
        """The joint above each link; the root has none."""
        return {joint.child: joint for joint in self.joints}

    def route(self, start: str, end: str) -> tuple[tuple[Joint, bool], ...]:
        """Joints of any kind between two links, each with whether the path goes up through it.

        Raises:
            InputError: A link is not in the URDF.
        """
        from_start, from_end = self._ancestors(start), self._ancestors(end)
        up = [link for link in from_start if link not in from_end]
        down = [link for link in reversed(from_end) if link not in from_start]
        return (
            *((self.joint_above[link], True) for link in up),
            *((self.joint_above[link], False) for link in down),
        )

    def _ancestors(self, link: str) -> list[str]:
        self.require_link(link)
        path = [link]
        while path[-1] in self.joint_above:
            path.append(self.joint_above[path[-1]].parent)
        return path

    def require_link(self, link: str) -> None:
        """Raise InputError with similar names if the URDF has no such link."""
        if link not in self.links:
            raise InputError(
                f"{self.source}: no link '{link}' in the URDF{near_matches(link, self.links)}"
            )


def load_robot(path: Path) -> Robot:
    """Read the kinematic tree of a URDF, or of a file named .xacro after its expansion.

    Raises:
        InputError: The file cannot be read or is no valid URDF; the error names the elements.
    """
    try:
        return parse_robot(read_urdf(path), path)
    except InputError:
        if path.suffix != ".xacro" or not path.is_file():
            raise
    return parse_robot(_expanded(path), path)


def _expanded(path: Path) -> bytes:
    """The URDF that a xacro file expands to with the defaults of its arguments.

    Raises:
        InputError: xacro is not installed, or the file is faulty or needs an argument.
    """
    command = f"`xacro {path} > robot.urdf` and give robot.urdf"
    try:
        import xacro
    except ImportError as error:
        raise InputError(
            f"{path}: is xacro: expand it with {command}, or have it expanded here: "
            "pip install 'imucalib[xacro]'"
        ) from error
    missing: list[str] = []
    try:
        # xacro prints to stdout
        with redirect_stdout(sys.stderr), packages_near(path) as missing:
            text: str = xacro.process_file(str(path)).toxml()
    # xacro evaluates Python code of the file, which may raise anything
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        if missing:
            reason = f"package '{missing[0]}' is neither installed nor a folder near the file"
        raise InputError(
            f"{path}: xacro cannot expand it ({reason}): if it needs arguments or other packages, "
            f"expand it with {command}"
        ) from error
    return text.encode()


def read_urdf(path: Path) -> bytes:
    """Read a URDF's bytes once, so that it may come through a pipe; ``-`` is standard input.

    Raises:
        InputError: The file cannot be read.
    """
    try:
        if str(path) == "-":
            return sys.stdin.buffer.read(SIZE_LIMIT + 1)
        with path.open("rb") as file:
            return file.read(SIZE_LIMIT + 1)  # a device may be endless
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}): check --urdf") from None


def parse_robot(data: bytes, path: Path | str) -> Robot:
    """The kinematic tree of a URDF's bytes.

    Meshes are not opened. Axes are normalised; a missing axis is x, the default of URDF.

    Raises:
        InputError: It is no valid URDF; the error names the elements.
    """
    name, link_elements, joint_elements = checked_urdf(data, path)
    links = tuple(map(frame_name, link_elements))
    if len(set(links)) < len(links):
        twice = Counter(links).most_common(1)[0][0]
        raise InputError(f"{path}: links '{twice}' and '/{twice}' are one frame: rename one")
    joints = tuple(_joint(*item, joint_elements) for item in joint_elements.items())
    children = {joint.child for joint in joints}
    return Robot(
        name=name,
        root=next(link for link in links if link not in children),
        links=links,
        joints=joints,
        sha256=hashlib.sha256(data).hexdigest(),
        source=path,
        xml=data,
    )


def _joint(name: str, element: Element, joints: Container[str]) -> Joint:
    axis = _numbers(element.value("axis", "xyz", "1 0 0"))
    norm = float(np.sqrt(axis @ axis))
    mimic = None
    followed = element.value("mimic", "joint")
    if followed in joints:  # otherwise the joint has a position of its own, or none
        multiplier, offset = (
            float(element.value("mimic", attribute, default))
            for attribute, default in (("multiplier", "1"), ("offset", "0"))
        )
        mimic = Mimic(joint=followed, multiplier=multiplier, offset=offset)
    return Joint(
        name=name,
        kind=cast("JointKind", element.attributes["type"]),
        parent=frame_name(element.value("parent", "link")),
        child=frame_name(element.value("child", "link")),
        R_origin=matrix_from_rpy(_numbers(element.value("origin", "rpy", "0 0 0"))) + 0.0,
        p_origin=_numbers(element.value("origin", "xyz", "0 0 0")),
        axis=axis / norm if norm > 0.0 else axis,
        mimic=mimic,
    )


def _numbers(text: str) -> Floats:
    return np.array([float(word) for word in text.split()])
