"""Which optimiser: the paper names one class of them and leaves the choice open.

On the residuals of the published method: scipy's optimisers, the least sum of absolute values, for
which its text asks, and robust losses. On those of the matched filters: scipy's optimisers and our
reduced solve. Each optimiser starts from guesses of several sizes, on the same residuals.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.estimate.model import lean_columns
from imucalib_cli.estimate.model.windows import Windowing, plan_windows
from imucalib_cli.estimate.options import MatchedOptions, PaperOptions, WindowChoice
from imucalib_cli.estimate.solution.robust import residual_scales
from imucalib_cli.estimate.solution.solve import Known, solve_globally
from imucalib_cli.estimate.window_choice import choose_window
from imucalib_cli.paper.filters import filtered_instants
from imucalib_cli.signals.prepare import clean_imu
from imucalib_cli.signals.trajectory import Trajectory
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.study.bound import bound_columns
from imucalib_cli.study.experiment import Section, grid
from imucalib_cli.study.figures import COLOURS, label_logarithmic, new_figure, save_svg
from imucalib_cli.study.method_runs import Conditioned, Pose, errors_of, pose_only, wrong_guess
from imucalib_cli.study.optimisers import (
    OPTIMISERS,
    PoseCost,
    matched_cost,
    published_cost,
    solve_by,
)
from imucalib_cli.study.recordings import clean_recording, streams_of
from imucalib_cli.study.tables import (
    DEGREES,
    MILLIMETRES,
    chosen,
    column,
    digits,
    groups,
    median,
    over_bound,
    root_mean_square,
    statistic,
    text,
    worst,
)

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from imucalib_cli.simulate.recording import Recording
    from imucalib_cli.study.experiment import Cell, Draw
    from imucalib_cli.study.tables import Column, Row


_FIRST_SCALES = (0.05, 0.005)
"""m/s² and rad/s: weights of the matched residuals before their spread is known."""
_NOTE = (
    "Root mean square over seeds; over bound is its ratio to the Cramér-Rao bound of white noise "
    "with the pose alone unknown. Excess is how far what is least stays, at worst, above the least "
    "that any optimiser found of the same. Evaluations are of all residuals, those for numeric "
    "derivatives included; time is the optimiser's alone, the filters before it are in prepare; "
    "both medians. Scaled residuals are each sensor's over its own spread, told by a first fit "
    "of absolute values, which is counted. Huber and Cauchy are tuned to 95 % efficiency in "
    "normal noise. The matched filters bridge single samples that are thrown off before they "
    "filter; the published method has nothing of the kind."
)
_GUESS_NOTE = (
    "How many ended at the true pose, and the median of their evaluations; an optimiser that needs "
    "no guess is given none."
)


_NAMES = ("residuals", "least", "optimiser")
"""Columns that identify an optimiser."""
_ERRORS = (
    *map(text, _NAMES),
    statistic("translation mm", root_mean_square, "translation", MILLIMETRES),
    statistic("over bound", over_bound, "translation"),
    statistic("rotation deg", root_mean_square, "rotation", DEGREES),
    statistic("over bound", over_bound, "rotation"),
    statistic("excess", worst, "excess"),
    statistic("evaluations", median, "evaluations"),
    statistic("time ms", median, "seconds", 1e3),
    statistic("prepare ms", median, "preparation", 1e3),
)


def _found_from(guess: str) -> Column:
    """How often an optimiser finds the pose from a guess, and its evaluations."""

    def cell(rows: Sequence[Row]) -> str:
        these = chosen(rows, guess=guess)
        found = sum(row["found"] is True for row in these)
        return f"{found} of {len(these)} ({digits(median(these, 'evaluations'))})"

    return guess, cell


@dataclass(frozen=True, kw_only=True)
class GuessSize:
    """How far off the truth the optimisers start."""

    translation: float
    """m."""
    rotation_deg: float

    @property
    def words(self) -> str:
        """For tables."""
        return f"{self.translation:g} m, {self.rotation_deg:g} deg"


@dataclass(frozen=True, kw_only=True)
class OptimiserStudy(Conditioned):
    """Every optimiser from every guess."""

    name = "optimiser"
    line = _NAMES
    systems: tuple[str, ...]
    guesses: tuple[GuessSize, ...]
    paper_window: int
    paper_exclusion: float
    found_translation: float
    found_rotation_deg: float

    def sections(self) -> list[Section]:
        """Errors and effort from the nearest guess; then how often each guess is good enough."""
        guesses = [size.words for size in self.guesses]
        by_guess = *map(text, _NAMES), *map(_found_from, guesses)
        made = []
        for system, condition in product(self.systems, self.names):
            title = f"{system}: {condition}"
            runs = grid(system=[system], condition=[condition], guess=guesses)
            sizes = f"{title}, by the size of the guess's error"
            made += [
                Section(f"{title}, from {guesses[0]}", runs[:1], _ERRORS, _NOTE),
                Section(sizes, runs, by_guess, _GUESS_NOTE),
            ]
        return made

    def measure(self, cell: Cell) -> list[Row]:
        """All optimisers on one recording from one guess."""
        seed = cell["seed"]
        clean = clean_recording(cell["system"], self.physics)
        truth = Pose(clean.R_parent_imu, clean.t_parent_imu)
        noise = self.condition_of(cell).sensors
        size = next(size for size in self.guesses if size.words == cell["guess"])
        guess = wrong_guess(clean, size.translation, size.rotation_deg, seed)
        prepared = self._prepare(corrupt(clean, noise, seed), guess)
        bound = bound_columns(clean, noise, alone=True)
        rows: list[Row] = []
        for optimiser in OPTIMISERS:
            cost, preparation = prepared[optimiser.cost.removesuffix(", scaled")]
            pose, failure = None, None
            effort: Row = dict.fromkeys(("value", "evaluations", "seconds"))
            try:
                pose, effort = solve_by(optimiser, cost, guess)
            except InputError as error:  # a linear program that is not solved
                failure = str(error)
            row: Row = {
                "residuals": optimiser.cost,
                "least": optimiser.kind,
                "optimiser": optimiser.name,
                "preparation": preparation,
                **errors_of(pose, truth),
                **effort,
                "failure": failure,
            }
            row["found"] = (
                pose is not None
                and row["translation"] <= self.found_translation
                and row["rotation"] <= math.radians(self.found_rotation_deg)
            )
            rows.append(cell | row | bound)
        return rows

    def _prepare(self, recording: Recording, guess: Pose) -> dict[str, tuple[PoseCost, float]]:
        """Residuals of the published method and of ours, each with the seconds of filtering.

        In ours each sensor is weighted by its own spread, as the estimator weights it.
        """
        imu, path = streams_of(recording)
        norm = float(np.linalg.norm(recording.gravity_world))
        begun = time.perf_counter()
        options = PaperOptions(
            window=WindowChoice(samples=self.paper_window),
            exclusion_threshold=self.paper_exclusion,
        )
        every, _, _ = filtered_instants(imu, path, options, guess.R, guess.t)
        published = published_cost(every.compared(), norm)
        between = time.perf_counter()
        trajectory, whole = Trajectory.of(path), clean_imu(imu)
        imu_grid = whole.grid(trajectory.interval, use_ticks=whole.ticks is not None)
        degree = MatchedOptions().degree
        length, _ = choose_window(WindowChoice(), imu_grid, trajectory, degree)
        windowing = Windowing(imu_grid, trajectory, plan_windows(length, degree, imu_grid.dt))
        centres = windowing.centres(0.0)
        windows = windowing.rows(0.0, centres)
        gains = windowing.plan.noise_gains
        known = Known.of(pose_only(norm))
        normal = windows.normal_matrix(np.array(_FIRST_SCALES) / gains, np.ones(len(centres)))
        x = solve_globally(normal, known).x
        accel, gyro = residual_scales(np.concatenate(windows.residuals(x), axis=1))
        matched = matched_cost(windows, x[lean_columns.G], accel / gains[0], gyro / gains[1])
        seconds = between - begun, time.perf_counter() - between
        return {"published": (published, seconds[0]), "matched": (matched, seconds[1])}

    def shown(self, rows: Sequence[Row]) -> list[Row]:
        """With how far each cost stays above the least that any optimiser found of the same."""
        keys = "system", "condition", "guess", "seed", "residuals", "least"
        found = []
        for same in groups(rows, *keys):
            values = column(same, "value")
            least = max(min(values), 1e-300) if len(values) > 1 else math.nan
            for row in same:
                value = math.nan if row["value"] is None else row["value"]
                found.append(row | {"excess": max(value / least - 1.0, 0.0)})
        return found

    def figures(self, rows: Sequence[Row]) -> dict[str, Draw]:
        """Error and time of each, from the nearest guess."""
        near = chosen(rows, guess=self.guesses[0].words)
        return {
            f"{self.name}-{system}": partial(draw_optimisers, chosen(near, system=system))
            for system in self.systems
        }


def draw_optimisers(rows: Sequence[Row], path: Path) -> None:
    """Error and time as a bar for each optimiser; a row of panels for each condition."""
    conditions = groups(rows, "condition")
    figure, panels = new_figure(len(conditions), 2, size=(11.0, 4.2 * len(conditions)))
    for place, mine in enumerate(conditions):
        optimisers = groups(mine, *_NAMES)
        names = [[str(each[0][key]) for key in _NAMES] for each in optimisers]
        kinds = list(dict.fromkeys(residuals for residuals, _, _ in names))
        errors = [root_mean_square(each, "translation") * MILLIMETRES for each in optimisers]
        times = [median(each, "seconds") * 1e3 for each in optimisers]
        left, right = panels[2 * place : 2 * place + 2]
        for axes, values, words in (
            (left, errors, "translation error, mm"),
            (right, times, "time ms"),
        ):
            axes.barh(
                range(len(values)),
                values,
                color=[COLOURS[kinds.index(residuals)] for residuals, _, _ in names],
            )
            axes.set_xscale("log")
            label_logarithmic(axes.xaxis)
            labels = [f"{name}: {least}, {residuals}" for residuals, least, name in names]
            axes.set_yticks(range(len(values)), labels=labels)
            axes.invert_yaxis()
            axes.set_xlabel(words)
            axes.set_title(str(mine[0]["condition"]))
        right.set_yticklabels([])
    save_svg(figure, path)
