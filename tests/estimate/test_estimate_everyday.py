"""Robots and sensors as they are: driver filters, ramps, give in the mount, everyday errors.

Truth is that of benchmarks/robots.py: analytic motions and pinocchio's accelerations.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.signal import lfilter

import imucalib_cli as ic
from benchmarks import robots
from benchmarks.robots import ANY, ROBOTS, Case, Row, make_case
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import GRAVITY_STD, MatchedOptions, WindowChoice
from tests.estimate.estimate_arm import (
    EXACT,
    GRADES,
    INDUSTRIAL,
    UNLIKELY,
    Log,
    Mount,
    Moves,
    calibrated,
    codes,
    make_log,
    nees,
    parameter,
    pose_error,
    sigma,
)
from tests.estimate.estimate_faults import flawed_log
from tests.slow import slow_after

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate


@cache
def everyday(
    robot: str, row: str, seed: int, *, exact: bool = False
) -> tuple[Estimate, Mount, Case]:
    case = make_case(robot, row, seed)
    estimate = calibrate_matched(case.imu, case.path, EXACT if exact else MatchedOptions())
    return estimate, Mount(R=case.R, t=case.t), case


def worst(estimate: Estimate, mount: Mount) -> float:
    """Error of the worst component in its sigma."""
    return float(np.max(np.abs(pose_error(estimate, mount)) / sigma(estimate)))


@pytest.mark.parametrize("seed", slow_after(1, range(3)))
def test_a_drivers_exponential_average_is_found_and_corrected(seed: int) -> None:
    estimate, mount, _ = everyday("ur10e", "average-0.2", seed)
    assert worst(estimate, mount) < 3.0
    names = {each.values["name"] for each in estimate.findings if each.code == "unknown.found"}
    assert names & {"accel_filter", "gyro_filter"}
    # Of the samples' spacing: an exponential average of alpha has variance (1 - alpha) / alpha²,
    # half of which stands by the second derivative beside the delay, 10 samples² here.
    for name in ("accel_filter", "gyro_filter"):
        assert parameter(estimate, name)[0] == pytest.approx(10.0 / 200.0**2, rel=0.25)


@pytest.mark.parametrize("seed", slow_after(1, range(2)))
def test_a_sound_driver_has_no_filter(seed: int) -> None:
    estimate, *_ = everyday("ur10e", "quiet", seed)
    names = {each.values["name"] for each in estimate.findings if each.code == "unknown.found"}
    assert names.isdisjoint({"accel_filter", "gyro_filter"})


@pytest.mark.parametrize("seed", slow_after(1, range(3)))
def test_biases_that_ramp_are_followed(seed: int) -> None:
    estimate, mount, case = everyday("ur10e", "bias-ramp", seed)
    assert worst(estimate, mount) < 3.0
    assert estimate.trusted
    ramp, std = parameter(estimate, "gyro_bias_ramp")
    assert np.all(np.abs(ramp - case.drawn["gyro_ramp"]) < 4 * std)


@pytest.mark.parametrize(
    ("robot", "seeds"), slow_after(1, [("ur10e", 2), *((robot, 6) for robot in ROBOTS)])
)
def test_an_everyday_robot_is_covered_and_better_than_believed_exact(
    robot: str, seeds: int
) -> None:
    scores, whole, lean = [], [], []
    for seed in range(seeds):
        estimate, mount, _ = everyday(robot, "everyday", seed)
        scores.append(nees(estimate, mount))
        whole.append(float(np.linalg.norm(pose_error(estimate, mount)[:3])))
        believed, *_ = everyday(robot, "everyday", seed, exact=True)
        lean.append(float(np.linalg.norm(pose_error(believed, mount)[:3])))
    assert np.mean(scores) < 12.0
    assert np.sqrt(np.mean(np.square(whole))) < 0.5 * np.sqrt(np.mean(np.square(lean)))


def test_an_error_that_only_one_window_sees_is_told_and_in_sigma() -> None:
    """Play of 0.03 deg steps faster than the model's: in short windows it looks like a spring."""
    case = make_case(ANY, ANY, 233)
    estimate = calibrate_matched(case.imu, case.path, MatchedOptions())
    (told,) = (each for each in estimate.findings if each.code == "unknown.implausible")
    assert told.values["name"] == "mount_give"
    assert told.values["other"] == pytest.approx(0.4)
    assert nees(estimate, Mount(R=case.R, t=case.t)) < UNLIKELY


@pytest.mark.parametrize(
    ("robot", "row", "seed"),
    [
        # A bias that walks by 1e-4 m/s² in that time is loud at the lowest frequencies alone.
        ("ur10e", Row(noise=robots.INDUSTRIAL, walk=(3e-6, 2e-7)), 400),
        # Noise of the tracker is in the columns of lengths.
        ("mobile", "quiet", 403),
    ],
)
def test_half_an_hour_of_noise_changes_no_unit_of_length(
    robot: str, row: str | Row, seed: int
) -> None:
    """Lengths, scales of the accelerometer and gravity grow together: no log tells by how much."""
    case = make_case(robot, row, seed, seconds=1800.0, imu_rate=100.0, joint_rate=100.0)
    estimate = calibrate_matched(case.imu, case.path, MatchedOptions())
    assert estimate.trusted
    assert np.linalg.norm(estimate.t_parent_imu - case.t) < 5e-5
    assert nees(estimate, Mount(R=case.R, t=case.t)) < UNLIKELY
    (norm,), (std,) = parameter(estimate, "gravity_norm")
    assert abs(norm - case.drawn["gravity"]) < 3.0 * std


def test_a_tracker_of_a_real_body_keeps_its_unit_of_length() -> None:
    """By a short window too, in which its noise is large."""
    body = Path(__file__).parents[2] / "sample_data/broad_21_cut.mcap"
    short = MatchedOptions(window=WindowChoice(seconds=0.1))
    found = ic.calibrate(body, parent="sensor_body", estimator=short).result.diagnostics
    norm = next(each.value for each in found.parameters if each.name == "gravity_norm")
    assert norm == pytest.approx(9.80665, abs=2.0 * GRAVITY_STD)


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


@pytest.mark.parametrize("seed", slow_after(1, range(3)))
def test_the_window_moves_nothing_on_a_sound_log(seed: int) -> None:
    log = make_log(Moves(seed=seed, seconds=40.0)).noisy(seed, INDUSTRIAL)
    assert "window.dependent" not in codes(calibrated(log))


@pytest.mark.parametrize(("rate", "told"), slow_after(1, [(4.0, True), (8.0, False)]))
def test_a_mount_that_rings_is_covered_and_told_where_it_is_slow(rate: float, told: bool) -> None:
    """Delay and curvature of the resonance are those of a filter, which is found and corrected."""
    quick = Moves(
        seed=1, seconds=40.0, move=0.8, pause=0.5, amplitude=(0.25, 0.2, 0.25, 0.45, 0.45, 0.6)
    )
    log = _sprung(make_log(quick), rate).noisy(1, INDUSTRIAL)
    estimate = calibrated(log)
    assert nees(estimate, log.mount) < UNLIKELY
    assert ("residual.beyond_noise" in codes(estimate)) == told


@pytest.mark.parametrize("grade", slow_after(1, GRADES))
@pytest.mark.parametrize("size", slow_after(1, [0.02, 0.1]))
def test_a_bias_that_is_there_only_while_the_link_turns_is_covered(size: float, grade: str) -> None:
    log = flawed_log(moves=Moves(seed=3, seconds=48.0)).noisy(2, GRADES[grade])
    turning = np.linalg.norm(log.imu.gyro, axis=1) > 0.1
    assert 0.2 < turning.mean() < 0.9
    offset = size * np.array([0.6, -0.5, 0.62])
    shifted = log.with_imu(log.imu.t, log.imu.gyro, log.imu.accel + turning[:, None] * offset)
    found, clean = calibrated(shifted), calibrated(log)
    assert nees(found, log.mount) < UNLIKELY
    assert clean.findings == ()
    off = [np.linalg.norm(pose_error(each, log.mount)[:3]) for each in (found, clean)]
    assert off[0] > off[1]
