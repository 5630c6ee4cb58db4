"""Every method of the comparison on the same data, with the options its user would choose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import PaperOptions
from imucalib_cli.estimate.published.method import calibrate_paper
from imucalib_cli.study.contest import Answer, Pose, exact_system, pose_only
from imucalib_cli.study.methods.bspline import calibrate_bspline, calibrate_bspline_camera
from imucalib_cli.study.methods.gyro_first import GyroFirstOptions, calibrate_gyro_first
from imucalib_cli.study.methods.liang import LiangOptions, calibrate_liang

if TYPE_CHECKING:
    from collections.abc import Callable

    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples
    from imucalib_cli.simulate.recording import CameraRecord
    from imucalib_cli.study.methods.bspline import BSplineOptions


@dataclass(frozen=True, kw_only=True, eq=False)
class Given:
    """Data of one recording for all methods; each uses part of it."""

    imu: ImuSamples
    path: KinematicPath
    camera: CameraRecord
    gravity_norm: float
    """m/s²."""
    nominal: Pose
    """Of the IMU in its parent link as the URDF states it: the published method's guess."""
    spline: BSplineOptions
    """With the IMU's noise from its data sheet."""
    few_knots_per_second: float
    """Options of the spline for a user who knows that this motion needs no more knots."""
    gyro_first: GyroFirstOptions
    liang: LiangOptions
    liang_tuned: LiangOptions


@dataclass(frozen=True)
class Entrant:
    """A method of the comparison."""

    data: str
    """Its data besides the IMU."""
    unknowns: str
    call: Callable[[Given, PaperOptions | None], Answer]
    """With a setting, which the published method alone has."""


def _spline(given: Given, **changes: object) -> Answer:
    options = replace(given.spline, **changes)  # type: ignore[arg-type]
    return calibrate_bspline(given.imu, given.path, options)


def _matched(given: Given, options: MatchedOptions) -> Answer:
    return _answer(calibrate_matched(given.imu, given.path, options))


def _published(given: Given, setting: PaperOptions | None) -> Answer:
    options = replace(
        setting or PaperOptions(),
        gravity_norm=given.gravity_norm,
        R_initial=given.nominal.R,
        t_initial=given.nominal.t,
    )
    return _answer(calibrate_paper(given.imu, given.path, options))


def _answer(estimate: Estimate) -> Answer:
    evaluations = estimate.notes.get("evaluations")
    return Answer(
        frame="parent",
        R_frame_imu=estimate.R_parent_imu,
        t_frame_imu=estimate.t_parent_imu,
        time_offset=None if estimate.time_offset_std is None else estimate.time_offset,
        evaluations=int(evaluations) if isinstance(evaluations, int | float) else 1,
    )


_ALL = "pose, biases, tilt, offset"
ENTRANTS: dict[str, Entrant] = {
    "paper": Entrant("poses", "pose", _published),
    "ours, pose only": Entrant(
        "poses", "pose", lambda g, _: _matched(g, pose_only(g.gravity_norm))
    ),
    "B-spline batch, pose only": Entrant(
        "poses", "pose", lambda g, _: _spline(g, gravity="fixed", time_offset=0.0, biases=False)
    ),
    "ours": Entrant("poses", _ALL, lambda g, _: _matched(g, exact_system(g.gravity_norm))),
    "B-spline batch": Entrant("poses", _ALL, lambda g, _: _spline(g)),
    "B-spline batch, few knots": Entrant(
        "poses", _ALL, lambda g, _: _spline(g, knots_per_second=g.few_knots_per_second)
    ),
    "gyro-first hand-eye": Entrant(
        "poses", _ALL, lambda g, _: calibrate_gyro_first(g.imu, g.path, g.gyro_first)
    ),
    "B-spline batch, corners": Entrant(
        "corners", _ALL, lambda g, _: calibrate_bspline_camera(g.imu, g.camera, g.spline)
    ),
    "hand-eye + RANSAC (Liang)": Entrant(
        "corners", "pose, gyro bias", lambda g, _: calibrate_liang(g.imu, g.camera, g.liang)
    ),
    "hand-eye + RANSAC, tuned": Entrant(
        "corners", "pose, biases", lambda g, _: calibrate_liang(g.imu, g.camera, g.liang_tuned)
    ),
}
"""By the name that tables show."""


def enter(name: str, setting: PaperOptions | None, given: Given) -> Answer:
    """Run a method, the published one in a setting; a function that other processes can import."""
    return ENTRANTS[name].call(given, setting)
