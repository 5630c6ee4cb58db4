"""The URDF of a simulated system, with the IMU's nominal pose."""

from __future__ import annotations

from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET
from xml.sax.saxutils import escape

import numpy as np

from imucalib_cli.simulate.config import Jointed, Legged

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.simulate.config import FreeBody, SystemConfig, Trunk

_TO_AXIS = {"x": (0.0, np.pi / 2, 0.0), "y": (-np.pi / 2, 0.0, 0.0), "z": (0.0, 0.0, 0.0)}
"""rpy that turns a cylinder from z, its axis in URDF, to another axis."""

ORIGIN = (
    "Made by imucalib simulate from configs/{name}.yaml, which tells where its numbers are from."
)


def urdf_text(system: SystemConfig) -> str:
    """Write the robot's description, with the IMU at its nominal pose and not the true one."""
    robot = ET.Element("robot", name=system.name)
    mover = system.mover
    if isinstance(mover, Jointed):
        if isinstance(mover, Legged):
            _box(robot, system.parent, mover.trunk, mover.trunk.com)
        else:
            ET.SubElement(robot, "link", name=system.world)
        _jointed(robot, mover)
    else:
        _box(robot, system.parent, mover, (0.0, 0.0, 0.0))
    for imu in system.every_imu:
        _fixed(robot, imu.link, imu.parent, imu.nominal.xyz, imu.nominal.rpy)
    for frame in system.frames:
        _fixed(robot, frame.link, frame.parent, frame.xyz, frame.rpy)
    ET.indent(robot)
    comment = escape(ORIGIN.format(name=system.name))
    body = ET.tostring(robot, encoding="unicode")
    return f'<?xml version="1.0"?>\n<!-- {comment} -->\n{body}\n'


def _jointed(robot: ET.Element, arm: Jointed) -> None:
    for link in arm.links:
        element = ET.SubElement(robot, "link", name=link.name)
        turn = _TO_AXIS[link.axis]
        visual = ET.SubElement(element, "visual")
        _origin(visual, link.com, turn)
        shape = ET.SubElement(visual, "geometry")
        ET.SubElement(shape, "cylinder", radius=_number(link.radius), length=_number(link.length))
        _inertial(element, link.mass, link.com, link.inertia())
    for joint in arm.joints:
        element = ET.SubElement(robot, "joint", name=joint.name, type="revolute")
        _origin(element, joint.xyz, joint.rpy)
        ET.SubElement(element, "parent", link=joint.parent)
        ET.SubElement(element, "child", link=joint.child)
        ET.SubElement(element, "axis", xyz=_numbers(joint.direction))
        limit = np.radians(joint.range_deg)
        ET.SubElement(
            element,
            "limit",
            lower=_number(-limit),
            upper=_number(limit),
            effort=_number(joint.effort),
            velocity=_number(np.radians(joint.velocity_deg)),
        )


def _box(robot: ET.Element, name: str, body: FreeBody | Trunk, com: Sequence[float]) -> None:
    element = ET.SubElement(robot, "link", name=name)
    visual = ET.SubElement(element, "visual")
    ET.SubElement(ET.SubElement(visual, "geometry"), "box", size=_numbers(body.size))
    _inertial(element, body.mass, com, body.inertia)


def _inertial(
    link: ET.Element, mass: float, com: Sequence[float], inertia: Sequence[float]
) -> None:
    element = ET.SubElement(link, "inertial")
    _origin(element, com, (0.0, 0.0, 0.0))
    ET.SubElement(element, "mass", value=_number(mass))
    ixx, iyy, izz = (_number(value) for value in inertia)
    ET.SubElement(element, "inertia", ixx=ixx, ixy="0", ixz="0", iyy=iyy, iyz="0", izz=izz)


def _fixed(
    robot: ET.Element, link: str, parent: str, xyz: Sequence[float], rpy: Sequence[float]
) -> None:
    joint = ET.SubElement(robot, "joint", name=f"{link.removesuffix('_link')}_joint", type="fixed")
    _origin(joint, xyz, rpy)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=link)
    ET.SubElement(robot, "link", name=link)


def _origin(element: ET.Element, xyz: Sequence[float], rpy: Sequence[float]) -> None:
    ET.SubElement(element, "origin", xyz=_numbers(xyz), rpy=_numbers(rpy))


def _numbers(values: Sequence[float]) -> str:
    return " ".join(_number(value) for value in values)


def _number(value: float) -> str:
    return f"{value:.17g}" if float(f"{value:.12g}") != value else f"{value:.12g}"
