"""The solve itself: derivatives, starts, priors, statistics."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.model import columns as lean
from imucalib_cli.estimate.model.design import Model
from imucalib_cli.estimate.model.layout import lay_out
from imucalib_cli.estimate.model.state import State, gravity_axes, tilt_from_down, tilted
from imucalib_cli.estimate.model.windows import Windowing, WindowRows, plan_windows
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.estimate.solution.fit import whitened
from imucalib_cli.estimate.solution.robust import window_weights
from imucalib_cli.estimate.solution.solve import Known, cube_rotations, refine, solve_globally
from imucalib_cli.estimate.solution.spectrum import part_matrices, statistics
from imucalib_cli.robot.rotations import nearest_rotation
from imucalib_cli.signals.prepare import clean_imu
from imucalib_cli.signals.trajectory import Trajectory
from tests.estimate.estimate_arm import (
    GRAVITY,
    Log,
    make_log,
    random_mount,
    rotation_error,
)

Floats = NDArray[np.float64]


@pytest.mark.parametrize(
    "direction", [(0, 0, -1), (0, 0, 1), (1, 0, 0), (0.6, -0.8, 0), (0, 0.9, 0.1)]
)
def test_tilt_spans_the_sphere_wherever_gravity_points(direction: tuple[float, ...]) -> None:
    gravity = GRAVITY * np.array(direction) / np.linalg.norm(direction)
    axes = gravity_axes(gravity)
    np.testing.assert_allclose(axes @ axes.T, np.eye(2), atol=1e-14)
    np.testing.assert_allclose(axes @ gravity, 0.0, atol=1e-14 * GRAVITY)
    turned = tilted(gravity, np.array([0.3, -0.2]))
    expected = Rotation.from_rotvec([0.3, -0.2] @ axes).apply(gravity)
    np.testing.assert_allclose(turned, expected, atol=1e-13)


@given(st.floats(-3.1, 3.1), st.floats(0.0, 3.1))
@settings(deadline=None, max_examples=25)
def test_tilt_from_down_leads_back_to_down(heading: float, angle: float) -> None:
    turn = Rotation.from_rotvec([angle * np.cos(heading), angle * np.sin(heading), 0.0])
    gravity = turn.apply([0.0, 0.0, -GRAVITY])
    tilt = tilt_from_down(gravity)
    assert np.linalg.norm(tilt) == pytest.approx(angle, abs=1e-7)
    # The axis of that turn is the same seen from down and from gravity.
    np.testing.assert_allclose(tilted(gravity, -tilt), [0.0, 0.0, -GRAVITY], atol=1e-6)


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


def random_x(seed: int) -> Floats:
    """Coefficients of the lean columns for some pose, biases and gravity."""
    rng = np.random.default_rng(seed)
    R, gravity = (Rotation.random(rng=rng) for _ in range(2))
    biases = rng.normal(size=(2, 3)) * [[0.3], [0.02]]
    down = gravity.apply([0, 0, GRAVITY])
    parts = (rng.normal(size=3), R.as_matrix().ravel(), biases[0], biases[1], down)
    return np.concatenate([[1.0], *parts])


def test_the_lean_rows_are_the_whole_models(log: Log, rows: WindowRows) -> None:
    """Both read in the parent's axes at each window's centre; biases in different frames."""
    x = random_x(3)
    R = x[lean.R].reshape(3, 3)
    windowing = windowing_of(log)
    layout = lay_out(windowing.trajectory, MatchedOptions())
    values = np.zeros(layout.size)
    values[layout.part("accel_bias")] = R.T @ x[lean.BA]
    values[layout.part("gyro_bias")] = R.T @ x[lean.BG]
    state = State(R, x[lean.T], x[lean.G], values)
    (whole,) = Model(windowing, layout).residuals(state, rows.centres)
    for one, part in zip(rows.residuals(x), (slice(0, 3), slice(3, 6)), strict=True):
        np.testing.assert_allclose(one, whole.values[:, part], atol=1e-9 * np.abs(one).max())


def test_every_start_reaches_the_one_optimum(log: Log, rows: WindowRows) -> None:
    normal = normal_of(rows)
    known = Known.of(MatchedOptions())
    best = solve_globally(normal, known)
    assert np.linalg.norm(rotation_error(best.R, log.mount.R)) < 2e-3
    for R in cube_rotations():
        start = np.zeros(lean.COUNT)
        start[lean.ONE], start[lean.R] = 1.0, R.ravel()
        found = refine(normal, known, start, 200)
        # Downhill from anywhere: to the optimum, or to where another rotation is a minimum.
        assert found.cost > best.cost * (1 - 1e-9)
        turned = np.linalg.norm(rotation_error(found.R, best.R))
        assert turned < 1e-6 or found.cost > 100 * best.cost


def test_the_optimum_is_scipys(rows: WindowRows) -> None:
    """The same cost, minimised by scipy over its own parametrisation from the truth nearby."""
    normal = normal_of(rows)
    free = Known.of(MatchedOptions())
    found = solve_globally(normal, free)
    known = free.pointing(found.x[lean.G])
    assert np.linalg.norm(known.mean[lean.G]) == pytest.approx(GRAVITY)
    best = refine(normal, known, found.x)
    np.testing.assert_array_equal(best.x[lean.G], known.mean[lean.G])
    values, vectors = np.linalg.eigh(normal)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))).T

    def residuals(z: Floats) -> Floats:
        R = Rotation.from_rotvec(z[3:6]).as_matrix()
        return np.asarray(root @ np.r_[1.0, z[:3], R.ravel(), z[6:12], best.x[lean.G]])

    start = np.r_[best.x[lean.T], Rotation.from_matrix(best.R).as_rotvec(), np.zeros(6)]
    z = least_squares(residuals, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    np.testing.assert_allclose(best.x[lean.T], z[:3], atol=1e-6)
    R = Rotation.from_rotvec(z[3:6]).as_matrix()
    np.testing.assert_allclose(rotation_error(best.R, R), 0.0, atol=1e-7)
    np.testing.assert_allclose(best.x[lean.BA], z[6:9], atol=1e-5)


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
    x = random_x(3)
    R = x[lean.R].reshape(3, 3)
    state = State(R, x[lean.T], x[lean.G], np.zeros(layout.size))
    (residuals,) = model.residuals(state, rows.centres)
    weights = np.random.default_rng(0).uniform(0, 1, len(rows.centres))

    def both() -> list[tuple[slice, Floats]]:
        return list(
            whitened(
                model,
                state,
                rows.centres,
                residuals=residuals.values,
                weights=weights,
                scales=(0.3, 0.1),
            )
        )

    flat = np.concatenate([values for _, values in both()])
    gains = np.array(windowing.plan.noise_gains) / (0.3, 0.1) * np.sqrt(weights)[:, None]
    np.testing.assert_allclose(flat[:, :, 0], residuals.values * np.repeat(gains, 3, axis=1))
    whole = np.einsum("wij,wik->jk", flat, flat)
    size = layout.size + 1
    found = statistics(windowing.plan, rows.centres, both(), weights, size)
    scale = np.sqrt(np.diag(whole))
    for sums in (
        found.normal.sum(axis=(0, 1)),
        found.parts.sum(axis=0),
        part_matrices(rows.centres, both(), size).sum(axis=0),
    ):
        unit = np.outer(scale, scale)
        np.testing.assert_allclose(sums / unit, whole / unit, atol=1e-12)


def known_of(**options: object) -> Known:
    return Known.of(MatchedOptions(**options))  # type: ignore[arg-type]


def test_zero_holds_and_gravity_is_held_where_it_is_known() -> None:
    told = known_of(accel_bias_std=0.05, gyro_bias_std=0.0, tilt_std=0.01)
    np.testing.assert_array_equal(told.std[lean.BA], 0.05)
    np.testing.assert_array_equal(told.std[lean.BG], 0.0)
    np.testing.assert_allclose(told.std[lean.G], 0.01 * GRAVITY)
    for held in (known_of(gravity="fixed"), known_of(tilt_std=0.0)):
        np.testing.assert_array_equal(held.std[lean.G], 0.0)
        np.testing.assert_array_equal(held.mean[lean.G], [0.0, 0.0, -GRAVITY])
    none = known_of(gravity="none")
    np.testing.assert_array_equal([none.std[lean.G], none.mean[lean.G]], 0.0)


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
    x = solve_globally(normal_of(rows), Known.of(MatchedOptions())).x
    accel = rows.accel.copy()
    accel[200:230, :, lean.ONE] += 3.0
    spoiled = np.concatenate(WindowRows(rows.centres, accel, rows.gyro).residuals(x), axis=1)
    motion = (accel[:, :, lean.T] ** 2).sum(axis=(1, 2))
    weights = window_weights(spoiled, motion, redescend=True)
    np.testing.assert_array_equal(weights[200:230], 0.0)
    others = np.delete(weights, np.s_[200:230])
    assert (others > 0.99).mean() > 0.98
    gentle = window_weights(spoiled, motion, redescend=False)
    assert np.all((gentle[200:230] > 0) & (gentle[200:230] < 0.2))
