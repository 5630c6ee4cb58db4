"""Conditions of a run: recording, sensors, and initial guess."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import product
from typing import TYPE_CHECKING, Literal

import numpy as np

from imucalib_cli.estimate.options import PaperOptions, WindowChoice
from imucalib_cli.robot.rotations import matrix_from_rotvec
from imucalib_cli.simulate.load import load_grade
from imucalib_cli.simulate.options import ZERO, NoiseOptions, PhysicsOptions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Floats
    from imucalib_cli.simulate.recording import Recording
    from imucalib_cli.study.study import Cell


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """Recording of a study's systems."""

    imu_rate: float
    """Hz."""
    robot_rate: float
    """Hz."""
    duration: float | None = None
    """s; None: the whole plan."""
    profile: Literal["smooth", "hard"] = "smooth"
    """How a free body is pushed."""

    def __post_init__(self) -> None:
        if min(self.imu_rate, self.robot_rate, self.duration or 1.0) <= 0.0:
            raise ValueError("imu_rate, robot_rate and duration must be above zero")

    @property
    def physics(self) -> PhysicsOptions:
        """For the simulation."""
        return PhysicsOptions(
            duration=self.duration,
            imu_rate=self.imu_rate,
            robot_rate=self.robot_rate,
            profile=self.profile,
        )


@dataclass(frozen=True, kw_only=True)
class Condition:
    """Sensors under which methods are compared."""

    name: str
    grade: str = "ideal"
    """Of configs/imu_grades.yaml."""
    biases: bool = False
    """Whether the grade's biases and their walks are simulated."""
    noise: NoiseOptions = field(default_factory=NoiseOptions)
    """Noise options in addition to the grade; they have priority."""
    seeds: int | None = None
    """Number of seeds; None takes the study's."""

    def __post_init__(self) -> None:
        """Refuse an unknown grade when the parameters are read, not in the middle of a study."""
        load_grade(self.grade)

    @property
    def sensors(self) -> NoiseOptions:
        """Noise of the grade with the additional options."""
        graded = load_grade(self.grade)
        if not self.biases:
            graded = replace(
                graded, accel_bias=ZERO, gyro_bias=ZERO, accel_bias_walk=0.0, gyro_bias_walk=0.0
            )
        nothing = vars(NoiseOptions())
        return replace(graded, **{n: v for n, v in vars(self.noise).items() if v != nothing[n]})


@dataclass(frozen=True, kw_only=True)
class Conditioned(Recorded):
    """Recordings under several conditions, each with several seeds."""

    conditions: tuple[Condition, ...]
    seeds: int

    @property
    def names(self) -> list[str]:
        """By name."""
        return [condition.name for condition in self.conditions]

    def condition_of(self, cell: Cell) -> Condition:
        """The condition of a run."""
        return self.conditions[self.names.index(cell["condition"])]

    def seeds_of(self, cell: Cell) -> range:
        """Seeds of a condition."""
        return range(self.condition_of(cell).seeds or self.seeds)


def paper_settings(
    windows: Sequence[int],
    exclusions: Sequence[float],
    residuals: Sequence[Literal["l1", "components"]] = ("l1",),
) -> tuple[PaperOptions, ...]:
    """What we do not know of the published method: window, samples, exclusion, m/s², residual."""
    return tuple(
        PaperOptions(window=WindowChoice(samples=window), exclusion_threshold=limit, residual=kind)
        for window, limit, kind in product(windows, exclusions, residuals)
    )


def setting_words(setting: PaperOptions | None) -> str | None:
    """A setting's name in tables; none of other methods."""
    if setting is None:
        return None
    limit = setting.exclusion_threshold
    dropped = f"drops over {limit:.3g} m/s²" if limit else "drops none"
    return f"L {setting.window.samples}, {dropped}"


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose of the IMU in its parent link, or of one frame in another."""

    R: Floats
    """(3, 3)."""
    t: Floats
    """(3,), m."""

    def moved(self, step: Floats) -> Pose:
        """After a step (6,) of translation, m, and of rotation on the left, rad."""
        return Pose(matrix_from_rotvec(step[3:]) @ self.R, self.t + step[:3])


def wrong_guess(recording: Recording, translation: float, rotation: float, seed: int) -> Pose:
    """The truth, moved by a distance, m, and turned by an angle, rad, in random directions.

    They are uniform on the sphere (section 4.1 of the paper). The paper adds its vector to the
    rotation vector. Here it is a rotation on the left, so that the error's angle is the stated
    one.
    """
    directions = np.random.default_rng(seed).normal(size=(2, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    step = np.concatenate([translation * directions[0], rotation * directions[1]])
    return Pose(recording.R_parent_imu, recording.t_parent_imu).moved(step)
