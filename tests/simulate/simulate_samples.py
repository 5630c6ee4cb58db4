"""What tests ask of a recording, and its IMUs by pinocchio's own mechanics."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.options import PhysicsOptions
from imucalib_cli.simulate.physics import record
from imucalib_cli.simulate.recording import CameraRecord, JointRecord, PoseRecord, Recording
from imucalib_cli.simulate.urdf import urdf_text
from tests.by_pinocchio import follow

ROOT = Path(__file__).parents[2]


def configured(folder: Path, system: str, change: Callable[[Any], object]) -> Path:
    """A file of a system of the package, changed."""
    raw = yaml.safe_load((ROOT / "configs" / f"{system}.yaml").read_text())
    change(raw)
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump(raw))
    return path


def recorded(system: str, **options: Any) -> Recording:
    """A clean recording of a system of the package."""
    return record(load_system(system), PhysicsOptions(**options))


def joints(recording: Recording, number: int = 0) -> JointRecord:
    part = recording.robot[number]
    assert isinstance(part, JointRecord)
    return part


def pose(recording: Recording) -> PoseRecord:
    part = recording.robot[0]
    assert isinstance(part, PoseRecord)
    return part


def camera(recording: Recording) -> CameraRecord:
    assert recording.camera is not None
    return recording.camera


def imus_by_pinocchio(recording: Recording) -> tuple[Floats, Floats, Floats, Floats]:
    """Gyro, specific force, R_world_imu and position of each IMU from the state, (N, IMUs, ...)."""
    system, state, physics = recording.system, recording.state, recording.physics
    walks = [pin.JointModelFreeFlyer()] if system.legged else []
    model: Any = pin.buildModelFromXML(urdf_text(system), *walks)
    mounts: list[Any] = [(system.parent, physics.mount_rpy, physics.mount_xyz)]
    mounts += [(imu.parent, imu.rpy, imu.xyz) for imu in system.imus]
    frames = []
    for number, (link, rpy, xyz) in enumerate(mounts):
        parent = model.frames[model.getFrameId(link)]
        mount = pin.SE3(Rotation.from_euler("xyz", rpy).as_matrix(), np.array(xyz))
        place = parent.placement * mount
        frame = pin.Frame(f"true_{number}", parent.parentJoint, 0, place, pin.OP_FRAME)
        frames.append(model.addFrame(frame))
    in_model = [model.joints[model.getJointId(joint.name)] for joint in system.joints]
    place_q, place_v = [joint.idx_q for joint in in_model], [joint.idx_v for joint in in_model]
    many = np.ones((len(state.t), 1))
    q, v, a = many * pin.neutral(model), many * np.zeros(model.nv), many * np.zeros(model.nv)
    for own, theirs, places in (
        (q, state.position, place_q),
        (v, state.velocity, place_v),
        (a, state.acceleration, place_v),
    ):
        own[:, places] = theirs[:, -len(in_model) :]
    if walks:
        back = Rotation.from_quat(state.position[:, [4, 5, 6, 3]]).inv()
        q[:, :7] = state.position[:, [0, 1, 2, 4, 5, 6, 3]]
        # MuJoCo's trunk: linear in the world, angular in the body; pinocchio's: both in the body.
        v[:, :3], v[:, 3:6] = back.apply(state.velocity[:, :3]), state.velocity[:, 3:6]
        a[:, :3] = back.apply(state.acceleration[:, :3]) - np.cross(v[:, 3:6], v[:, :3])
        a[:, 3:6] = state.acceleration[:, 3:6]
    motions = follow(model, frames, q, v, a)
    gravity = [each.R.swapaxes(1, 2) @ recording.gravity_world for each in motions]
    accel = [each.acceleration - down for each, down in zip(motions, gravity, strict=True)]
    return (
        np.stack([each.omega for each in motions], axis=1),
        np.stack(accel, axis=1),
        np.stack([each.R for each in motions], axis=1),
        np.stack([each.p for each in motions], axis=1),
    )
