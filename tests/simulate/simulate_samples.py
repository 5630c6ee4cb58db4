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
    data = model.createData()
    in_model = [model.joints[model.getJointId(joint.name)] for joint in system.joints]
    place_q, place_v = [joint.idx_q for joint in in_model], [joint.idx_v for joint in in_model]
    gyro, accel, turn, position = [], [], [], []
    for qm, vm, am in zip(state.position, state.velocity, state.acceleration, strict=True):
        q, v, a = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        q[place_q], v[place_v], a[place_v] = (x[-len(in_model) :] for x in (qm, vm, am))
        if walks:
            R = Rotation.from_quat(qm[[4, 5, 6, 3]]).as_matrix()
            q[:3], q[3:7] = qm[:3], qm[[4, 5, 6, 3]]
            # MuJoCo's trunk: linear in the world, angular in the body; pinocchio's: both in the
            # body.
            v[:3], v[3:6] = R.T @ vm[:3], vm[3:6]
            a[:3], a[3:6] = R.T @ am[:3] - np.cross(v[3:6], v[:3]), am[3:6]
        pin.forwardKinematics(model, data, q, v, a)
        pin.updateFramePlacements(model, data)
        poses = [data.oMf[frame] for frame in frames]
        turn.append([pose.rotation.copy() for pose in poses])
        position.append([pose.translation.copy() for pose in poses])
        gyro.append([pin.getFrameVelocity(model, data, f, pin.LOCAL).angular for f in frames])
        accel.append(
            [
                pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL).linear
                - pose.rotation.T @ recording.gravity_world
                for frame, pose in zip(frames, poses, strict=True)
            ]
        )
    return np.array(gyro), np.array(accel), np.array(turn), np.array(position)
