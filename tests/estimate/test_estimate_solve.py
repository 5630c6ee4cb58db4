"""The solve itself: derivatives, starts, priors, statistics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from imucalib_cli.estimate import columns as lean_columns
from imucalib_cli.estimate.design import Model
from imucalib_cli.estimate.fit import with_residuals
from imucalib_cli.estimate.jacobian import columns
from imucalib_cli.estimate.layout import lay_out
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.estimate.prepare import clean_imu
from imucalib_cli.estimate.robust import window_weights
from imucalib_cli.estimate.solve import (
    DTILT,
    TANGENT,
    LeanState,
    LeanUnknowns,
    refine,
    solve_globally,
)
from imucalib_cli.estimate.spectrum import part_matrices, statistics, whitening
from imucalib_cli.estimate.starts import cube_rotations
from imucalib_cli.estimate.state import State
from imucalib_cli.estimate.windows import Windowing, WindowRows, plan_windows
from imucalib_cli.robot.rotations import nearest_rotation
from imucalib_cli.signals.trajectory import Trajectory
from tests.estimate.estimate_arm import (
    GRAVITY,
    Log,
    make_log,
    random_mount,
    rotation_error,
)

Floats = NDArray[np.float64]


def random_state(seed: int, gravity: Floats | None = None) -> LeanState:
    rng = np.random.default_rng(seed)
    R = Rotation.random(rng=rng).as_matrix()
    if gravity is None:
        gravity = Rotation.random(rng=rng).apply([0, 0, GRAVITY])
    biases = rng.normal(size=(2, 3)) * [[0.3], [0.02]]
    return LeanState(rng.normal(size=3), R, biases[0], biases[1], gravity)


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=25)
def test_jacobian_is_the_difference_of_moved_states(seed: int) -> None:
    state, h = random_state(seed), 1e-6
    steps = h * np.eye(TANGENT)
    differences = [(state.moved(s).vector() - state.moved(-s).vector()) / (2 * h) for s in steps]
    np.testing.assert_allclose(state.jacobian(), np.stack(differences, axis=1), atol=1e-8)


@pytest.mark.parametrize(
    "gravity", [(0, 0, -1), (0, 0, 1), (1, 0, 0), (0.6, -0.8, 0), (0, 0.9, 0.1)]
)
def test_tilt_spans_the_sphere_wherever_gravity_points(gravity: tuple[float, ...]) -> None:
    state = random_state(1, GRAVITY * np.array(gravity) / np.linalg.norm(gravity))
    turned = state.jacobian()[lean_columns.G, DTILT]
    assert np.linalg.svd(turned, compute_uv=False)[-1] > 0.4 * GRAVITY
    step = np.zeros(TANGENT)
    step[DTILT] = 0.3, -0.2
    assert np.linalg.norm(state.moved(step).gravity) == pytest.approx(GRAVITY)


def test_rotation_is_perturbed_on_the_left() -> None:
    state = random_state(2)
    step = np.zeros(TANGENT)
    step[3:6] = 0.02, -0.03, 0.01
    expected = Rotation.from_rotvec(step[3:6]).as_matrix() @ state.R
    np.testing.assert_allclose(state.moved(step).R, expected, atol=1e-15)


@pytest.fixture(scope="module")
def log() -> Log:
    return make_log(mount=random_mount(11)).noisy(2)


def windowing_of(log: Log, seconds: float = 0.2) -> Windowing:
    trajectory = Trajectory.of(log.path)
    clean = clean_imu(log.imu)
    grid = clean.grid(trajectory.interval, use_ticks=False)
    return Windowing(
        grid, trajectory, plan_windows(2 * round(seconds / grid.dt / 2) + 1, 3, grid.dt)
    )


@pytest.fixture(scope="module")
def rows(log: Log) -> WindowRows:
    windowing = windowing_of(log)
    return windowing.rows(0.0, windowing.centres(0.0))


def normal_of(rows: WindowRows) -> Floats:
    return rows.normal_matrix(0.02, 0.002, np.ones(len(rows.centres)))


def test_the_lean_rows_are_the_whole_models(log: Log, rows: WindowRows) -> None:
    """Both read in the parent's axes at each window's centre; biases in different frames."""
    lean = random_state(3)
    windowing = windowing_of(log)
    layout = lay_out(windowing.trajectory, MatchedOptions())
    x = np.zeros(layout.size)
    x[layout.part("accel_bias")] = lean.R.T @ lean.accel_bias
    x[layout.part("gyro_bias")] = lean.R.T @ lean.gyro_bias
    state = State(lean.R, lean.t, lean.gravity, x)
    (whole,) = Model(windowing, layout).residuals(state, rows.centres)
    for one, part in zip(rows.residuals(lean.vector()), (slice(0, 3), slice(3, 6)), strict=True):
        np.testing.assert_allclose(one, whole.values[:, part], atol=1e-9 * np.abs(one).max())


def test_every_start_reaches_the_one_optimum(log: Log, rows: WindowRows) -> None:
    normal = normal_of(rows)
    unknowns = LeanUnknowns.of(MatchedOptions())
    best = solve_globally(normal, unknowns)
    assert np.linalg.norm(rotation_error(best.state.R, log.mount.R)) < 2e-3
    for R in cube_rotations():
        found = refine(normal, unknowns, replace(best.state, R=R, t=np.zeros(3)), 200)
        # Downhill from anywhere: to the optimum, or to where another rotation is a minimum.
        assert found.cost > best.cost * (1 - 1e-9)
        turned = np.linalg.norm(rotation_error(found.state.R, best.state.R))
        assert turned < 1e-6 or found.cost > 100 * best.cost


def test_the_optimum_is_scipys(rows: WindowRows) -> None:
    """The same cost, minimised by scipy over its own parametrisation from the truth nearby."""
    normal = normal_of(rows)
    unknowns = LeanUnknowns.of(MatchedOptions())
    best = solve_globally(normal, unknowns).state
    values, vectors = np.linalg.eigh(normal[:22, :22])
    root = (vectors * np.sqrt(np.maximum(values, 0.0))).T

    def residuals(z: Floats) -> Floats:
        R = Rotation.from_rotvec(z[3:6]).as_matrix()
        g = Rotation.from_rotvec([z[12], z[13], 0.0]).apply([0, 0, -GRAVITY])
        return np.asarray(root @ np.r_[1.0, z[:3], R.ravel(), z[6:12], g])

    start = np.r_[best.t, Rotation.from_matrix(best.R).as_rotvec(), np.zeros(8)]
    found = least_squares(residuals, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    np.testing.assert_allclose(best.t, found[:3], atol=1e-6)
    R = Rotation.from_rotvec(found[3:6]).as_matrix()
    np.testing.assert_allclose(rotation_error(best.R, R), 0.0, atol=1e-7)
    np.testing.assert_allclose(best.accel_bias, found[6:9], atol=1e-5)


def test_cube_rotations_are_the_group_of_24() -> None:
    group = cube_rotations()
    assert len({tuple(np.round(R).ravel()) for R in group}) == 24
    for R in group:
        np.testing.assert_array_equal(R @ R.T, np.eye(3))
        assert np.linalg.det(R) == pytest.approx(1.0)


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=25)
def test_nearest_rotation_is_scipys(seed: int) -> None:
    rng = np.random.default_rng(seed)
    M = Rotation.random(rng=rng).as_matrix() + 0.3 * rng.normal(size=(3, 3))
    found = nearest_rotation(M)
    assert np.linalg.det(found) == pytest.approx(1.0)
    best, _ = Rotation.align_vectors(M.T, np.eye(3))
    np.testing.assert_allclose(found, best.as_matrix(), atol=1e-7)


def test_bands_and_parts_add_up_to_the_whole(log: Log, rows: WindowRows) -> None:
    """Parseval's sum over the frequencies, and the parts' sum, are the plain normal matrix."""
    windowing = windowing_of(log)
    layout = lay_out(windowing.trajectory, MatchedOptions(robot="exact", sensor_model="ideal"))
    model = Model(windowing, layout)
    lean = random_state(3)
    state = State(lean.R, lean.t, lean.gravity, np.zeros(layout.size))
    (residuals,) = model.residuals(state, rows.centres)
    weights = np.random.default_rng(0).uniform(0, 1, len(rows.centres))
    root = whitening(windowing.plan, weights, (0.3, 0.1))

    def both() -> list[tuple[slice, Floats]]:
        return list(with_residuals(columns(model, state, rows.centres), residuals.values))

    flat = np.concatenate([values for _, values in both()]) * root[:, :, None]
    whole = np.einsum("wij,wik->jk", flat, flat)
    size = layout.size + 1
    found = statistics(windowing.plan, rows.centres, both(), root, size)
    scale = np.sqrt(np.diag(whole))
    for sums in (
        found.normal.sum(axis=(0, 1)),
        found.parts.sum(axis=0),
        part_matrices(rows.centres, both(), root, size).sum(axis=0),
    ):
        unit = np.outer(scale, scale)
        np.testing.assert_allclose(sums / unit, whole / unit, atol=1e-12)


def unknowns_of(**options: object) -> LeanUnknowns:
    return LeanUnknowns.of(MatchedOptions(**options))  # type: ignore[arg-type]


def test_a_prior_is_information_and_zero_removes() -> None:
    told = unknowns_of(accel_bias_std=0.05, gyro_bias_std=0.0, tilt_std=0.01)
    np.testing.assert_allclose(told.prior_information[6:9], 1 / 0.05**2)
    assert not told.free[9:12].any()
    np.testing.assert_allclose(told.prior_information[12:14], 1 / 0.01**2)
    assert not unknowns_of(gravity="fixed").free[12:14].any()
    assert not unknowns_of(gravity="none").free[12:14].any()
    assert unknowns_of(gravity="none").gravity_norm == 0.0
    assert not unknowns_of(tilt_std=0.0).free[12:14].any()


def test_priors_pull_as_hard_as_they_should(log: Log) -> None:
    """The posterior of a bias is the precision-weighted mean of measurement and prior."""

    def calibrated(std: float) -> tuple[Floats, Floats]:
        options = MatchedOptions(accel_bias_std=std, gravity="fixed", time_offset=0.0)
        estimate = calibrate_matched(log.imu, log.path, options)
        assert estimate.accel_bias_std is not None
        return estimate.accel_bias, estimate.accel_bias_std

    free, free_std = calibrated(np.inf)
    assert np.all(np.abs(free - [0.1, -0.05, 0.08]) < 4 * free_std)
    tight, tight_std = calibrated(1e-5)
    assert np.abs(tight).max() < 3e-2 * np.abs(free).max()
    assert np.all(tight_std <= 1.05e-5)
    known = MatchedOptions(accel_bias_std=0.0)
    assert calibrate_matched(log.imu, log.path, known).accel_bias_std is None


def test_a_prior_on_tilt_holds_the_vertical() -> None:
    lean = 0.02
    gravity = Rotation.from_rotvec([lean, 0, 0]).apply([0, 0, -GRAVITY])
    log = make_log(gravity_world=gravity).noisy(1)

    def found(std: float) -> Floats:
        options = MatchedOptions(tilt_std=std, gravity_std=0.0)
        return calibrate_matched(log.imu, log.path, options).gravity_world

    np.testing.assert_allclose(found(np.inf), gravity, atol=0.02)
    np.testing.assert_allclose(found(0.1), gravity, atol=0.02)
    np.testing.assert_allclose(found(1e-6), [0, 0, -GRAVITY], atol=1e-2)
    np.testing.assert_array_equal(found(0.0), [0, 0, -GRAVITY])


def test_weights_drop_what_is_far_off_and_nothing_else(rows: WindowRows) -> None:
    best = solve_globally(normal_of(rows), LeanUnknowns.of(MatchedOptions()))
    x = best.state.vector()
    accel = rows.accel.copy()
    accel[200:230, :, lean_columns.ONE] += 3.0
    spoiled = np.concatenate(WindowRows(rows.centres, accel, rows.gyro).residuals(x), axis=1)
    motion = (accel[:, :, lean_columns.T] ** 2).sum(axis=(1, 2))
    weights = window_weights(spoiled, motion, redescend=True)
    np.testing.assert_array_equal(weights[200:230], 0.0)
    others = np.delete(weights, np.s_[200:230])
    assert (others > 0.99).mean() > 0.98
    gentle = window_weights(spoiled, motion, redescend=False)
    assert np.all((gentle[200:230] > 0) & (gentle[200:230] < 0.2))
