"""Sweeps of one parameter: what is run, what is compared with it, and that small ones run."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucalib_cli.study.bound import cramer_rao
from imucalib_cli.study.recordings import clean_recording
from imucalib_cli.study.studies.methods import ENTRANTS
from imucalib_cli.study.studies.sweeps import Sweep, summary_table
from imucalib_cli.study.tables import Row, digits, worst
from tests.study.study_samples import study

VALUES: dict[str, dict[str, Any]] = {
    "window": {"samples": (11,)},
    "encoder": {"noise": (1e-5,), "step": (1e-4,)},
    "bias": {
        "accel_bias": (0.1,),
        "gyro_bias": (0.01,),
        "accel_bias_walk": (1e-4,),
        "gyro_bias_walk": (1e-5,),
    },
    "rate": {"together": (100.0,), "robot": (50.0,)},
}


def tiny(name: str, **changes: Any) -> Sweep:
    """Twelve seconds of the arm at 100 Hz, one value, one seed."""
    whole = study(name)
    noisy = tuple(replace(c, seeds=None) for c in whole.conditions if c.name == "MEMS")
    shrunk: dict[str, Any] = {
        "duration": 12.0,
        "imu_rate": 100.0,
        "robot_rate": 100.0,
        "conditions": noisy or whole.conditions[:1],
        "seeds": 1,
        "paper_windows": (5, 11),
        "paper_exclusions": (0.0,),
    }
    made: Sweep = study(name, **(shrunk | VALUES[name] | changes))
    return made


@pytest.mark.parametrize("name", [*VALUES, "optimiser", "methods"])
@pytest.mark.parametrize("quick", [True, False])
def test_every_value_is_run_with_every_condition_and_seed(name: str, quick: bool) -> None:
    loaded = study(name, quick=quick)
    cells = loaded.cells()
    if name == "methods":
        values = len(ENTRANTS)
    elif name == "optimiser":
        values = len(loaded.systems) * len(loaded.guesses)
    else:
        values = len(loaded.systems) * sum(len(loaded.values(part)) for part in loaded.parts)
    seeds = sum(condition.seeds or loaded.seeds for condition in loaded.conditions)
    assert len(cells) == values * seeds
    assert len({tuple(cell.items()) for cell in cells}) == len(cells)
    assert quick or loaded.seeds >= 5


@pytest.mark.slow
@pytest.mark.parametrize("name", VALUES)
def test_small_run_gives_finite_errors_tables_and_figure(name: str, tmp_path: Path) -> None:
    small = tiny(name)
    rows = [row for cell in small.cells() for row in small.measure(cell)]
    assert all(row["failure"] is None for row in rows)
    json.dumps(rows, allow_nan=False)  # as they are kept
    for row in rows:
        for key in ("translation", "rotation", "bound_translation", "bound_rotation"):
            value = row[key]
            assert isinstance(value, float)
            assert 0.0 < value < math.inf
    *tables, short = small.tables(rows)
    assert len(tables) == len(small.parts)
    assert [len(table.rows) for table in tables] == [4] * len(tables)
    assert len(short.rows) == 4 * len(tables)
    figures = small.figures(rows)
    for name_, draw in figures.items():
        draw(tmp_path / f"{name_}.svg")
    assert len(list(tmp_path.iterdir())) == len(figures) == len(tables)


@pytest.mark.slow
def test_run_is_reproducible() -> None:
    small = tiny("encoder", paper_windows=(11,))
    cell = small.cells()[0]
    first, again = ([row | {"seconds": 0.0} for row in small.measure(cell)] for _ in range(2))
    assert first == again


@pytest.mark.slow
def test_bound_uses_the_unknowns_of_the_method() -> None:
    small = tiny("window")
    cell = small.cells()[0]
    physics, _ = small.inputs(cell)
    # MEMS: one-sided densities at 100 Hz.
    accel, gyro = (
        300e-6 * 9.80665 * math.sqrt(50.0),
        math.radians(0.014) * math.sqrt(50.0),
    )
    clean = clean_recording("rihibot", physics)
    alone, everything = cramer_rao(clean, accel, gyro, ()), cramer_rao(clean, accel, gyro)
    for row in small.measure(cell):
        bound = everything if row["method"] == "matched" else alone
        assert row["bound_translation"] == pytest.approx(bound.translation, rel=1e-5)
        assert row["bound_rotation"] == pytest.approx(bound.rotation, rel=1e-5)


def test_each_part_changes_its_own_parameter() -> None:
    window, encoder, bias, rate = (study(name) for name in VALUES)
    cells = {
        (name, cell["part"], cell["value"]): (*sweep.inputs(cell), *sweep.filters(cell))
        for name, sweep in zip(VALUES, (window, encoder, bias, rate), strict=True)
        for cell in sweep.cells()
    }
    for (name, part, value), (physics, noise, settings, window) in cells.items():
        assert isinstance(value, float)
        if name == "window":
            assert window.samples == round(value * 250.0)
            assert {setting.window for setting in settings} == {window}
        encoders = (noise.encoder_noise, noise.encoder_step)
        if name == "encoder":
            assert encoders == ((value, 0.0) if part == "noise" else (0.0, value))
        biases = [float(np.linalg.norm(b)) for b in (noise.accel_bias, noise.gyro_bias)]
        if name == "bias":
            told = [*biases, noise.accel_bias_walk, noise.gyro_bias_walk]
            wanted = dict.fromkeys(("accel", "gyro", "accel-walk", "gyro-walk"), 0.0)
            assert told == pytest.approx(list((wanted | {str(part): value}).values()))
        if name == "rate":
            imu = value if part == "together" else 500.0
            assert (physics.imu_rate, physics.robot_rate) == (imu, value)


PLACE = {"system": "rihibot", "part": "noise", "condition": "MEMS"}


def shown(rows: list[Row]) -> tuple[list[Row], tuple[str, ...]]:
    """The rows of the best setting, and the line of the table that they make."""
    small = tiny("encoder", noise=(1.0,))
    (line,) = small.tables(rows)[0].rows
    return small.shown(rows), line


def row(seed: int, window: int | None, translation: float | None, **more: Any) -> Row:
    made: Row = {
        **PLACE,
        "value": 1.0,
        "method": "paper",
        "seed": seed,
        "window": window,
        "exclusion": 0.0,
        "translation": translation,
        "rotation": 0.1,
        "bound_translation": 2.0,
        "bound_rotation": None,
        "trusted": True,
        "failure": None if translation is not None else "too few",
    }
    return made | more


def test_published_method_is_shown_with_best_setting() -> None:
    worse = [row(0, 5, 3.0), row(1, 5, 4.0)]
    better = [row(0, 11, 1.0), row(1, 11, 2.0)]
    best_where_it_answers = [row(0, 21, 0.1), row(1, 21, None)]
    rows = [*worse, *better, *best_where_it_answers]
    best, line = shown(rows)
    assert best == better
    assert worst(better, "translation") == 2.0
    root_mean_square = math.sqrt((1.0 + 4.0) / 2.0)
    assert line[:7] == (
        "1",
        "paper",
        "11",
        "0",
        digits(root_mean_square * 1e3),
        "2000",
        digits(root_mean_square / 2.0),
    )
    assert line[-3:] == ("-", "2 of 2", "2 of 2")


def test_missing_answers_are_listed_and_not_plotted() -> None:
    _, line = shown([row(0, 5, None, rotation=None)])
    assert line[4:10] == ("-",) * 6
    assert line[-2] == "0 of 1"


def test_summary_of_a_sweep_has_best_value_and_ends() -> None:
    ends = [row(0, 5, 0.004, value=1.0), row(0, 5, 0.001, value=2.0), row(0, 5, 0.002, value=4.0)]
    table = summary_table({"swept": [r | {"bound_translation": 5e-4} for r in ends]})
    assert table.rows == (("swept", "paper", "2", "1", "2", "4 at 1", "2 at 4"),)
