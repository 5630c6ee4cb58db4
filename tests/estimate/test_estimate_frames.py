"""Metamorphic: turn the world, the parent frame or the IMU, and the answer turns with it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from imucalib_cli.robot.path import FixedStep
from tests.estimate.estimate_arm import (
    GRAVITY,
    MEMS,
    Log,
    calibrated,
    covariance,
    make_log,
    rotation_error,
    sigma,
    taken_as_exact,
)

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate

Floats = NDArray[np.float64]

TURN = Rotation.from_rotvec([0.7, -1.1, 0.4]).as_matrix()
SHIFT = np.array([0.3, -0.2, 0.5])


@pytest.fixture(scope="module")
def log() -> Log:
    return make_log().noisy(3)


def in_world(log: Log) -> Log:
    steps = (FixedStep(R=TURN, p=SHIFT), *log.path.steps)
    return replace(log, path=replace(log.path, steps=steps))


def at_parent(log: Log) -> Log:
    steps = (*log.path.steps, FixedStep(R=TURN, p=SHIFT))
    return replace(log, path=replace(log.path, steps=steps))


def at_imu(log: Log) -> Log:
    return log.with_imu(log.imu.t, log.imu.gyro @ TURN, log.imu.accel @ TURN)


@pytest.fixture(scope="module")
def plain(log: Log) -> Estimate:
    return taken_as_exact(log)


def test_where_the_world_frame_is_does_not_matter(log: Log, plain: Estimate) -> None:
    turned = taken_as_exact(in_world(log))
    shift = turned.t_parent_imu - plain.t_parent_imu
    assert np.all(np.abs(shift) < 1e-4 * sigma(plain)[:3])
    turn = rotation_error(turned.R_parent_imu, plain.R_parent_imu)
    assert np.all(np.abs(turn) < 1e-4 * sigma(plain)[3:])
    np.testing.assert_allclose(covariance(turned), covariance(plain), rtol=1e-3, atol=1e-15)
    np.testing.assert_allclose(turned.gravity_world, TURN @ plain.gravity_world, atol=1e-6)


def test_another_parent_frame_re_expresses_pose_and_covariance(log: Log, plain: Estimate) -> None:
    """The tangent is the parent frame's: both blocks turn with it, and nothing mixes."""
    moved = taken_as_exact(at_parent(log))
    t = TURN @ moved.t_parent_imu + SHIFT
    # Scales are medians over axes, so the weights differ a little: far less than sigma.
    assert np.all(np.abs(t - plain.t_parent_imu) < 0.1 * sigma(plain)[:3])
    turn = rotation_error(TURN @ moved.R_parent_imu, plain.R_parent_imu)
    assert np.all(np.abs(turn) < 0.1 * sigma(plain)[3:])
    both = np.kron(np.eye(2), TURN)
    expected = both.T @ covariance(plain) @ both
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(covariance(moved) / scale, expected / scale, atol=0.06)


def test_another_imu_frame_turns_the_rotation_and_the_biases(log: Log, plain: Estimate) -> None:
    turned = taken_as_exact(at_imu(log))
    np.testing.assert_allclose(turned.R_parent_imu, plain.R_parent_imu @ TURN, atol=1e-8)
    np.testing.assert_allclose(turned.t_parent_imu, plain.t_parent_imu, atol=1e-8)
    np.testing.assert_allclose(turned.accel_bias, TURN.T @ plain.accel_bias, atol=1e-7)
    np.testing.assert_allclose(turned.gyro_bias, TURN.T @ plain.gyro_bias, atol=1e-9)
    np.testing.assert_allclose(covariance(turned), covariance(plain), rtol=1e-5, atol=1e-15)
    assert turned.accel_bias_std is not None
    assert np.all(turned.accel_bias_std > 0)


@pytest.mark.slow
def test_with_all_of_the_table_free_frames_hardly_matter(log: Log) -> None:
    """Errors along axes have priors, so other axes are other priors: less than half a sigma."""
    plain = calibrated(log)
    for other, R_new_old, R_imu, p in (
        (at_imu, np.eye(3), TURN, np.zeros(3)),
        (at_parent, TURN, np.eye(3), SHIFT),
        (in_world, np.eye(3), np.eye(3), np.zeros(3)),
    ):
        found = calibrated(other(log))
        t, R = R_new_old @ found.t_parent_imu + p, R_new_old @ found.R_parent_imu @ R_imu.T
        assert np.all(np.abs(t - plain.t_parent_imu) < 0.5 * sigma(plain)[:3])
        assert np.all(np.abs(rotation_error(R, plain.R_parent_imu)) < 0.5 * sigma(plain)[3:])


def test_sigma_scales_with_the_noise() -> None:
    quiet, loud = make_log().noisy(4), make_log().noisy(4, (4 * MEMS[0], 4 * MEMS[1]))
    one, other = taken_as_exact(quiet), taken_as_exact(loud)
    np.testing.assert_allclose(sigma(other) / sigma(one), 4.0, rtol=0.05)


def test_when_the_log_began_does_not_matter(log: Log, plain: Estimate) -> None:
    late = log.with_imu(log.imu.t + 4096.0, log.imu.gyro, log.imu.accel)
    later = taken_as_exact(late.with_joints(t=log.path.tracks[0].t + 4096.0))
    np.testing.assert_allclose(later.t_parent_imu, plain.t_parent_imu, atol=1e-7)
    assert later.time_offset == pytest.approx(plain.time_offset, abs=1e-8)


def test_units_of_gravity_follow_the_norm_told() -> None:
    """Everything measured in other units of length is the same answer in those units."""
    log = make_log().noisy(5)
    one = taken_as_exact(log)
    steps = tuple(
        replace(step, p=3.0 * step.p) if isinstance(step, FixedStep) else step
        for step in log.path.steps
    )
    longer = replace(
        log.with_imu(log.imu.t, log.imu.gyro, 3.0 * log.imu.accel),
        path=replace(log.path, steps=steps),
    )
    other = taken_as_exact(longer, gravity_norm=3.0 * GRAVITY)
    assert np.all(np.abs(other.t_parent_imu / 3.0 - one.t_parent_imu) < 0.1 * sigma(one)[:3])
    np.testing.assert_allclose(sigma(other)[:3] / 3.0, sigma(one)[:3], rtol=0.05)
    np.testing.assert_allclose(sigma(other)[3:], sigma(one)[3:], rtol=0.05)
