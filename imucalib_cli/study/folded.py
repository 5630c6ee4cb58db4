"""What tables 2 and 3 share: calibrations on folds of moves, each with several seeds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from imucalib_cli.estimate.options import WindowChoice
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import PhysicsOptions
from imucalib_cli.study.contest import Settings, contest
from imucalib_cli.study.folds import moves_of, stratified_folds, without
from imucalib_cli.study.guesses import wrong_guess
from imucalib_cli.study.summary import DEGREES, MILLIMETRES, spread
from imucalib_cli.study.systems import clean_recording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.simulate.options import NoiseOptions
    from imucalib_cli.study.contest import Method
    from imucalib_cli.study.experiment import Cell, Row


@dataclass(frozen=True, kw_only=True)
class FoldedParameters:
    """What configs/studies/ states of both, with units."""

    systems: tuple[str, ...]
    imu_rate: float
    robot_rate: float
    profile: Literal["smooth", "hard"]
    folds: int
    seeds: int
    paper_window: int
    paper_exclusion: float

    def runs(self, condition: Cell) -> list[Cell]:
        """A condition on every fold with every seed."""
        return [
            condition | {"fold": fold, "seed": seed}
            for fold in range(self.folds)
            for seed in range(self.seeds)
        ]


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One calibration of a folded study."""

    noise: NoiseOptions
    noise_seed: int
    initial_translation: float
    """m, error of the guess the published method starts from."""
    initial_rotation: float
    """rad."""


def seed_of(parameters: FoldedParameters, cell: Cell) -> int:
    """A seed for each run of a condition: folds see other draws too (section 4.4)."""
    return int(cell["fold"] or 0) * parameters.seeds + int(cell["seed"] or 0)


def calibrate_fold(
    parameters: FoldedParameters, cell: Cell, trial: Trial, methods: tuple[Method, ...]
) -> list[Row]:
    """All methods on what a fold leaves of a recording.

    Args:
        parameters: Of the study.
        cell: With ``system``, ``fold`` and ``seed``.
        trial: Noise and guess.
        methods: To run.
    """
    physics = PhysicsOptions(
        imu_rate=parameters.imu_rate,
        robot_rate=parameters.robot_rate,
        profile=parameters.profile,
    )
    clean = clean_recording(str(cell["system"]), physics)
    folds = stratified_folds(moves_of(clean.system, clean.system.duration), parameters.folds)
    held_out = folds[int(cell["fold"] or 0)]
    guess = wrong_guess(
        clean, trial.initial_translation, trial.initial_rotation, seed_of(parameters, cell)
    )
    settings = Settings(
        paper_window=WindowChoice(samples=parameters.paper_window),
        paper_exclusion=parameters.paper_exclusion,
        R_initial=guess.R_parent_imu,
        t_initial=guess.t_parent_imu,
    )
    recording = without(corrupt(clean, trial.noise, trial.noise_seed), held_out)
    return [cell | row for row in contest(recording, methods, settings)]


ERROR_HEADER = ("translation mm", "rotation deg", "|mean Δxyz| mm", "mean |rpy| deg")


def error_cells(rows: Sequence[Row]) -> tuple[str, str, str, str]:
    """Mean ± standard deviation of the four errors, as the header below names them."""
    return (
        spread(rows, "translation", MILLIMETRES),
        spread(rows, "rotation", DEGREES),
        spread(rows, "averaged_translation", MILLIMETRES),
        spread(rows, "averaged_rotation", DEGREES),
    )
