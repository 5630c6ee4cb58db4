"""What is known of the pose beforehand: held, weighed in, and contradicted where the data do."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.model import columns
from imucalib_cli.estimate.options import MatchedOptions, PosePrior
from imucalib_cli.estimate.solution.solve import Known, refine
from imucalib_cli.findings import Severity
from tests.estimate.estimate_arm import EXACT, GRAVITY, INDUSTRIAL, MOUNT, Log, Moves, parent_motion
from tests.estimate.estimate_faults import flawed_log, nees, pose_error

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


def calibrated(
    prior: PosePrior | None,
    recorded: Log | None = None,
    gravity: Literal["tilt", "fixed"] = "tilt",
) -> Estimate:
    data = recorded or log()
    return calibrate_matched(data.imu, data.path, replace(EXACT, pose=prior, gravity=gravity))


def fixing(*names: str) -> tuple[float, ...]:
    return tuple(0.0 if name in names else np.inf for name in NAMES)


def sigma(estimate: Estimate) -> Floats:
    assert estimate.covariance is not None
    return np.sqrt(np.diag(estimate.covariance))


def turned_from(estimate: Estimate, prior: PosePrior) -> Floats:
    """Rotation vector from the prior's rotation to the estimate's, parent frame."""
    assert prior.R_parent_imu is not None
    return np.asarray(
        Rotation.from_matrix(estimate.R_parent_imu @ prior.R_parent_imu.T).as_rotvec()
    )


@pytest.mark.parametrize("name", NAMES)
def test_a_fixed_component_is_what_it_was_fixed_to(name: str) -> None:
    prior, place = told(fixing(name)), NAMES.index(name)
    estimate = calibrated(prior)
    assert estimate.trusted
    assert estimate.warnings == ()
    if place < 3:
        assert estimate.t_parent_imu[place] == MOUNT.t[place]
    else:
        assert abs(turned_from(estimate, prior)[place - 3]) < 1e-8
    others = [index for index in range(6) if index != place]
    assert sigma(estimate)[place] == 0.0
    # What is known of one makes no other worse, but for how well the noise is known.
    free = calibrated(None)
    assert np.all(sigma(estimate)[others] <= 1.06 * sigma(free)[others])
    off = np.abs(pose_error(estimate, MOUNT))[others]
    assert np.all(off < 4 * sigma(estimate)[others])


def test_all_of_the_pose_may_be_fixed() -> None:
    estimate = calibrated(told(fixing(*NAMES)))
    np.testing.assert_array_equal(estimate.t_parent_imu, MOUNT.t)
    np.testing.assert_allclose(estimate.R_parent_imu, MOUNT.R, atol=1e-15)
    np.testing.assert_array_equal(estimate.covariance, np.zeros((6, 6)))
    # There is still a clock to be found.
    assert estimate.time_offset_std is not None
    assert abs(estimate.time_offset) < 4 * estimate.time_offset_std


def contradiction(estimate: Estimate) -> dict[str, Any]:
    """What the first reason not to trust the estimate says."""
    reason, *_ = (each for each in estimate.findings if each.severity is Severity.UNTRUSTED)
    return {"code": reason.code, **reason.values}


@pytest.mark.parametrize(("name", "size"), [("tx", 8e-3), ("rz", -np.radians(1.0))])
def test_a_wrong_fix_is_contradicted_by_name_and_size(name: str, size: float) -> None:
    wrong = np.where(np.array(NAMES) == name, size, 0.0).tolist()
    prior = told(fixing(name), dt=tuple(wrong[:3]), turn=tuple(wrong[3:]))
    estimate = calibrated(prior)
    found = contradiction(estimate)
    assert (found["code"], found["option"]) == ("prior.contradicted", f"--fix {name}")
    assert found["step"] == pytest.approx(-size, rel=0.15)
    assert estimate.corrections == ()


def test_of_several_fixed_components_the_wrong_one_is_named() -> None:
    prior = told(fixing(*NAMES), dt=(0.0, 0.0, 0.02))
    found = contradiction(calibrated(prior))
    assert (found["code"], found["option"]) == ("prior.contradicted", "--fix tz")
    assert found["step"] == pytest.approx(-0.02, abs=1e-3)


def test_a_prior_weighs_in_by_inverse_variance() -> None:
    """Against the textbook's combination of two Gaussians, from the free estimate's numbers."""
    free = calibrated(None)
    assert free.covariance is not None
    P, std = free.covariance, 1.5 * sigma(free) * [1.0, 0.5, 2.0, 1.0, 0.7, 1.3]
    away = np.array([2.0, -1.0, 1.5, 1.0, 2.0, -1.5]) * std
    prior = PosePrior(
        std=tuple(std),
        R_parent_imu=Rotation.from_rotvec(away[3:]).as_matrix() @ free.R_parent_imu,
        t_parent_imu=free.t_parent_imu + away[:3],
    )
    both = calibrated(prior)
    gain = P @ np.linalg.inv(P + np.diag(std**2))
    expected, left = gain @ away, P - gain @ P
    turned = Rotation.from_matrix(both.R_parent_imu @ free.R_parent_imu.T).as_rotvec()
    moved = np.concatenate([both.t_parent_imu - free.t_parent_imu, turned])
    np.testing.assert_allclose(moved / sigma(free), expected / sigma(free), atol=0.15)
    np.testing.assert_allclose(sigma(both), np.sqrt(np.diag(left)), rtol=0.07)
    assert both.distrust == ()


def test_a_wide_prior_changes_nothing_and_a_tight_one_holds() -> None:
    free = calibrated(None)
    wide = calibrated(told((1.0,) * 3 + (1.0,) * 3, dt=(0.1, 0.0, 0.0)))
    np.testing.assert_allclose(wide.t_parent_imu, free.t_parent_imu, atol=1e-6)
    tight = calibrated(told((1e-7,) * 3 + (1e-8,) * 3))
    assert np.linalg.norm(pose_error(tight, MOUNT)[:3]) < 1e-6
    assert np.all(sigma(tight) <= 1.01 * np.array([1e-7] * 3 + [1e-8] * 3))


def test_a_prior_that_the_data_contradict_is_named() -> None:
    found = contradiction(calibrated(told((1e-3,) + (np.inf,) * 5, dt=(0.02, 0.0, 0.0))))
    assert (found["code"], found["option"]) == ("prior.contradicted", "--prior-std tx")
    assert found["step"] == pytest.approx(-0.02, abs=4 * sigma(calibrated(None))[0])


def test_a_contradicted_prior_is_no_change_within_the_log() -> None:
    estimate = calibrated(told((1e-3,) + (np.inf,) * 5, dt=(0.02, 0.0, 0.0)))
    assert not any(each.code.startswith("change.") for each in estimate.findings)


@pytest.mark.parametrize("turn", [-2.9, -1.3, 2.2, 3.1])
@pytest.mark.parametrize("axis", range(3))
def test_one_free_axis_is_found_from_far(axis: int, turn: float) -> None:
    away = np.zeros(3)
    away[axis] = turn
    held = [NAMES[3 + other] for other in range(3) if other != axis]
    prior = told(fixing(*held), turn=tuple(-away))
    estimate = calibrated(prior)
    assert estimate.trusted
    off = np.abs(turned_from(estimate, prior) - away)
    assert off[axis] < 4 * sigma(estimate)[3 + axis]
    assert np.delete(off, axis).max() < 1e-12


@pytest.mark.parametrize(
    "away", [(0, 2.0, 1.5), (2.2, 0, -1.0), (-1.5, -1.8, 0), (0, -0.5, 2.6), (1.0, 0, 0.3)]
)
def test_two_free_axes_are_found_from_far(away: tuple[float, ...]) -> None:
    held = away.index(0)
    # The prior stands where a turn by ``away`` on the left of it is the truth.
    R = Rotation.from_rotvec(away).as_matrix().T @ MOUNT.R
    prior = PosePrior(std=fixing(NAMES[3 + held]), R_parent_imu=R, t_parent_imu=np.zeros(3))
    estimate = calibrated(prior)
    assert estimate.trusted
    assert nees_of_free(estimate, 3 + held) < 25.0
    assert abs(turned_from(estimate, prior)[held]) < 1e-12


def nees_of_free(estimate: Estimate, held: int) -> float:
    assert estimate.covariance is not None
    free = [index for index in range(6) if index != held]
    error = pose_error(estimate, MOUNT)[free]
    return float(error @ np.linalg.solve(estimate.covariance[np.ix_(free, free)], error))


def test_what_the_motion_leaves_open_a_fix_closes() -> None:
    """About one axis of the wrist, the place along that axis is unknown until it is told.

    The vertical is known: a tilt of the base would look like a turn about the axis.
    """
    one = Moves(seed=2, seconds=16.0, amplitude=(0, 0, 0, 0, 1.8, 0))
    recorded = flawed_log(moves=one).noisy(1, INDUSTRIAL)
    omega = parent_motion(one, np.arange(0.0, 16.0, 0.01)).omega
    axis = np.linalg.eigh(omega.T @ omega)[1][:, 2]
    free = calibrated(None, recorded, "fixed")
    (left,) = free.unobservable
    assert left.kind == "translation"
    assert abs(left.direction_parent @ axis) == pytest.approx(1.0, abs=1e-3)
    # The axis is nearest to y: any component along it will do.
    closed = calibrated(told(fixing("ty")), recorded, "fixed")
    assert closed.trusted
    assert closed.t_parent_imu[1] == MOUNT.t[1]
    assert np.linalg.norm(closed.t_parent_imu - MOUNT.t) < 1e-3
    weighed = calibrated(told((np.inf, 1e-3, *[np.inf] * 4)), recorded, "fixed")
    assert weighed.trusted
    assert sigma(weighed)[1] == pytest.approx(1e-3, rel=0.05)


def test_a_prior_is_true_of_itself() -> None:
    """Priors drawn about the truth leave sigma true."""
    clean, rng = flawed_log(moves=Moves(seed=4, seconds=12.0)), np.random.default_rng(8)
    std = np.array([3e-4, 2e-4, 4e-4, 1e-4, 1e-4, 1e-4])
    scores = []
    for seed in range(10):
        away = rng.normal(size=6) * std
        prior = told(tuple(std), dt=tuple(away[:3]), turn=tuple(away[3:]))
        scores.append(nees(calibrated(prior, clean.noisy(seed)), MOUNT))
    assert abs(np.mean(scores) - 6.0) < 3 * np.sqrt(12 / 10)


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=25)
def test_priors_leave_no_way_downhill(seed: int) -> None:
    """The cost with priors far away, stated anew, is level where the solve ends."""
    rng, h = np.random.default_rng(seed), 1e-6
    rows, R_start = rng.normal(size=(4 * columns.COUNT, columns.COUNT)), Rotation.random(rng=rng)
    down = np.array([0.0, 0.0, -GRAVITY])
    start = np.r_[1.0, rng.normal(size=3), R_start.as_matrix().ravel(), rng.normal(size=6), down]
    # Residuals of the size of their noise at the truth, from which the priors pull away.
    rows[:, columns.ONE] += rng.normal(size=len(rows)) - rows @ start
    normal = rows.T @ rows
    away = rng.normal(size=3)
    away *= rng.uniform(0.0, 1.5) / np.linalg.norm(away)
    known, t_known = Rotation.from_rotvec(away) * R_start, rng.normal(size=3)
    options = MatchedOptions(
        accel_bias_std=0.1,
        gyro_bias_std=0.1,
        gravity="fixed",
        pose=PosePrior(std=(0.1,) * 6, R_parent_imu=known.as_matrix(), t_parent_imu=t_known),
    )
    best = refine(normal, Known.of(options), start)

    def cost(step: Floats) -> float:
        x = best.x.copy()
        x[columns.T] += step[:3]
        R = Rotation.from_rotvec(step[3:6]) * Rotation.from_matrix(best.R)
        x[columns.R] = R.as_matrix().ravel()
        x[columns.BA] += step[6:9]
        x[columns.BG] += step[9:]
        off = np.r_[x[columns.T] - t_known, (R * known.inv()).as_rotvec(), x[13:19]]
        return float(x @ normal @ x + (off**2).sum() / 0.1**2)

    steps = h * np.eye(12)
    slopes = [(cost(s) - cost(-s)) / (2 * h) for s in steps]
    bends = [
        (cost(1e3 * s) + cost(-1e3 * s) - 2 * cost(np.zeros(12))) / (1e3 * h) ** 2 for s in steps
    ]
    # Steps that are left, by Newton, in the unit of each component.
    assert np.abs(np.array(slopes) / np.maximum(bends, 1.0)).max() < 1e-4
