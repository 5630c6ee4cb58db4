"""Table 2: errors over the noise of the IMU, and what gravity, time and inertia have to do with it.

Each pair of noise levels is calibrated on folds of moves with several seeds, as in section 4.4 of
the paper. Its open question, why errors grow on the arm and not on the bar, is put to the test:
by stamps that are late by less and by more than a sample period, with and without gravity, and by
bars of other inertia.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from imucalib_cli.simulate.options import (
    NoiseOptions,
    Vector,
)
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
from imucalib_cli.study.noise_claims import Criteria, noise_claims, question_claims
from imucalib_cli.study.summary import chosen, digits
from imucalib_cli.study.systems import clean_recording
from imucalib_cli.study.table import Table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from imucalib_cli.simulate.options import PhysicsOptions
    from imucalib_cli.study.experiment import Cell, Figure, Row, Study

PARTS = ("accel", "gyro", "both")
"""Which noise varies."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A system, perhaps changed."""

    name: str
    system: str
    gravity: float | None = None
    """m/s²; None is the system's own, as below."""
    inertia: Vector | None = None
    """kg m²."""
    robot_phase: float = 0.0
    """Of a period, by which the robot's instants come after those of the IMU."""
    offsets: tuple[float, ...] = (0.0,)
    """s, by which stamps of the IMU are late."""

    def physics(self, common: PhysicsOptions) -> PhysicsOptions:
        """How it is recorded."""
        return replace(
            common, gravity=self.gravity, inertia=self.inertia, robot_phase=self.robot_phase
        )


@dataclass(frozen=True, kw_only=True)
class NoiseParameters(FoldedParameters):
    """As configs/studies/noise.yaml states them, with units and sources."""

    accel: tuple[float, ...]
    gyro: tuple[float, ...]
    adis: tuple[float, ...]
    initial_translation: float
    initial_rotation_deg: float
    aside_accel: tuple[float, ...]
    timing: tuple[Case, ...] = ()
    bodies: tuple[Case, ...] = ()
    claims: Criteria

    def __post_init__(self) -> None:
        """Refuse levels that cannot be paired, and cases of one name that differ."""
        super().__post_init__()
        if len(self.accel) != len(self.gyro):
            raise ValueError("accel and gyro need as many levels each: they are paired")
        if 0.0 not in self.accel or 0.0 not in self.gyro:
            raise ValueError("accel and gyro need the level 0 among theirs: each varies alone")
        for case in (*self.timing, *self.bodies):
            if replace(self.case(case.name), offsets=case.offsets) != case:
                raise ValueError(f"two cases are named {case.name} and differ")

    def case(self, name: str) -> Case:
        """By its name; systems are cases too."""
        cases = [Case(name=system, system=system) for system in self.systems]
        return next(c for c in (*cases, *self.timing, *self.bodies) if c.name == name)

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
        """Every pair of levels on every fold with every seed, then the open question's cases."""
        config = self.config
        conditions = [
            (system, accel, gyro, 0.0)
            for system in config.systems
            for part in PARTS
            for accel, gyro in config.levels(part)
        ]
        conditions += [
            (case.name, accel, 0.0, offset)
            for case in (*config.timing, *config.bodies)
            for offset in case.offsets
            for accel in config.aside_accel
        ]
        return [
            run
            for case, accel, gyro, offset in dict.fromkeys(conditions)
            for run in config.runs({"case": case, "accel": accel, "gyro": gyro, "offset": offset})
        ]

    def measure(self, cell: Cell) -> list[Row]:
        """All methods on one fold with one seed."""
        config = self.config
        case = config.case(str(cell["case"]))
        trial = Trial(
            clean=clean_recording(case.system, case.physics(config.physics)),
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
        """One table a system and part, those of the open question, and the claims."""
        config = self.config
        best = in_best_setting(rows, "case", "accel", "gyro", "offset", "method")
        made = [
            _table(
                f"{system}: {_PART_WORDS[part]}",
                [(chosen(best, case=system, offset=0.0), pair) for pair in config.levels(part)],
            )
            for system in config.systems
            for part in PARTS
        ]
        made += [
            self._aside(best, case, "stamps of the IMU that are late") for case in config.timing
        ]
        made += [self._aside(best, case, "inertia") for case in config.bodies]
        return [
            *made,
            noise_claims(rows, config.accel, config.gyro, config.adis, config.claims),
            question_claims(rows, config.aside_accel, config.timing, config.bodies, config.claims),
        ]

    def _aside(self, rows: Sequence[Row], case: Case, words: str) -> Table:
        levels = [
            (chosen(rows, case=case.name, offset=offset), (accel, 0.0))
            for offset in case.offsets
            for accel in self.config.aside_accel
        ]
        return _table(f"{case.name}: {words}", levels)

    def figures(self, rows: Sequence[Row]) -> list[Figure]:
        """None: the tables say it."""
        del rows
        return []


_PART_WORDS = {
    "accel": "accelerometer noise, gyroscope without",
    "gyro": "gyroscope noise, accelerometer without",
    "both": "both",
}


def _table(title: str, levels: Sequence[tuple[Sequence[Row], tuple[float, float]]]) -> Table:
    """Rows of a case and an offset, each with a pair of levels to take of them."""
    lines = []
    for rows, (accel, gyro) in levels:
        for method in METHODS:
            found = chosen(rows, accel=accel, gyro=gyro, method=method)
            failed = sum(row["failure"] is not None for row in found)
            lines.append(
                (
                    digits(1e3 * float(found[0]["offset"] or 0.0)) if found else "-",
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
            "late ms",
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
