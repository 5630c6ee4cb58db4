"""One parameter swept, everything else held: conditions, methods and seeds on a grid.

The studies of what the paper leaves open share this; each says only what its parameter does.
Beside every error stands the Cramér-Rao bound with the unknowns of the method in question.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar, Generic, TypeVar

from imucalib_cli.estimate.options import WindowChoice
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.study.bound import bound_columns
from imucalib_cli.study.conditions import Condition, Recorded, condition_of
from imucalib_cli.study.contest import METHODS, PUBLISHED, Method, Settings, contest
from imucalib_cli.study.experiment import Figure
from imucalib_cli.study.guesses import wrong_guess
from imucalib_cli.study.paper_setting import paper_settings
from imucalib_cli.study.summary import chosen
from imucalib_cli.study.sweep_figures import draw_sweep
from imucalib_cli.study.sweep_tables import NOTE, summary_table, sweep_table
from imucalib_cli.study.systems import clean_recording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.simulate.options import NoiseOptions, PhysicsOptions
    from imucalib_cli.study.experiment import Cell, Row
    from imucalib_cli.study.paper_setting import PaperSetting
    from imucalib_cli.study.table import Table


@dataclass(frozen=True, kw_only=True)
class SweepParameters(Recorded):
    """What configs/studies/ states of every sweep, with units."""

    systems: tuple[str, ...]
    conditions: tuple[Condition, ...]
    seeds: int
    paper_windows: tuple[int, ...]
    paper_exclusions: tuple[float, ...]
    initial_translation: float
    initial_rotation_deg: float


@dataclass(frozen=True, kw_only=True)
class Part:
    """One of a study's sweeps."""

    name: str
    words: str
    """What is swept, with its unit, for headers and axes."""
    values: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Setup:
    """All that one run is made with."""

    physics: PhysicsOptions
    noise: NoiseOptions
    variants: tuple[PaperSetting, ...]
    """Of the published method: each is run, tables show the best."""
    window: WindowChoice = field(default_factory=WindowChoice)
    """Of the matched filters."""


Config = TypeVar("Config", bound=SweepParameters)


@dataclass(frozen=True)
class Sweep(ABC, Generic[Config]):
    """A study with one parameter on the abscissa."""

    name: ClassVar[str]
    note: ClassVar[str]
    """What its tables need said, beside what all sweeps say."""
    config: Config

    @abstractmethod
    def parts(self) -> list[Part]:
        """What is swept, and over which values."""

    @abstractmethod
    def change(self, setup: Setup, part: str, value: float, seed: int) -> Setup:
        """The run's setup with the parameter at a value."""

    def methods(self) -> tuple[Method, ...]:
        """Who takes part."""
        return METHODS

    def cells(self) -> list[Cell]:
        """Every value under every condition with every seed."""
        return [
            {
                "system": system,
                "part": part.name,
                "condition": condition.name,
                "value": value,
                "seed": seed,
            }
            for system in self.config.systems
            for part in self.parts()
            for condition in self.config.conditions
            for value in part.values
            for seed in range(condition.seeds or self.config.seeds)
        ]

    def setup(self, cell: Cell) -> Setup:
        """What a cell is run with."""
        config = self.config
        condition = condition_of(config.conditions, cell["condition"])
        setup = Setup(
            physics=config.physics,
            noise=condition.sensors,
            variants=paper_settings(config.paper_windows, config.paper_exclusions),
        )
        return self.change(
            setup, str(cell["part"]), float(cell["value"] or 0), int(cell["seed"] or 0)
        )

    def measure(self, cell: Cell) -> list[Row]:
        """All methods on one recording, the published one in each of its variants."""
        config, setup, seed = self.config, self.setup(cell), int(cell["seed"] or 0)
        clean = clean_recording(str(cell["system"]), setup.physics)
        recording = corrupt(clean, setup.noise, seed)
        guess = wrong_guess(
            clean, config.initial_translation, math.radians(config.initial_rotation_deg), seed
        )
        settings = Settings(
            window=setup.window, R_initial=guess.R_parent_imu, t_initial=guess.t_parent_imu
        )
        rows: list[Row] = []
        for method in self.methods():
            bound = bound_columns(clean, setup.noise, alone=method != "matched")
            if method not in PUBLISHED:
                untuned: Row = {"window": None, "exclusion": None}
                rows += [
                    cell | row | untuned | bound for row in contest(recording, (method,), settings)
                ]
                continue
            for variant in setup.variants:
                tuned: Row = {"window": variant.window, "exclusion": variant.exclusion}
                found = contest(recording, (method,), settings.published(variant))
                rows += [cell | row | tuned | bound for row in found]
        return rows

    def tables(self, rows: Sequence[Row]) -> list[Table]:
        """One a system, part and condition; what must be known of all stands with the first."""
        sweeps = [
            (
                f"{system}: {part.words}, {condition.name}",
                part.words,
                chosen(rows, system=system, part=part.name, condition=condition.name),
            )
            for system in self.config.systems
            for part in self.parts()
            for condition in self.config.conditions
        ]
        first, *others = (sweep_table(mine, title, words) for title, words, mine in sweeps)
        short = summary_table([(title, mine) for title, _, mine in sweeps])
        return [replace(first, note=NOTE + self.note), *others, short]

    def figures(self, rows: Sequence[Row]) -> list[Figure]:
        """One a system and part, a column of panels a condition."""

        def figure(system: str, part: Part) -> Figure:
            mine = chosen(rows, system=system, part=part.name)
            return Figure(
                f"{self.name}-{system}-{part.name}",
                lambda path: draw_sweep(mine, part.words, path),
            )

        return [figure(system, part) for system in self.config.systems for part in self.parts()]
