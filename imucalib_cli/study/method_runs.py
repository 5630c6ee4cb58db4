"""The inputs of a run, and the published method and ours run on one recording."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, fields, replace
from itertools import product
from typing import TYPE_CHECKING, Literal

import numpy as np
from msgspec import structs

from imucalib_cli.errors import InputError
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions, PaperOptions, WindowChoice
from imucalib_cli.paper.method import calibrate_paper
from imucalib_cli.results.pose import PoseError, pose_error
from imucalib_cli.robot.rotations import matrix_from_rotvec
from imucalib_cli.simulate.load import load_grade
from imucalib_cli.simulate.options import ZERO, NoiseOptions, PhysicsOptions
from imucalib_cli.study.experiment import Study, grid
from imucalib_cli.study.recordings import streams_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples
    from imucalib_cli.simulate.recording import Recording
    from imucalib_cli.study.experiment import Cell
    from imucalib_cli.study.tables import Row


@dataclass(frozen=True, kw_only=True)
class Recorded(Study):
    """A study on simulated recordings."""

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
        """Options of the simulation."""
        return PhysicsOptions(**{part.name: getattr(self, part.name) for part in fields(Recorded)})


@dataclass(frozen=True, kw_only=True)
class Condition:
    """Sensors under which methods are compared."""

    name: str
    grade: str = "ideal"
    """Of configs/imu_grades.yaml."""
    biases: bool = False
    """Whether the biases of the grade and their walks are simulated."""
    noise: NoiseOptions = field(default_factory=NoiseOptions)
    """Noise options in addition to the grade; those that are not zero have priority."""
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
    """A study under several conditions, each with several seeds."""

    conditions: tuple[Condition, ...]
    seeds: int

    @property
    def names(self) -> list[str]:
        """Names of the conditions."""
        return [condition.name for condition in self.conditions]

    def condition_of(self, cell: Cell) -> Condition:
        """The condition of a run."""
        return self.conditions[self.names.index(cell["condition"])]

    def repeats(self, run: Cell) -> list[Cell]:
        """The seeds of a run's condition."""
        return grid(seed=range(self.condition_of(run).seeds or self.seeds))


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose of the IMU in its parent link, or of one frame in another."""

    R: Floats
    """(3, 3)."""
    t: Floats
    """(3,), m."""

    def moved(self, step: Floats) -> Pose:
        """The pose after a step (6,) of translation, m, and of rotation on the left, rad."""
        return Pose(matrix_from_rotvec(step[3:]) @ self.R, self.t + step[:3])


@dataclass(frozen=True, kw_only=True, eq=False)
class Answer:
    """Pose of the IMU in the frame that a method solves for."""

    frame: Literal["parent", "camera"]
    """The parent link of the IMU, or the camera."""
    T_frame_imu: Pose
    time_offset: float | None
    """IMU stamp - robot (or camera) stamp of the same instant, s; None where not estimated."""
    evaluations: int
    """Number of evaluations of all residuals, or of models tried."""
    accel_bias: Floats | None = None
    """(3,), IMU frame, m/s², mean over the log; None where not estimated."""
    gyro_bias: Floats | None = None
    """(3,), IMU frame, rad/s, mean over the log; None where not estimated."""
    gravity_world: Floats | None = None
    """(3,), m/s²; None where not estimated."""


def wrong_guess(recording: Recording, translation: float, rotation_deg: float, seed: int) -> Pose:
    """The truth, moved by a distance, m, and turned by an angle, degrees, in random directions.

    The directions are uniform on the sphere (section 4.1 of the paper). The paper adds its vector
    to the rotation vector. Here it is a rotation on the left, so that the angle of the error is
    the stated one.
    """
    directions = np.random.default_rng(seed).normal(size=(2, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    sizes = translation, np.radians(rotation_deg)
    step = np.concatenate([size * to for size, to in zip(sizes, directions, strict=True)])
    return Pose(recording.R_parent_imu, recording.t_parent_imu).moved(step)


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
    """Name of a setting in tables; None for other methods."""
    if setting is None:
        return None
    limit = setting.exclusion_threshold
    dropped = f"drops over {limit:.3g} m/s²" if limit else "drops none"
    return f"L {setting.window.samples}, {dropped}"


def exact_system(gravity_norm: float) -> MatchedOptions:
    """The matched method for the exact robot, sensor and gravity (m/s², or none) of the studies.

    Unknown besides the pose are the biases, the vertical and the time offset.
    """
    return MatchedOptions(
        gravity="tilt" if gravity_norm > 0.0 else "none",
        gravity_norm=gravity_norm,
        gravity_std=0.0,
        sensor_model="ideal",
        robot="exact",
    )


def pose_only(gravity_norm: float) -> MatchedOptions:
    """The matched method with the unknowns of the published method."""
    return structs.replace(
        exact_system(gravity_norm),
        time_offset=0.0,
        accel_bias_std=0.0,
        gyro_bias_std=0.0,
        gravity="fixed" if gravity_norm > 0.0 else "none",
    )


PUBLISHED: dict[str, Literal["l1", "components"]] = {
    "paper": "l1",
    "paper, components": "components",
}
"""The published method with one L1 sum per instant as residual, and with the six components: it is
not known which its authors square."""
OURS: dict[str, Callable[[float], MatchedOptions]] = {
    "matched, pose only": pose_only,
    "matched": exact_system,
}
"""Ours with the unknowns of the published method, and with all its own."""
METHODS = (*PUBLISHED, *OURS)


def errors_of(found: Pose | None, truth: Pose) -> Row:
    """Columns of the errors of a pose; None in each if the method gave no answer."""
    if found is None:
        return dict.fromkeys(PoseError.__struct_fields__)
    return structs.asdict(pose_error(found.R, found.t, truth.R, truth.t))


def calibrate_published(
    imu: ImuSamples, path: KinematicPath, setting: PaperOptions, guess: Pose, gravity_norm: float
) -> Estimate:
    """The published method in a setting, from a guess; gravity in m/s².

    Raises:
        InputError: As :func:`calibrate_paper`.
    """
    start = {"R_initial": guess.R, "t_initial": guess.t, "gravity_norm": gravity_norm}
    return calibrate_paper(imu, path, structs.replace(setting, **start))


def run_methods(
    methods: Sequence[str],
    recording: Recording,
    guess: Pose,
    settings: Sequence[PaperOptions],
    window: WindowChoice | None = None,
) -> Iterator[tuple[PaperOptions | None, Row]]:
    """Calibrate by methods: the published one from a guess in each of its settings, ours once.

    Yields:
        The setting, and a row: method, translation and rotation (norm, m; angle, rad), the paper's
        averages of them, time_offset (error, s), trusted, seconds, evaluations. Without an answer
        ``failure`` is the reason and the errors are None.
    """
    imu, path = streams_of(recording)
    norm = float(np.linalg.norm(recording.gravity_world))
    truth = Pose(recording.R_parent_imu, recording.t_parent_imu)
    for method in methods:
        for setting in settings if method in PUBLISHED else (None,):
            begun = time.perf_counter()
            found, failure = None, None
            try:
                if setting is None:
                    ours = structs.replace(OURS[method](norm), window=window or WindowChoice())
                    found = calibrate_matched(imu, path, ours)
                else:
                    theirs = structs.replace(setting, residual=PUBLISHED[method])
                    found = calibrate_published(imu, path, theirs, guess, norm)
            except InputError as error:
                failure = str(error)
            seconds = time.perf_counter() - begun
            row: Row = {
                "method": method,
                **errors_of(Pose(found.R_parent_imu, found.t_parent_imu) if found else None, truth),
                "time_offset": found and found.time_offset - recording.noise.time_offset,
                "trusted": found is not None and found.trusted,
                "seconds": found and seconds,
                "evaluations": found and found.notes.get("evaluations"),
                "failure": failure,
            }
            yield setting, row
