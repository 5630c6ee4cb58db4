"""The estimators under comparison on one recording: the same data, and how far each is off."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import InputError
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions, PaperOptions, WindowChoice
from imucalib_cli.estimate.paper import calibrate_paper
from imucalib_cli.results.pose import PoseError, pose_error
from imucalib_cli.robot.rotations import matrix_from_rpy
from imucalib_cli.study.systems import robot_model
from imucalib_cli.study.trial import streams_of

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.simulate.recording import Recording
    from imucalib_cli.study.experiment import Row
    from imucalib_cli.study.paper_setting import PaperSetting

Floats = NDArray[np.float64]

Method = Literal["paper", "paper, components", "matched, pose only", "matched"]
"""The published method with one L1 sum an instant as residual, and with the six components, for it
is not known to us which its authors square; ours with the same unknowns; ours with all its own."""
METHODS: tuple[Method, ...] = ("paper", "paper, components", "matched, pose only", "matched")
PUBLISHED: tuple[Method, ...] = ("paper", "paper, components")

NO_ERRORS: Row = dict.fromkeys(part.name for part in fields(PoseError))
"""In place of an error's columns, where a method gave no answer."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Settings:
    """How the estimators are set."""

    window: WindowChoice = field(default_factory=WindowChoice)
    """Of the matched filters."""
    paper_window: WindowChoice = field(default_factory=lambda: PaperOptions().window)
    paper_exclusion: float | None = None
    """m/s²; None takes the method's default."""
    R_initial: Floats | None = None
    """(3, 3), guess of R_parent_imu for the published method; None takes the URDF's."""
    t_initial: Floats | None = None
    """(3,), m."""

    def published(self, setting: PaperSetting) -> Settings:
        """With the published method set so."""
        return replace(
            self,
            paper_window=WindowChoice(samples=setting.window),
            paper_exclusion=setting.exclusion,
        )


def contest(recording: Recording, methods: tuple[Method, ...], settings: Settings) -> list[Row]:
    """Errors of each method on a recording.

    Returns:
        A row a method: method, translation and rotation (norm, m; angle, rad), the paper's
        averages of them, time_offset (error, s), trusted, seconds, evaluations; where a method
        gives no answer, ``failure`` says why and the errors are None.
    """
    rows = []
    for method in methods:
        begun = time.perf_counter()
        try:
            estimate = estimate_by(method, recording, settings)
        except InputError as error:
            rows.append(_failed(method, str(error)))
            continue
        rows.append(_row(method, recording, estimate, time.perf_counter() - begun))
    return rows


def estimate_by(method: Method, recording: Recording, settings: Settings) -> Estimate:
    """One method's estimate.

    Raises:
        InputError: It cannot use the recording.
    """
    imu, path = streams_of(recording, robot_model(recording.system.name))
    norm = float(np.linalg.norm(recording.gravity_world))
    if method in {"paper", "paper, components"}:
        nominal = recording.system.imu.nominal
        guess = settings.R_initial, settings.t_initial
        return calibrate_paper(
            imu,
            path,
            PaperOptions(
                window=settings.paper_window,
                exclusion_threshold=settings.paper_exclusion,
                residual="l1" if method == "paper" else "components",
                gravity_norm=norm,
                R_initial=matrix_from_rpy(nominal.rpy) if guess[0] is None else guess[0],
                t_initial=np.array(nominal.xyz) if guess[1] is None else guess[1],
            ),
        )
    options = pose_only(norm) if method == "matched, pose only" else exact_system(norm)
    return calibrate_matched(imu, path, replace(options, window=settings.window))


def exact_system(gravity_norm: float) -> MatchedOptions:
    """The matched method where robot, sensor and gravity are what they are taken for.

    The simulated systems of the studies are so: what is unknown beside the pose are the biases,
    the vertical and the time offset.

    Args:
        gravity_norm: m/s²; zero where there is no gravity.
    """
    return MatchedOptions(
        gravity="tilt" if gravity_norm > 0.0 else "none",
        gravity_norm=gravity_norm,
        gravity_std=0.0,
        sensor_model="ideal",
        robot="exact",
    )


def pose_only(gravity_norm: float) -> MatchedOptions:
    """The matched method with the unknowns of the published one.

    Args:
        gravity_norm: m/s²; zero where there is no gravity.
    """
    return replace(
        exact_system(gravity_norm),
        time_offset=0.0,
        accel_bias_std=0.0,
        gyro_bias_std=0.0,
        gravity="fixed" if gravity_norm > 0.0 else "none",
    )


def _row(method: Method, recording: Recording, estimate: Estimate, seconds: float) -> Row:
    error = pose_error(
        estimate.R_parent_imu,
        estimate.t_parent_imu,
        recording.R_parent_imu,
        recording.t_parent_imu,
    )
    noise = recording.corruption.noise if recording.corruption else None
    return {
        "method": method,
        **asdict(error),
        "time_offset": estimate.time_offset - (noise.time_offset if noise else 0.0),
        "trusted": estimate.trusted,
        "seconds": seconds,
        "evaluations": estimate.notes.get("evaluations"),
        "failure": None,
    }


def _failed(method: Method, why: str) -> Row:
    return NO_ERRORS | {
        "method": method,
        "time_offset": None,
        "trusted": False,
        "seconds": None,
        "evaluations": None,
        "failure": why,
    }
