"""A result of ours beside what Kalibr found of the same IMU, and beside the truth of a simulation.

Kalibr writes ``*-camchain-imucam.yaml`` (kalibr_calibrate_imu_camera), ``imucalib simulate``
writes ``<log>.truth.yaml``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from msgspec import UNSET, Meta, UnsetType
from numpy.typing import NDArray

from imucalib_cli.digits import figures
from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.findings import warning
from imucalib_cli.guarded_yaml import YamlError, load_one
from imucalib_cli.results.answers import (
    Distance,
    FramePoses,
    KalibrAnswer,
    KalibrPose,
    OurPose,
    TimeShifts,
    TruthPose,
    distance_entry,
    part_entries,
    test_entry,
)
from imucalib_cli.results.codec import FARTHEST, convert
from imucalib_cli.results.from_estimate import plain, pose_entry
from imucalib_cli.results.pose import pose_error
from imucalib_cli.results.pose_comparison import PoseComparison, compare_poses
from imucalib_cli.results.result import SCHEMA, Result, Tree, Vector3
from imucalib_cli.robot.mount import fixed_transform
from imucalib_cli.robot.rotations import matrix_from_quaternion, nearest_rotation
from imucalib_cli.shown import shown

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.results.pose import PoseError
    from imucalib_cli.robot.urdf import Robot

Floats = NDArray[np.float64]
Pose = tuple[Floats, Floats]
"""R (3, 3) and t (3,), m."""
_Four = Annotated[list[float], Meta(min_length=4, max_length=4)]
_Matrix4 = Annotated[list[_Four], Meta(min_length=4, max_length=4)]

OPTICAL = "_optical_frame"
"""REP 103's suffix of frames whose z is forward, which Kalibr's cameras are."""
_FAR = {"translation": 0.5, "rotation": math.radians(20.0)}
"""m and rad: two calibrations of one mount are nearer, the wrong frame of a camera is farther."""
_ROUNDING = 1e-4
"""How far from orthonormal a rotation may be that was rounded when it was copied."""
KALIBR = "the -camchain-imucam.yaml that kalibr_calibrate_imu_camera writes"
TRUTH = "the truth.yaml that imucalib simulate writes beside a log"
"""What the two files should be, for messages."""


class _Camera(Tree, frozen=True):
    """One camera of Kalibr's chain."""

    T_cam_imu: _Matrix4
    timeshift_cam_imu: float | UnsetType = UNSET


class _TrueTransform(Tree, frozen=True):
    """Of the IMU in its parent link."""

    parent: str
    child: str
    translation: Vector3
    rotation_xyzw: _Four


class _TrueCamera(Tree, frozen=True):
    """Of the simulated camera."""

    T_cam_imu: _Matrix4
    timeshift_cam_imu: float


class _Truth(Tree, frozen=True):
    """What is read of a truth file."""

    transform: _TrueTransform
    time_offset: float
    camera: _TrueCamera | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class KalibrResult:
    """Pose of the IMU in one camera of a chain."""

    file: str
    camera: str
    T_camera_imu: Pose
    timeshift: float | None
    """s, IMU stamp - camera stamp of the same instant; None where it was not estimated."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TruePose:
    """What is true about one IMU of a simulated log."""

    file: str
    parent: str
    child: str
    T_parent_imu: Pose
    T_camera_imu: Pose | None
    """In the optical frame of the simulated camera; None where there was none."""
    time_offset: float
    """s, IMU stamp - robot stamp."""
    timeshift: float | None
    """s, IMU stamp - camera stamp."""


def read_kalibr(text: str, name: str, camera: str = "cam0") -> KalibrResult:
    """Read one camera of Kalibr's result.

    ``T_cam_imu`` maps coordinates of the IMU to the camera's optical frame;
    ``timeshift_cam_imu`` is defined by t_imu = t_cam + shift (Kalibr's IccUtil.py, printResults).

    Args:
        text: Content of the file.
        name: What to call the file in a message.
        camera: Which of the chain.

    Raises:
        InputError: It is no such file, or a value in it cannot be.
        ChoiceError: It has no such camera.
    """
    loaded = _mapping(text, name)
    cameras = [key for key in loaded if str(key).startswith("cam")]
    if not cameras:
        raise InputError(f"{name}: holds no cam0: it should be {KALIBR}")
    if camera not in cameras:
        raise ChoiceError(f"--camera {camera}: {name} has {', '.join(map(str, cameras))}")
    if not isinstance(loaded[camera], dict) or "T_cam_imu" not in loaded[camera]:
        raise InputError(
            f"{name}: {camera} has no T_cam_imu: it should be {KALIBR}, not the camchain it reads"
        )
    found = convert(loaded[camera], _Camera, name, "Kalibr's -camchain-imucam.yaml", where=camera)
    R, t = _pose(found.T_cam_imu, f"{name}: {camera}")
    shift = found.timeshift_cam_imu
    return KalibrResult(
        file=name,
        camera=camera,
        T_camera_imu=(nearest_rotation(R), t),
        timeshift=None if shift is UNSET else shift,
    )


def read_truth(text: str, name: str) -> TruePose:
    """Read ``<log>.truth.yaml`` of ``imucalib simulate``.

    Raises:
        InputError: It is no such file, or a value in it cannot be.
    """
    loaded = _mapping(text, name)
    if not {"transform", "time_offset"} <= set(loaded):
        raise InputError(f"{name}: holds no transform and time_offset: it should be {TRUTH}")
    if isinstance(loaded["time_offset"], dict):
        raise InputError(f"{name}: is a result of imucalib run, no truth: it should be {TRUTH}")
    found = convert(loaded, _Truth, name, "the truth.yaml of `imucalib simulate`")
    transform, camera = found.transform, found.camera
    if abs(math.hypot(*transform.rotation_xyzw) - 1.0) > 1e-6:
        raise InputError(f"{name}: transform.rotation_xyzw should have norm 1")
    return TruePose(
        file=name,
        parent=transform.parent,
        child=transform.child,
        T_parent_imu=(
            matrix_from_quaternion(transform.rotation_xyzw),
            np.array(transform.translation),
        ),
        T_camera_imu=None if camera is None else _pose(camera.T_cam_imu, f"{name}: camera"),
        time_offset=found.time_offset,
        timeshift=None if camera is None else camera.timeshift_cam_imu,
    )


def _pose(rows: list[list[float]], where: str) -> Pose:
    """A transform (4, 4) of a file."""
    T = np.array(rows)
    R, far = T[:3, :3], np.abs(T).max() > FARTHEST  # squares of such numbers may overflow
    if (
        far
        or np.abs(R.T @ R - np.eye(3)).max() > _ROUNDING
        or abs(np.linalg.det(R) - 1.0) > _ROUNDING
        or np.abs(T[3] - [0.0, 0.0, 0.0, 1.0]).max() > _ROUNDING
    ):
        raise InputError(
            f"{where}.T_cam_imu should be a rotation and a translation above the row 0 0 0 1"
        )
    return R, T[:3, 3]


def _mapping(text: str, name: str) -> dict[Any, Any]:
    """The one mapping of a YAML file; an empty one where there is none."""
    try:
        loaded = load_one(text)
    except YamlError as error:
        raise InputError(f"{name}: not YAML: {error}") from error
    return loaded if isinstance(loaded, dict) else {}


@dataclass(frozen=True, kw_only=True, eq=False)
class KalibrComparison:
    """The answer, and what its words are made from."""

    answer: KalibrAnswer
    apart: PoseComparison
    """Kalibr's less ours in the parent's frame. Its covariance is ours alone: Kalibr's file has
    none."""


def compare_with_kalibr(
    file: str,
    result: Result,
    kalibr: KalibrResult,
    robot: Robot,
    *,
    camera_link: str,
    truth: TruePose | None = None,
) -> KalibrComparison:
    """Express both results in both frames through the URDF's fixed joints.

    Args:
        file: Name of our result's file.
        result: Ours.
        kalibr: Kalibr's.
        robot: The URDF, whose fixed joints lead from the parent link to the camera.
        camera_link: The camera's optical frame in it.
        truth: What is true, if anybody knows. Each is held against it in the frame that it was
            estimated in, so that a camera that is drawn wrong counts against neither.

    Raises:
        ChoiceError: A frame is not in the URDF, or a joint between them moves; or the truth is of
            another IMU or parent.
    """
    found = result.uncertain_pose
    if truth is not None and (truth.parent, truth.child) != (found.parent, found.child):
        raise ChoiceError(
            f"{truth.file} is of {truth.child} in {truth.parent}, {file} of {found.child} in "
            f"{found.parent}: give the truth of the same log, or run with the same --parent"
        )
    R, p = fixed_transform(robot, found.parent, camera_link)
    ours, theirs = (found.R, found.t), (R @ kalibr.T_camera_imu[0], p + R @ kalibr.T_camera_imu[1])
    nominal = None
    if found.child in robot.links:
        nominal = fixed_transform(robot, found.parent, found.child)
    our_error, their_error = None, None
    if truth is not None:
        our_error = pose_error(*ours, *truth.T_parent_imu)
        their_error = pose_error(*theirs, *truth.T_parent_imu)
        if truth.T_camera_imu is not None:
            their_error = pose_error(*kalibr.T_camera_imu, *truth.T_camera_imu)

    def poses(pose: Pose) -> FramePoses:
        return FramePoses(pose_entry(R.T @ pose[0], R.T @ (pose[1] - p)), pose_entry(*pose))

    def entries(pose: Pose, error: PoseError | None) -> dict[str, Any]:
        both = poses(pose)
        return {
            "T_camera_imu": both.T_camera_imu,
            "T_parent_imu": both.T_parent_imu,
            "from_nominal": None
            if nominal is None
            else distance_entry(pose_error(*pose, *nominal)),
            "error": None if error is None else distance_entry(error),
        }

    apart = compare_poses(found, found.exactly(*theirs))
    our_pose = OurPose(
        file=file, time_offset=plain(result.time_offset.seconds), **entries(ours, our_error)
    )
    kalibr_pose = KalibrPose(
        file=kalibr.file,
        camera=kalibr.camera,
        timeshift_cam_imu=plain(kalibr.timeshift),
        **entries(theirs, their_error),
    )
    times = None if kalibr.timeshift is None else _time_shifts(result, kalibr.timeshift, truth)
    translation, rotation = part_entries(apart)
    answer = KalibrAnswer(
        schema=SCHEMA,
        comparison="kalibr",
        status=result.status,
        reason=_reason(result, apart, our_pose, kalibr_pose, times),
        parent=result.parent,
        child=result.child,
        camera_link=camera_link,
        urdf=str(robot.source),
        translation=translation,
        rotation=rotation,
        test=test_entry(apart.test()),
        time=times,
        warnings=_warnings(apart, camera_link, robot),
        imucalib=our_pose,
        kalibr=kalibr_pose,
        nominal=None if nominal is None else poses(nominal),
        truth=None if truth is None else _truth_entry(truth),
    )
    return KalibrComparison(answer=answer, apart=apart)


def _time_shifts(result: Result, shift: float, truth: TruePose | None) -> TimeShifts:
    def milliseconds(value: float | None, true: float | None = 0.0) -> Any:
        return None if value is None or true is None else plain((value - true) * 1e3)

    offset = result.time_offset.seconds
    return TimeShifts(
        difference_ms=milliseconds(shift, offset),
        sigma_ms=milliseconds(result.time_offset.std),
        camera_offset_ms=milliseconds(offset - shift),
        imucalib_error_ms=milliseconds(offset, None if truth is None else truth.time_offset),
        kalibr_error_ms=milliseconds(shift, None if truth is None else truth.timeshift),
    )


def _truth_entry(truth: TruePose) -> TruthPose:
    return TruthPose(
        file=truth.file,
        T_camera_imu=None if truth.T_camera_imu is None else pose_entry(*truth.T_camera_imu),
        T_parent_imu=pose_entry(*truth.T_parent_imu),
        time_offset=plain(truth.time_offset),
        timeshift_cam_imu=plain(truth.timeshift),
    )


def _warnings(apart: PoseComparison, camera_link: str, robot: Robot) -> list[str]:
    """What makes it likely that a frame was taken for another."""
    known = [part for part in apart.parts if not len(part.unknown)]
    if not any(part.norm > _FAR[part.kind] for part in known):
        return []
    others = [link for link in robot.links if link.endswith(OPTICAL) and link != camera_link]
    return [warning("compare.frames_far", camera_link=camera_link, others=others).message]


def _reason(
    result: Result,
    apart: PoseComparison,
    ours: OurPose,
    theirs: KalibrPose,
    times: TimeShifts | None,
) -> str:
    """One sentence with the figures."""
    said = f"{result.child} in {result.parent}: Kalibr's pose is {apart} from ours"
    if apart.in_sigmas:
        said += f", which is {apart.in_sigmas} of ours"
    for name, error in (("ours", ours.error), ("Kalibr's", theirs.error)):
        if error is not None:
            said += f"; {name} is {_distance_words(error)} off the truth"
    return said if times is None else f"{said}; {_camera_clock_words(times)}"


def _distance_words(distance: Distance) -> str:
    """Such as ``0.12 mm and 0.003 deg``."""
    return f"{figures(distance.distance_mm, 3)} mm and {figures(distance.angle_deg, 3)} deg"


def _camera_clock_words(times: TimeShifts) -> str:
    """What both time shifts together say about the camera's clock."""
    late = times.camera_offset_ms
    return (
        f"by both time shifts the camera's stamps are {figures(abs(late), 3)} ms "
        f"{'early' if late < 0.0 else 'late'} against the robot's"
    )


def summarise_comparison(compared: KalibrComparison) -> str:
    """A dozen lines, with a newline at the end: two columns, then what is between them."""
    return "\n".join(map(shown, _lines(compared.answer, compared.apart))) + "\n"


def _lines(answer: KalibrAnswer, apart: PoseComparison) -> Iterator[str]:
    ours, theirs, times = answer.imucalib, answer.kalibr, answer.time
    yield f"{answer.child} in {answer.parent}: Kalibr's pose beside ours"
    yield f"  ours from {ours.file}: {answer.status}"
    yield f"  Kalibr's from {theirs.file}: {theirs.camera} at {answer.camera_link} of {answer.urdf}"
    yield ""
    yield _columns("", "ours", "Kalibr's")
    one, other = ours.T_parent_imu, theirs.T_parent_imu
    places = _numbers(one.translation), _numbers(other.translation)
    yield _columns("xyz", *places, f"m, in {answer.parent}")
    angles = _numbers(one.rotation_rpy), _numbers(other.rotation_rpy)
    yield _columns("rpy", *angles, "rad, about fixed x, y, z")
    for name, mine, his in (
        ("from nominal", ours.from_nominal, theirs.from_nominal),
        ("off the truth", ours.error, theirs.error),
    ):
        if mine is not None and his is not None:
            yield _columns(name, _distance_words(mine), _distance_words(his))
    if times is not None and ours.time_offset is not None and theirs.timeshift_cam_imu is not None:
        both = _milliseconds(ours.time_offset * 1e3), _milliseconds(theirs.timeshift_cam_imu * 1e3)
        yield _columns("time shift", *both, "IMU stamp less the robot's, the camera's")
        if times.imucalib_error_ms is not None:
            error = times.kalibr_error_ms
            his_error = "" if error is None else _milliseconds(error)
            yield _columns("its error", _milliseconds(times.imucalib_error_ms), his_error)
    yield ""
    yield f"  Kalibr's - ours  {apart}"
    yield f"                   {' and '.join(part.vector_words for part in apart.parts)}"
    if apart.in_sigmas:
        yield f"                   {apart.in_sigmas} of ours: Kalibr's file has none"
    if times is not None:
        yield f"  clocks           {_camera_clock_words(times)}"
    yield from (f"  warning: {said}" for said in answer.warnings)


def _columns(name: str, ours: str, theirs: str, words: str = "") -> str:
    return f"  {name:<15}  {ours:<30}  {theirs:<30}  {words}".rstrip()


def _milliseconds(value: float) -> str:
    return f"{figures(value, 5)} ms"


def _numbers(values: list[float]) -> str:
    return " ".join(f"{round(value, 6) + 0.0:.6f}" for value in values)
