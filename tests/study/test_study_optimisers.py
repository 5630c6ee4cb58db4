"""Optimisers against each other on clean data, and the least absolute values against medians."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from imucalib_cli.arrays import Floats
from imucalib_cli.errors import InputError
from imucalib_cli.estimate.options import PaperOptions
from imucalib_cli.paper.filters import Instants, filtered_instants
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import NoiseOptions, PhysicsOptions
from imucalib_cli.study import optimisers
from imucalib_cli.study.method_runs import Pose, wrong_guess
from imucalib_cli.study.optimisers import (
    OPTIMISERS,
    PoseCost,
    by_linear_programs,
    by_relaxation,
    by_reweighting,
    least_absolute,
    published_cost,
    solve_by,
    value_of,
)
from imucalib_cli.study.recordings import clean_recording, streams_of
from imucalib_cli.study.tables import chosen
from tests.study.study_samples import study

RECORDED: dict[str, Any] = {"duration": 12.0, "imu_rate": 100.0, "robot_rate": 100.0}
PHYSICS, SMALL = PhysicsOptions(**RECORDED), {**RECORDED, "seeds": 1}
GRAVITY = 9.80665
NEED_NO_GUESS = ("reduced solve", "relaxed linear program")


def near(translation: float, rotation_deg: float) -> Pose:
    """A guess off the truth of the system by these."""
    return wrong_guess(clean_recording("rihibot", PHYSICS), translation, rotation_deg, 0)


def instants(noise: NoiseOptions | None = None) -> Instants:
    """What the published method compares on the system's recording."""
    clean = clean_recording("rihibot", PHYSICS)
    imu, path = streams_of(clean if noise is None else corrupt(clean, noise, 0))
    every, _, _ = filtered_instants(imu, path, PaperOptions(), np.eye(3), np.zeros(3))
    return every.compared()


@pytest.fixture(scope="module")
def clean() -> PoseCost:
    return published_cost(instants(), GRAVITY)


@pytest.fixture(scope="module")
def spiked() -> PoseCost:
    noise = NoiseOptions(accel_white=2e-3, gyro_white=4e-4, spikes=0.01)
    return published_cost(instants(noise), GRAVITY)


def _steps(cost: PoseCost, pose: Pose) -> Callable[[Floats], Floats]:
    return lambda step: cost.residuals(pose.moved(step))


def test_least_absolute_values_give_medians() -> None:
    rng = np.random.default_rng(1)
    r = rng.standard_cauchy(401)
    groups = np.eye(3)[np.arange(401) % 3]
    medians = [np.median(r[np.arange(401) % 3 == k]) for k in range(3)]
    counts = np.bincount(np.arange(401) % 3)
    found = least_absolute(-groups, r)
    for k in range(3):
        if counts[k] % 2:  # between two middle values any is a median
            assert found[k] == pytest.approx(medians[k], abs=1e-9)
        mine = r[np.arange(401) % 3 == k]
        assert np.abs(mine - found[k]).sum() == pytest.approx(np.abs(mine - medians[k]).sum())


@pytest.mark.slow
def test_optimisers_of_the_same_cost_agree(clean: PoseCost) -> None:
    """From a guess nearby, on clean data: one minimum of each cost."""
    guess = near(0.02, 3.0)
    poses: dict[str, list[Pose]] = {}
    for optimiser in OPTIMISERS:
        pose, effort = solve_by(optimiser, clean, guess)
        assert effort["evaluations"] >= 1
        if optimiser.cost == "published":
            poses.setdefault(optimiser.kind, []).append(pose)
    # Sums of absolute values have kinks, in which all but linear programs stop a little short.
    for kind, most in (("squares", 1e-7), ("squared sums", 2e-5), ("absolute values", 1e-5)):
        first, *others = poses[kind]
        assert len(others) >= 2
        for other in others:
            np.testing.assert_allclose(other.t, first.t, atol=most)
            np.testing.assert_allclose(other.R, first.R, atol=most)


@pytest.mark.slow
def test_absolute_sum_is_below_that_of_least_squares(clean: PoseCost, spiked: PoseCost) -> None:
    for cost in (clean, spiked):
        guess = near(0.02, 3.0)
        step = least_squares(_steps(cost, guess), np.zeros(6), xtol=1e-12).x
        squares = value_of(cost, guess.moved(step), "absolute values")
        ways = (by_reweighting, by_linear_programs, by_relaxation)
        ends = [way(cost, guess)[0] for way in ways]
        sums = [value_of(cost, end, "absolute values") for end in ends]
        assert max(sums) < 0.999 * squares
        np.testing.assert_allclose(sums, min(sums), rtol=1e-6)
        # A vertex is a minimum: no small step in any direction goes lower.
        pose = ends[1]
        for direction in np.vstack([np.eye(6), -np.eye(6)]):
            assert value_of(cost, pose.moved(1e-5 * direction), "absolute values") > sums[1]


def test_no_guess_reaches_the_minimum_of_a_good_guess(spiked: PoseCost) -> None:
    lost = near(1.0, 178.0)
    for optimiser in OPTIMISERS:
        if optimiser.name not in NEED_NO_GUESS or optimiser.cost != "published":
            continue
        ends = [solve_by(optimiser, spiked, at) for at in (lost, near(0, 0))]
        np.testing.assert_array_equal(ends[0][0].t, ends[1][0].t)


@pytest.mark.slow
def test_spikes_affect_least_squares_more_than_absolute_values(spiked: PoseCost) -> None:
    truth, guess = near(0.0, 0.0), near(0.02, 3.0)
    off = {
        (o.cost, o.kind): float(np.linalg.norm(pose.t - truth.t))
        for o in OPTIMISERS
        if o.cost != "matched" and o.name not in NEED_NO_GUESS
        for pose in [solve_by(o, spiked, guess)[0]]
    }
    least = off["published", "squares"]
    assert off["published", "absolute values"] < 0.2 * least
    assert off["published, scaled", "huber"] < 0.2 * least
    assert off["published, scaled", "cauchy"] < 0.2 * least


@pytest.mark.slow
def test_small_study_reports_errors_and_convergence(tmp_path: Path) -> None:
    small = study("optimiser", **SMALL, conditions=study("optimiser").conditions[1:2])
    rows = [row for cell in small.cells() for row in small.measure(cell)]
    assert len(rows) == 2 * len(OPTIMISERS)
    json.dumps(rows, allow_nan=False)  # as they are kept
    for row in rows:
        assert np.isfinite(
            [float(row[key] or 0) for key in ("translation", "rotation", "value")]
        ).all()
        assert isinstance(row["bound_translation"], float)
    assert all(row["found"] for row in chosen(rows, guess="0.02 m, 2 deg"))
    tables = small.tables(rows)
    assert [len(table.rows) for table in tables] == [len(OPTIMISERS)] * 2
    for name, draw in small.figures(rows).items():
        draw(tmp_path / f"{name}.svg")
    assert (tmp_path / "optimiser-rihibot.svg").stat().st_size > 1000


def test_failed_linear_program_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def unsolved(J: Floats, r: Floats) -> Floats:
        del J, r
        raise InputError("linear program: nothing found")

    monkeypatch.setattr(optimisers, "least_absolute", unsolved)
    small = study("optimiser", **SMALL)
    rows = small.measure(small.cells()[0])
    failed = {row["optimiser"] for row in rows if row["failure"] is not None}
    assert failed == {"linear programs", "relaxed linear program"}
    lines = small.tables(rows)[0].rows
    assert sum(line[3] == "-" for line in lines) == 2


@pytest.mark.slow
@pytest.mark.parametrize("cost", ["published", "matched"])
def test_exact_derivatives_need_fewer_evaluations(cost: str) -> None:
    small = study("optimiser", **SMALL)
    rows = small.measure(small.cells()[-1])
    numeric, analytic = (
        chosen(rows, optimiser=name, residuals=cost, least="squares")[0]
        for name in ("trf", "trf, analytic")
    )
    assert numeric["translation"] == pytest.approx(analytic["translation"], rel=1e-5)
    assert float(analytic["evaluations"] or 0) * 3 < float(numeric["evaluations"] or 0)
