"""Table 1: the published method, ours and others on one camera-IMU transform (section 4.3).

Every method runs alone in a fresh process, on the same recording and the same noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import PaperOptions
from imucalib_cli.robot.rotations import matrix_from_rpy
from imucalib_cli.simulate.camera.view import seen_from_camera
from imucalib_cli.simulate.load import load_grade
from imucalib_cli.simulate.noise import corrupt, white_std
from imucalib_cli.simulate.options import NoiseOptions
from imucalib_cli.study.bound import bound_columns
from imucalib_cli.study.experiment import Section, grid
from imucalib_cli.study.fresh_process import run_alone
from imucalib_cli.study.method_runs import (
    Answer,
    Conditioned,
    Pose,
    calibrate_published,
    errors_of,
    exact_system,
    paper_settings,
    pose_only,
    setting_words,
)
from imucalib_cli.study.methods.bspline import (
    BSplineOptions,
    calibrate_bspline,
    calibrate_bspline_camera,
)
from imucalib_cli.study.methods.gyro_first import GyroFirstOptions, calibrate_gyro_first
from imucalib_cli.study.methods.liang import (
    LiangOptions,
    Ransac,
    StillOptions,
    calibrate_liang,
)
from imucalib_cli.study.recordings import clean_recording, streams_of
from imucalib_cli.study.tables import (
    DEGREES,
    ERROR_COLUMNS,
    ERRORS,
    Claim,
    Column,
    answered,
    chosen,
    count,
    digits,
    exceeds,
    in_best_setting,
    mean,
    mean_error,
    over_bound,
    statistic,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples
    from imucalib_cli.simulate.recording import CameraRecord, Recording
    from imucalib_cli.study.experiment import Cell
    from imucalib_cli.study.fresh_process import Cost
    from imucalib_cli.study.tables import Row, Table

_LIBRARIES = ("scipy.optimize", "scipy.linalg", "scipy.signal", "cv2")
"""Libraries whose import is not a cost of a method."""
_MEGABYTES = 1e-6
_CONTENDERS = {"paper": "paper", "ours, pose only": "matched, pose only", "ours": "matched"}
"""The methods that claims compare with others, with their names in other studies."""
_LIANG, _CORNERS = "hand-eye + RANSAC (Liang)", "B-spline batch, corners"
_RIVALS = {
    _CORNERS: "a B-spline batch of Kalibr's kind on corners",
    _LIANG: "Liang et al. as published",
    "hand-eye + RANSAC, tuned": "Liang et al. tuned for start-stop motion",
}


_NOTE = (
    "Errors of T_camera_imu, mean ± standard deviation over seeds, as norm and geodesic angle; "
    "|mean Δxyz| and mean |rpy| are the averages that the paper's tool reports, smaller by "
    "construction. Over bound: root mean square over the Cramér-Rao bound of the method's own "
    "unknowns on exact kinematics; with corners there is no such bound. Wall and CPU: the method "
    "alone in a fresh process, libraries loaded, one thread; runs side by side slow each other. "
    "Memory: peak resident set (VmHWM, reset before) less what interpreter, libraries and data "
    "held, {held} MB. The published method stands in the best of its settings by the truth: for "
    "translation in the table, for each error in the claims. The B-spline batch on corners is of "
    "Kalibr's kind, not Kalibr."
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Given:
    """Data of one recording for all methods, and their options; each method uses part of it."""

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
    setting: PaperOptions | None = None
    """Of the published method; None takes its defaults."""


@dataclass(frozen=True)
class Entrant:
    """A method of the comparison."""

    data: str
    """Its data besides the IMU."""
    unknowns: str
    call: Callable[[Given], Answer]


def _spline(given: Given, **changes: object) -> Answer:
    options = replace(given.spline, **changes)  # type: ignore[arg-type]
    return calibrate_bspline(given.imu, given.path, options)


def _matched(given: Given, options: MatchedOptions) -> Answer:
    return _answer(calibrate_matched(given.imu, given.path, options))


def _published(given: Given) -> Answer:
    start = given.setting or PaperOptions(), given.nominal, given.gravity_norm
    return _answer(calibrate_published(given.imu, given.path, *start))


def _answer(estimate: Estimate) -> Answer:
    evaluations = estimate.notes.get("evaluations")
    return Answer(
        frame="parent",
        T_frame_imu=Pose(estimate.R_parent_imu, estimate.t_parent_imu),
        time_offset=None if estimate.time_offset_std is None else estimate.time_offset,
        evaluations=int(evaluations) if isinstance(evaluations, int | float) else 1,
    )


_ALL = "pose, biases, tilt, offset"
ENTRANTS: dict[str, Entrant] = {
    "paper": Entrant("poses", "pose", _published),
    "ours, pose only": Entrant("poses", "pose", lambda g: _matched(g, pose_only(g.gravity_norm))),
    "B-spline batch, pose only": Entrant(
        "poses", "pose", lambda g: _spline(g, gravity="fixed", time_offset=0.0, biases=False)
    ),
    "ours": Entrant("poses", _ALL, lambda g: _matched(g, exact_system(g.gravity_norm))),
    "B-spline batch": Entrant("poses", _ALL, _spline),
    "B-spline batch, few knots": Entrant(
        "poses", _ALL, lambda g: _spline(g, knots_per_second=g.few_knots_per_second)
    ),
    "gyro-first hand-eye": Entrant(
        "poses", _ALL, lambda g: calibrate_gyro_first(g.imu, g.path, g.gyro_first)
    ),
    _CORNERS: Entrant(
        "corners", _ALL, lambda g: calibrate_bspline_camera(g.imu, g.camera, g.spline)
    ),
    _LIANG: Entrant(
        "corners", "pose, gyro bias", lambda g: calibrate_liang(g.imu, g.camera, g.liang)
    ),
    "hand-eye + RANSAC, tuned": Entrant(
        "corners", "pose, biases", lambda g: calibrate_liang(g.imu, g.camera, g.liang_tuned)
    ),
}
"""The methods by their names in tables."""


def enter(name: str, setting: PaperOptions | None, given: Given) -> Answer:
    """Run a method, the published one in a setting; a function that other processes can import."""
    return ENTRANTS[name].call(replace(given, setting=setting))


@dataclass(frozen=True, kw_only=True)
class Quoted:
    """Figures that others report, shown as such."""

    condition: str
    method: str
    translation: str
    rotation: str
    seconds: str


@dataclass(frozen=True, kw_only=True)
class MethodsCriteria:
    """Criteria of the claims."""

    conditions: tuple[str, ...]
    """The conditions of which the paper speaks."""
    liang_rotation_deg: float


@dataclass(frozen=True, kw_only=True)
class MethodsStudy(Conditioned):
    """Section 4.3 and Table 1."""

    name = "methods"
    line = ("method",)
    system: str
    camera: str
    paper_windows: tuple[int, ...]
    paper_exclusions: tuple[float, ...]
    paper_residuals: tuple[Literal["l1", "components"], ...]
    stated_where_none: str
    """A grade."""
    knots_per_second: float
    few_knots_per_second: float
    bias_interval: float
    gyro_first_window: float
    gyro_first_degree: int
    still: StillOptions
    published_ransac: Ransac
    tuned_ransac: Ransac
    claims: MethodsCriteria
    quoted: tuple[Quoted, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if min(self.knots_per_second, self.few_knots_per_second, self.bias_interval) <= 0.0:
            raise ValueError("knots_per_second and bias_interval must be above zero")
        load_grade(self.stated_where_none)

    @property
    def paper_settings(self) -> tuple[PaperOptions, ...]:
        """All settings of the published method."""
        return paper_settings(self.paper_windows, self.paper_exclusions, self.paper_residuals)

    def sections(self) -> list[Section]:
        """Every method, a table for each condition."""
        return [
            Section(f"camera-IMU transform, {name}", [{"condition": name}], _COLUMNS)
            for name in self.names
        ]

    def repeats(self, run: Cell) -> list[Cell]:
        """Every method with every seed."""
        return [seed | method for seed in super().repeats(run) for method in grid(method=ENTRANTS)]

    def measure(self, cell: Cell) -> list[Row]:
        """One method on one recording; the published one in all its settings."""
        seed, name = cell["seed"], cell["method"]
        clean = clean_recording(self.system, self.physics, self.camera)
        noise = self.condition_of(cell).sensors
        recording = corrupt(clean, noise, seed)
        settings = self.paper_settings if name == "paper" else (None,)
        data = given(recording, self, seed)
        costs = run_alone([partial(enter, name, each, data) for each in settings], _LIBRARIES)
        bound = bound_columns(clean, noise, alone=ENTRANTS[name].unknowns == "pose")
        return [
            cell
            | {"setting": f"{setting_words(setting)}, {setting.residual}" if setting else None}
            | row_of(cost, recording)
            | bound
            for cost, setting in zip(costs, settings, strict=True)
        ]

    def shown(self, rows: Sequence[Row]) -> list[Row]:
        """Of the published method, those of its best setting."""
        return in_best_setting(rows, mean_error(), "condition", "method")

    def tables(self, rows: Sequence[Row]) -> list[Table]:
        """With the figures that are quoted, and why methods failed."""
        *tables, claims = super().tables(rows)
        notes = [_NOTE.format(held=digits(mean(rows, "held") * _MEGABYTES)), *[""] * len(tables)]
        images = "images", ENTRANTS[_CORNERS].unknowns
        made = []
        for condition, table, said in zip(self.names, tables, notes, strict=False):
            failed = [row for row in chosen(rows, condition=condition) if row["failure"]]
            whys = dict.fromkeys(f"{row['method']}: {row['failure']}." for row in failed)
            quoted = [
                (q.method, *images, q.translation, "-", q.rotation, *"---", q.seconds, *"---")
                for q in self.quoted
                if q.condition == condition
            ]
            note = " ".join([said, *whys]).strip()
            made.append(replace(table, rows=(*table.rows, *quoted), note=note))
        return [*made, claims]

    def verdicts(self, rows: Sequence[Row]) -> dict[str, list[Claim]]:
        """Each contender against each rival, where the paper speaks of it."""
        judged = [name for name in self.names if name in self.claims.conditions]
        claims = [claim for name in judged for claim in self._claims(rows, name)]
        return {"Claims of section 4.3, by mean norms and angles": claims}

    def _claims(self, rows: Sequence[Row], condition: str) -> Iterator[Claim]:
        def error(method: str, key: str, scale: float) -> float:
            """Mean error, of the published method in the best setting for this error."""
            mine = chosen(rows, condition=condition, method=method)
            return scale * mean(in_best_setting(mine, mean_error(key)), key)

        rivals: dict[str, dict[str, float]] = {
            words: {key: error(rival, key, scale) for key, scale, _ in ERRORS}
            for rival, words in _RIVALS.items()
        }
        for quote in self.quoted:
            if quote.condition == condition:
                rivals[quote.method] = {
                    "translation": _number(quote.translation),
                    "rotation": _number(quote.rotation),
                }
        for name, words in _CONTENDERS.items():
            for key, scale, unit in ERRORS:
                ours = error(name, key, scale)
                for rival, errors in rivals.items():
                    yield Claim(
                        words=f"{words}: below {rival} in {key} ({condition})",
                        found=f"{digits(ours)} {unit} against {digits(errors[key])} {unit}",
                        met=exceeds(errors[key], ours),
                    )
        angle, limit = error(_LIANG, "rotation", DEGREES), self.claims.liang_rotation_deg
        yield Claim(
            words=f"paper: Liang et al. over {limit:g} deg ({condition})",
            found=f"{digits(angle)} deg",
            met=exceeds(angle, limit),
        )


def _name(rows: Sequence[Row]) -> str:
    method, setting = rows[0]["method"], rows[0]["setting"]
    return str(method) if setting is None else f"{method} ({setting})"


def _over_bound(rows: Sequence[Row], key: str) -> float:
    """Only methods on poses have a bound."""
    on_poses = ENTRANTS[rows[0]["method"]].data == "poses"
    return over_bound(rows, key) if on_poses else math.nan


_COLUMNS: tuple[Column, ...] = (
    ("method", _name),
    ("data beside the IMU", lambda rows: ENTRANTS[rows[0]["method"]].data),
    ("unknowns", lambda rows: ENTRANTS[rows[0]["method"]].unknowns),
    ERROR_COLUMNS[0],
    statistic("over bound", _over_bound, "translation"),
    ERROR_COLUMNS[1],
    statistic("over bound", _over_bound, "rotation"),
    *ERROR_COLUMNS[2:],
    statistic("wall s", mean, "seconds"),
    statistic("CPU s", mean, "cpu_seconds"),
    statistic("memory MB", mean, "memory", _MEGABYTES),
    count("answers", answered),
)


def _number(quoted: str) -> float:
    """A quoted figure; NaN if it is a range or a dash."""
    try:
        return float(quoted)
    except ValueError:
        return math.nan


def given(recording: Recording, study: MethodsStudy, seed: int) -> Given:
    """The inputs of the methods from a recording with a camera; the seed is of RANSAC's draws.

    Raises:
        ValueError: The recording has no camera.
    """
    if recording.camera is None:
        raise ValueError("the recording has no camera")
    imu, path = streams_of(recording)
    stated = recording.noise
    if stated.accel_noise == 0.0:
        grade = load_grade(study.stated_where_none)
        stated = NoiseOptions(accel_noise=grade.accel_noise, gyro_noise=grade.gyro_noise)
    accel_std, gyro_std = white_std(stated, recording.imu)
    norm = float(np.linalg.norm(recording.gravity_world))
    nominal = recording.system.imu.nominal
    published = LiangOptions(
        ransac=replace(study.published_ransac, seed=seed), still=study.still, gravity_norm=norm
    )
    return Given(
        imu=imu,
        path=path,
        camera=recording.camera,
        gravity_norm=norm,
        nominal=Pose(matrix_from_rpy(nominal.rpy), np.array(nominal.xyz)),
        spline=BSplineOptions(
            accel_std=accel_std,
            gyro_std=gyro_std,
            accel_bias_walk=stated.accel_bias_walk,
            gyro_bias_walk=stated.gyro_bias_walk,
            bias_interval=study.bias_interval,
            knots_per_second=study.knots_per_second,
            gravity_norm=norm,
        ),
        few_knots_per_second=study.few_knots_per_second,
        gyro_first=GyroFirstOptions(
            window_seconds=study.gyro_first_window,
            degree=study.gyro_first_degree,
            gravity_norm=norm,
        ),
        liang=published,
        liang_tuned=replace(published, tuned=True, ransac=replace(study.tuned_ransac, seed=seed)),
    )


def row_of(cost: Cost[Answer], recording: Recording) -> Row:
    """Errors of T_camera_imu, and the cost of the answer.

    Raises:
        InputError: The camera is not on the link of the IMU.
    """
    answer = cost.value
    truth = seen_from_camera(recording, recording.R_parent_imu, recording.t_parent_imu)
    found = answer.T_frame_imu if answer else None
    if answer and answer.frame == "parent":
        found = Pose(*seen_from_camera(recording, answer.T_frame_imu.R, answer.T_frame_imu.t))
    return {
        **{key: value for key, value in vars(cost).items() if key != "value"},
        **errors_of(found, Pose(*truth)),
        "time_offset": answer and answer.time_offset,
        "evaluations": answer and answer.evaluations,
    }
