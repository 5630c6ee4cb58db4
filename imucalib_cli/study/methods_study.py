"""Table 1: the published method, ours and others on one camera-IMU transform (section 4.3).

Every method runs alone in a fresh process, on the same recording and the same noise.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.results.pose import pose_error
from imucalib_cli.robot.rotations import matrix_from_rpy
from imucalib_cli.simulate.camera import camera_mount
from imucalib_cli.simulate.camera_config import load_camera
from imucalib_cli.simulate.load import load_grade, load_system
from imucalib_cli.simulate.noise import corrupt, white_std
from imucalib_cli.simulate.options import NoiseOptions
from imucalib_cli.simulate.physics import record
from imucalib_cli.study.alone import run_alone
from imucalib_cli.study.bound import bound_columns
from imucalib_cli.study.conditions import (
    Condition,
    Recorded,
)
from imucalib_cli.study.contest import NO_ERRORS
from imucalib_cli.study.load import load_parameters
from imucalib_cli.study.methods.bspline_problem import BSplineOptions
from imucalib_cli.study.methods.entrants import ENTRANTS, Given, PaperEntry
from imucalib_cli.study.methods.gyro_first import GyroFirstOptions
from imucalib_cli.study.methods.hand_eye import (  # noqa: TC001 - types of fields, checked when read
    Ransac,
)
from imucalib_cli.study.methods.pnp import observations_of
from imucalib_cli.study.methods.strapdown import (  # noqa: TC001 - likewise
    StillOptions,
)
from imucalib_cli.study.methods_tables import MethodsCriteria, methods_tables
from imucalib_cli.study.paper_setting import paper_settings
from imucalib_cli.study.trial import robot_of, streams_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from imucalib_cli.simulate.options import PhysicsOptions
    from imucalib_cli.simulate.recording import Recording
    from imucalib_cli.study.alone import Cost
    from imucalib_cli.study.experiment import Cell, Figure, Row, Study
    from imucalib_cli.study.methods.answer import Answer
    from imucalib_cli.study.table import Table

Floats = NDArray[np.float64]

_LIBRARIES = ("scipy.optimize", "scipy.linalg", "scipy.signal", "cv2")
"""Whose import is not a method's cost."""


@dataclass(frozen=True, kw_only=True)
class Quoted:
    """Figures of others, shown as such."""

    condition: str
    method: str
    translation: str
    rotation: str
    seconds: str


@dataclass(frozen=True, kw_only=True)
class MethodsParameters(Recorded):
    """As configs/studies/methods.yaml states them, with units and sources."""

    system: str
    camera: str
    conditions: tuple[Condition, ...]
    seeds: int
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
        """Refuse splines without knots, and claims about what is not run."""
        super().__post_init__()
        if min(self.knots_per_second, self.few_knots_per_second, self.bias_interval) <= 0.0:
            raise ValueError("knots_per_second and bias_interval must be above zero")
        load_grade(self.stated_where_none)

    @property
    def paper_settings(self) -> tuple[PaperEntry, ...]:
        """All that the published method is run with."""
        return tuple(
            PaperEntry(window=setting.window, exclusion=setting.exclusion, residual=residual)
            for setting in paper_settings(self.paper_windows, self.paper_exclusions)
            for residual in self.paper_residuals
        )

    def condition(self, name: str) -> Condition:
        """By its name."""
        return next(c for c in self.conditions if c.name == name)


@dataclass(frozen=True)
class MethodsStudy:
    """Section 4.3 and Table 1."""

    config: MethodsParameters
    name: str = "methods"

    def cells(self) -> list[Cell]:
        """Every method under every condition with every seed."""
        return [
            {"condition": condition.name, "method": method, "seed": seed}
            for condition in self.config.conditions
            for seed in range(condition.seeds or self.config.seeds)
            for method in ENTRANTS
        ]

    def measure(self, cell: Cell) -> list[Row]:
        """One method on one recording; the published one in all its settings."""
        config = self.config
        clean = seen_recording(config.system, config.camera, config.physics)
        noise = config.condition(str(cell["condition"])).sensors
        entrant = ENTRANTS[str(cell["method"])]
        seed = int(cell["seed"] or 0)
        recording = corrupt(clean, noise, seed)
        costs = run_alone(
            entrant.calls(config.paper_settings), given(recording, config, seed), _LIBRARIES
        )
        bound = bound_columns(clean, noise, alone=entrant.unknowns == "pose")
        settings = config.paper_settings if entrant.call is None else (None,)
        return [
            cell | {"setting": setting.words if setting else None} | _row(cost, recording) | bound
            for cost, setting in zip(costs, settings, strict=True)
        ]

    def tables(self, rows: Sequence[Row]) -> list[Table]:
        """One a condition, and the claims."""
        quoted: list[Row] = [asdict(quote) for quote in self.config.quoted]
        conditions = [condition.name for condition in self.config.conditions]
        return methods_tables(rows, conditions, quoted, self.config.claims)

    def figures(self, rows: Sequence[Row]) -> list[Figure]:
        """None: the tables say it."""
        del rows
        return []


@cache
def seen_recording(system: str, camera: str, physics: PhysicsOptions) -> Recording:
    """Noise-free run of a system before its pattern."""
    moved, config = load_camera(camera, load_system(system))
    return record(moved, physics, camera=config)


def given(recording: Recording, config: MethodsParameters, seed: int) -> Given:
    """What methods are given of a recording, noisy or not.

    Args:
        recording: With a camera.
        config: How methods are set.
        seed: Of RANSAC's draws.

    Raises:
        ValueError: The recording has no camera.
    """
    if recording.camera is None:
        raise ValueError("the recording has no camera")
    imu, path = streams_of(recording, robot_of(recording.system))
    noise = recording.corruption.noise if recording.corruption else NoiseOptions()
    stated = noise if noise.accel_noise > 0.0 else _densities(config.stated_where_none)
    accel_std, gyro_std = white_std(stated, recording.imu)
    norm = float(np.linalg.norm(recording.gravity_world))
    nominal = recording.system.imu.nominal
    return Given(
        imu=imu,
        path=path,
        camera=observations_of(recording.camera),
        gravity_norm=norm,
        R_nominal=matrix_from_rpy(nominal.rpy),
        t_nominal=np.array(nominal.xyz),
        spline=BSplineOptions(
            accel_std=accel_std,
            gyro_std=gyro_std,
            accel_bias_walk=stated.accel_bias_walk,
            gyro_bias_walk=stated.gyro_bias_walk,
            bias_interval=config.bias_interval,
            knots_per_second=config.knots_per_second,
            gravity_norm=norm,
        ),
        few_knots_per_second=config.few_knots_per_second,
        still=config.still,
        gyro_first=GyroFirstOptions(
            window_seconds=config.gyro_first_window,
            degree=config.gyro_first_degree,
            gravity_norm=norm,
        ),
        published_ransac=replace(config.published_ransac, seed=seed),
        tuned_ransac=replace(config.tuned_ransac, seed=seed),
    )


def _densities(grade: str) -> NoiseOptions:
    stated = load_grade(grade)
    return NoiseOptions(accel_noise=stated.accel_noise, gyro_noise=stated.gyro_noise)


def _row(cost: Cost[Answer], recording: Recording) -> Row:
    """Errors of T_camera_imu, and what they cost."""
    row: Row = {
        "seconds": cost.seconds,
        "cpu_seconds": cost.cpu_seconds,
        "memory": cost.memory,
        "held": cost.held,
        "failure": cost.failure,
    }
    answer = cost.value
    if answer is None:
        return row | NO_ERRORS | {"time_offset": None, "evaluations": None}
    R_parent_camera, p_parent_camera = _mount(recording)

    def from_camera(R_imu: Floats, t_imu: Floats) -> tuple[Floats, Floats]:
        return R_parent_camera.T @ R_imu, R_parent_camera.T @ (t_imu - p_parent_camera)

    found = answer.R_frame_imu, answer.t_frame_imu
    if answer.frame == "parent":
        found = from_camera(*found)
    truth = from_camera(recording.R_parent_imu, recording.t_parent_imu)
    error = pose_error(*found, *truth)
    effort: Row = {"time_offset": answer.time_offset, "evaluations": answer.evaluations}
    return row | asdict(error) | effort


def _mount(recording: Recording) -> tuple[Floats, Floats]:
    """R_parent_camera and p_parent_camera, which the kinematics know."""
    if recording.camera is None:
        raise ValueError("the recording has no camera")
    link, R, p = camera_mount(recording.system, recording.camera.config.frame.link)
    if link != recording.system.parent:
        raise ValueError("the camera is not on the IMU's link")
    return R, p


def load(file: Path | None, *, quick: bool) -> Study:
    """The study with its parameters."""
    return MethodsStudy(load_parameters(MethodsParameters, "methods", file, quick=quick))
