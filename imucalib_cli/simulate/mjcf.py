"""A system's configuration as a MuJoCo model (MJCF)."""

from __future__ import annotations

from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.robot.rotations import matrix_from_rpy, quaternion_from_matrix
from imucalib_cli.simulate.config import Arm

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from imucalib_cli.simulate.config import FreeBody, SystemConfig

    Floats = NDArray[np.float64]

SITE, CAMERA = "imu", "camera"
Mount = tuple[str, "Floats", "Floats"]


def model_xml(
    system: SystemConfig,
    R_parent_imu: Floats,
    t_parent_imu: Floats,
    gravity_world: Floats,
    camera: Mount | None = None,
) -> str:
    """Write the model with an accelerometer and a gyroscope at the IMU's mount.

    With a camera, sensors of its pose in the world (position, quaternion wxyz) follow.

    Args:
        system: What to model.
        R_parent_imu: (3, 3), true orientation of the IMU in its parent link.
        t_parent_imu: (3,), m.
        gravity_world: (3,), m/s².
        camera: The link that carries the camera, R_link_camera (3, 3), p_link_camera (3,), m.

    Raises:
        InputError: The parent link is not in the configuration.
    """
    root = ET.Element("mujoco", model=system.name)
    ET.SubElement(root, "compiler", angle="radian", autolimits="false")
    option = ET.SubElement(root, "option", integrator="RK4", gravity=_numbers(gravity_world))
    ET.SubElement(option, "flag", contact="disable", constraint="disable")
    world = ET.SubElement(root, "worldbody")
    mover = system.mover
    if isinstance(mover, Arm):
        bodies = _arm(world, mover)
        _drives(ET.SubElement(root, "actuator"), mover)
    else:
        bodies = _free_body(world, system.parent, mover)
    if system.parent not in bodies:
        raise InputError(f"{system.name}: no link {system.parent}; it has {', '.join(bodies)}")
    imu = bodies[system.parent]
    position, orientation = _numbers(t_parent_imu), _numbers(_wxyz(R_parent_imu))
    ET.SubElement(imu, "site", name=SITE, pos=position, quat=orientation)
    sensors = ET.SubElement(root, "sensor")
    ET.SubElement(sensors, "gyro", site=SITE)
    ET.SubElement(sensors, "accelerometer", site=SITE)
    if camera is not None:
        link, R_link_camera, p_link_camera = camera
        position, orientation = _numbers(p_link_camera), _numbers(_wxyz(R_link_camera))
        ET.SubElement(bodies[link], "site", name=CAMERA, pos=position, quat=orientation)
        ET.SubElement(sensors, "framepos", objtype="site", objname=CAMERA)
        ET.SubElement(sensors, "framequat", objtype="site", objname=CAMERA)
    return ET.tostring(root, encoding="unicode")


def _arm(world: ET.Element, arm: Arm) -> dict[str, ET.Element]:
    bodies: dict[str, ET.Element] = {}
    links = {link.name: link for link in arm.links}
    for joint, rotor in zip(arm.joints, arm.drives.rotor_inertia, strict=True):
        link = links.get(joint.child)
        if link is None:
            raise InputError(f"joint {joint.name}: no mass is stated for its link {joint.child}")
        body = ET.SubElement(
            bodies.get(joint.parent, world),
            "body",
            name=link.name,
            pos=_numbers(joint.xyz),
            quat=_numbers(_wxyz(matrix_from_rpy(joint.rpy))),
            gravcomp=repr(arm.drives.gravity_compensation),
        )
        ET.SubElement(body, "joint", name=joint.name, axis="0 0 1", armature=repr(rotor))
        inertia = _numbers(link.inertia())
        ET.SubElement(
            body, "inertial", pos=_numbers(link.com), mass=repr(link.mass), diaginertia=inertia
        )
        bodies[link.name] = body
    return bodies


def _drives(actuators: ET.Element, arm: Arm) -> None:
    drives = zip(arm.joints, arm.drives.stiffness, arm.drives.damping, strict=True)
    for joint, stiffness, damping in drives:
        ET.SubElement(actuators, "position", joint=joint.name, kp=repr(stiffness), kv=repr(damping))


def _free_body(world: ET.Element, name: str, free: FreeBody) -> dict[str, ET.Element]:
    body = ET.SubElement(world, "body", name=name)
    ET.SubElement(body, "freejoint")
    inertia = _numbers(free.inertia)
    ET.SubElement(body, "inertial", pos="0 0 0", mass=repr(free.mass), diaginertia=inertia)
    return {name: body}


def _wxyz(R: Floats) -> Floats:
    """MuJoCo's quaternion order, of a rotation matrix (3, 3)."""
    return np.roll(quaternion_from_matrix(R), 1)


def _numbers(values: Sequence[float] | Floats) -> str:
    return " ".join(repr(float(value)) for value in values)
