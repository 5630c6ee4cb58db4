"""Table 3: what the error of the initial guess does to the result (section 4.5 of the paper)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from imucalib_cli.simulate.options import NoiseOptions
from imucalib_cli.study.claims import Claim, claims_table
from imucalib_cli.study.folded import (
    ERROR_HEADER,
    FoldedParameters,
    Trial,
    calibrate_fold,
    error_cells,
    setting_of,
)
from imucalib_cli.study.load import load_parameters
from imucalib_cli.study.summary import DEGREES, MILLIMETRES, chosen, column, digits, least_setting
from imucalib_cli.study.systems import clean_recording
from imucalib_cli.study.table import Table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from imucalib_cli.study.contest import Method
    from imucalib_cli.study.experiment import Cell, Figure, Row, Study

METHODS: tuple[Method, ...] = ("paper", "paper, components", "matched")


@dataclass(frozen=True, kw_only=True)
class InitialErrorParameters(FoldedParameters):
    """As configs/studies/initial-error.yaml states them, with units."""

    translation: tuple[float, ...]
    rotation_deg: tuple[float, ...]
    accel: float
    gyro: float
    failed_translation: float
    failed_rotation_deg: float
    same_translation: float
    realistic_rotation_deg: float

    def __post_init__(self) -> None:
        """Refuse sizes that cannot be paired."""
        super().__post_init__()
        if len(self.translation) != len(self.rotation_deg):
            raise ValueError("translation and rotation_deg need as many sizes: they are paired")

    def sizes(self) -> list[tuple[float, float]]:
        """Translation, m, and rotation, deg: each alone, then both together."""
        pairs = [(size, 0.0) for size in self.translation]
        pairs += [(0.0, size) for size in self.rotation_deg]
        pairs += zip(self.translation, self.rotation_deg, strict=True)
        return list(dict.fromkeys(pairs))


@dataclass(frozen=True)
class InitialErrorStudy:
    """Section 4.5 and Table 3."""

    config: InitialErrorParameters
    name: str = "initial-error"

    def cells(self) -> list[Cell]:
        """Every size of error on every fold in several directions."""
        return [
            run
            for system in self.config.systems
            for translation, rotation_deg in self.config.sizes()
            for run in self.config.runs(
                {
                    "system": system,
                    "initial_translation": translation,
                    "initial_rotation_deg": rotation_deg,
                }
            )
        ]

    def measure(self, cell: Cell) -> list[Row]:
        """All methods on one fold, from one guess; ours is given none."""
        config = self.config
        trial = Trial(
            clean=clean_recording(str(cell["system"]), config.physics),
            noise=NoiseOptions(accel_white=config.accel, gyro_white=config.gyro),
            # The noise is the fold's: only the guess differs between the seeds.
            noise_seed=int(cell["fold"] or 0),
            initial_translation=float(cell["initial_translation"] or 0.0),
            initial_rotation=math.radians(float(cell["initial_rotation_deg"] or 0.0)),
        )
        return calibrate_fold(config, cell, trial, METHODS)

    def tables(self, rows: Sequence[Row]) -> list[Table]:
        """One table a system, and the claims."""
        rows = self._in_steadiest_setting(rows)
        made = [self._table(chosen(rows, system=system), system) for system in self.config.systems]
        return [*made, claims_table("Claims of section 4.5", self._claims(rows))]

    def figures(self, rows: Sequence[Row]) -> list[Figure]:
        """None: the tables say it."""
        del rows
        return []

    def _in_steadiest_setting(self, rows: Sequence[Row]) -> list[Row]:
        """Each method on each system in the setting in which its result depends least on the guess.

        The exclusion is by the pose that the guess gives, so that it may depend much.
        """
        return [
            row
            for system in self.config.systems
            for method in METHODS
            for row in least_setting(chosen(rows, system=system, method=method), self._unsteadiness)
        ]

    def _unsteadiness(self, rows: Sequence[Row]) -> tuple[int, float]:
        """Failures, and how far the other results on a fold are apart, mm."""
        good = [row for row in rows if not self._failed(row)]
        widest = max(self._range(good, fold) for fold in range(self.config.folds))
        return len(rows) - len(good), widest

    def _failed(self, row: Row) -> bool:
        """Whether a calibration gave no answer, or one in another minimum."""
        translation, rotation = row["translation"], row["rotation"]
        return not (
            isinstance(translation, float)
            and isinstance(rotation, float)
            and translation <= self.config.failed_translation
            and rotation * DEGREES <= self.config.failed_rotation_deg
        )

    def _table(self, rows: Sequence[Row], system: str) -> Table:
        lines = []
        for translation, rotation_deg in self.config.sizes():
            sized = chosen(rows, initial_translation=translation, initial_rotation_deg=rotation_deg)
            for method in METHODS:
                found = chosen(sized, method=method)
                good = [row for row in found if not self._failed(row)]
                lines.append(
                    (
                        digits(translation),
                        digits(rotation_deg),
                        method,
                        setting_of(found),
                        *error_cells(good),
                        f"{len(found) - len(good)} of {len(found)}",
                    )
                )
        return Table(
            title=f"{system}: error of the initial guess",
            header=(
                "initial m",
                "initial deg",
                "method",
                "its setting",
                *ERROR_HEADER,
                "failed",
            ),
            rows=tuple(lines),
            note=(
                f"Failed: no answer, or one farther than {self.config.failed_translation * 1e3:g} "
                f"mm or {self.config.failed_rotation_deg:g} deg from the truth, another minimum; "
                "means and spreads are of the others. The published method stands in the setting "
                "in which its result depends least on the guess, which need not be its most exact. "
                "The matched method is given no guess."
            ),
        )

    def _claims(self, rows: Sequence[Row]) -> list[Claim]:
        limit = self.config.realistic_rotation_deg
        parts = {f"initial errors up to {limit:g} deg": False, f"beyond {limit:g} deg": True}
        made = []
        for system in self.config.systems:
            for method in METHODS:
                for words, beyond in parts.items():
                    found = [
                        row
                        for row in chosen(rows, system=system, method=method)
                        if (column([row], "initial_rotation_deg")[0] > limit) is beyond
                    ]
                    if found:
                        made.append(self._steady(f"{method}: {system}: {words}", found))
        return made

    def _steady(self, words: str, found: Sequence[Row]) -> Claim:
        failed, widest = self._unsteadiness(found)
        most = MILLIMETRES * self.config.same_translation
        return Claim(
            words=f"{words}: the result does not vary (no failure; within {most:g} mm of each "
            "other on each fold)",
            found=f"{failed} of {len(found)} failed; others within {digits(widest)} mm of each "
            "other",
            met=not failed and widest < most,
        )

    def _range(self, rows: Sequence[Row], fold: int) -> float:
        """Largest less smallest translation error on a fold, mm."""
        errors = column(chosen(rows, fold=fold), "translation")
        return MILLIMETRES * (max(errors) - min(errors)) if errors else math.nan


def load(file: Path | None, *, quick: bool) -> Study:
    """The study with its parameters."""
    return InitialErrorStudy(
        load_parameters(InitialErrorParameters, "initial-error", file, quick=quick)
    )
