"""Every method of the comparison on the same data, each as its user would set it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import PaperOptions, WindowChoice
from imucalib_cli.estimate.paper import calibrate_paper
from imucalib_cli.study.contest import exact_system, pose_only
from imucalib_cli.study.methods.answer import Answer
from imucalib_cli.study.methods.bspline import calibrate_bspline
from imucalib_cli.study.methods.bspline_camera import calibrate_bspline_camera
from imucalib_cli.study.methods.gyro_first import GyroFirstOptions, calibrate_gyro_first
from imucalib_cli.study.methods.liang import LiangOptions, calibrate_liang
from imucalib_cli.study.paper_setting import PaperSetting

if TYPE_CHECKING:
    from collections.abc import Callable

    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples
    from imucalib_cli.study.methods.bspline_problem import BSplineOptions
    from imucalib_cli.study.methods.hand_eye import Ransac
    from imucalib_cli.study.methods.pnp import CameraObservations
    from imucalib_cli.study.methods.strapdown import StillOptions

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Given:
    """What all methods are given of one recording; each takes its part."""

    imu: ImuSamples
    path: KinematicPath
    camera: CameraObservations
    gravity_norm: float
    """m/s²."""
    R_nominal: Floats
    """(3, 3), R_parent_imu as the URDF states it: the published method's guess."""
    t_nominal: Floats
    """(3,), m."""
    spline: BSplineOptions
    """With the IMU's noise as its data sheet states it."""
    few_knots_per_second: float
    """Of the spline whose user knows that this motion needs no more."""
    gyro_first: GyroFirstOptions
    still: StillOptions
    published_ransac: Ransac
    tuned_ransac: Ransac


@dataclass(frozen=True, kw_only=True)
class PaperEntry(PaperSetting):
    """The published method as it takes part."""

    residual: Literal["l1", "components"]

    @property
    def words(self) -> str:
        """For tables."""
        return f"{super().words}, {self.residual}"


def paper(setting: PaperEntry, given: Given) -> Answer:
    """The published method."""
    options = PaperOptions(
        window=WindowChoice(samples=setting.window),
        exclusion_threshold=setting.exclusion,
        residual=setting.residual,
        gravity_norm=given.gravity_norm,
        R_initial=given.R_nominal,
        t_initial=given.t_nominal,
    )
    return _answer(calibrate_paper(given.imu, given.path, options))


def matched(given: Given) -> Answer:
    """Ours with all its unknowns."""
    return _answer(calibrate_matched(given.imu, given.path, exact_system(given.gravity_norm)))


def matched_pose_alone(given: Given) -> Answer:
    """Ours with the unknowns of the published method."""
    return _answer(calibrate_matched(given.imu, given.path, pose_only(given.gravity_norm)))


def gyro_first(given: Given) -> Answer:
    """Wahba's problem, then the lever arm."""
    return calibrate_gyro_first(given.imu, given.path, given.gyro_first)


def spline_on_poses(given: Given) -> Answer:
    """B-spline batch on kinematic poses."""
    return calibrate_bspline(given.imu, given.path, given.spline)


def spline_with_few_knots(given: Given) -> Answer:
    """The same with as few knots as this motion needs."""
    sparse = replace(given.spline, knots_per_second=given.few_knots_per_second)
    return calibrate_bspline(given.imu, given.path, sparse)


def spline_on_poses_alone(given: Given) -> Answer:
    """The same with the unknowns of the published method."""
    known = replace(given.spline, gravity="fixed", time_offset=0.0, biases=False)
    return calibrate_bspline(given.imu, given.path, known)


def spline_on_corners(given: Given) -> Answer:
    """B-spline batch on what Kalibr is given."""
    return calibrate_bspline_camera(given.imu, given.camera, given.spline)


def hand_eye(given: Given) -> Answer:
    """Hand-eye with RANSAC, as published."""
    options = LiangOptions(
        ransac=given.published_ransac, still=given.still, gravity_norm=given.gravity_norm
    )
    return calibrate_liang(given.imu, given.camera, options)


def hand_eye_tuned(given: Given) -> Answer:
    """The same, tuned for start-stop motion."""
    options = LiangOptions(
        tuned=True,
        ransac=given.tuned_ransac,
        still=given.still,
        gravity_norm=given.gravity_norm,
    )
    return calibrate_liang(given.imu, given.camera, options)


def _answer(estimate: Estimate) -> Answer:
    evaluations = estimate.notes.get("evaluations")
    return Answer(
        frame="parent",
        R_frame_imu=estimate.R_parent_imu,
        t_frame_imu=estimate.t_parent_imu,
        time_offset=None if estimate.time_offset_std is None else estimate.time_offset,
        evaluations=int(evaluations) if isinstance(evaluations, int | float) else 1,
    )


@dataclass(frozen=True, kw_only=True)
class Entrant:
    """A method that takes part."""

    data: str
    """What it is given beside the IMU."""
    unknowns: str
    call: Callable[[Given], Answer] | None
    """None for the published method, which is called with each of its settings."""

    def calls(self, settings: tuple[PaperEntry, ...]) -> list[Callable[[Given], Answer]]:
        """What to run."""
        return [partial(paper, s) for s in settings] if self.call is None else [self.call]


_ALL = "pose, biases, tilt, offset"
ENTRANTS: dict[str, Entrant] = {
    "paper": Entrant(data="poses", unknowns="pose", call=None),
    "ours, pose only": Entrant(data="poses", unknowns="pose", call=matched_pose_alone),
    "B-spline batch, pose only": Entrant(data="poses", unknowns="pose", call=spline_on_poses_alone),
    "ours": Entrant(data="poses", unknowns=_ALL, call=matched),
    "B-spline batch": Entrant(data="poses", unknowns=_ALL, call=spline_on_poses),
    "B-spline batch, few knots": Entrant(data="poses", unknowns=_ALL, call=spline_with_few_knots),
    "gyro-first hand-eye": Entrant(data="poses", unknowns=_ALL, call=gyro_first),
    "B-spline batch, corners": Entrant(data="corners", unknowns=_ALL, call=spline_on_corners),
    "hand-eye + RANSAC (Liang)": Entrant(data="corners", unknowns="pose, gyro bias", call=hand_eye),
    "hand-eye + RANSAC, tuned": Entrant(
        data="corners", unknowns="pose, biases", call=hand_eye_tuned
    ),
}
"""By the name that tables show."""
