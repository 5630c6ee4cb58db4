"""Common part of tables 2 and 3: calibrations on folds of moves, each with several seeds.

Whole moves of the plan are held out, not samples.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.simulate.config import Arm, FreeBody
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.recording import Record, rows_kept
from imucalib_cli.study.conditions import Recorded, paper_settings, setting_words, wrong_guess
from imucalib_cli.study.contest import contest
from imucalib_cli.study.rows import best_setting, chosen, column, groups
from imucalib_cli.study.study import Study, grid
from imucalib_cli.study.tables import Column, Table, lay_out

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from imucalib_cli.simulate.config import SystemConfig
    from imucalib_cli.simulate.options import NoiseOptions
    from imucalib_cli.simulate.recording import Recording
    from imucalib_cli.study.study import Cell, Row


_ROUNDING = 1e-6
"""s, tolerance of a plan's duration."""
_WRIST_JOINTS = 3
"""Joints at the end of an arm that are its wrist."""


@dataclass(frozen=True, kw_only=True)
class FoldedStudy(Study, Recorded):
    """A study on folds of moves."""

    systems: tuple[str, ...]
    folds: int
    seeds: int
    paper_windows: tuple[int, ...]
    paper_exclusions: tuple[float, ...]

    @abstractmethod
    def sections(self) -> dict[str, list[Cell]]:
        """Tables by their titles, each with its conditions; a condition may be in several."""

    def cells(self) -> list[Cell]:
        """Every condition on every fold with every seed."""
        conditions = chain.from_iterable(self.sections().values())
        once = {tuple(sorted(condition.items())): condition for condition in conditions}
        folds = grid(fold=range(self.folds), seed=range(self.seeds))
        return [condition | run for condition in once.values() for run in folds]

    def section_tables(
        self,
        rows: Sequence[Row],
        methods: Sequence[str],
        columns: Sequence[Column],
        note: str = "",
    ) -> list[Table]:
        """A table a section, in it a line for each condition and method that was run."""
        return [
            lay_out(
                title,
                columns,
                [
                    line
                    for condition in conditions
                    for method in methods
                    if (line := chosen(rows, **condition, method=method))
                ],
                note,
            )
            for title, conditions in self.sections().items()
        ]

    def seed_of(self, cell: Cell) -> int:
        """A seed for each run of a condition: folds see other draws too (section 4.4)."""
        return int(cell["fold"] * self.seeds + cell["seed"])

    def calibrate(
        self,
        methods: Sequence[str],
        cell: Cell,
        clean: Recording,
        noise: NoiseOptions,
        *,
        noise_seed: int,
        initial_error: tuple[float, float],
    ) -> list[Row]:
        """Run methods on a recording without a fold, from a guess off by m and rad."""
        moves = moves_of(clean.system, self.duration or clean.system.duration)
        held_out = stratified_folds(moves, self.folds)[cell["fold"]]
        guess = wrong_guess(clean, *initial_error, self.seed_of(cell))
        recording = without(corrupt(clean, noise, noise_seed), held_out)
        settings = paper_settings(self.paper_windows, self.paper_exclusions)
        return [
            cell | row | {"setting": setting_words(setting)}
            for setting, row in contest(methods, recording, guess, settings)
        ]


def steadily_small(rows: list[Row]) -> tuple[int, float]:
    """Badness of a setting: number of missing answers, then geometric mean of translation."""
    errors = column(rows, "translation")
    missing = len(rows) - len(errors)
    return missing, float(np.mean(np.log(errors))) if errors else math.inf


def in_best_setting(
    rows: Sequence[Row], badness: Callable[[list[Row]], Any], *keys: str
) -> list[Row]:
    """Rows in the setting of least badness of each group by keys: the upper limit of tuning."""
    return [row for group in groups(rows, *keys) for row in best_setting(group, badness)]


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """One move of the plan with the standstill after it."""

    start: float
    """s."""
    stop: float
    kind: str
    """wrist or arm; force or torque."""


def moves_of(system: SystemConfig, duration: float) -> list[Stretch]:
    """Moves of a system's plan within a duration, in order; they cover all of it."""
    mover = system.mover
    if isinstance(mover, Arm):
        moves, again = _arm_moves(mover), 1
    elif isinstance(mover, FreeBody):
        moves, again = _pushes(mover), 0
    else:
        raise InputError(f"{system.name} walks: only an arm or a free body moves and rests in turn")
    t = mover.start_rest
    stretches, number = [], 0
    while t < duration - _ROUNDING:
        if number == len(moves):  # as the simulation repeats its plan
            number = min(again, len(moves) - 1)
        kind, seconds = moves[number]
        stretches.append(Stretch(start=t, stop=min(t + seconds, duration), kind=kind))
        t, number = t + seconds, number + 1
    # Standstill at the start belongs to the first move, the last sample to the last move.
    stretches[0] = replace(stretches[0], start=0.0)
    stretches[-1] = replace(stretches[-1], stop=np.inf)
    return stretches


def _arm_moves(arm: Arm) -> list[tuple[str, float]]:
    targets = [arm.start_deg, *(move.to_deg for move in arm.moves)]
    moves = []
    for move, (before, after) in zip(arm.moves, pairwise(targets), strict=True):
        wrist_alone = before[:-_WRIST_JOINTS] == after[:-_WRIST_JOINTS]
        moves.append(("wrist" if wrist_alone else "arm", move.seconds + move.rest))
    return moves


def _pushes(body: FreeBody) -> list[tuple[str, float]]:
    seconds = body.push + body.stop + body.pause
    return [("torque" if any(push.torque) else "force", seconds) for push in body.pushes]


def stratified_folds(moves: Sequence[Stretch], count: int) -> list[list[Stretch]]:
    """The moves of each fold; every kind is distributed in turn, so that folds are similar."""
    folds: list[list[Stretch]] = [[] for _ in range(count)]
    for kind in sorted({move.kind for move in moves}):
        for number, move in enumerate(move for move in moves if move.kind == kind):
            folds[number % count].append(move)
    return [sorted(fold, key=lambda move: move.start) for fold in folds]


def without(recording: Recording, held_out: Sequence[Stretch]) -> Recording:
    """A recording without some of its moves: gaps in every stream."""

    def left(record: Record) -> Record:
        kept = np.ones(len(record.t), dtype=bool)
        for move in held_out:
            kept &= (record.t < move.start) | (record.t >= move.stop)
        return rows_kept(record, kept)

    robot = tuple(left(record) for record in recording.robot)
    return replace(recording, imu=left(recording.imu), robot=robot)
