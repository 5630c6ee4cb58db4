"""Table 2: errors over the noise of the IMU, and what a stamp offset does to them.

Each pair of noise levels is calibrated on folds of moves with several seeds, as in section 4.4 of
the paper. Its open question, why errors grow on the arm and not on the bar, is put to the test by
stamps that are late by less and by more than a sample period.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from imucalib_cli.estimate.options import WindowChoice
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import NoiseOptions, PhysicsOptions
from imucalib_cli.study.contest import METHODS, Settings, contest
from imucalib_cli.study.folds import moves_of, stratified_folds, without
from imucalib_cli.study.guesses import wrong_guess
from imucalib_cli.study.load import load_parameters
from imucalib_cli.study.noise_claims import noise_claims
from imucalib_cli.study.summary import DEGREES, MILLIMETRES, chosen, digits, spread
from imucalib_cli.study.systems import clean_recording
from imucalib_cli.study.table import Table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from imucalib_cli.study.experiment import Cell, Figure, Row, Study

PARTS = ("accel", "gyro", "both")
"""Which noise varies."""


@dataclass(frozen=True, kw_only=True)
class NoiseParameters:
    """As configs/studies/noise.yaml states them, with units and sources."""

    systems: tuple[str, ...]
    imu_rate: float
    robot_rate: float
    profile: Literal["smooth", "hard"]
    folds: int
    seeds: int
    accel: tuple[float, ...]
    gyro: tuple[float, ...]
    paper_window: int
    paper_exclusion: float
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
            {
                "system": system,
                "accel": accel,
                "gyro": gyro,
                "offset": offset,
                "fold": fold,
                "seed": seed,
            }
            for system, accel, gyro, offset in dict.fromkeys(conditions)
            for fold in range(self.config.folds)
            for seed in range(self.config.seeds)
        ]

    def measure(self, cell: Cell) -> list[Row]:
        """All methods on one fold with one seed."""
        config, system = self.config, str(cell["system"])
        physics = PhysicsOptions(
            imu_rate=config.imu_rate, robot_rate=config.robot_rate, profile=config.profile
        )
        clean = clean_recording(system, physics)
        noise = NoiseOptions(
            accel_white=float(cell["accel"] or 0.0),
            gyro_white=float(cell["gyro"] or 0.0),
            time_offset=float(cell["offset"] or 0.0),
        )
        fold = int(cell["fold"] or 0)
        # Folds see other noise too: a seed is a seed of one calibration (section 4.4).
        seed = fold * config.seeds + int(cell["seed"] or 0)
        folds = stratified_folds(moves_of(clean.system, clean.system.duration), config.folds)
        recording = without(corrupt(clean, noise, seed), folds[fold])
        guess = wrong_guess(
            clean, config.initial_translation, math.radians(config.initial_rotation_deg), seed
        )
        settings = Settings(
            paper_window=WindowChoice(samples=config.paper_window),
            paper_exclusion=config.paper_exclusion,
            R_initial=guess.R_parent_imu,
            t_initial=guess.t_parent_imu,
        )
        return [cell | row for row in contest(recording, METHODS, settings)]

    def tables(self, rows: Sequence[Row]) -> list[Table]:
        """One table a system and part, one for offsets, and the claims."""
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
                    spread(found, "translation", MILLIMETRES),
                    spread(found, "rotation", DEGREES),
                    spread(found, "averaged_translation", MILLIMETRES),
                    spread(found, "averaged_rotation", DEGREES),
                    f"{len(found) - failed} of {len(found)}",
                )
            )
    return Table(
        title=title,
        header=(
            "σ_a m/s²",
            "σ_ω rad/s",
            "method",
            "translation mm",
            "rotation deg",
            "|mean Δxyz| mm",
            "mean |rpy| deg",
            "answers",
        ),
        rows=tuple(lines),
    )


def load(file: Path | None, *, quick: bool) -> Study:
    """The study with its parameters."""
    return NoiseStudy(load_parameters(NoiseParameters, "noise", file, quick=quick))
