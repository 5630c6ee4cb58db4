"""Errors of robot, sensor and user that are the same all along a log are named."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from tests.estimate.estimate_arm import INDUSTRIAL, Log, Moves, make_log, rotation_error

if TYPE_CHECKING:
    from imucalib_cli.robot.path import Track


def score(log: Log, options: MatchedOptions | None = None) -> tuple[float, tuple[str, ...], bool]:
    """Squared error in units of the stated covariance, warnings, trust."""
    estimate = calibrate_matched(log.imu, log.path, options or MatchedOptions())
    assert estimate.covariance is not None
    error = np.concatenate(
        [
            estimate.t_parent_imu - log.mount.t,
            rotation_error(estimate.R_parent_imu, log.mount.R),
        ]
    )
    nees = float(error @ np.linalg.solve(estimate.covariance, error))
    return nees, estimate.warnings + estimate.distrust, estimate.trusted


def with_joints(log: Log, track: Track) -> Log:
    return replace(log, path=replace(log.path, tracks=(track,)))


@pytest.fixture(scope="module")
def noisy() -> Log:
    return make_log(Moves(seconds=40.0)).noisy(3, INDUSTRIAL)


def test_the_right_model_is_left_alone(noisy: Log) -> None:
    nees, words, trusted = score(noisy)
    assert trusted
    assert nees < 22.5  # chi-squared, 6 degrees of freedom, p = 0.001
    assert not words


def test_a_joint_zero_off_is_found_and_covered(noisy: Log) -> None:
    track = noisy.path.tracks[0]
    shifted = track.values.copy()
    shifted[:, 3] += 0.01
    log = with_joints(noisy, replace(track, values=shifted))
    nees, _, trusted = score(log)
    assert trusted
    assert nees < 22.5
    (found,) = calibrate_matched(log.imu, log.path, MatchedOptions()).findings
    assert (found.code, found.values["name"]) == ("unknown.found", "joint_zero")
    assert found.values["labels"] == ("j3",)
    # True less reported.
    assert found.values["values"] == pytest.approx((-0.01,), rel=0.02)


def test_a_gyroscope_scale_error_is_not_trusted(noisy: Log) -> None:
    wrong = noisy.with_imu(noisy.imu.t, noisy.imu.gyro * 1.1, noisy.imu.accel)
    _, words, trusted = score(wrong)
    assert not trusted
    assert any("more than any sound robot or sensor has" in each for each in words)


def test_held_joints_are_used_where_they_change(noisy: Log) -> None:
    track = noisy.path.tracks[0]
    held = track.values[(np.arange(len(track.t)) // 10) * 10]
    log = with_joints(noisy, replace(track, values=held))
    estimate = calibrate_matched(log.imu, log.path, MatchedOptions())
    assert any("held" in each for each in estimate.warnings)
    assert np.linalg.norm(estimate.t_parent_imu - log.mount.t) < 5e-4


def test_a_prior_that_the_data_contradict_is_named(noisy: Log) -> None:
    biased = noisy.with_imu(
        noisy.imu.t, noisy.imu.gyro, noisy.imu.accel + np.array([0.3, 0.0, 0.0])
    )
    _, words, trusted = score(biased, MatchedOptions(accel_bias_std=0.01))
    assert not trusted
    assert any("contradict --accel-bias" in each for each in words)


def test_gravity_that_points_aside_is_told(noisy: Log) -> None:
    # The accelerometer's other convention: the base seems to hang from the ceiling.
    turned = noisy.with_imu(noisy.imu.t, noisy.imu.gyro, -noisy.imu.accel)
    _, words, trusted = score(turned)
    assert not trusted or any("the accelerometer points down at rest" in each for each in words)


def test_one_stamp_of_zero_costs_one_sample(noisy: Log) -> None:
    t = noisy.imu.t + 1.7e9
    t[1000] = 0.0
    tracks = tuple(replace(track, t=track.t + 1.7e9) for track in noisy.path.tracks)
    log = replace(
        noisy.with_imu(t, noisy.imu.gyro, noisy.imu.accel), path=replace(noisy.path, tracks=tracks)
    )
    nees, words, trusted = score(log)
    assert trusted
    assert nees < 22.5
    assert any("1 with stamps far from the log" in each for each in words)
