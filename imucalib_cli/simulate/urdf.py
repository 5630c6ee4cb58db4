"""The URDF of a simulated system, with the IMU's nominal pose."""

from __future__ import annotations

from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET
from xml.sax.saxutils import escape

import numpy as np

from imucalib_cli.simulate.config import FixedFrame, Jointed, Legged
from imucalib_cli.simulate.elements import add
from imucalib_cli.simulate.options import ZERO

if TYPE_CHECKING:
    from imucalib_cli.simulate.config import ArmLink, FreeBody, SystemConfig, Trunk

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
            _box(robot, system.parent, mover.trunk)
        else:
            add(robot, "link", name=system.world)
        _jointed(robot, mover)
    else:
        _box(robot, system.parent, mover)
    nominal = [
        FixedFrame(link=imu.link, parent=imu.parent, **vars(imu.nominal))
        for imu in system.every_imu
    ]
    for frame in (*nominal, *system.frames):
        name = f"{frame.link.removesuffix('_link')}_joint"
        joint = add(robot, "joint", name=name, type="fixed")
        add(joint, "origin", xyz=frame.xyz, rpy=frame.rpy)
        add(joint, "parent", link=frame.parent)
        add(joint, "child", link=frame.link)
        add(robot, "link", name=frame.link)
    ET.indent(robot)
    comment = escape(ORIGIN.format(name=system.name))
    body = ET.tostring(robot, encoding="unicode")
    return f'<?xml version="1.0"?>\n<!-- {comment} -->\n{body}\n'


def _jointed(robot: ET.Element, arm: Jointed) -> None:
    for link in arm.links:
        element = add(robot, "link", name=link.name)
        visual = add(element, "visual")
        add(visual, "origin", xyz=link.com, rpy=_TO_AXIS[link.axis])
        add(add(visual, "geometry"), "cylinder", radius=link.radius, length=link.length)
        _inertial(element, link)
    for joint in arm.joints:
        limit = np.radians(joint.range_deg)
        velocity = np.radians(joint.velocity_deg)
        element = add(robot, "joint", name=joint.name, type="revolute")
        add(element, "origin", xyz=joint.xyz, rpy=joint.rpy)
        add(element, "parent", link=joint.parent)
        add(element, "child", link=joint.child)
        add(element, "axis", xyz=joint.direction)
        add(element, "limit", lower=-limit, upper=limit, effort=joint.effort, velocity=velocity)


def _box(robot: ET.Element, name: str, body: FreeBody | Trunk) -> None:
    element = add(robot, "link", name=name)
    add(add(add(element, "visual"), "geometry"), "box", size=body.size)
    _inertial(element, body)


def _inertial(link: ET.Element, body: ArmLink | FreeBody | Trunk) -> None:
    element = add(link, "inertial")
    add(element, "origin", xyz=body.com, rpy=ZERO)
    add(element, "mass", value=body.mass)
    ixx, iyy, izz = body.inertia
    add(element, "inertia", ixx=ixx, ixy=0.0, ixz=0.0, iyy=iyy, iyz=0.0, izz=izz)
