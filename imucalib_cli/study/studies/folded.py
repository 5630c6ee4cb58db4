"""What tables 2 and 3 share: calibrations on folds of moves, each with several seeds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.study.conditions import Recorded, paper_settings, wrong_guess
from imucalib_cli.study.contest import contest, contestants
from imucalib_cli.study.folds import moves_of, stratified_folds, without
from imucalib_cli.study.rows import DEGREES, MILLIMETRES, best_setting, column, groups
from imucalib_cli.study.tables import Column, spread

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from imucalib_cli.simulate.options import NoiseOptions
    from imucalib_cli.simulate.recording import Recording
    from imucalib_cli.study.study import Cell, Row


@dataclass(frozen=True, kw_only=True)
class FoldedParameters(Recorded):
    """What configs/studies/ states of both, with units."""

    systems: tuple[str, ...]
    folds: int
    seeds: int
    paper_windows: tuple[int, ...]
    paper_exclusions: tuple[float, ...]

    def seed_of(self, cell: Cell) -> int:
        """A seed for each run of a condition: folds see other draws too (section 4.4)."""
        return int(cell["fold"] or 0) * self.seeds + int(cell["seed"] or 0)

    def calibrate(
        self,
        methods: Sequence[str],
        cell: Cell,
        clean: Recording,
        noise: NoiseOptions,
        *,
        noise_seed: int,
        initial_error: tuple[float, float],
    ) -> list[Row]:
        """All methods on what a fold leaves of a recording.

        Args:
            methods: To run.
            cell: With ``fold`` and ``seed``.
            clean: The recording without noise.
            noise: To add.
            noise_seed: Of it.
            initial_error: Of the guess that the published method starts from, m and rad.
        """
        moves = moves_of(clean.system, self.duration or clean.system.duration)
        held_out = stratified_folds(moves, self.folds)[int(cell["fold"] or 0)]
        guess = wrong_guess(clean, *initial_error, self.seed_of(cell))
        recording = without(corrupt(clean, noise, noise_seed), held_out)
        settings = paper_settings(self.paper_windows, self.paper_exclusions)
        return [
            cell
            | contest(method, recording, options)
            | {"setting": setting.words if setting else None}
            for method, setting, options in contestants(methods, recording, guess, settings)
        ]


def steadily_small(rows: list[Row]) -> tuple[int, float]:
    """Badness of a setting: answers that are missing, then the geometric mean of translation."""
    errors = column(rows, "translation")
    missing = len(rows) - len(errors)
    return missing, float(np.mean(np.log(errors))) if errors else math.inf


def in_best_setting(
    rows: Sequence[Row], badness: Callable[[list[Row]], Any], *keys: str
) -> list[Row]:
    """Rows in the best setting of each group: the most that tuning could do for it.

    Args:
        rows: Of a study.
        badness: What the best setting has least of.
        keys: What makes a group.
    """
    return [row for group in groups(rows, *keys) for row in best_setting(group, badness)]


ERROR_COLUMNS: tuple[Column, ...] = (
    ("translation mm", lambda rows: spread(rows, "translation", MILLIMETRES)),
    ("rotation deg", lambda rows: spread(rows, "rotation", DEGREES)),
    ("|mean Δxyz| mm", lambda rows: spread(rows, "averaged_translation", MILLIMETRES)),
    ("mean |rpy| deg", lambda rows: spread(rows, "averaged_rotation", DEGREES)),
)
"""Mean ± standard deviation over rows."""
