"""What is known of the pose beforehand: held, weighed in, and contradicted where the data do."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from imucalib_cli.estimate.options import MatchedOptions, PosePrior
from imucalib_cli.findings import Severity
from tests.estimate.estimate_arm import (
    GRAVITY,
    INDUSTRIAL,
    MOUNT,
    Log,
    Mount,
    Moves,
    calibrated,
    codes,
    covariance,
    make_log,
    nees,
    parent_motion,
    pose_error,
    rotation_error,
    sigma,
    taken_as_exact,
)
from tests.estimate.estimate_faults import flawed_log
from tests.slow import slow_after

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate

Floats = NDArray[np.float64]

NAMES = ("tx", "ty", "tz", "rx", "ry", "rz")
FREE = (np.inf,) * 6


@cache
def log() -> Log:
    return flawed_log(moves=Moves(seed=4, seconds=16.0)).noisy(1)


def told(
    std: tuple[float, ...] = FREE,
    *,
    dt: tuple[float, ...] = (0.0, 0.0, 0.0),
    turn: tuple[float, ...] = (0.0, 0.0, 0.0),
) -> PosePrior:
    """A prior about the true mount, moved by dt and turned on the left by a rotation vector."""
    R = Rotation.from_rotvec(turn).as_matrix() @ MOUNT.R
    return PosePrior(std=std, R_parent_imu=R, t_parent_imu=MOUNT.t + dt)


def knowing(prior: PosePrior | None, recorded: Log | None = None, **options: Any) -> Estimate:
    return taken_as_exact(recorded or log(), pose=prior, **options)


def fixing(*names: str) -> tuple[float, ...]:
    return tuple(0.0 if name in names else np.inf for name in NAMES)


def turned_from(estimate: Estimate, prior: PosePrior) -> Floats:
    """Rotation vector from the prior's rotation to the estimate's, parent frame."""
    assert prior.R_parent_imu is not None
    return rotation_error(estimate.R_parent_imu, prior.R_parent_imu)


@pytest.mark.parametrize("name", slow_after(1, ["tz", "rx", "tx", "ty", "ry", "rz"]))
def test_a_fixed_component_is_what_it_was_fixed_to(name: str) -> None:
    prior, place = told(fixing(name)), NAMES.index(name)
    estimate = knowing(prior)
    assert estimate.trusted
    assert estimate.warnings == ()
    if place < 3:
        assert estimate.t_parent_imu[place] == MOUNT.t[place]
    else:
        assert abs(turned_from(estimate, prior)[place - 3]) < 1e-8
    others = [index for index in range(6) if index != place]
    assert sigma(estimate)[place] == 0.0
    # What is known of one makes no other worse, but for how well the noise is known.
    free = knowing(None)
    assert np.all(sigma(estimate)[others] <= 1.06 * sigma(free)[others])
    off = np.abs(pose_error(estimate, MOUNT))[others]
    assert np.all(off < 4 * sigma(estimate)[others])


def test_all_of_the_pose_may_be_fixed() -> None:
    estimate = knowing(told(fixing(*NAMES)))
    np.testing.assert_array_equal(estimate.t_parent_imu, MOUNT.t)
    np.testing.assert_allclose(estimate.R_parent_imu, MOUNT.R, atol=1e-15)
    np.testing.assert_array_equal(estimate.covariance, np.zeros((6, 6)))
    # There is still a clock to be found.
    assert estimate.time_offset_std is not None
    assert abs(estimate.time_offset) < 4 * estimate.time_offset_std


def assert_contradicted(estimate: Estimate, option: str, step: Any) -> None:
    """The first reason not to trust the estimate, by name and size."""
    reason, *_ = (each for each in estimate.findings if each.severity is Severity.UNTRUSTED)
    assert (reason.code, reason.values["option"]) == ("prior.contradicted", option)
    assert reason.values["step"] == step


@pytest.mark.parametrize(("name", "size"), slow_after(1, [("tx", 8e-3), ("rz", -np.radians(1.0))]))
def test_a_wrong_fix_is_contradicted_by_name_and_size(name: str, size: float) -> None:
    wrong = np.where(np.array(NAMES) == name, size, 0.0).tolist()
    prior = told(fixing(name), dt=tuple(wrong[:3]), turn=tuple(wrong[3:]))
    estimate = knowing(prior)
    assert_contradicted(estimate, f"--fix {name}", pytest.approx(-size, rel=0.15))
    assert estimate.corrections == ()


def test_of_several_fixed_components_the_wrong_one_is_named() -> None:
    prior = told(fixing(*NAMES), dt=(0.0, 0.0, 0.02))
    assert_contradicted(knowing(prior), "--fix tz", pytest.approx(-0.02, abs=1e-3))


def test_a_prior_weighs_in_by_inverse_variance() -> None:
    """Against the textbook's combination of two Gaussians, from the free estimate's numbers."""
    free = knowing(None)
    P, std = covariance(free), 1.5 * sigma(free) * [1.0, 0.5, 2.0, 1.0, 0.7, 1.3]
    away = np.array([2.0, -1.0, 1.5, 1.0, 2.0, -1.5]) * std
    prior = PosePrior(
        std=tuple(std),
        R_parent_imu=Rotation.from_rotvec(away[3:]).as_matrix() @ free.R_parent_imu,
        t_parent_imu=free.t_parent_imu + away[:3],
    )
    both = knowing(prior)
    gain = P @ np.linalg.inv(P + np.diag(std**2))
    expected, left = gain @ away, P - gain @ P
    moved = pose_error(both, Mount(R=free.R_parent_imu, t=free.t_parent_imu))
    np.testing.assert_allclose(moved / sigma(free), expected / sigma(free), atol=0.15)
    np.testing.assert_allclose(sigma(both), np.sqrt(np.diag(left)), rtol=0.07)
    assert both.distrust == ()


def test_a_wide_prior_changes_nothing_and_a_tight_one_holds() -> None:
    free = knowing(None)
    wide = knowing(told((1.0,) * 3 + (1.0,) * 3, dt=(0.1, 0.0, 0.0)))
    np.testing.assert_allclose(wide.t_parent_imu, free.t_parent_imu, atol=1e-6)
    tight = knowing(told((1e-7,) * 3 + (1e-8,) * 3))
    assert np.linalg.norm(pose_error(tight, MOUNT)[:3]) < 1e-6
    assert np.all(sigma(tight) <= 1.01 * np.array([1e-7] * 3 + [1e-8] * 3))


def test_a_prior_that_the_data_contradict_is_named() -> None:
    estimate = knowing(told((1e-3,) + (np.inf,) * 5, dt=(0.02, 0.0, 0.0)))
    step = pytest.approx(-0.02, abs=4 * sigma(knowing(None))[0])
    assert_contradicted(estimate, "--prior-std tx", step)
    # Nor is it taken for a change within the log.
    assert not any(code.startswith("change.") for code in codes(estimate))


@pytest.mark.parametrize("turn", slow_after(1, [3.1, -2.9, -1.3, 2.2]))
@pytest.mark.parametrize("axis", slow_after(1, range(3)))
def test_one_free_axis_is_found_from_far(axis: int, turn: float) -> None:
    away = np.zeros(3)
    away[axis] = turn
    held = [NAMES[3 + other] for other in range(3) if other != axis]
    prior = told(fixing(*held), turn=tuple(-away))
    estimate = knowing(prior)
    assert estimate.trusted
    off = np.abs(turned_from(estimate, prior) - away)
    assert off[axis] < 4 * sigma(estimate)[3 + axis]
    assert np.delete(off, axis).max() < 1e-12


@pytest.mark.parametrize(
    ("x", "y", "z"),
    slow_after(1, [(0, 2, 1.5), (2.2, 0, -1), (-1.5, -1.8, 0), (0, -0.5, 2.6), (1, 0, 0.3)]),
)
def test_two_free_axes_are_found_from_far(x: float, y: float, z: float) -> None:
    away = (x, y, z)
    held = away.index(0)
    # The prior stands where a turn by ``away`` on the left of it is the truth.
    R = Rotation.from_rotvec(away).as_matrix().T @ MOUNT.R
    prior = PosePrior(std=fixing(NAMES[3 + held]), R_parent_imu=R, t_parent_imu=np.zeros(3))
    estimate = knowing(prior)
    assert estimate.trusted
    assert nees_of_free(estimate, 3 + held) < 25.0
    assert abs(turned_from(estimate, prior)[held]) < 1e-12


def nees_of_free(estimate: Estimate, held: int) -> float:
    free = [index for index in range(6) if index != held]
    error = pose_error(estimate, MOUNT)[free]
    return float(error @ np.linalg.solve(covariance(estimate)[np.ix_(free, free)], error))


def test_what_the_motion_leaves_open_a_fix_closes() -> None:
    """About one axis of the wrist, the place along that axis is unknown until it is told.

    The vertical is known: a tilt of the base would look like a turn about the axis.
    """
    one = Moves(seed=2, seconds=16.0, amplitude=(0, 0, 0, 0, 1.8, 0))
    recorded = flawed_log(moves=one).noisy(1, INDUSTRIAL)
    omega = parent_motion(one, np.arange(0.0, 16.0, 0.01)).omega
    axis = np.linalg.eigh(omega.T @ omega)[1][:, 2]
    free = knowing(None, recorded, gravity="fixed")
    (left,) = free.unobservable
    assert left.kind == "translation"
    assert abs(left.direction_parent @ axis) == pytest.approx(1.0, abs=1e-3)
    # The axis is nearest to y: any component along it will do.
    closed = knowing(told(fixing("ty")), recorded, gravity="fixed")
    assert closed.trusted
    assert closed.t_parent_imu[1] == MOUNT.t[1]
    assert np.linalg.norm(closed.t_parent_imu - MOUNT.t) < 1e-3
    weighed = knowing(told((np.inf, 1e-3, *[np.inf] * 4)), recorded, gravity="fixed")
    assert weighed.trusted
    assert sigma(weighed)[1] == pytest.approx(1e-3, rel=0.05)


@pytest.mark.slow
def test_a_prior_is_true_of_itself() -> None:
    """Priors drawn about the truth leave sigma true."""
    clean, rng = flawed_log(moves=Moves(seed=4, seconds=12.0)), np.random.default_rng(8)
    std = np.array([3e-4, 2e-4, 4e-4, 1e-4, 1e-4, 1e-4])
    scores = []
    for seed in range(10):
        away = rng.normal(size=6) * std
        prior = told(tuple(std), dt=tuple(away[:3]), turn=tuple(away[3:]))
        scores.append(nees(knowing(prior, clean.noisy(seed)), MOUNT))
    assert abs(np.mean(scores) - 6.0) < 3 * np.sqrt(12 / 10)


def test_a_prior_on_a_bias_pulls_as_hard_as_it_should() -> None:
    """The posterior of a bias is the precision-weighted mean of measurement and prior."""

    recorded = make_log(Moves(seconds=12.0)).noisy(2)

    def found(std: float) -> tuple[Floats, Floats]:
        options = MatchedOptions(accel_bias_std=std, gravity="fixed", time_offset=0.0)
        estimate = calibrated(recorded, options)
        assert estimate.accel_bias_std is not None
        return estimate.accel_bias, estimate.accel_bias_std

    free, free_std = found(np.inf)
    assert np.all(np.abs(free - [0.1, -0.05, 0.08]) < 4 * free_std)
    tight, tight_std = found(1e-5)
    assert np.abs(tight).max() < 3e-2 * np.abs(free).max()
    assert np.all(tight_std <= 1.05e-5)
    assert calibrated(recorded, MatchedOptions(accel_bias_std=0.0)).accel_bias_std is None


def test_a_prior_on_tilt_holds_the_vertical() -> None:
    lean = 0.02
    gravity = Rotation.from_rotvec([lean, 0, 0]).apply([0, 0, -GRAVITY])
    recorded = make_log(Moves(seconds=12.0), gravity_world=gravity).noisy(1)

    def found(std: float) -> Floats:
        options = MatchedOptions(tilt_std=std, gravity_std=0.0)
        return calibrated(recorded, options).gravity_world

    np.testing.assert_allclose(found(np.inf), gravity, atol=0.02)
    np.testing.assert_array_equal(found(0.0), [0, 0, -GRAVITY])
