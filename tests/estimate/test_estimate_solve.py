"""The solve itself: its starts, and its optimum against scipy's."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.estimate.model import columns as lean
from imucalib_cli.estimate.model.windows import WindowRows
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.estimate.solution.solve import Known, cube_rotations, refine, solve_globally
from tests.estimate.estimate_arm import (
    GRAVITY,
    Log,
    make_log,
    random_mount,
    windowing_of,
)
from tools.errors import rotation_error


@pytest.fixture(scope="module")
def log() -> Log:
    return make_log(mount=random_mount(11)).noisy(2)


@pytest.fixture(scope="module")
def rows(log: Log) -> WindowRows:
    windowing = windowing_of(log, 0.2)
    return windowing.rows(0.0, windowing.centres(0.0))


def normal_of(rows: WindowRows) -> Floats:
    return rows.normal_matrix(np.array([0.02, 0.002]), np.ones(len(rows.centres)))


def test_every_start_reaches_the_same_optimum(log: Log, rows: WindowRows) -> None:
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


def test_optimum_matches_scipy(rows: WindowRows) -> None:
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
