"""A system's configuration as a MuJoCo model (MJCF)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.robot.rotations import matrix_from_rpy, quaternion_from_matrix
from imucalib_cli.simulate.config import FreeBody, Legged
from imucalib_cli.simulate.elements import add

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Floats
    from imucalib_cli.simulate.config import Jointed, SystemConfig, Trunk


SITE, CAMERA = "imu", "camera"
Mount = tuple[str, "Floats", "Floats"]


def model_xml(
    system: SystemConfig,
    imus: Sequence[Mount],
    gravity_world: Floats,
    camera: Mount | None = None,
) -> str:
    """Write the model with a gyroscope and an accelerometer at the mount of each IMU.

    With a camera, sensors of its pose in the world (position, quaternion wxyz) follow. A mount is a
    link, and R (3, 3) and p (3,), m, in that link.

    Raises:
        InputError: A link of an IMU is not in the configuration.
    """
    root = ET.Element("mujoco", model=system.name)
    add(root, "compiler", angle="radian", autolimits="false")
    option = add(root, "option", integrator="RK4", gravity=gravity_world)
    world = add(root, "worldbody")
    mover = system.mover
    bodies: dict[str, ET.Element] = {}
    if isinstance(mover, Legged):
        height = mover.gait.height + mover.feet[0].radius
        bodies[system.parent] = _floating(world, system.parent, mover.trunk, height)
    else:
        add(option, "flag", contact="disable", constraint="disable")
    if isinstance(mover, FreeBody):
        bodies[system.parent] = _floating(world, system.parent, mover)
    else:
        _jointed(world, add(root, "actuator"), bodies, mover)
    if isinstance(mover, Legged):
        _contacts(world, bodies, mover)
    sensors = add(root, "sensor")
    for number, mount in enumerate(imus):
        if mount[0] not in bodies:
            raise InputError(f"{system.name}: no link {mount[0]}; it has {', '.join(bodies)}")
        site = f"{SITE}{number or ''}"
        _mounted(bodies, site, mount)
        add(sensors, "gyro", site=site)
        add(sensors, "accelerometer", site=site)
    if camera is not None:
        _mounted(bodies, CAMERA, camera)
        add(sensors, "framepos", objtype="site", objname=CAMERA)
        add(sensors, "framequat", objtype="site", objname=CAMERA)
    return ET.tostring(root, encoding="unicode")


def _mounted(bodies: dict[str, ET.Element], name: str, mount: Mount) -> None:
    link, R, p = mount
    add(bodies[link], "site", name=name, pos=p, quat=_wxyz(R))


def _jointed(
    world: ET.Element, actuators: ET.Element, bodies: dict[str, ET.Element], arm: Jointed
) -> None:
    """Add the body of each joint's link, and the joint's drive."""
    links, drives = {link.name: link for link in arm.links}, arm.drives
    each = zip(arm.joints, drives.rotor_inertia, drives.stiffness, drives.damping, strict=True)
    for joint, rotor, stiffness, damping in each:
        link = links.get(joint.child)
        if link is None:
            raise InputError(f"joint {joint.name}: no mass is stated for its link {joint.child}")
        body = add(
            bodies.get(joint.parent, world),
            "body",
            name=link.name,
            pos=joint.xyz,
            quat=_wxyz(matrix_from_rpy(joint.rpy)),
            gravcomp=drives.gravity_compensation,
        )
        add(body, "joint", name=joint.name, axis=joint.direction, armature=rotor)
        add(body, "inertial", pos=link.com, mass=link.mass, diaginertia=link.inertia)
        add(actuators, "position", joint=joint.name, kp=stiffness, kv=damping)
        bodies[link.name] = body


def _floating(
    world: ET.Element, name: str, box: FreeBody | Trunk, height: float = 0.0
) -> ET.Element:
    body = add(world, "body", name=name, pos=(0.0, 0.0, height))
    add(body, "freejoint")
    add(body, "inertial", pos=box.com, mass=box.mass, diaginertia=box.inertia)
    return body


def _contacts(world: ET.Element, bodies: dict[str, ET.Element], legged: Legged) -> None:
    """Only feet and the ground touch each other."""
    ground = legged.ground
    contact: dict[str, Any] = {
        "friction": (ground.friction, 0.005, 0.0001),  # MuJoCo's own but sliding
        "solref": (ground.time_constant, 1.0),
        # From MuJoCo's least hardness to its default: readings do not jump, so that their sum over
        # the instants of the log is the change of velocity.
        "solimp": (0.0001, 0.95, ground.depth, 0.5, 2.0),
    }
    plane = {"type": "plane", "size": "0 0 1", "contype": "1", "conaffinity": "0"}
    add(world, "geom", **plane, **contact)
    for foot in legged.feet:
        ball = {"type": "sphere", "contype": "0", "conaffinity": "1", "mass": "0"}
        add(bodies[foot.link], "geom", size=foot.radius, pos=foot.xyz, **ball, **contact)


def _wxyz(R: Floats) -> Floats:
    """MuJoCo's quaternion order, of a rotation matrix (3, 3)."""
    return np.roll(quaternion_from_matrix(R), 1)
