"""Sweep one parameter with everything else fixed: conditions, methods and seeds on a grid.

These are studies of questions that the paper leaves open. Each states what it varies. Every error
is shown with the Cramér-Rao bound for the unknowns of its method.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from imucalib_cli.estimate.options import WindowChoice
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.study.bound import bound_columns
from imucalib_cli.study.experiment import Draw, Section, grid
from imucalib_cli.study.figures import COLOURS, draw_curve, logarithmic, new_figure, save_svg
from imucalib_cli.study.method_runs import (
    METHODS,
    Conditioned,
    paper_settings,
    run_methods,
    wrong_guess,
)
from imucalib_cli.study.recordings import clean_recording
from imucalib_cli.study.tables import (
    ERRORS,
    MILLIMETRES,
    Row,
    Table,
    answered,
    chosen,
    count,
    digits,
    groups,
    in_best_setting,
    mean,
    number,
    over_bound,
    root_mean_square,
    statistic,
    text,
    worst,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from imucalib_cli.estimate.options import PaperOptions
    from imucalib_cli.simulate.options import NoiseOptions, PhysicsOptions
    from imucalib_cli.study.experiment import Cell
    from imucalib_cli.study.tables import Column

NOTE = (
    "Of all tables: root mean square over seeds; over bound is its ratio to the Cramér-Rao bound "
    "of this motion and the IMU's white noise, with the unknowns of the method: the pose alone, "
    "or, for matched, biases, tilt and time offset too. The published method is in the window and "
    "exclusion that the truth shows to be its best. "
)


@dataclass(frozen=True)
class Part:
    """One of the sweeps of a study."""

    parameter: str
    """The parameter of the study that has the values."""
    words: str
    """What is swept, with its unit, for headers and axes; may name other parameters."""
    options: tuple[str, ...] = ()
    """Options of sensors or simulation that take each value; a vector takes it as its norm."""


@dataclass(frozen=True, kw_only=True)
class Sweep(Conditioned):
    """A study with one parameter on the abscissa."""

    line = ("value", "method")
    note: ClassVar[str]
    """Note of its tables, after the note of all sweeps."""
    parts: ClassVar[dict[str, Part]]
    systems: tuple[str, ...]
    paper_windows: tuple[int, ...]
    paper_exclusions: tuple[float, ...]
    initial_translation: float
    initial_rotation_deg: float

    @property
    def words(self) -> dict[str, str]:
        """What is swept, by the name of the part."""
        return {name: part.words.format_map(vars(self)) for name, part in self.parts.items()}

    def values(self, part: str) -> Sequence[float]:
        """Values of a part."""
        values: Sequence[float] = getattr(self, self.parts[part].parameter)
        return values

    def sections(self) -> list[Section]:
        """Every value under every condition, a table for each system, part and condition."""
        sections: list[Section] = []
        for system, (part, words), condition in product(
            self.systems, self.words.items(), self.names
        ):
            title, columns = f"{system}: {words}, {condition}", (number("value", words), *_COLUMNS)
            runs = grid(
                system=[system], part=[part], condition=[condition], value=self.values(part)
            )
            note = "" if sections else NOTE + self.note
            sections.append(Section(title, runs, columns, note))
        return sections

    def inputs(self, cell: Cell) -> tuple[PhysicsOptions, NoiseOptions]:
        """What is simulated in a cell."""
        part = self.parts[cell["part"]]
        direction = np.random.default_rng(cell["seed"]).normal(size=3)  # the same for every norm
        vector = tuple((cell["value"] * direction / np.linalg.norm(direction)).tolist())

        def changes(options: NoiseOptions | PhysicsOptions) -> Row:
            return {
                name: vector if isinstance(old, tuple) else cell["value"]
                for name, old in vars(options).items()
                if name in part.options
            }

        physics, noise = self.physics, self.condition_of(cell).sensors
        return replace(physics, **changes(physics)), replace(noise, **changes(noise))

    def filters(self, cell: Cell) -> tuple[tuple[PaperOptions, ...], WindowChoice]:
        """Settings of the published method, of which tables show the best; our window."""
        del cell
        return paper_settings(self.paper_windows, self.paper_exclusions), WindowChoice()

    def measure(self, cell: Cell) -> list[Row]:
        """All methods on one recording, the published one in each of its settings."""
        (physics, noise), seed = self.inputs(cell), cell["seed"]
        clean = clean_recording(cell["system"], physics)
        recording = corrupt(clean, noise, seed)
        guess = wrong_guess(clean, self.initial_translation, self.initial_rotation_deg, seed)
        return [
            cell
            | row
            | {
                "window": setting.window.samples if setting else None,
                "exclusion": setting.exclusion_threshold if setting else None,
            }
            | bound_columns(clean, noise, alone=row["method"] != "matched")
            for setting, row in run_methods(METHODS, recording, guess, *self.filters(cell))
        ]

    def shown(self, rows: Sequence[Row]) -> list[Row]:
        """Of the published method, at each value the rows of its best setting.

        That answers most often and, of these, has the least error of translation. No tuning could
        do more for it.
        """
        keys = "system", "part", "condition", *self.line
        return in_best_setting(rows, _badness, *keys, setting=("window", "exclusion"))

    def tables(self, rows: Sequence[Row]) -> list[Table]:
        """One for each section, then a summary."""
        shown = self.shown(rows)
        return [
            *super().tables(rows),
            summary_table({each.title: each.rows(shown) for each in self.sections()}),
        ]

    def figures(self, rows: Sequence[Row]) -> dict[str, Draw]:
        """One for each system and part, with a column of panels for each condition."""
        shown = self.shown(rows)
        return {
            f"{self.name}-{system}-{part}": partial(
                draw_sweep, chosen(shown, system=system, part=part), words
            )
            for system in self.systems
            for part, words in self.words.items()
        }


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


def summary_table(sweeps: Mapping[str, Sequence[Row]]) -> Table:
    """A line for each sweep, by its title, and method: the best value, and errors at both ends."""

    def error(point: Sequence[Row]) -> str:
        return digits(root_mean_square(point, "translation") * MILLIMETRES)

    def value(point: Sequence[Row]) -> str:
        return digits(point[0]["value"])

    lines = []
    for title, rows in sweeps.items():
        for mine in groups(rows, "method"):
            points = groups(mine, "value")
            best, ends = min(points, key=_badness), (points[0], points[-1])
            over = digits(over_bound(best, "translation"))
            at_ends = (f"{error(end)} at {value(end)}" for end in ends)
            lines.append((title, mine[0]["method"], value(best), error(best), over, *at_ends))
    return Table(
        title="In short: translation errors, root mean square, mm",
        header=("sweep", "method", "best at", "error there", "over bound", "first", "last"),
        rows=tuple(lines),
    )


def draw_sweep(rows: Sequence[Row], words: str, path: Path) -> None:
    """Translation above, rotation below; a column of panels for each condition."""
    conditions = groups(rows, "condition")
    size = 7.2 * (1 + 0.6 * (len(conditions) - 1)), 4.2 * (1 + 0.7 * (len(ERRORS) - 1))
    figure, panels = new_figure(len(ERRORS), len(conditions), size=size, share_x=True)
    for line, (key, scale, unit) in enumerate(ERRORS):
        for place, mine in enumerate(conditions):
            axes = panels[line * len(conditions) + place]
            points = groups(mine, *Sweep.line)
            methods = dict.fromkeys(point[0]["method"] for point in points)
            for colour, method in zip(COLOURS, methods, strict=False):
                own = [point for point in points if point[0]["method"] == method]
                errors = [scale * root_mean_square(point, key) for point in own]
                draw_curve(axes, method, [p[0]["value"] for p in own], errors, color=colour)
            bounds = ("bound, pose alone", False, "--"), ("bound, all unknowns", True, ":")
            for name, everything, style in bounds:
                bound = {
                    point[0]["value"]: scale * mean(point, f"bound_{key}")
                    for point in points
                    if (point[0]["method"] == "matched") == everything
                }
                look = {"color": "black", "linestyle": style, "marker": ""}
                draw_curve(axes, name, list(bound), list(bound.values()), **look)
            logarithmic(axes)
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


@dataclass(frozen=True, kw_only=True)
class WindowStudy(Sweep):
    """The length of the window, which the paper calls small without a number.

    All filters of a run have the same length, on both sides of each method.
    """

    name = "window"
    note = (
        "A window is L sample intervals; an even L is taken one longer, as the filters need it odd."
    )
    parts: ClassVar[dict[str, Part]] = {"window": Part("samples", "window s")}
    samples: tuple[int, ...]

    def values(self, part: str) -> Sequence[float]:
        """Seconds, so that rates can be compared."""
        return [samples / self.imu_rate for samples in super().values(part)]

    def filters(self, cell: Cell) -> tuple[tuple[PaperOptions, ...], WindowChoice]:
        """The same window in the filters of both methods."""
        samples = round(cell["value"] * self.imu_rate)
        return paper_settings((samples,), self.paper_exclusions), WindowChoice(samples=samples)


@dataclass(frozen=True, kw_only=True)
class EncoderStudy(Sweep):
    """Joint positions as encoders read them: with noise, and in steps.

    Noise of the kinematics enters the regressors, not only the readings.
    """

    name = "encoder"
    note = (
        "The bound is that of perfect encoders: noise of the kinematics can only raise it. The "
        "matched filters choose their window from the log."
    )
    parts: ClassVar[dict[str, Part]] = {
        "noise": Part("noise", "encoder noise rad", ("encoder_noise",)),
        "step": Part("step", "encoder step rad", ("encoder_step",)),
    }
    noise: tuple[float, ...]
    step: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class BiasStudy(Sweep):
    """Biases of the IMU, constant and walking, which the published method takes to be zero."""

    name = "bias"
    note = (
        "A bias has the norm stated and a direction of the seed's; a walk begins at zero. The "
        "bound knows of constant biases, not of their walk. The published method and matched, "
        "pose only, take biases to be zero."
    )
    parts: ClassVar[dict[str, Part]] = {
        "accel": Part("accel_bias", "accelerometer bias m/s²", ("accel_bias",)),
        "gyro": Part("gyro_bias", "gyroscope bias rad/s", ("gyro_bias",)),
        "accel-walk": Part(
            "accel_bias_walk", "accelerometer bias walk m/s²/√s", ("accel_bias_walk",)
        ),
        "gyro-walk": Part("gyro_bias_walk", "gyroscope bias walk rad/s/√s", ("gyro_bias_walk",)),
    }
    accel_bias: tuple[float, ...]
    gyro_bias: tuple[float, ...]
    accel_bias_walk: tuple[float, ...]
    gyro_bias_walk: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class RateStudy(Sweep):
    """The rates of the log; those of the paper's are not known.

    Both streams faster or slower, and the robot's slower than the IMU's.
    """

    name = "rate"
    note = (
        "The noise densities are the same at every rate, so the bound is too, nearly. The "
        "published method smooths the IMU with as many samples as it derives the kinematics with, "
        "as its authors do, and takes the nearest sample of the IMU."
    )
    parts: ClassVar[dict[str, Part]] = {
        "together": Part("together", "rate of IMU and robot Hz", ("imu_rate", "robot_rate")),
        "robot": Part("robot", "robot's rate Hz, IMU at {imu_rate:g}", ("robot_rate",)),
    }
    together: tuple[float, ...]
    robot: tuple[float, ...]
