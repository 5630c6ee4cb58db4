"""Which optimiser: the paper names one class of them and leaves the choice open.

On the published method's residuals, those of scipy, the least sum of absolute values that its
words ask for, and robust losses; on the matched filters', those of scipy and our reduced solve.
From guesses of several sizes, each optimiser on the same residuals.
"""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import InputError
from imucalib_cli.estimate import columns
from imucalib_cli.estimate.options import MatchedOptions, PaperOptions, WindowChoice
from imucalib_cli.estimate.paper_filters import filtered_instants
from imucalib_cli.estimate.prepare import clean_imu
from imucalib_cli.estimate.robust import residual_scales
from imucalib_cli.estimate.solve import Known, solve_globally
from imucalib_cli.estimate.window_choice import choose_window
from imucalib_cli.estimate.windows import Windowing, plan_windows
from imucalib_cli.results.pose import pose_error
from imucalib_cli.signals.trajectory import Trajectory
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.study.bound import bound_columns
from imucalib_cli.study.conditions import Condition, Recorded, condition_of
from imucalib_cli.study.contest import NO_ERRORS, pose_only
from imucalib_cli.study.experiment import Figure
from imucalib_cli.study.guesses import wrong_guess
from imucalib_cli.study.load import load_parameters
from imucalib_cli.study.optimiser_tables import (
    draw_optimisers,
    errors_table,
    guess_name,
    guesses_table,
)
from imucalib_cli.study.optimisers import OPTIMISERS, Cost, Solved, solve_by
from imucalib_cli.study.pose_cost import Pose, PoseCost, matched_cost, published_cost
from imucalib_cli.study.summary import chosen
from imucalib_cli.study.systems import clean_recording, robot_model
from imucalib_cli.study.trial import streams_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from imucalib_cli.simulate.recording import Recording
    from imucalib_cli.study.experiment import Cell, Row, Study
    from imucalib_cli.study.table import Table

Floats = NDArray[np.float64]

_FIRST_SCALES = (0.05, 0.005)
"""m/s² and rad/s: how the matched residuals are weighted before they tell themselves."""


@dataclass(frozen=True, kw_only=True)
class GuessSize:
    """How far off the truth the optimisers start."""

    translation: float
    """m."""
    rotation_deg: float


@dataclass(frozen=True, kw_only=True)
class OptimiserParameters(Recorded):
    """As configs/studies/optimiser.yaml states them, with units."""

    systems: tuple[str, ...]
    conditions: tuple[Condition, ...]
    guesses: tuple[GuessSize, ...]
    seeds: int
    paper_window: int
    paper_exclusion: float
    found_translation: float
    found_rotation_deg: float


@dataclass(frozen=True)
class OptimiserStudy:
    """Every optimiser from every guess."""

    config: OptimiserParameters
    name: str = "optimiser"

    def cells(self) -> list[Cell]:
        """Every size of guess under every condition with every seed."""
        return [
            {
                "system": system,
                "condition": condition.name,
                "guess": guess_name(size.translation, size.rotation_deg),
                "seed": seed,
            }
            for system in self.config.systems
            for condition in self.config.conditions
            for size in self.config.guesses
            for seed in range(condition.seeds or self.config.seeds)
        ]

    def measure(self, cell: Cell) -> list[Row]:
        """All optimisers on one recording from one guess."""
        config, seed = self.config, int(cell["seed"] or 0)
        clean = clean_recording(str(cell["system"]), config.physics)
        noise = condition_of(config.conditions, cell["condition"]).sensors
        size = next(
            g for g in config.guesses if guess_name(g.translation, g.rotation_deg) == cell["guess"]
        )
        start = wrong_guess(clean, size.translation, math.radians(size.rotation_deg), seed)
        guess = Pose(start.t_parent_imu, start.R_parent_imu)
        costs, prepared = self._prepare(corrupt(clean, noise, seed), guess)
        bound = bound_columns(clean, noise, alone=True)
        rows: list[Row] = []
        for optimiser in OPTIMISERS:
            names: Row = {
                "residuals": optimiser.cost,
                "least": optimiser.kind,
                "optimiser": optimiser.name,
                "preparation": prepared["matched" if optimiser.cost == "matched" else "published"],
            }
            try:
                solved = solve_by(optimiser, costs, guess)
            except InputError as error:  # a linear program that is not solved
                rows.append(cell | names | _nothing(str(error)) | bound)
                continue
            rows.append(cell | names | self._judged(solved, clean) | bound)
        return rows

    def _judged(self, solved: Solved, clean: Recording) -> Row:
        """Errors and effort of an answer."""
        pose = solved.pose
        error = pose_error(pose.R, pose.t, clean.R_parent_imu, clean.t_parent_imu)
        found = (
            error.translation <= self.config.found_translation
            and error.rotation <= math.radians(self.config.found_rotation_deg)
        )
        return {
            **asdict(error),
            "found": found,
            "value": solved.value,
            "evaluations": solved.evaluations,
            "seconds": solved.seconds,
            "failure": None,
        }

    def _prepare(
        self, recording: Recording, guess: Pose
    ) -> tuple[dict[Cost, PoseCost], dict[Cost, float]]:
        """Residuals by whose they are, and the seconds that filtering for them took."""
        imu, path = streams_of(recording, robot_model(recording.system.name))
        norm = float(np.linalg.norm(recording.gravity_world))
        begun = time.perf_counter()
        options = PaperOptions(
            window=WindowChoice(samples=self.config.paper_window),
            exclusion_threshold=self.config.paper_exclusion,
        )
        every, _, _ = filtered_instants(imu, path, options, guess.R, guess.t)
        published = published_cost(every.compared(), norm)
        between = time.perf_counter()
        trajectory, whole = Trajectory.of(path), clean_imu(imu)
        grid = whole.grid(trajectory.interval, use_ticks=whole.ticks is not None)
        degree = MatchedOptions().degree
        length, _ = choose_window(WindowChoice(), grid, trajectory, degree)
        windowing = Windowing(grid, trajectory, plan_windows(length, degree, grid.dt))
        matched = _weighted(windowing, recording.gravity_world)
        ended = time.perf_counter()
        return {"published": published, "matched": matched}, {
            "published": between - begun,
            "matched": ended - between,
        }

    def tables(self, rows: Sequence[Row]) -> list[Table]:
        """Errors and effort from the nearest guess; then what guesses are good enough."""
        nearest = self.config.guesses[0]
        name = guess_name(nearest.translation, nearest.rotation_deg)
        made = []
        for system in self.config.systems:
            for condition in self.config.conditions:
                mine = chosen(rows, system=system, condition=condition.name)
                title = f"{system}: {condition.name}"
                made.append(errors_table(chosen(mine, guess=name), f"{title}, from {name}"))
                made.append(guesses_table(mine, f"{title}, by the size of the guess's error"))
        return made

    def figures(self, rows: Sequence[Row]) -> list[Figure]:
        """Error and time of each, from the nearest guess."""
        nearest = self.config.guesses[0]
        near = chosen(rows, guess=guess_name(nearest.translation, nearest.rotation_deg))

        def figure(system: str) -> Figure:
            mine = chosen(near, system=system)
            return Figure(f"{self.name}-{system}", lambda path: draw_optimisers(mine, path))

        return [figure(system) for system in self.config.systems]


def _nothing(why: str) -> Row:
    nothing: Row = dict.fromkeys(("value", "evaluations", "seconds"))
    return NO_ERRORS | nothing | {"found": False, "failure": why}


def _weighted(windowing: Windowing, gravity_world: Floats) -> PoseCost:
    """The matched residuals, each sensor by its own spread, as the estimator weights them."""
    centres = windowing.centres(0.0)
    rows = windowing.rows(0.0, centres)
    gains = windowing.plan.noise_gains
    known = Known.of(pose_only(float(np.linalg.norm(gravity_world))))
    accel, gyro = (scale / gain for scale, gain in zip(_FIRST_SCALES, gains, strict=True))
    normal = rows.normal_matrix(accel, gyro, np.ones(len(centres)))
    x = solve_globally(normal, known).x
    accel, gyro = residual_scales(np.concatenate(rows.residuals(x), axis=1))
    gravity = x[columns.G]
    return matched_cost(rows, gravity, accel / gains[0], gyro / gains[1])


def load(file: Path | None, *, quick: bool) -> Study:
    """The study with its parameters."""
    return OptimiserStudy(load_parameters(OptimiserParameters, "optimiser", file, quick=quick))
