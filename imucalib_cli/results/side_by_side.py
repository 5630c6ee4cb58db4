"""A result of ours beside one of Kalibr, in the camera's frame and in the parent link's."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.digits import figures
from imucalib_cli.errors import ChoiceError
from imucalib_cli.findings import Finding, warning, warnings
from imucalib_cli.results.difference import Difference, difference
from imucalib_cli.results.difference_words import both_words, sigmas_words
from imucalib_cli.results.pose_error import PoseError, pose_error
from imucalib_cli.results.uncertain_pose import UncertainPose, fixed_transform, pose_of

if TYPE_CHECKING:
    from imucalib_cli.results.kalibr_result import KalibrResult
    from imucalib_cli.results.movement import Side
    from imucalib_cli.results.true_pose import TruePose
    from imucalib_cli.robot.urdf import Robot

Floats = NDArray[np.float64]
Pose = tuple[Floats, Floats]
"""R (3, 3) and t (3,), m."""

OPTICAL = "_optical_frame"
"""REP 103's suffix of frames whose z is forward, which Kalibr's cameras are."""
_FAR = {"translation": 0.5, "rotation": math.radians(20.0)}
"""m and rad: two calibrations of one mount are nearer, the wrong frame of a camera is farther."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Opinion:
    """Where somebody takes the IMU to be."""

    camera_imu: Pose
    parent_imu: Pose
    from_nominal: PoseError | None
    """Distance from the URDF's own opinion; None where it has none."""
    error: PoseError | None
    """Distance from the truth, where it was told."""


@dataclass(frozen=True, kw_only=True)
class TimeShifts:
    """Of the IMU's stamps: ours against the robot's, Kalibr's against the camera's."""

    offset: float
    """s, IMU stamp - robot stamp."""
    std: float | None
    """s, 1 sigma of ours."""
    shift: float
    """s, IMU stamp - camera stamp."""
    true_offset: float | None
    true_shift: float | None

    @property
    def camera_offset(self) -> float:
        """Camera stamp - robot stamp of the same instant, s, if both are right."""
        return self.offset - self.shift


@dataclass(frozen=True, kw_only=True, eq=False)
class SideBySide:
    """Both results of one IMU."""

    side: Side
    """Our result."""
    kalibr: KalibrResult
    camera_link: str
    urdf: str
    ours: Opinion
    theirs: Opinion
    nominal: Opinion | None
    difference: Difference
    """Kalibr's less ours in the parent's frame. Its covariance is ours alone: Kalibr's file has
    none."""
    truth: TruePose | None
    findings: tuple[Finding, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings in words."""
        return warnings(self.findings)

    @property
    def times(self) -> TimeShifts | None:
        """None where Kalibr estimated no time shift."""
        if self.kalibr.timeshift is None:
            return None
        estimate = self.side.calibration.estimate
        return TimeShifts(
            offset=estimate.time_offset,
            std=estimate.time_offset_std,
            shift=self.kalibr.timeshift,
            true_offset=None if self.truth is None else self.truth.time_offset,
            true_shift=None if self.truth is None else self.truth.timeshift,
        )

    @property
    def reason(self) -> str:
        """One sentence with the figures."""
        apart, calibration = self.difference, self.side.calibration
        surely = [sigmas_words(part) for part in apart.parts if part.meaningful]
        said = (
            f"{calibration.child} in {calibration.parent}: Kalibr's pose is {both_words(apart)} "
            "from ours"
        )
        if any(surely):
            said += f", which is {' and '.join(filter(None, surely))} of ours"
        for name, opinion in (("ours", self.ours), ("Kalibr's", self.theirs)):
            if opinion.error is not None:
                said += f"; {name} is {error_words(opinion.error)} off the truth"
        if self.times is not None:
            said += f"; {camera_clock_words(self.times)}"
        return said


def side_by_side(
    side: Side,
    kalibr: KalibrResult,
    robot: Robot,
    camera_link: str,
    truth: TruePose | None = None,
) -> SideBySide:
    """Express both results in both frames through the URDF's fixed joints.

    Args:
        side: Our result, and the name of its file.
        kalibr: Kalibr's.
        robot: The URDF, whose fixed joints lead from the parent link to the camera.
        camera_link: The camera's optical frame in it.
        truth: What is true, if anybody knows. Each is held against it in the frame that it was
            estimated in, so that a camera that is drawn wrong counts against neither.

    Raises:
        ChoiceError: A frame is not in the URDF, or a joint between them moves; or the truth is of
            another IMU or parent.
    """
    found = pose_of(side.calibration)
    if truth is not None and (truth.parent, truth.child) != (found.parent, found.child):
        raise ChoiceError(
            f"{truth.file} is of {truth.child} in {truth.parent}, {side.name} of {found.child} in "
            f"{found.parent}: give the truth of the same log, or run with the same --parent"
        )
    R, p = fixed_transform(robot, found.parent, camera_link)
    told = R @ kalibr.R_camera_imu, p + R @ kalibr.t_camera_imu
    drawn = None
    if found.child in robot.links:
        drawn = fixed_transform(robot, found.parent, found.child)
    our_error, their_error = None, None
    if truth is not None:
        true = truth.R_parent_imu, truth.t_parent_imu
        our_error, their_error = pose_error(found.R, found.t, *true), pose_error(*told, *true)
        if truth.T_camera_imu is not None:
            T = truth.T_camera_imu
            their_error = pose_error(kalibr.R_camera_imu, kalibr.t_camera_imu, T[:3, :3], T[:3, 3])

    def opinion(pose: Pose, error: PoseError | None) -> Opinion:
        return Opinion(
            camera_imu=(R.T @ pose[0], R.T @ (pose[1] - p)),
            parent_imu=pose,
            from_nominal=None if drawn is None else pose_error(*pose, *drawn),
            error=error,
        )

    apart = difference(found, _exact(found, told))
    return SideBySide(
        side=side,
        kalibr=kalibr,
        camera_link=camera_link,
        urdf=str(robot.source),
        ours=opinion((found.R, found.t), our_error),
        theirs=opinion(told, their_error),
        nominal=None if drawn is None else opinion(drawn, None),
        difference=apart,
        truth=truth,
        findings=_findings(apart, camera_link, robot),
    )


def _findings(apart: Difference, camera_link: str, robot: Robot) -> tuple[Finding, ...]:
    """What makes it likely that a frame was taken for another."""
    known = [part for part in apart.parts if not len(part.unknown)]
    if not any(part.norm > _FAR[part.kind] for part in known):
        return ()
    others = [link for link in robot.links if link.endswith(OPTICAL) and link != camera_link]
    return (warning("compare.frames_far", camera_link=camera_link, others=others),)


def _exact(found: UncertainPose, pose: Pose) -> UncertainPose:
    """A pose that is told without its uncertainty."""
    return UncertainPose(
        parent=found.parent,
        child=found.child,
        R=pose[0],
        t=pose[1],
        covariance=np.zeros((6, 6)),
        unknown_translation=np.zeros((0, 3)),
        unknown_rotation=np.zeros((0, 3)),
    )


def error_words(error: PoseError) -> str:
    """Such as ``0.12 mm and 0.003 deg``."""
    return (
        f"{figures(error.translation * 1e3, 3)} mm and "
        f"{figures(math.degrees(error.rotation), 3)} deg"
    )


def camera_clock_words(times: TimeShifts) -> str:
    """What both time shifts together say about the camera's clock."""
    late = times.camera_offset * 1e3
    return (
        f"by both time shifts the camera's stamps are {figures(abs(late), 3)} ms "
        f"{'early' if late < 0.0 else 'late'} against the robot's"
    )
