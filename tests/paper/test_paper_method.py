"""The published method against a plain re-statement of it with scipy, sample by sample."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.optimize import least_squares
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Bools, Floats
from imucalib_cli.errors import InputError
from imucalib_cli.estimate.estimate import Estimate
from imucalib_cli.estimate.options import PaperOptions, WindowChoice
from imucalib_cli.paper.filters import DEFAULT_EXCLUSION, filtered_instants
from imucalib_cli.paper.method import calibrate_paper
from tests.estimate.estimate_arm import (
    GRAVITY,
    Log,
    Moves,
    make_log,
    parent_motion,
    solve_exact,
)
from tests.slow import slow_after
from tools.errors import rotation_error

MOVES = Moves(seconds=9.0, seed=5)
NEAR: dict[str, Any] = {
    "t_initial": np.array([-0.02, 0.09, 0.02]),
    "R_initial": Rotation.from_euler("xyz", [np.pi - 0.05, 0.0, np.pi / 2]).as_matrix(),
}


@pytest.fixture(scope="module")
def log() -> Log:
    log = make_log(MOVES)
    return log.noisy(0, accel_bias=(0, 0, 0), gyro_bias=(0, 0, 0))


def calibrate(log: Log, samples: int = 11, **options: Any) -> Estimate:
    chosen = PaperOptions(window=WindowChoice(samples=samples), **options)
    return calibrate_paper(log.imu, log.path, chosen)


def restated(log: Log, length: int) -> Callable[[Floats], Floats]:
    """The paper's error (N, 6), the pose filtered anew at each guess: t and rotation vector."""
    t, dt = log.path.tracks[0].t, 0.005
    motion = parent_motion(MOVES, t)

    def filtered(values: Floats, order: int) -> Floats:
        return np.asarray(savgol_filter(values, length, 3, deriv=order, delta=dt, axis=0))

    accel, gyro = filtered(log.imu.accel, 0), filtered(log.imu.gyro, 0)

    def differences(z: Floats) -> Floats:
        R_fs = Rotation.from_rotvec(z[3:]).as_matrix()
        p_ws = motion.p + motion.R @ z[:3]
        R_ws = motion.R @ R_fs
        derived = filtered(p_ws, 2)
        rate = filtered(R_ws.reshape(-1, 9), 1).reshape(-1, 3, 3)
        spin = np.einsum("nij,nkj->nik", rate, R_ws)
        omega = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        force = np.einsum("nij,nj->ni", R_ws, accel) - [0, 0, GRAVITY]
        turning = np.einsum("nij,nj->ni", R_ws, gyro)
        return np.hstack([derived - force, omega - turning])

    return differences


def minimised(differences: Callable[[Floats], Floats], *, components: bool) -> Floats:
    def residuals(z: Floats) -> Floats:
        error = differences(z)
        return np.asarray(error.ravel() if components else np.abs(error).sum(axis=1))

    start = np.r_[NEAR["t_initial"], Rotation.from_matrix(NEAR["R_initial"]).as_rotvec()]
    tolerances: Any = dict.fromkeys(("xtol", "ftol", "gtol"), 1e-10)
    return np.asarray(least_squares(residuals, start, x_scale="jac", **tolerances).x)


def kept(log: Log, **options: Any) -> Bools:
    """Instants that are not excluded at the true pose."""
    mount = log.mount
    return filtered_instants(log.imu, log.path, PaperOptions(**options), mount.R, mount.t)[0].kept


@pytest.mark.parametrize("samples", slow_after(1, [11, 25]))
@pytest.mark.parametrize("seed", slow_after(1, range(3)))
def test_residuals_match_the_paper_at_any_guess(log: Log, samples: int, seed: int) -> None:
    options = PaperOptions(window=WindowChoice(samples=samples), exclusion_threshold=0.0)
    instants, _, _ = filtered_instants(log.imu, log.path, options, np.eye(3), np.zeros(3))
    z = np.random.default_rng(seed).normal(size=6)
    expected = restated(log, samples)(z)
    np.testing.assert_allclose(instants.differences(z, GRAVITY), expected, atol=1e-8)


# The sum of absolute values has kinks, in which both solvers stop a little short.
@pytest.mark.parametrize(
    ("residual", "samples", "most"), [("l1", 11, 2e-5), ("components", 25, 1e-6)]
)
def test_result_matches_restated_paper_method(
    log: Log, residual: str, samples: int, most: float
) -> None:
    estimate = calibrate(log, samples, residual=residual, exclusion_threshold=0.0, **NEAR)
    found = minimised(restated(log, samples), components=residual == "components")
    np.testing.assert_allclose(estimate.t_parent_imu, found[:3], atol=most)
    R = Rotation.from_rotvec(found[3:]).as_matrix()
    np.testing.assert_allclose(rotation_error(estimate.R_parent_imu, R), 0.0, atol=most)
    assert estimate.residuals.windows_used == len(log.imu.t)
    assert estimate.residuals.windows_dropped == 0
    assert estimate.trusted


def test_l1_and_component_residuals_differ(log: Log) -> None:
    one, six = (calibrate(log, residual=kind, **NEAR) for kind in ("l1", "components"))
    assert 1e-6 < np.linalg.norm(one.t_parent_imu - six.t_parent_imu) < 5e-3


@pytest.mark.parametrize("angle", [0.5, 1.0])
def test_distant_guess_gives_the_same_answer(log: Log, angle: float) -> None:
    near = calibrate(log, exclusion_threshold=0.0, **NEAR)
    rng = np.random.default_rng(1)
    axis = rng.normal(size=3)
    R = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix() @ log.mount.R
    t = log.mount.t + np.array([0.3, -0.3, 0.2])
    far = calibrate(log, exclusion_threshold=0.0, R_initial=R, t_initial=t)
    np.testing.assert_allclose(far.t_parent_imu, near.t_parent_imu, atol=1e-5)
    turned = rotation_error(far.R_parent_imu, near.R_parent_imu)
    np.testing.assert_allclose(turned, 0.0, atol=1e-5)


@pytest.mark.parametrize("limit", [0.15, 1.0])
def test_exclusion_uses_second_differences_of_imu_pose(limit: float) -> None:
    """Position by the limit, quaternion by ten per metre times it, as the authors' have it."""
    log = make_log(MOVES)
    motion = parent_motion(MOVES, log.path.tracks[0].t)
    q = Rotation.from_matrix(motion.R @ log.mount.R).as_quat()
    q[1:] *= np.cumprod(np.sign(np.sum(q[1:] * q[:-1], axis=1)))[:, None]
    p = motion.p + motion.R @ log.mount.t
    dropped = [
        np.linalg.norm(np.diff(values, 2, axis=0), axis=1) > most * 0.005**2
        for values, most in ((p, limit), (q, 10 * limit))
    ]
    assert np.sum(~kept(log, exclusion_threshold=limit)) == (dropped[0] | dropped[1]).sum()
    assert dropped[0].any()
    assert dropped[1].any() == (limit < 0.2)
    assert pytest.approx(1e-4 * 250**2) == DEFAULT_EXCLUSION


def test_the_threshold_does_not_depend_on_the_rate() -> None:
    logs = [make_log(MOVES, imu_rate=rate, robot_rate=rate) for rate in (100.0, 200.0, 400.0)]
    shares = [np.mean(~kept(log, exclusion_threshold=1.0)) for log in logs]
    assert shares[0] > 0.1
    np.testing.assert_allclose(shares, shares[0], atol=0.01)


def test_paper_bias_grows_with_window_unlike_ours() -> None:
    """Measured in design: 0.16, 3.3, 55 mm at windows of 5, 21 and 101 samples at 100 Hz."""
    log = make_log(replace(MOVES, seconds=14.0), imu_rate=100.0, robot_rate=100.0)
    theirs, ours = [], []
    for samples in (5, 21, 51):
        paper = calibrate(
            log, samples, exclusion_threshold=0.0, R_initial=log.mount.R, t_initial=log.mount.t
        )
        theirs.append(float(np.linalg.norm(paper.t_parent_imu - log.mount.t)))
        ours.append(solve_exact(log, window=WindowChoice(samples=samples)).distance)
    assert theirs[2] > 4 * theirs[1] > 16 * theirs[0]
    assert theirs[1] > 1e-3
    assert max(ours) < 6e-6


def test_paper_method_reports_no_sigma(log: Log) -> None:
    estimate = calibrate(log, **NEAR)
    assert estimate.method == "paper"
    assert estimate.covariance is None
    assert (estimate.time_offset, estimate.time_offset_std) == (0.0, None)
    assert estimate.accel_bias_std is None
    np.testing.assert_array_equal(estimate.gravity_world, [0, 0, -GRAVITY])


def test_zero_gravity_is_not_subtracted() -> None:
    log = make_log(MOVES, gravity_world=np.zeros(3))
    estimate = calibrate(log, 5, gravity_norm=0.0, R_initial=log.mount.R, exclusion_threshold=0.0)
    assert np.linalg.norm(estimate.t_parent_imu - log.mount.t) < 1e-3
    np.testing.assert_array_equal(estimate.gravity_world, 0.0)


def test_gap_is_excluded_and_keeps_the_result(log: Log) -> None:
    rows = (log.imu.t < 5.0) | (log.imu.t > 6.0)
    estimate = calibrate(log.kept(rows), **NEAR, exclusion_threshold=0.0)
    assert any("1 gaps" in warning for warning in estimate.warnings)
    whole = calibrate(log, **NEAR, exclusion_threshold=0.0)
    np.testing.assert_allclose(estimate.t_parent_imu, whole.t_parent_imu, atol=1.5e-3)
    # One sample either side of the gap pairs with its neighbour.
    assert estimate.residuals.windows_used == pytest.approx(rows.sum(), abs=2)


def test_an_even_window_becomes_odd_and_a_short_log_is_refused(log: Log) -> None:
    assert calibrate(log, 10, **NEAR).window.samples == 11
    seconds = PaperOptions(window=WindowChoice(seconds=0.1), **NEAR)
    assert calibrate_paper(log.imu, log.path, seconds).window.samples == 21
    with pytest.raises(InputError, match="fewer than the window of 5001"):
        calibrate(log, 5001)
    with pytest.raises(InputError, match="excluded"):
        calibrate(log, 1201, exclusion_threshold=1e-9)


def test_local_minimum_is_untrusted() -> None:
    log = make_log(Moves(seconds=12.0))
    upside_down = log.mount.R @ np.diag([1.0, -1.0, -1.0])
    options = PaperOptions(exclusion_threshold=0.0, R_initial=upside_down)
    estimate = calibrate_paper(log.imu, log.path, options)
    assert np.linalg.norm(estimate.t_parent_imu - log.mount.t) > 0.5
    assert not estimate.trusted
    assert any("local minimum" in reason for reason in estimate.distrust)
