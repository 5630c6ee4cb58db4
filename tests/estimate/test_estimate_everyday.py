"""Robots and sensors as they are: driver filters, ramps, give in the mount, everyday errors.

Truth is that of benchmarks/robots.py: analytic motions and pinocchio's accelerations.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from benchmarks.robots import ROBOTS, Case, make_case
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from tests.estimate.estimate_arm import EXACT, INDUSTRIAL, Log, Moves, make_log, rotation_error

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate

Floats = NDArray[np.float64]


def error_of(estimate: Estimate, case: Case) -> Floats:
    """(6,), in the tangent of the covariance."""
    turned = Rotation.from_matrix(estimate.R_parent_imu @ case.R.T).as_rotvec()
    return np.concatenate([estimate.t_parent_imu - case.t, turned])


def nees(estimate: Estimate, case: Case) -> float:
    assert estimate.covariance is not None
    error = error_of(estimate, case)
    return float(error @ np.linalg.solve(estimate.covariance, error))


def sigmas(estimate: Estimate, case: Case) -> Floats:
    """(6,), error of each component in its sigma."""
    assert estimate.covariance is not None
    return np.asarray(np.abs(error_of(estimate, case)) / np.sqrt(np.diag(estimate.covariance)))


@cache
def calibrated(robot: str, row: str, seed: int, *, exact: bool = False) -> tuple[Estimate, Case]:
    case = make_case(robot, row, seed)
    options = EXACT if exact else MatchedOptions()
    return calibrate_matched(case.imu, case.path, options), case


@pytest.mark.parametrize("seed", range(3))
def test_a_drivers_exponential_average_is_found_and_corrected(seed: int) -> None:
    estimate, case = calibrated("ur10e", "average-0.2", seed)
    assert sigmas(estimate, case).max() < 3.0
    names = {each.values["name"] for each in estimate.findings if each.code == "unknown.found"}
    assert names & {"accel_filter", "gyro_filter"}
    # Of the samples' spacing: an exponential average of alpha has variance (1 - alpha) / alpha²,
    # half of which stands by the second derivative beside the delay, 10 samples² here.
    found = {each.name: each for each in estimate.parameters}
    for name in ("accel_filter", "gyro_filter"):
        assert found[name].value == pytest.approx(10.0 / 200.0**2, rel=0.25)


@pytest.mark.parametrize("seed", range(2))
def test_a_sound_driver_has_no_filter(seed: int) -> None:
    estimate, _ = calibrated("ur10e", "quiet", seed)
    names = {each.values["name"] for each in estimate.findings if each.code == "unknown.found"}
    assert names.isdisjoint({"accel_filter", "gyro_filter"})


@pytest.mark.parametrize("seed", range(3))
def test_biases_that_ramp_are_followed(seed: int) -> None:
    estimate, case = calibrated("ur10e", "bias-ramp", seed)
    assert sigmas(estimate, case).max() < 3.0
    assert estimate.trusted
    ramp = [each.value for each in estimate.parameters if each.name == "gyro_bias_ramp"]
    std = [each.std for each in estimate.parameters if each.name == "gyro_bias_ramp"]
    assert np.all(np.abs(np.array(ramp) - case.drawn["gyro_ramp"]) < 4 * np.array(std))


@pytest.mark.parametrize("robot", ROBOTS)
def test_an_everyday_robot_is_covered_and_better_than_believed_exact(robot: str) -> None:
    scores, whole, lean = [], [], []
    for seed in range(6):
        estimate, case = calibrated(robot, "everyday", seed)
        scores.append(nees(estimate, case))
        whole.append(float(np.linalg.norm(error_of(estimate, case)[:3])))
        believed, _ = calibrated(robot, "everyday", seed, exact=True)
        lean.append(float(np.linalg.norm(error_of(believed, case)[:3])))
    assert np.mean(scores) < 12.0
    assert np.sqrt(np.mean(np.square(whole))) < 0.5 * np.sqrt(np.mean(np.square(lean)))


def _sprung(log: Log, rate: float = 8.0, damping: float = 0.05) -> Log:
    """The log of an IMU on a spring: what it measures follows the link as a resonance does."""
    w, dt = 2.0 * np.pi * rate, float(np.median(np.diff(log.imu.t)))
    # Bilinear transform of w² / (s² + 2 d w s + w²), which passes rest unchanged.
    k = 2.0 / dt
    b = np.array([1.0, 2.0, 1.0]) * w**2
    friction = 2 * damping * w * k
    a = np.array([k**2 + friction + w**2, 2 * (w**2 - k**2), k**2 - friction + w**2])
    rest = log.imu.accel[0]
    accel = rest + lfilter(b / a[0], a / a[0], log.imu.accel - rest, axis=0)
    return log.with_imu(log.imu.t, log.imu.gyro, accel)


def window_findings(estimate: Estimate) -> list[str]:
    return [each.code for each in estimate.findings if each.code == "window.dependent"]


@pytest.mark.parametrize("seed", range(3))
def test_the_window_moves_nothing_on_a_sound_log(seed: int) -> None:
    log = make_log(Moves(seed=seed, seconds=40.0)).noisy(seed, INDUSTRIAL)
    assert window_findings(calibrate_matched(log.imu, log.path, MatchedOptions())) == []


@pytest.mark.parametrize(("rate", "told"), [(8.0, False), (4.0, True)])
def test_a_mount_that_rings_is_covered_and_told_where_it_is_slow(rate: float, told: bool) -> None:
    """Delay and curvature of the resonance are those of a filter, which is found and corrected."""
    quick = Moves(
        seed=1, seconds=40.0, move=0.8, pause=0.5, amplitude=(0.25, 0.2, 0.25, 0.45, 0.45, 0.6)
    )
    log = _sprung(make_log(quick), rate).noisy(1, INDUSTRIAL)
    estimate = calibrate_matched(log.imu, log.path, MatchedOptions())
    assert estimate.covariance is not None
    turned = rotation_error(estimate.R_parent_imu, log.mount.R)
    error = np.concatenate([estimate.t_parent_imu - log.mount.t, turned])
    assert error @ np.linalg.solve(estimate.covariance, error) < 22.5  # chi-squared, p = 0.001
    assert any(each.code == "residual.beyond_noise" for each in estimate.findings) == told
