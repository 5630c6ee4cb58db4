"""Sweep one parameter with everything else fixed: conditions, methods and seeds on a grid.

Studies of questions that the paper leaves open. Each defines only the effect of its parameter.
Every error is shown with the Cramér-Rao bound for the unknowns of its method.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np

from imucalib_cli.estimate.options import WindowChoice
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.study.bound import bound_columns
from imucalib_cli.study.conditions import Conditioned, paper_settings, wrong_guess
from imucalib_cli.study.contest import METHODS, contest
from imucalib_cli.study.figures import COLOURS, draw_curve, logarithmic, new_figure, save_svg
from imucalib_cli.study.recordings import clean_recording
from imucalib_cli.study.rows import (
    ERRORS,
    MILLIMETRES,
    best_setting,
    chosen,
    groups,
    mean,
    over_bound,
    root_mean_square,
    worst,
)
from imucalib_cli.study.study import Draw, Row, Study, grid
from imucalib_cli.study.tables import (
    Column,
    Table,
    answered,
    count,
    digits,
    lay_out,
    number,
    statistic,
    text,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes

    from imucalib_cli.estimate.options import PaperOptions
    from imucalib_cli.simulate.options import NoiseOptions, PhysicsOptions
    from imucalib_cli.study.study import Cell

T = TypeVar("T", "NoiseOptions", "PhysicsOptions")

NOTE = (
    "Of all tables: root mean square over seeds; over bound is its ratio to the Cramér-Rao bound "
    "of this motion and the IMU's white noise, with the unknowns of the method: the pose alone, "
    "or, for matched, biases, tilt and time offset too. The published method is in the window and "
    "exclusion that the truth shows to be its best. "
)


@dataclass(frozen=True, kw_only=True)
class Setup:
    """Inputs of one run."""

    physics: PhysicsOptions
    noise: NoiseOptions
    settings: tuple[PaperOptions, ...]
    """Of the published method: all are run, tables show the best."""
    window: WindowChoice
    """Of the matched filters."""


@dataclass(frozen=True)
class Part:
    """One of a study's sweeps."""

    name: str
    parameter: str
    """Of the study, that has the values."""
    words: str
    """What is swept, with its unit, for headers and axes; may name other parameters."""
    options: tuple[str, ...]
    """Of sensors or simulation, that take each value; a vector takes it as its norm."""


@dataclass(frozen=True, kw_only=True)
class Sweep(Study, Conditioned):
    """A study with one parameter on the abscissa."""

    note: ClassVar[str]
    """What its tables need said, beside what all sweeps say."""
    parts: ClassVar[tuple[Part, ...]]
    systems: tuple[str, ...]
    paper_windows: tuple[int, ...]
    paper_exclusions: tuple[float, ...]
    initial_translation: float
    initial_rotation_deg: float

    @property
    def words(self) -> dict[str, str]:
        """What is swept, by the name of the part."""
        return {part.name: part.words.format_map(vars(self)) for part in self.parts}

    def values(self, part: Part) -> Sequence[float]:
        """What is swept over."""
        values: Sequence[float] = getattr(self, part.parameter)
        return values

    def cells(self) -> list[Cell]:
        """Every value under every condition with every seed."""
        values = {part.name: self.values(part) for part in self.parts}
        return grid(
            system=self.systems,
            part=values,
            condition=self.names,
            value=lambda cell: values[cell["part"]],
            seed=self.seeds_of,
        )

    def setup(self, cell: Cell) -> Setup:
        """What a cell is run with."""
        (part,) = (part for part in self.parts if part.name == cell["part"])
        direction = np.random.default_rng(cell["seed"]).normal(size=3)  # the same for every norm
        vector = tuple((cell["value"] * direction / np.linalg.norm(direction)).tolist())

        def changed(options: T) -> T:
            own: dict[str, Any] = {
                name: vector if isinstance(old, tuple) else cell["value"]
                for name, old in vars(options).items()
                if name in part.options
            }
            return replace(options, **own)

        return Setup(
            physics=changed(self.physics),
            noise=changed(self.condition_of(cell).sensors),
            settings=paper_settings(self.paper_windows, self.paper_exclusions),
            window=WindowChoice(),
        )

    def measure(self, cell: Cell) -> list[Row]:
        """All methods on one recording, the published one in each of its settings."""
        setup, seed = self.setup(cell), cell["seed"]
        clean = clean_recording(cell["system"], setup.physics)
        recording = corrupt(clean, setup.noise, seed)
        guess = wrong_guess(
            clean, self.initial_translation, math.radians(self.initial_rotation_deg), seed
        )
        return [
            cell
            | row
            | {
                "window": setting.window.samples if setting else None,
                "exclusion": setting.exclusion_threshold if setting else None,
            }
            | bound_columns(clean, setup.noise, alone=row["method"] != "matched")
            for setting, row in contest(METHODS, recording, guess, setup.settings, setup.window)
        ]

    def tables(self, rows: Sequence[Row]) -> list[Table]:
        """One a system, part and condition; what must be known of all stands with the first."""
        words = self.words
        titled = {
            f"{cell['system']}: {words[cell['part']]}, {cell['condition']}": chosen(rows, **cell)
            for cell in grid(system=self.systems, part=words, condition=self.names)
        }
        first, *others = (
            sweep_table(title, words[mine[0]["part"]], mine) for title, mine in titled.items()
        )
        return [replace(first, note=NOTE + self.note), *others, summary_table(titled)]

    def figures(self, rows: Sequence[Row]) -> dict[str, Draw]:
        """One a system and part, a column of panels a condition."""
        return {
            f"{self.name}-{system}-{part}": partial(
                draw_sweep, chosen(rows, system=system, part=part), words
            )
            for system in self.systems
            for part, words in self.words.items()
        }


def best_points(rows: Sequence[Row]) -> list[list[Row]]:
    """The rows of each value and method, in the order of the rows, under one condition.

    Where the published method was run in several settings, those of the one that answers most
    often and, of these, with the least error of translation: the most that tuning could do for it.
    """
    return [
        best_setting(mine, _badness, "window", "exclusion")
        for mine in groups(rows, "value", "method")
    ]


def _badness(rows: Sequence[Row]) -> tuple[int, float]:
    error = root_mean_square(rows, "translation")
    return sum(not answered(row) for row in rows), math.inf if math.isnan(error) else error


_COLUMNS: tuple[Column, ...] = (
    text("method"),
    text("window", "its L"),
    number("exclusion", "its exclusion m/s²"),
    *(
        made
        for key, scale, unit in ERRORS
        for made in (
            statistic(f"{key} {unit}", root_mean_square, key, scale),
            statistic(f"worst {unit}", worst, key, scale),
            statistic("over bound", over_bound, key),
        )
    ),
    count("answers", answered),
    count("trusted", lambda row: row["trusted"] is True),
)


def sweep_table(title: str, words: str, rows: Sequence[Row]) -> Table:
    """Errors of every method at every value, under one condition; words with the value's unit."""
    return lay_out(title, (number("value", words), *_COLUMNS), best_points(rows))


def summary_table(sweeps: Mapping[str, Sequence[Row]]) -> Table:
    """Each sweep in a line a method: where it is best, and what the ends of the sweep cost.

    Args:
        sweeps: Rows of each by its title, as for the tables above it.
    """

    def error(rows: Sequence[Row]) -> str:
        return digits(root_mean_square(rows, "translation") * MILLIMETRES)

    def value(rows: Sequence[Row]) -> str:
        return digits(rows[0]["value"])

    def line(title: str, points: list[list[Row]]) -> tuple[str, ...]:
        best, ends = min(points, key=_badness), (points[0], points[-1])
        return (
            title,
            best[0]["method"],
            value(best),
            error(best),
            digits(over_bound(best, "translation")),
            *(f"{error(end)} at {value(end)}" for end in ends),
        )

    return Table(
        title="In short: translation errors, root mean square, mm",
        header=("sweep", "method", "best at", "error there", "over bound", "first", "last"),
        rows=tuple(
            line(title, best_points(mine))
            for title, rows in sweeps.items()
            for mine in groups(rows, "method")
        ),
    )


def draw_sweep(rows: Sequence[Row], words: str, path: Path) -> None:
    """Translation above, rotation below, a column of panels a condition."""
    conditions = groups(rows, "condition")
    figure, panels = new_figure(len(ERRORS), len(conditions), share_x=True)
    for line, (key, scale, unit) in enumerate(ERRORS):
        for place, mine in enumerate(conditions):
            axes = panels[line * len(conditions) + place]
            _draw_errors(axes, best_points(mine), key, scale)
            if line == 0:
                axes.set_title(str(mine[0]["condition"]))
            else:
                axes.set_xlabel(words)
            if place == 0:
                axes.set_ylabel(f"{key} error, {unit}")
    handles = {
        name: handle
        for axes in panels
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=3)
    save_svg(figure, path)


def _draw_errors(axes: Axes, points: list[list[Row]], key: str, scale: float) -> None:
    """The error of each method over the parameter, then the two bounds."""
    for place, method in enumerate(dict.fromkeys(point[0]["method"] for point in points)):
        mine = [point for point in points if point[0]["method"] == method]
        errors = [scale * root_mean_square(point, key) for point in mine]
        values = [point[0]["value"] for point in mine]
        draw_curve(axes, method, values, errors, color=COLOURS[place])
    bounds = ("bound, pose alone", False, "--"), ("bound, all unknowns", True, ":")
    for name, everything, style in bounds:
        bound = {
            point[0]["value"]: scale * mean(point, f"bound_{key}")
            for point in points
            if (point[0]["method"] == "matched") == everything
        }
        draw_curve(
            axes, name, list(bound), list(bound.values()), color="black", linestyle=style, marker=""
        )
    logarithmic(axes)


@dataclass(frozen=True, kw_only=True)
class WindowStudy(Sweep):
    """The window's length, which the paper calls small without a number.

    The same length for all filters of a run, on both sides of each method.
    """

    name = "window"
    note = (
        "A window is L sample intervals; an even L is taken one longer, as the filters need it odd."
    )
    parts = (Part("window", "samples", "window s", ()),)
    samples: tuple[int, ...]

    def values(self, part: Part) -> Sequence[float]:
        """Seconds, so that rates can be compared."""
        return [samples / self.imu_rate for samples in super().values(part)]

    def setup(self, cell: Cell) -> Setup:
        """The filters of both methods."""
        samples = round(cell["value"] * self.imu_rate)
        return replace(
            super().setup(cell),
            settings=paper_settings((samples,), self.paper_exclusions),
            window=WindowChoice(samples=samples),
        )


@dataclass(frozen=True, kw_only=True)
class EncoderStudy(Sweep):
    """Joint positions as encoders read them: with noise, and in steps.

    Noise of the kinematics enters the regressors and not the readings alone.
    """

    name = "encoder"
    note = (
        "The bound is that of perfect encoders: noise of the kinematics can only raise it. The "
        "matched filters choose their window from the log."
    )
    parts = (
        Part("noise", "noise", "encoder noise rad", ("encoder_noise",)),
        Part("step", "step", "encoder step rad", ("encoder_step",)),
    )
    noise: tuple[float, ...]
    step: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class BiasStudy(Sweep):
    """Biases of the IMU, constant and wandering, which the published method takes for zero."""

    name = "bias"
    note = (
        "A bias has the norm stated and a direction of the seed's; a walk begins at zero. The "
        "bound knows of constant biases, not of their walk. The published method and matched, "
        "pose only, take biases to be zero."
    )
    parts = (
        Part("accel", "accel_bias", "accelerometer bias m/s²", ("accel_bias",)),
        Part("gyro", "gyro_bias", "gyroscope bias rad/s", ("gyro_bias",)),
        Part(
            "accel-walk",
            "accel_bias_walk",
            "accelerometer bias walk m/s²/√s",
            ("accel_bias_walk",),
        ),
        Part("gyro-walk", "gyro_bias_walk", "gyroscope bias walk rad/s/√s", ("gyro_bias_walk",)),
    )
    accel_bias: tuple[float, ...]
    gyro_bias: tuple[float, ...]
    accel_bias_walk: tuple[float, ...]
    gyro_bias_walk: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class RateStudy(Sweep):
    """The rates of the log, which are not known for the paper's.

    Both streams faster or slower, and the robot's slower than the IMU's.
    """

    name = "rate"
    note = (
        "The noise densities are the same at every rate, so the bound is too, nearly. The "
        "published method smooths the IMU with as many samples as it derives the kinematics with, "
        "as its authors do, and takes the nearest sample of the IMU."
    )
    parts = (
        Part("together", "together", "rate of IMU and robot Hz", ("imu_rate", "robot_rate")),
        Part("robot", "robot", "robot's rate Hz, IMU at {imu_rate:g}", ("robot_rate",)),
    )
    together: tuple[float, ...]
    robot: tuple[float, ...]
