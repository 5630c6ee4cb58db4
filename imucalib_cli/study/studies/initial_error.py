"""Table 3: what the error of the initial guess does to the result (section 4.5 of the paper)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from imucalib_cli.simulate.options import NoiseOptions
from imucalib_cli.study.contest import PUBLISHED
from imucalib_cli.study.recordings import clean_recording
from imucalib_cli.study.rows import DEGREES, MILLIMETRES, chosen, column
from imucalib_cli.study.studies.folded import FoldedStudy, in_best_setting
from imucalib_cli.study.tables import (
    ERROR_COLUMNS,
    Claim,
    Column,
    answered,
    claims_table,
    count,
    digits,
    number,
    text,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from imucalib_cli.study.study import Cell, Row
    from imucalib_cli.study.tables import Table

METHODS = (*PUBLISHED, "matched")


@dataclass(frozen=True, kw_only=True)
class InitialErrorStudy(FoldedStudy):
    """Section 4.5 and Table 3."""

    name = "initial-error"
    translation: tuple[float, ...]
    rotation_deg: tuple[float, ...]
    accel: float
    gyro: float
    failed_translation: float
    failed_rotation_deg: float
    same_translation: float
    realistic_rotation_deg: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.translation) != len(self.rotation_deg):
            raise ValueError("translation and rotation_deg need as many sizes: they are paired")

    def sections(self) -> dict[str, list[Cell]]:
        """A table a system: translation alone, rotation alone, then both together."""
        sizes = [(size, 0.0) for size in self.translation]
        sizes += [(0.0, size) for size in self.rotation_deg]
        sizes += zip(self.translation, self.rotation_deg, strict=True)
        return {
            f"{system}: error of the initial guess": [
                {"system": system, "initial_translation": size, "initial_rotation_deg": angle}
                for size, angle in dict.fromkeys(sizes)
            ]
            for system in self.systems
        }

    def measure(self, cell: Cell) -> list[Row]:
        """All methods on one fold, from one guess; ours is given none."""
        return self.calibrate(
            METHODS,
            cell,
            clean_recording(cell["system"], self.physics),
            NoiseOptions(accel_white=self.accel, gyro_white=self.gyro),
            # The noise is the fold's: only the guess differs between the seeds.
            noise_seed=cell["fold"],
            initial_error=(
                cell["initial_translation"],
                math.radians(cell["initial_rotation_deg"]),
            ),
        )

    def tables(self, rows: Sequence[Row]) -> list[Table]:
        """One table a system, and the claims; each method in its steadiest setting.

        That is the one in which the result depends least on the guess: the exclusion is by the
        pose that the guess gives, so that it may depend much.
        """
        rows = in_best_setting(rows, self._unsteadiness, "system", "method")
        note = (
            f"Failed: no answer, or one farther than {self.failed_translation * 1e3:g} mm "
            f"or {self.failed_rotation_deg:g} deg from the truth, another minimum; means "
            "and spreads are of the others. The published method stands in the setting in which "
            "its result depends least on the guess, which need not be its most exact. The matched "
            "method is given no guess."
        )
        errors: list[Column] = [
            (header, lambda rows, cell=cell: cell(self._good(rows)))  # type: ignore[misc]
            for header, cell in ERROR_COLUMNS
        ]
        columns: tuple[Column, ...] = (
            number("initial_translation", "initial m"),
            number("initial_rotation_deg", "initial deg"),
            text("method"),
            text("setting", "its setting"),
            *errors,
            count("failed", self._failed),
        )
        return [
            *self.section_tables(rows, METHODS, columns, note),
            claims_table("Claims of section 4.5", self._claims(rows)),
        ]

    def _failed(self, row: Row) -> bool:
        """Whether a calibration gave no answer, or one in another minimum."""
        return not (
            answered(row)
            and row["translation"] <= self.failed_translation
            and row["rotation"] * DEGREES <= self.failed_rotation_deg
        )

    def _good(self, rows: Sequence[Row]) -> list[Row]:
        return [row for row in rows if not self._failed(row)]

    def _unsteadiness(self, rows: Sequence[Row]) -> tuple[int, float]:
        """Failures, and how far the other results on a fold are apart, mm."""
        good = self._good(rows)
        folds = [chosen(good, fold=fold) for fold in range(self.folds)]
        errors = [column(fold, "translation") for fold in folds]
        ranges = [MILLIMETRES * (max(e) - min(e)) if e else math.nan for e in errors]
        return len(rows) - len(good), max(ranges)

    def _claims(self, rows: Sequence[Row]) -> Iterator[Claim]:
        limit = self.realistic_rotation_deg
        parts = {False: f"initial errors up to {limit:g} deg", True: f"beyond {limit:g} deg"}
        most = MILLIMETRES * self.same_translation
        for system in self.systems:
            for method in METHODS:
                mine = chosen(rows, system=system, method=method)
                for beyond, words in parts.items():
                    found = [row for row in mine if (row["initial_rotation_deg"] > limit) is beyond]
                    if not found:
                        continue
                    failed, widest = self._unsteadiness(found)
                    yield Claim(
                        words=f"{method}: {system}: {words}: the result does not vary (no "
                        f"failure; within {most:g} mm of each other on each fold)",
                        found=f"{failed} of {len(found)} failed; others within {digits(widest)} "
                        "mm of each other",
                        met=not failed and widest < most,
                    )
