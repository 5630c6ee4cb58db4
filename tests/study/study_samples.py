"""Small studies, a view of the pattern, and the errors of answers."""

from dataclasses import replace
from typing import Any

from imucalib_cli.results.pose import PoseError, pose_error
from imucalib_cli.simulate.camera.view import camera_mount
from imucalib_cli.simulate.camera_config import load_camera
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.options import PhysicsOptions
from imucalib_cli.simulate.physics import record
from imucalib_cli.simulate.recording import Recording
from imucalib_cli.study.method_runs import Answer
from imucalib_cli.study.study import load_study


def study(name: str, *, quick: bool = True, **changes: Any) -> Any:
    """A study of any kind, with some parameters changed."""
    return replace(load_study(name, quick=quick), **changes)


def before_the_pattern(seconds: float, imu_rate: float) -> Recording:
    system, camera = load_camera("rihibot", load_system("rihibot"))
    physics = PhysicsOptions(duration=seconds, imu_rate=imu_rate, robot_rate=20.0)
    return record(system, physics, camera=camera)


def error(answer: Answer, recording: Recording) -> PoseError:
    """Of the pose in the frame that the method solves for."""
    R, t = recording.R_parent_imu, recording.t_parent_imu
    if answer.frame == "camera":
        _, R_parent_camera, p = camera_mount(recording.system, "camera_optical_frame")
        R, t = R_parent_camera.T @ R, R_parent_camera.T @ (t - p)
    return pose_error(answer.T_frame_imu.R, answer.T_frame_imu.t, R, t)
