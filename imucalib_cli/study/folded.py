"""What tables 2 and 3 share: calibrations on folds of moves, each with several seeds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.study.conditions import Recorded
from imucalib_cli.study.contest import PUBLISHED, Settings, contest
from imucalib_cli.study.folds import moves_of, stratified_folds, without
from imucalib_cli.study.guesses import wrong_guess
from imucalib_cli.study.paper_setting import paper_settings
from imucalib_cli.study.summary import (
    DEGREES,
    MILLIMETRES,
    best_setting,
    column,
    least_setting,
    spread,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.simulate.options import NoiseOptions
    from imucalib_cli.simulate.recording import Recording
    from imucalib_cli.study.contest import Method
    from imucalib_cli.study.experiment import Cell, Row, Scalar


@dataclass(frozen=True, kw_only=True)
class FoldedParameters(Recorded):
    """What configs/studies/ states of both, with units."""

    systems: tuple[str, ...]
    folds: int
    seeds: int
    paper_windows: tuple[int, ...]
    paper_exclusions: tuple[float, ...]

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

    clean: Recording
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
        cell: With ``fold`` and ``seed``.
        trial: Recording, noise and guess.
        methods: To run.
    """
    clean = trial.clean
    moves = moves_of(clean.system, parameters.duration or clean.system.duration)
    folds = stratified_folds(moves, parameters.folds)
    held_out = folds[int(cell["fold"] or 0)]
    guess = wrong_guess(
        clean, trial.initial_translation, trial.initial_rotation, seed_of(parameters, cell)
    )
    recording = without(corrupt(clean, trial.noise, trial.noise_seed), held_out)
    settings = Settings(R_initial=guess.R_parent_imu, t_initial=guess.t_parent_imu)
    rows = contest(recording, tuple(m for m in methods if m not in PUBLISHED), settings)
    found = [cell | row | {"setting": None} for row in rows]
    for setting in paper_settings(parameters.paper_windows, parameters.paper_exclusions):
        rows = contest(
            recording, tuple(m for m in methods if m in PUBLISHED), settings.published(setting)
        )
        found += [cell | row | {"setting": setting.words} for row in rows]
    return found


def in_best_setting(rows: Sequence[Row], *keys: str) -> list[Row]:
    """Rows with each condition in the setting of least error: the most tuning could do for it.

    Args:
        rows: Of a study.
        keys: What makes a condition.
    """
    return [row for group in _groups(rows, keys) for row in best_setting(group)]


def in_steadily_best_setting(rows: Sequence[Row], *keys: str) -> list[Row]:
    """Rows in one setting a group: the one with the most answers, then the least geometric mean.

    Args:
        rows: Of a study.
        keys: What makes a group.
    """

    def badness(tried: list[Row]) -> tuple[int, float]:
        errors = column(tried, "translation")
        missing = len(tried) - len(errors)
        return missing, float(np.mean(np.log(errors))) if errors else math.inf

    return [row for group in _groups(rows, keys) for row in least_setting(group, badness)]


def _groups(rows: Sequence[Row], keys: Sequence[str]) -> list[list[Row]]:
    """Rows that are alike in some keys, together."""
    groups: dict[tuple[Scalar, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return list(groups.values())


def setting_of(rows: Sequence[Row]) -> str:
    """The published method's; a dash for methods that have none."""
    return str(rows[0]["setting"] or "-") if rows else "-"


ERROR_HEADER = ("translation mm", "rotation deg", "|mean Δxyz| mm", "mean |rpy| deg")


def error_cells(rows: Sequence[Row]) -> tuple[str, str, str, str]:
    """Mean ± standard deviation of the four errors, as the header below names them."""
    return (
        spread(rows, "translation", MILLIMETRES),
        spread(rows, "rotation", DEGREES),
        spread(rows, "averaged_translation", MILLIMETRES),
        spread(rows, "averaged_rotation", DEGREES),
    )
