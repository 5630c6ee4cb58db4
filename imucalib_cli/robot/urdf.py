"""A URDF as a tree of links and joints, without anything that their motion and load do not need.

Our own check (:mod:`imucalib_cli.robot.urdf_check`) reads the file first and keeps only its
kinematic elements and sound masses; yourdfpy parses those. Errors in visuals, meshes, inertias and
extensions therefore do not matter.
"""

from __future__ import annotations

import hashlib
import importlib.util
import logging
import sys
from collections import Counter, defaultdict
from contextlib import contextmanager
from functools import cache, cached_property
from io import BytesIO
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from msgspec import Struct

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.robot.expansion import expanded
from imucalib_cli.robot.names import frame_name
from imucalib_cli.robot.urdf_check import check_urdf
from imucalib_cli.robot.urdf_xml import SIZE_LIMIT
from imucalib_cli.shown import near_matches

if TYPE_CHECKING:
    from collections.abc import Container, Iterator
    from pathlib import Path

    from imucalib_cli.arrays import Floats

JointKind = Literal["fixed", "revolute", "continuous", "prismatic", "floating", "planar"]


class Mimic(Struct, frozen=True, kw_only=True):
    """Position = multiplier * position of ``joint`` + offset."""

    joint: str
    multiplier: float
    offset: float


class Joint(Struct, frozen=True, kw_only=True, eq=False):
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


class Robot(Struct, frozen=True, kw_only=True, eq=False, dict=True):
    """The tree of a URDF's links."""

    name: str
    root: str
    links: tuple[str, ...]
    joints: tuple[Joint, ...]
    masses: dict[str, tuple[float, Floats]]
    """kg, and centre of mass (3,), m, in the link's frame, of links of known mass."""
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

    @cached_property
    def joints_below(self) -> defaultdict[str, list[Joint]]:
        """The joints below each link."""
        found: defaultdict[str, list[Joint]] = defaultdict(list)
        for joint in self.joints:
            found[joint.parent].append(joint)
        return found

    def carried(self, joint: Joint, but: Container[Joint]) -> tuple[float, Floats]:
        """Mass, kg, of the links behind a joint, and its centre (3,), m, in the frame behind it.

        Joints in ``but`` carry links of their own; other joints are taken to stand at zero.
        """
        mass, moment = 0.0, np.zeros(3)
        links = [(joint.child, np.eye(3), np.zeros(3))]
        for link, R, p in links:  # grows
            own, centre = self.masses.get(link, (0.0, p))
            mass, moment = mass + own, moment + own * (p + R @ centre)
            links += [
                (each.child, R @ each.R_origin, p + R @ each.p_origin)
                for each in self.joints_below[link]
                if each not in but
            ]
        return mass, moment / mass if mass else moment

    def route(self, start: str, end: str) -> tuple[tuple[Joint, bool], ...]:
        """Joints of any kind between two links, each with whether the path goes up through it.

        Raises:
            ChoiceError: A link is not in the URDF.
        """
        way = way_between(self._ancestors(start), self._ancestors(end))
        return tuple((self.joint_above[link], upwards) for link, upwards in way)

    def _ancestors(self, link: str) -> list[str]:
        self.require_link(link)
        path = [link]
        while path[-1] in self.joint_above:
            path.append(self.joint_above[path[-1]].parent)
        return path

    def require_link(self, link: str) -> None:
        """Raise ChoiceError with similar names if the URDF has no such link."""
        if link not in self.links:
            raise ChoiceError(
                f"{self.source}: no link '{link}' in the URDF{near_matches(link, self.links)}"
            )


def way_between(from_start: list[str], from_end: list[str]) -> list[tuple[str, bool]]:
    """Nodes of a tree to go up from (True), then those to go down to, by ancestors of both ends.

    Ancestors include the node itself, and end at the root.
    """
    up = [(node, True) for node in from_start if node not in from_end]
    return up + [(node, False) for node in reversed(from_end) if node not in from_start]


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
    return parse_robot(expanded(path), path)


def read_urdf(path: Path) -> bytes:
    """Read a URDF's bytes once, so that it may come through a pipe; ``-`` is standard input.

    Raises:
        InputError: The file cannot be read.
    """
    try:
        if str(path) == "-":
            if sys.stdin is None:
                raise InputError("standard input is closed: name a file with --urdf")
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
    kinematics = check_urdf(data, path)
    with _quiet():
        model = _yourdfpy().URDF.load(
            BytesIO(kinematics), build_scene_graph=False, load_meshes=False
        )
    links = tuple(frame_name(link.name) for link in model.robot.links)
    if len(set(links)) < len(links):
        twice = Counter(links).most_common(1)[0][0]
        raise InputError(f"{path}: links '{twice}' and '/{twice}' are one frame: rename one")
    joints = tuple(map(_joint, model.robot.joints))
    children = {joint.child for joint in joints}
    return Robot(
        name=model.robot.name,
        root=next(link for link in links if link not in children),
        links=links,
        joints=joints,
        masses={
            name: (float(link.inertial.mass), np.array(link.inertial.origin[:3, 3]))
            for name, link in zip(links, model.robot.links, strict=True)
            if link.inertial is not None
        },
        sha256=hashlib.sha256(data).hexdigest(),
        source=path,
        xml=data,
    )


class _Unopened(ModuleType):
    """Placeholder for a module that nothing here calls; all its names are ``object``."""

    def __getattr__(self, name: str) -> type:
        return object


@cache
def _yourdfpy() -> Any:
    # Import private copies of yourdfpy.urdf, and of the trimesh.transformations that it uses,
    # without the rest of the two packages: meshes and scenes are not used, and importing them takes
    # 0.5 s and 70 MB. The transformations of a URDF need nothing of the two modules that they
    # import. sys.modules is restored, so that other users of yourdfpy in this process get all of
    # it.
    packages = ("yourdfpy", "trimesh")

    def taken_out() -> dict[str, ModuleType]:
        names = [name for name in sys.modules if name.partition(".")[0] in packages]
        return {name: sys.modules.pop(name) for name in names}

    with _quiet():
        specs = {name: importlib.util.find_spec(name) for name in packages}
        before = taken_out()
        try:
            for name in ("trimesh.typed", "trimesh.util"):
                sys.modules[name] = _Unopened(name)
            for name, spec in specs.items():
                if spec is not None:
                    sys.modules[name] = unopened = _Unopened(name)
                    unopened.__path__ = list(spec.submodule_search_locations or ())
            return importlib.import_module("yourdfpy.urdf")
        finally:
            taken_out()
            sys.modules.update(before)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep yourdfpy and trimesh from writing to stderr: our own check reports errors."""
    loggers = [logging.getLogger(name) for name in ("yourdfpy", "trimesh")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def _joint(parsed: Any) -> Joint:
    origin = np.eye(4) if parsed.origin is None else np.asarray(parsed.origin, dtype=np.float64)
    axis = np.asarray(parsed.axis, dtype=np.float64)
    norm = float(np.sqrt(axis @ axis))
    mimic = parsed.mimic
    return Joint(
        name=parsed.name,
        kind=cast("JointKind", parsed.type),
        parent=frame_name(parsed.parent),
        child=frame_name(parsed.child),
        R_origin=np.ascontiguousarray(origin[:3, :3]),
        p_origin=np.ascontiguousarray(origin[:3, 3]),
        axis=axis / norm if norm > 0.0 else axis,
        mimic=mimic and Mimic(joint=mimic.joint, multiplier=mimic.multiplier, offset=mimic.offset),
    )
