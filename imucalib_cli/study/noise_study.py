"""Table 2: errors over the noise of the IMU, and what a stamp offset does to them.

Each pair of noise levels is calibrated on folds of moves with several seeds, as in section 4.4 of
the paper. Its open question, why errors grow on the arm and not on the bar, is put to the test by
stamps that are late by less and by more than a sample period.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from imucalib_cli.simulate.options import NoiseOptions
from imucalib_cli.study.contest import METHODS
from imucalib_cli.study.folded import (
    ERROR_HEADER,
    FoldedParameters,
    Trial,
    calibrate_fold,
    error_cells,
    in_best_setting,
    seed_of,
    setting_of,
)
from imucalib_cli.study.load import load_parameters
from imucalib_cli.study.noise_claims import noise_claims
from imucalib_cli.study.summary import chosen, digits
from imucalib_cli.study.table import Table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from imucalib_cli.study.experiment import Cell, Figure, Row, Study

PARTS = ("accel", "gyro", "both")
"""Which noise varies."""


@dataclass(frozen=True, kw_only=True)
class NoiseParameters(FoldedParameters):
    """As configs/studies/noise.yaml states them, with units and sources."""

    accel: tuple[float, ...]
    gyro: tuple[float, ...]
    initial_translation: float
    initial_rotation_deg: float
    offset_system: str
    offsets: tuple[float, ...]

    def levels(self, part: str) -> list[tuple[float, float]]:
        """Pairs of accelerometer's and gyroscope's noise of one part of the table."""
        match part:
            case "accel":
                return [(level, 0.0) for level in self.accel]
            case "gyro":
                return [(0.0, level) for level in self.gyro]
            case _:
                return list(zip(self.accel, self.gyro, strict=True))


@dataclass(frozen=True)
class NoiseStudy:
    """Section 4.4 and Table 2."""

    config: NoiseParameters
    name: str = "noise"

    def cells(self) -> list[Cell]:
        """Every pair of levels on every fold with every seed."""
        conditions = [
            (system, accel, gyro, 0.0)
            for system in self.config.systems
            for part in PARTS
            for accel, gyro in self.config.levels(part)
        ]
        conditions += [
            (self.config.offset_system, accel, gyro, offset)
            for offset in self.config.offsets
            for accel, gyro in self.config.levels("accel")
        ]
        return [
            run
            for system, accel, gyro, offset in dict.fromkeys(conditions)
            for run in self.config.runs(
                {"system": system, "accel": accel, "gyro": gyro, "offset": offset}
            )
        ]

    def measure(self, cell: Cell) -> list[Row]:
        """All methods on one fold with one seed."""
        config = self.config
        trial = Trial(
            noise=NoiseOptions(
                accel_white=float(cell["accel"] or 0.0),
                gyro_white=float(cell["gyro"] or 0.0),
                time_offset=float(cell["offset"] or 0.0),
            ),
            noise_seed=seed_of(config, cell),
            initial_translation=config.initial_translation,
            initial_rotation=math.radians(config.initial_rotation_deg),
        )
        return calibrate_fold(config, cell, trial, METHODS)

    def tables(self, rows: Sequence[Row]) -> list[Table]:
        """One table a system and part, one for offsets, and the claims."""
        rows = in_best_setting(rows, "system", "accel", "gyro", "offset", "method")
        made = [
            _table(
                chosen(rows, system=system, offset=0.0),
                f"{system}: {_PART_WORDS[part]}",
                self.config.levels(part),
                METHODS,
            )
            for system in self.config.systems
            for part in PARTS
        ]
        made += [
            _table(
                chosen(rows, system=self.config.offset_system, offset=offset),
                f"{self.config.offset_system}: IMU stamps {offset * 1e3:g} ms late "
                f"({offset * self.config.imu_rate:.2g} periods)",
                self.config.levels("accel"),
                METHODS,
            )
            for offset in self.config.offsets
        ]
        return [*made, noise_claims(rows, self.config.accel, self.config.gyro)]

    def figures(self, rows: Sequence[Row]) -> list[Figure]:
        """None: the tables say it."""
        del rows
        return []


_PART_WORDS = {
    "accel": "accelerometer noise, gyroscope without",
    "gyro": "gyroscope noise, accelerometer without",
    "both": "both",
}


def _table(
    rows: Sequence[Row], title: str, levels: list[tuple[float, float]], methods: tuple[str, ...]
) -> Table:
    lines = []
    for accel, gyro in levels:
        for method in methods:
            found = chosen(rows, accel=accel, gyro=gyro, method=method)
            failed = sum(row["failure"] is not None for row in found)
            lines.append(
                (
                    digits(accel),
                    digits(gyro),
                    method,
                    setting_of(found),
                    *error_cells(found),
                    f"{len(found) - failed} of {len(found)}",
                )
            )
    return Table(
        title=title,
        header=(
            "σ_a m/s²",
            "σ_ω rad/s",
            "method",
            "its setting",
            *ERROR_HEADER,
            "answers",
        ),
        rows=tuple(lines),
    )


def load(file: Path | None, *, quick: bool) -> Study:
    """The study with its parameters."""
    return NoiseStudy(load_parameters(NoiseParameters, "noise", file, quick=quick))
