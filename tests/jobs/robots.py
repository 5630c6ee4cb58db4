"""Robots of several shapes and logs of them: kinematics by pinocchio, readings by differences."""

from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from imucalib_cli.results.result import Result
from tests.conftest import START_NS
from tests.logs.logs_samples import Said, posed, positions, reading, say, tf, write_log
from tools.errors import pose_off

Floats = Any
JointRow = tuple[str, str, str, str, str, str]
"""Name, type, parent, child, xyz, axis."""

_STEP = 1e-3
"""s, of the differences, of eighth order: exact to 1e-9."""
_FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
_SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])
GRAVITY = np.array([0.0, 0.0, -9.80665])


def _rows(text: str) -> tuple[JointRow, ...]:
    """A joint a line: name, type, parent, child: xyz: axis."""
    rows = [[part.strip() for part in line.split(":")] for line in text.strip().splitlines()]
    return tuple((*names.split(), xyz, axis) for names, xyz, axis in rows)  # type: ignore[misc]


def _leg(name: str, x: float, y: float) -> str:
    return f"""
        {name}_hip revolute trunk {name}_hip_link: {x} {y} 0: 1 0 0
        {name}_thigh revolute {name}_hip_link {name}_thigh_link: 0 0.08 0: 0 1 0
        {name}_calf revolute {name}_thigh_link {name}_calf_link: 0 0 -0.2: 0 1 0
        {name}_foot fixed {name}_calf_link {name}_foot_link: 0 0 -0.2:"""


@dataclass(frozen=True, kw_only=True)
class Shape:
    """A robot, and the link that carries the IMU."""

    joints: tuple[JointRow, ...]
    carrier: str
    alike: tuple[str, ...] = ()
    """Links that are rigidly joined to it."""
    base: str | None = None
    """Link whose pose is published, if the base moves."""
    fingers: tuple[str, ...] = field(default=())
    """Joints that follow the first of them."""
    stroke: float = 1.0
    """How far they move, relative."""

    def urdf(self, prefix: str = "") -> str:
        links = dict.fromkeys(link for row in self.joints for link in row[2:4])
        lines = [f'<link name="{prefix}{link}"/>' for link in links]
        for name, kind, parent, child, xyz, axis in self.joints:
            inner = f'<parent link="{prefix}{parent}"/><child link="{prefix}{child}"/>'
            inner += f'<origin xyz="{xyz}" rpy="0 0 0"/>'
            if kind != "fixed":
                inner += f'<axis xyz="{axis}"/>'
                inner += '<limit lower="-3" upper="3" effort="1" velocity="9"/>'
            if name in self.fingers[1:]:
                inner += f'<mimic joint="{prefix}{self.fingers[0]}" multiplier="-1"/>'
            lines.append(f'<joint name="{prefix}{name}" type="{kind}">{inner}</joint>')
        return "<robot name='shape'>" + "".join(lines) + "</robot>"


SHAPES = {
    "arm with a gripper": Shape(
        joints=_rows("""
            j1 revolute base l1: 0 0 0.3: 0 0 1
            j2 revolute l1 l2: 0 0 0: 0 1 0
            j3 revolute l2 l3: 0 0 0.4: 0 1 0
            j4 revolute l3 l4: 0.1 0 0.3: 1 0 0
            flange_joint fixed l4 flange: 0 0 0.1:
            left_finger prismatic flange finger_l: 0 0.02 0.05: 0 1 0
            right_finger prismatic flange finger_r: 0 -0.02 0.05: 0 1 0"""),
        carrier="l4",
        alike=("flange",),
        fingers=("left_finger", "right_finger"),
    ),
    "pan and tilt on a lift": Shape(
        joints=_rows("""
            lift prismatic base column: 0 0 0.2: 0 0 1
            pan continuous column pan_link: 0 0 0.1: 0 0 1
            tilt revolute pan_link tilt_link: 0.05 0 0.1: 0 1 0
            camera_joint fixed tilt_link camera: 0.03 0 0.02:"""),
        carrier="tilt_link",
        alike=("camera",),
    ),
    "quadruped": Shape(
        joints=_rows(_leg("FL", 0.2, 0.1) + _leg("FR", 0.2, -0.1) + _leg("RL", -0.2, 0.1)),
        carrier="trunk",
        base="trunk",
    ),
    "arm on a moving base": Shape(
        joints=_rows("""
            mast_joint fixed base_link mast: 0.1 0 0.5:
            pan revolute mast shoulder: 0 0 0.1: 0 0 1
            lift revolute shoulder upper: 0 0 0.1: 0 1 0
            roll revolute upper tool: 0 0 0.4: 0 0 1"""),
        carrier="upper",
        base="base_link",
    ),
}


def record(shape: Shape, path: Path, *, storage: str = "mcap2", **options: Any) -> Path:
    """A log of :func:`messages`; the storage is one of tests.logs."""
    write_log(path, messages(shape, **options), storage)
    return path


def messages(
    shape: Shape,
    *,
    mount: pin.SE3,
    imu_frame: str = "imu",
    joint_prefix: str = "",
    namespace: str = "",
    base_topic: str = "/tf",
    still: Collection[str] = (),
    seconds: float = 30.0,
    seed: int = 0,
) -> list[Said]:
    """All joints move, and the base if it does, with the noise of a good IMU at T_carrier_imu.

    A ``base_topic`` other than /tf has a PoseStamped; ``still`` joints do not move.
    """
    rng = np.random.default_rng(seed)
    root = (pin.JointModelFreeFlyer(),) if shape.base else ()
    model = pin.buildModelFromXML(shape.urdf(), *root)
    data, frame = model.createData(), model.getFrameId(shape.carrier)
    names = [row[0] for row in shape.joints if row[1] != "fixed"]
    jointed = [model.joints[model.getJointId(name)] for name in names]
    places = [slice(joint.idx_q, joint.idx_q + joint.nq) for joint in jointed]
    turning = [joint.nq == 2 for joint in jointed]  # continuous: cosine and sine
    size = np.array([0.1 if row[1] == "prismatic" else 0.7 for row in shape.joints])
    size = size[[row[1] != "fixed" for row in shape.joints]]
    size *= [name not in still for name in names]
    size *= [shape.stroke if name in shape.fingers else 1.0 for name in names]
    waves = rng.uniform(0.8, 3.0, (2, len(names) + 6)), rng.uniform(0, 6, (2, len(names) + 6))

    t = np.arange(0.0, seconds, 0.01)
    near = t[:, None] + _STEP * np.arange(-4, 5)
    waving = np.sin(near[..., None, None] * waves[0] + waves[1])
    sway = (waving * [[0.6], [0.4]]).sum(axis=2)  # (N, 9, n + 6)
    joints = sway[..., 6:] * size
    for name in shape.fingers[1:]:
        joints[..., names.index(name)] = -joints[..., names.index(shape.fingers[0])]
    angles = sway[..., :3] * [1.2, 0.3, 0.3]
    turned = Rotation.from_euler("ZYX", angles.reshape(-1, 3)).as_quat()
    base = np.dstack([sway[..., 3:6] * [0.5, 0.5, 0.1], turned.reshape(*near.shape, 4)])
    q = np.tile(pin.neutral(model), (*near.shape, 1))
    if shape.base:
        q[..., :7] = base
    for place, turns, value in zip(places, turning, np.moveaxis(joints, 2, 0), strict=True):
        q[..., place] = np.dstack([np.cos(value), np.sin(value)] if turns else [value])
    R, p = np.empty((*near.shape, 3, 3)), np.empty((*near.shape, 3))
    for index in np.ndindex(near.shape):
        pin.framesForwardKinematics(model, data, q[index])
        pose = data.oMf[frame] * mount
        R[index], p[index] = pose.rotation, pose.translation
    R_imu = np.swapaxes(R[:, 4], 1, 2)
    turns_by = Rotation.from_matrix((R_imu[:, None] @ R).reshape(-1, 3, 3)).as_rotvec()
    noise = rng.standard_normal((len(t), 6 + len(names))) * np.repeat(
        [1e-3, 0.01, 2e-5], [3, 3, len(names)]
    )
    w = _FIRST @ turns_by.reshape(p.shape) / _STEP + noise[:, :3]
    force = _SECOND @ p / _STEP**2 - GRAVITY
    a = (R_imu @ force[..., None])[..., 0] + noise[:, 3:6]
    read = joints[:, 4] + noise[:, 6:]
    # a mimic joint is not published
    told = [k for k, name in enumerate(names) if name not in shape.fingers[1:]]
    said = []
    for k, seconds_since in enumerate(t.tolist()):
        ns = START_NS + round(seconds_since * 1e9)
        said.append(say(f"{namespace}/imu", reading(ns, w[k], a[k], imu_frame), ns))
        state = positions(ns, (joint_prefix + names[j] for j in told), read[k, told])
        said.append(say(f"{namespace}/joint_states", state, ns + 1))
        if shape.base:
            said.append(_pose_message(base_topic, shape.base, base[k, 4], ns))
    return said


def assert_matches_truth(result: Result, mount: pin.SE3, *, largest: float = 5e-3) -> None:
    """The pose is within four sigmas of the truth, and sigmas of translation are small, m."""
    assert result.status == "ok"
    off = pose_off(result.pose.R, result.pose.t, mount.rotation, mount.translation)
    sigma = np.sqrt(np.diag(np.asarray(result.uncertain_pose.covariance)))
    assert (np.abs(off) < 4.0 * sigma).all()
    assert sigma[:3].max() < largest


def _pose_message(topic: str, child: str, pose: Floats, ns: int) -> Said:
    xyz, xyzw = np.split(pose, [3])
    if topic == "/tf":
        return say(topic, tf(ns, "odom", child, xyz, xyzw), ns + 2)
    return say(topic, posed(ns, "odom", xyz, xyzw), ns + 2)


def random_mount(seed: int) -> pin.SE3:
    rng = np.random.default_rng(seed)
    return pin.SE3(Rotation.random(rng=rng).as_matrix(), rng.uniform(-0.08, 0.08, 3))
