"""Compare our result with Kalibr's for the same IMU, and with the truth of a simulation.

Kalibr writes ``*-camchain-imucam.yaml`` (kalibr_calibrate_imu_camera), ``imucalib simulate``
writes ``<log>.truth.yaml``.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from msgspec import Meta

from imucalib_cli.arrays import Floats
from imucalib_cli.digits import figures
from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.findings import warning
from imucalib_cli.guarded_yaml import YamlError, load_one
from imucalib_cli.layout import Table
from imucalib_cli.results.codec import FARTHEST, ROTATIONS_AGREE, convert
from imucalib_cli.results.comparison import answers
from imucalib_cli.results.comparison.pose_comparison import compare_poses
from imucalib_cli.results.fields import mm_and_deg, numbers
from imucalib_cli.results.from_estimate import pose_entry
from imucalib_cli.results.pose import pose_error
from imucalib_cli.results.result import SCHEMA, Result
from imucalib_cli.robot.mount import fixed_transform
from imucalib_cli.robot.rotations import matrix_from_quaternion, nearest_rotation
from imucalib_cli.tree import Tree, Vector3, plain

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.layout import Block
    from imucalib_cli.results.comparison.pose_comparison import PoseComparison
    from imucalib_cli.results.pose import UncertainPose
    from imucalib_cli.robot.urdf import Robot

Pose = tuple[Floats, Floats]
"""R (3, 3) and t (3,), m."""
_Four = Annotated[list[float], Meta(min_length=4, max_length=4)]
_Matrix4 = Annotated[list[_Four], Meta(min_length=4, max_length=4)]

OPTICAL = "_optical_frame"
"""REP 103's suffix of frames whose z is forward, which Kalibr's cameras are."""
_FAR = {"translation": 0.5, "rotation": math.radians(20.0)}
"""m and rad: two calibrations of one mount differ by less, a wrong camera frame by more."""
_LEAST = (15, 30, 30)
"""Widths of the summary's first columns, with which later lines are aligned."""
_ROUNDING = 1e-4
"""How far a rotation that was rounded in copying may be from orthonormal."""
KALIBR = "the -camchain-imucam.yaml that kalibr_calibrate_imu_camera writes"
TRUTH = "the truth.yaml that imucalib simulate writes next to a log"
"""What the two files should be, for messages."""


class Camera(Tree, frozen=True):
    """The IMU in one camera of Kalibr's chain, or in the simulated one."""

    T_cam_imu: _Matrix4
    """Maps coordinates of the IMU to the camera's optical frame."""
    timeshift_cam_imu: float | None = None
    """s, IMU stamp - camera stamp of the same instant (Kalibr's IccUtil.py, printResults: t_imu =
    t_cam + shift); null where it was not estimated."""

    def __post_init__(self) -> None:
        R, _ = self.pose
        if (
            not np.abs(self.T_cam_imu).max() <= FARTHEST  # nor nan; squares may overflow
            or np.abs(R.T @ R - np.eye(3)).max() > _ROUNDING
            or abs(np.linalg.det(R) - 1.0) > _ROUNDING
            or np.abs(np.subtract(self.T_cam_imu[3], [0.0, 0.0, 0.0, 1.0])).max() > _ROUNDING
        ):
            raise ValueError(
                "T_cam_imu should be a rotation and a translation above the row 0 0 0 1"
            )

    @property
    def pose(self) -> Pose:
        """Of the IMU in the optical frame."""
        T = np.array(self.T_cam_imu)
        return T[:3, :3], T[:3, 3]


class TrueTransform(Tree, frozen=True):
    """Of the IMU in its parent link."""

    parent: str
    child: str
    translation: Vector3
    rotation_xyzw: _Four

    def __post_init__(self) -> None:
        if abs(math.hypot(*self.rotation_xyzw) - 1.0) > ROTATIONS_AGREE:
            raise ValueError("rotation_xyzw should have norm 1")

    @property
    def pose(self) -> Pose:
        """Of the IMU in the parent link."""
        return matrix_from_quaternion(self.rotation_xyzw), np.array(self.translation)


class Truth(Tree, frozen=True):
    """The truth about one IMU of a simulated log, as far as it is read from its file."""

    transform: TrueTransform
    time_offset: float
    """s, IMU stamp - robot stamp."""
    camera: Camera | None = None


def read_kalibr(text: str, name: str, camera: str) -> Camera:
    """One camera from the text of Kalibr's result; ``name`` is its file, for messages.

    Raises InputError where it is another file or has an impossible value, ChoiceError where it has
    no such camera.
    """
    loaded = _mapping(text, name)
    cameras = [str(key) for key in loaded if str(key).startswith("cam")]
    if camera in cameras:
        return convert(loaded[camera], Camera, name, KALIBR, where=camera)
    if cameras:
        raise ChoiceError(f"--camera {camera}: {name} has {', '.join(cameras)}")
    raise InputError(f"{name}: holds no cam0: it should be {KALIBR}")


def read_truth(text: str, name: str) -> Truth:
    """``<log>.truth.yaml`` of ``imucalib simulate``; InputError for another or a damaged file."""
    return convert(_mapping(text, name), Truth, name, TRUTH)


def _mapping(text: str, name: str) -> dict[Any, Any]:
    """The mapping in a YAML file; empty where there is none."""
    try:
        loaded = load_one(text)
    except YamlError as error:
        raise InputError(f"{name}: not YAML: {error}") from error
    return loaded if isinstance(loaded, dict) else {}


def compare_with_kalibr(
    result: tuple[str, Result],
    kalibr: tuple[str, str, Camera],
    robot: Robot,
    *,
    camera_link: str,
    truth: tuple[str, Truth] | None,
) -> tuple[answers.KalibrAnswer, tuple[Block, ...]]:
    """Express both results in both frames through the URDF's fixed joints, also in words.

    Each result is compared with the truth in the frame in which it was estimated, so that a wrong
    camera pose in the URDF counts against neither. The files come with their names, that of Kalibr
    also with the camera's; ``camera_link`` is its optical frame.

    Raises:
        ChoiceError: A frame is not in the URDF, a joint between them moves, or the truth is of
            another IMU or parent.
    """
    (file, ours), (kalibr_file, camera_name, camera) = result, kalibr
    found, shift = ours.uncertain_pose, camera.timeshift_cam_imu
    R, p = fixed_transform(robot, found.parent, camera_link)
    R_camera, t_camera = nearest_rotation(camera.pose[0]), camera.pose[1]
    our_pose, kalibr_pose = (found.R, found.t), (R @ R_camera, p + R @ t_camera)
    nominal = error = kalibr_error = true = None
    if found.child in robot.links:
        nominal = fixed_transform(robot, found.parent, found.child)
    if truth is not None:
        true = _true_pose(*truth, file, found)
        error = _distance(our_pose, truth[1].transform.pose)
        kalibr_error = _distance(kalibr_pose, truth[1].transform.pose)
        if truth[1].camera is not None:
            kalibr_error = _distance((R_camera, t_camera), truth[1].camera.pose)

    def poses(pose: Pose) -> dict[str, Any]:
        in_camera = R.T @ pose[0], R.T @ (pose[1] - p)
        return {"T_camera_imu": pose_entry(*in_camera), "T_parent_imu": pose_entry(*pose)}

    apart = compare_poses(found, found.exactly(*kalibr_pose))
    times = None if shift is None else _time_shifts(ours, shift, true)
    far = any(part.norm > _FAR[part.kind] for part in apart.parts if not len(part.unknown))
    others = [link for link in robot.links if link.endswith(OPTICAL) and link != camera_link]
    doubt = warning("compare.frames_far", camera_link=camera_link, others=others).message
    answer = answers.KalibrAnswer(
        schema=SCHEMA,
        comparison="kalibr",
        status=ours.status,
        reason=_reason(ours, apart, (error, kalibr_error), times),
        parent=ours.parent,
        child=ours.child,
        camera_link=camera_link,
        urdf=str(robot.source),
        **apart.entries(),
        test=apart.test(),
        time=times,
        warnings=[doubt] if far else [],
        imucalib=answers.OurPose(
            file=file,
            **poses(our_pose),
            from_nominal=_distance(our_pose, nominal),
            error=error,
            time_offset=plain(ours.time_offset.seconds),
        ),
        kalibr=answers.KalibrPose(
            file=kalibr_file,
            camera=camera_name,
            **poses(kalibr_pose),
            from_nominal=_distance(kalibr_pose, nominal),
            error=kalibr_error,
            timeshift_cam_imu=plain(shift),
        ),
        nominal=None if nominal is None else answers.FramePoses(**poses(nominal)),
        truth=true,
    )
    return answer, tuple(_blocks(answer, apart))


def _true_pose(name: str, truth: Truth, file: str, found: UncertainPose) -> answers.TruthPose:
    """The truth as answers write it; ChoiceError where it is of another IMU than the result."""
    true, camera = truth.transform, truth.camera
    if (true.parent, true.child) != (found.parent, found.child):
        raise ChoiceError(
            f"{name} is of {true.child} in {true.parent}, {file} of {found.child} in "
            f"{found.parent}: give the truth of the same log, or run with the same --parent"
        )
    return answers.TruthPose(
        file=name,
        T_camera_imu=None if camera is None else pose_entry(*camera.pose),
        T_parent_imu=pose_entry(*true.pose),
        time_offset=plain(truth.time_offset),
        timeshift_cam_imu=None if camera is None else plain(camera.timeshift_cam_imu),
    )


def _distance(pose: Pose, other: Pose | None) -> answers.Distance | None:
    if other is None:
        return None
    error = pose_error(*pose, *other)
    return answers.Distance(
        distance_mm=plain(error.translation * 1e3),
        angle_deg=plain(math.degrees(error.rotation)),
        averaged=answers.Averaged(
            metric="ATOM compareTransforms: |mean of x y z|, mean of |roll| |pitch| |yaw|",
            translation_mm=plain(error.averaged_translation * 1e3),
            rotation_deg=plain(math.degrees(error.averaged_rotation)),
        ),
    )


def _time_shifts(
    result: Result, shift: float, truth: answers.TruthPose | None
) -> answers.TimeShifts:
    def milliseconds(value: float | None, true: float | None = 0.0) -> Any:
        return None if value is None or true is None else plain((value - true) * 1e3)

    offset = result.time_offset.seconds
    return answers.TimeShifts(
        difference_ms=milliseconds(shift, offset),
        sigma_ms=milliseconds(result.time_offset.std),
        camera_offset_ms=milliseconds(offset - shift),
        imucalib_error_ms=milliseconds(offset, None if truth is None else truth.time_offset),
        kalibr_error_ms=milliseconds(shift, None if truth is None else truth.timeshift_cam_imu),
    )


def _reason(
    result: Result,
    apart: PoseComparison,
    errors: tuple[answers.Distance | None, answers.Distance | None],
    times: answers.TimeShifts | None,
) -> str:
    said = f"{result.child} in {result.parent}: Kalibr's pose is {apart} from ours"
    if apart.in_sigmas:
        said += f", which is {apart.in_sigmas} of ours"
    for name, error in zip(("ours", "Kalibr's"), errors, strict=True):
        if error is not None:
            said += f"; {name} is {_words(error)} off the truth"
    return said if times is None else f"{said}; {_camera_clock_words(times)}"


def _words(distance: answers.Distance) -> str:
    return mm_and_deg(distance.distance_mm, distance.angle_deg, 3)


def _camera_clock_words(times: answers.TimeShifts) -> str:
    """The offset of the camera's clock that both time shifts imply."""
    late = times.camera_offset_ms
    return (
        f"by both time shifts the camera's stamps are {figures(abs(late), 3)} ms "
        f"{'early' if late < 0.0 else 'late'} against the robot's"
    )


def _blocks(answer: answers.KalibrAnswer, apart: PoseComparison) -> Iterator[Block]:
    """Both results in two columns, then the difference."""
    ours, theirs, times = answer.imucalib, answer.kalibr, answer.time
    yield f"{answer.child} in {answer.parent}: Kalibr's pose and ours"
    yield f"  ours from {ours.file}: {answer.status}"
    yield f"  Kalibr's from {theirs.file}: {theirs.camera} at {answer.camera_link} of {answer.urdf}"
    yield ""
    both = ours.T_parent_imu, theirs.T_parent_imu
    rows = [
        ("xyz", *(numbers(each.translation, 6) for each in both), f"m, in {answer.parent}"),
        ("rpy", *(numbers(each.rotation_rpy, 6) for each in both), "rad, about fixed x, y, z"),
    ]
    for name, mine, his in (
        ("from nominal", ours.from_nominal, theirs.from_nominal),
        ("off the truth", ours.error, theirs.error),
    ):
        if mine is not None and his is not None:
            rows.append((name, _words(mine), _words(his), ""))
    if times is not None and ours.time_offset is not None and theirs.timeshift_cam_imu is not None:
        shifts = (
            _milliseconds(1e3 * each) for each in (ours.time_offset, theirs.timeshift_cam_imu)
        )
        rows.append(("time shift", *shifts, "IMU stamp less the robot's, the camera's"))
        if times.imucalib_error_ms is not None:
            errors = map(_milliseconds, (times.imucalib_error_ms, times.kalibr_error_ms))
            rows.append(("its error", *errors, ""))
    yield Table(("", "ours", "Kalibr's", ""), tuple(rows), least=_LEAST)
    yield ""
    yield f"  Kalibr's - ours  {apart}"
    yield f"                   {' and '.join(part.vector_words for part in apart.parts)}"
    if apart.in_sigmas:
        yield f"                   {apart.in_sigmas} of ours: Kalibr's file has none"
    if times is not None:
        yield f"  clocks           {_camera_clock_words(times)}"
    yield from (f"  warning: {said}" for said in answer.warnings)


def _milliseconds(value: float | None) -> str:
    return "" if value is None else f"{figures(value, 5)} ms"
