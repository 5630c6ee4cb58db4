"""Names of Unitree's motors and IMUs in Unitree's URDFs; their messages only number them.

The order of motors is that of the low-level examples of unitree_sdk2_python (commit 37116c5): Go2,
B2, Go2W, H1, G1, H1_2, H2. The names are those of unitree_ros (commit d6f13aa).
"""

_LEGS = ("FR", "FL", "RR", "RL")
_DOGS = tuple(f"{leg}_{part}_joint" for leg in _LEGS for part in ("hip", "thigh", "calf"))
_WHEELS = tuple(f"{leg}_foot_joint" for leg in _LEGS)


def _sided(side: str, *parts: str) -> tuple[str, ...]:
    return tuple(f"{side}_{part}_joint" for part in parts)


_SHOULDER = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow")
_ARM = (*_SHOULDER, "wrist_roll", "wrist_pitch", "wrist_yaw")
_BOTH_ARMS = (*_sided("left", *_ARM), *_sided("right", *_ARM))
_WAIST = ("waist_yaw_joint", "waist_roll_joint", "waist_pitch_joint")
_H1 = (
    *_sided("right", "hip_roll", "hip_pitch", "knee"),
    *_sided("left", "hip_roll", "hip_pitch", "knee"),
    "torso_joint",
    "left_hip_yaw_joint",
    "right_hip_yaw_joint",
    "",
    "left_ankle_joint",
    "right_ankle_joint",
    *_sided("right", *_SHOULDER),
    *_sided("left", *_SHOULDER),
)
_G1_LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
_H2_LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_roll", "ankle_pitch")
_H1_2_LEG = ("hip_yaw", "hip_pitch", "hip_roll", "knee", "ankle_pitch", "ankle_roll")
_G1 = (*_sided("left", *_G1_LEG), *_sided("right", *_G1_LEG), *_WAIST, *_BOTH_ARMS)
_H2 = (
    *_sided("left", *_H2_LEG),
    *_sided("right", *_H2_LEG),
    *_WAIST,
    *_BOTH_ARMS,
    "head_pitch_joint",
    "head_yaw_joint",
)
_H1_2 = (*_sided("left", *_H1_2_LEG), *_sided("right", *_H1_2_LEG), "torso_joint", *_BOTH_ARMS)

JOINTS_GO = {"Go2": _DOGS, "Go2W": (*_DOGS, *_WHEELS), "H1": _H1}
"""Joints of unitree_go by robot, in the order of the motors; empty for an unused motor."""
JOINTS_HG = {"G1": _G1, "H1_2": _H1_2, "H2": _H2}
"""Joints of unitree_hg, likewise."""
TRUNK = ("imu", "imu_link")
"""Links of the IMU of unitree_go: of Go2, of H1 and B2."""
PELVIS = ("imu_in_pelvis", "imu_link")
"""Links of the IMU of unitree_hg: of G1, of H1_2."""
TORSO = ("imu_in_torso",)
"""Link of the second IMU of unitree_hg, /secondary_imu."""
