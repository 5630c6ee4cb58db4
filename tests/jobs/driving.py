"""A base that drives on a plane, with an IMU: motion by closed formulas, so that truth is exact."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.conftest import START_NS
from tests.logs.logs_samples import reading, say, tf, write_log

TRUE_T = np.array([0.3, -0.1, 0.08])
"""m, of the IMU in base_link."""
TRUE_R = Rotation.from_euler("xyz", [0.03, -0.02, 0.4])
_WAVES = np.array(
    [  # amplitude, rad/s and phase of x and y, m, and of the yaw, rad
        [[0.8, 0.9, 0.0], [0.3, 2.1, 1.0]],
        [[0.7, 0.7, 0.5], [0.3, 1.9, 2.0]],
        [[0.9, 0.8, 0.3], [0.4, 2.3, 0.7]],
    ]
)
URDF = """<robot name="cart">
  <link name="base_link"/> <link name="imu_link"/>
  <joint name="imu_joint" type="fixed">
    <parent link="base_link"/> <child link="imu_link"/>
    <origin xyz="0.29 -0.09 {z}" rpy="0.03 -0.02 0.4"/>
  </joint>
</robot>
"""
"""The drawing is 10 mm off in x and y; z is as it is told."""


def _derivative(t: NDArray[np.float64], order: int) -> NDArray[np.float64]:
    """(3, N), of x, y and yaw."""
    a, w, phase = (_WAVES[..., k, None] for k in range(3))
    return np.asarray((a * w**order * np.sin(w * t + phase + order * np.pi / 2)).sum(axis=1))


def drive(
    folder: Path, *, seconds: float = 60.0, pose_noise: float = 0.0, z: float = 0.08, seed: int = 0
) -> tuple[Path, Path]:
    """A log of odometry and an IMU, and the URDF, whose height is z, m.

    Odometry has noise of ``pose_noise``, m and rad, along and about all axes.
    """
    rng, said = np.random.default_rng(seed), []
    t = np.arange(round(seconds * 200)) / 200
    yaw, rate, turn = (_derivative(t, order)[2] for order in range(3))
    ax, ay, _ = _derivative(t, 2)
    c, s = np.cos(yaw), np.sin(yaw)
    x, y, _ = TRUE_T
    push = np.stack(
        [
            c * ax + s * ay - turn * y - rate**2 * x,
            -s * ax + c * ay + turn * x - rate**2 * y,
            np.full_like(t, 9.80665),
        ],
        axis=1,
    )
    accel = push @ TRUE_R.as_matrix() + rng.normal(0.0, 0.01, push.shape)
    gyro = np.outer(rate, TRUE_R.as_matrix()[2]) + rng.normal(0.0, 1e-3, push.shape)
    for ns, w, a in zip(_ns(t), gyro, accel, strict=True):
        said.append(say("/imu", reading(ns, w, a), ns))
    t = t[::4]
    noise = rng.normal(0.0, pose_noise, (len(t), 6)) if pose_noise else np.zeros((len(t), 6))
    for ns, (x, y, yaw), off in zip(_ns(t), _derivative(t, 0).T, noise, strict=True):
        turned = Rotation.from_rotvec(off[3:]) * Rotation.from_euler("z", yaw)
        place = np.array([x, y, 0.0]) + off[:3]
        message = tf(ns, "odom", "base_link", place, turned.as_quat())
        said.append(say("/tf", message, ns + 1))
    log = write_log(folder / "log", sorted(said, key=lambda each: each.log_ns), "mcap2")
    urdf = folder / "cart.urdf"
    urdf.write_text(URDF.format(z=z))
    return log, urdf


def with_a_camera_frame(folder: Path, rpy: str) -> Path:
    """The IMU's joint in the axes of a camera that the base carries."""
    R = Rotation.from_euler("xyz", [float(each) for each in rpy.split()])
    xyz = R.inv().apply([0.29, -0.09, 0.08])
    turn = (R.inv() * TRUE_R).as_euler("xyz")
    urdf = folder / "camera.urdf"
    urdf.write_text(f"""<robot name="cart">
  <link name="base_link"/> <link name="camera"/> <link name="imu_link"/>
  <joint name="camera_joint" type="fixed">
    <parent link="base_link"/> <child link="camera"/> <origin rpy="{rpy}"/>
  </joint>
  <joint name="imu_joint" type="fixed">
    <parent link="camera"/> <child link="imu_link"/>
    <origin xyz="{" ".join(map(repr, xyz.tolist()))}" rpy="{" ".join(map(repr, turn.tolist()))}"/>
  </joint>
</robot>""")
    return urdf


def _ns(t: NDArray[np.float64]) -> list[int]:
    return [START_NS + round(each * 1e9) for each in t.tolist()]
