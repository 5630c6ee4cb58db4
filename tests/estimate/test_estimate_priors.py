"""Prior knowledge of the pose: held, weighed in, and contradicted where the data do so."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.estimate.options import PosePrior
from imucalib_cli.findings import Severity
from tests.estimate.estimate_arm import (
    GRAVITY,
    MOUNT,
    NAMES,
    Log,
    Mount,
    Moves,
    Solved,
    make_log,
    parent_motion,
    prior,
    solve_exact,
)
from tests.slow import slow_after
from tools.errors import pose_error, rotation_error


@cache
def log() -> Log:
    return make_log(Moves(seed=4, seconds=16.0), imu_rate=100.0).noisy(1)


def free() -> Solved:
    return solve_exact(log())


def with_prior(**known: Any) -> Solved:
    """The estimate with arguments of `prior`."""
    return solve_exact(log(), pose=prior(**known))


def stds(values: Any) -> dict[str, Any]:
    return dict(zip(NAMES, values, strict=True))


ALL = stds((0.0,) * 6)


def turned_from(found: Solved, known: PosePrior) -> Floats:
    """Rotation vector from the prior's rotation to the estimate's, parent frame."""
    assert known.R_parent_imu is not None
    return rotation_error(found.R_parent_imu, known.R_parent_imu)


@pytest.mark.parametrize("name", slow_after(1, ["tz", "rx", "tx", "ty", "ry", "rz"]))
def test_a_fixed_component_keeps_its_value(name: str) -> None:
    found, place = with_prior(**{name: 0.0}), NAMES.index(name)
    assert found.trusted
    assert found.warnings == ()
    assert abs(found.error[place]) < (1e-15 if place < 3 else 1e-8)
    assert found.sigma[place] == 0.0
    # Knowledge of one makes no other worse, but for how well the noise is known.
    others = np.delete(np.arange(6), place)
    assert np.all(found.sigma[others] <= 1.06 * free().sigma[others])
    assert np.all(np.abs(found.error[others]) < 4 * found.sigma[others])


def test_whole_pose_can_be_fixed() -> None:
    found = with_prior(**ALL)
    np.testing.assert_array_equal(found.t_parent_imu, MOUNT.t)
    np.testing.assert_allclose(found.R_parent_imu, MOUNT.R, atol=1e-15)
    np.testing.assert_array_equal(found.covariance, np.zeros((6, 6)))
    # There is still a clock to be found.
    assert found.time_offset_std is not None
    assert abs(found.time_offset) < 4 * found.time_offset_std


@pytest.mark.parametrize(
    ("known", "option", "step", "within"),
    [
        ({"tx": 0.0, "dt": (8e-3, 0.0, 0.0)}, "--fix tx", -8e-3, 1.2e-3),
        pytest.param(
            *({"rz": 0.0, "turn": (0.0, 0.0, -np.radians(1.0))}, "--fix rz"),
            *(np.radians(1.0), np.radians(0.15)),
            marks=pytest.mark.slow,
        ),
        # Of several fixed components the wrong one is named.
        ({**ALL, "dt": (0.0, 0.0, 0.02)}, "--fix tz", -0.02, 1e-3),
        ({"tx": 1e-3, "dt": (0.02, 0.0, 0.0)}, "--prior-std tx", -0.02, None),
    ],
    ids=["fixed shift", "fixed turn", "one of six", "prior"],
)
def test_wrong_prior_is_contradicted_with_name_and_size(
    known: dict[str, Any], option: str, step: float, within: float | None
) -> None:
    found = with_prior(**known)
    reason, *_ = (each for each in found.findings if each.severity is Severity.UNTRUSTED)
    assert (reason.code, reason.values["option"]) == ("prior.contradicted", option)
    assert reason.values["step"] == pytest.approx(step, abs=within or 4 * free().sigma[0])
    assert found.corrections == {}
    # Nor is it taken for a change within the log.
    assert not any(code.startswith("change.") for code in found.codes)


def test_prior_is_weighted_by_inverse_variance() -> None:
    """Against the textbook's combination of two Gaussians, from the free estimate's numbers."""
    P, std = free().P, 1.5 * free().sigma * [1.0, 0.5, 2.0, 1.0, 0.7, 1.3]
    away = np.array([2.0, -1.0, 1.5, 1.0, 2.0, -1.5]) * std
    alone = Mount(R=free().R_parent_imu, t=free().t_parent_imu)
    both = with_prior(mount=alone, dt=away[:3], turn=away[3:], **stds(std))
    gain = P @ np.linalg.inv(P + np.diag(std**2))
    moved, sigma = pose_error(both, alone.R, alone.t), free().sigma
    np.testing.assert_allclose(moved / sigma, gain @ away / sigma, atol=0.15)
    np.testing.assert_allclose(both.sigma, np.sqrt(np.diag(P - gain @ P)), rtol=0.07)
    assert both.distrust == ()


def test_wide_prior_has_no_effect_and_tight_prior_fixes() -> None:
    wide = with_prior(dt=(0.1, 0.0, 0.0), **stds((1.0,) * 6))
    np.testing.assert_allclose(wide.t_parent_imu, free().t_parent_imu, atol=1e-6)
    std = np.repeat([1e-7, 1e-8], 3)
    tight = with_prior(**stds(std))
    assert tight.distance < 1e-6
    assert np.all(tight.sigma <= 1.01 * std)


@pytest.mark.parametrize("turn", slow_after(1, [3.1, -2.9, -1.3, 2.2]))
@pytest.mark.parametrize("axis", slow_after(1, range(3)))
def test_one_free_axis_converges_from_far(axis: int, turn: float) -> None:
    away = turn * np.eye(3)[axis]
    held: dict[str, Any] = {name: 0.0 for other, name in enumerate(NAMES[3:]) if other != axis}
    known = prior(turn=-away, **held)
    found = solve_exact(log(), pose=known)
    assert found.trusted
    off = np.abs(turned_from(found, known) - away)
    assert off[axis] < 4 * found.sigma[3 + axis]
    assert np.delete(off, axis).max() < 1e-12


@pytest.mark.parametrize(
    "away",
    slow_after(
        1, [((0, 2, 1.5),), ((2.2, 0, -1),), ((-1.5, -1.8, 0),), ((0, -0.5, 2.6),), ((1, 0, 0.3),)]
    ),
)
def test_two_free_axes_converge_from_far(away: tuple[float, ...]) -> None:
    held = away.index(0)
    # A turn by ``away`` on the left of the prior is the truth.
    R = Rotation.from_rotvec(away).as_matrix().T @ MOUNT.R
    known = prior(Mount(R=R, t=np.zeros(3)), **{NAMES[3 + held]: 0.0})
    found = solve_exact(log(), pose=known)
    assert found.trusted
    free = np.delete(np.arange(6), 3 + held)
    error = found.error[free]
    assert error @ np.linalg.solve(found.P[np.ix_(free, free)], error) < 25.0
    assert abs(turned_from(found, known)[held]) < 1e-12


def test_fix_resolves_unobservable_direction() -> None:
    """About one axis of the wrist, the place along that axis is unknown until it is stated.

    The vertical is known: a tilt of the base would look like a turn about the axis.
    """
    one = Moves(seed=2, seconds=16.0, amplitude=(0, 0, 0, 0, 1.8, 0))
    wrist = make_log(one, imu_rate=100.0).noisy(1, "industrial")
    omega = parent_motion(one, np.arange(0.0, 16.0, 0.01)).omega
    axis = np.linalg.eigh(omega.T @ omega)[1][:, 2]
    (hidden,) = solve_exact(wrist, gravity="fixed").unobservable
    assert hidden.kind == "translation"
    assert abs(hidden.direction_parent @ axis) == pytest.approx(1.0, abs=1e-3)
    # The axis is nearest to y: any component along it will do.
    closed, weighed = (
        solve_exact(wrist, gravity="fixed", pose=prior(ty=std)) for std in (0.0, 1e-3)
    )
    assert closed.trusted
    assert closed.t_parent_imu[1] == MOUNT.t[1]
    assert closed.distance < 1e-3
    assert weighed.trusted
    assert weighed.sigma[1] == pytest.approx(1e-3, rel=0.05)


@pytest.mark.slow
def test_priors_drawn_about_truth_keep_sigma_correct() -> None:
    clean = make_log(Moves(seed=4, seconds=12.0), imu_rate=100.0)
    rng, std = np.random.default_rng(8), np.array([3e-4, 2e-4, 4e-4, 1e-4, 1e-4, 1e-4])
    scores = []
    for seed in range(10):
        away = rng.normal(size=6) * std
        known = prior(dt=away[:3], turn=away[3:], **stds(std))
        scores.append(solve_exact(clean.noisy(seed), pose=known).nees)
    assert abs(np.mean(scores) - 6.0) < 3 * np.sqrt(12 / 10)


def test_bias_prior_has_correct_weight() -> None:
    """The posterior of a bias is the precision-weighted mean of measurement and prior."""
    recorded = make_log(Moves(seconds=12.0)).noisy(2)
    free, tight = (
        solve_exact(recorded, accel_bias_std=std, gravity="fixed", time_offset=0.0)
        for std in (np.inf, 1e-5)
    )
    assert free.accel_bias_std is not None
    assert tight.accel_bias_std is not None
    assert np.all(np.abs(free.accel_bias - [0.1, -0.05, 0.08]) < 4 * free.accel_bias_std)
    assert np.abs(tight.accel_bias).max() < 3e-2 * np.abs(free.accel_bias).max()
    assert np.all(tight.accel_bias_std <= 1.05e-5)
    assert solve_exact(recorded, accel_bias_std=0.0).accel_bias_std is None


def test_tilt_prior_constrains_the_vertical() -> None:
    gravity = Rotation.from_rotvec([0.02, 0, 0]).apply([0, 0, -GRAVITY])
    recorded = make_log(Moves(seconds=12.0), gravity_world=gravity).noisy(1)
    free, held = (solve_exact(recorded, tilt_std=std) for std in (np.inf, 0.0))
    np.testing.assert_allclose(free.gravity_world, gravity, atol=0.02)
    np.testing.assert_array_equal(held.gravity_world, [0, 0, -GRAVITY])
