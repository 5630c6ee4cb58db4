"""Metamorphic: turn the world, the parent frame or the IMU, and the answer turns with it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib_cli.robot.path import FixedStep
from tests.estimate.estimate_arm import (
    GRAVITY,
    MEMS,
    Log,
    Solved,
    make_log,
    rotation_error,
    solve,
    solve_exact,
)

TURN = Rotation.from_rotvec([0.7, -1.1, 0.4]).as_matrix()
SHIFT = np.array([0.3, -0.2, 0.5])
STEP = FixedStep(R=TURN, p=SHIFT)


@cache
def log() -> Log:
    return make_log().noisy(3)


def in_world() -> Log:
    return replace(log(), path=replace(log().path, steps=(STEP, *log().path.steps)))


def at_parent() -> Log:
    return replace(log(), path=replace(log().path, steps=(*log().path.steps, STEP)))


def at_imu() -> Log:
    return log().with_imu(gyro=log().imu.gyro @ TURN, accel=log().imu.accel @ TURN)


def assert_close(t: np.ndarray, R: np.ndarray, plain: Solved, sigmas: float) -> None:
    """A pose is another estimate's, within so many of its sigmas."""
    error = np.concatenate([t - plain.t_parent_imu, rotation_error(R, plain.R_parent_imu)])
    assert np.all(np.abs(error) < sigmas * plain.sigma)


def test_where_the_world_frame_is_does_not_matter() -> None:
    plain, turned = solve_exact(log()), solve_exact(in_world())
    assert_close(turned.t_parent_imu, turned.R_parent_imu, plain, 1e-4)
    np.testing.assert_allclose(turned.P, plain.P, rtol=1e-3, atol=1e-15)
    np.testing.assert_allclose(turned.gravity_world, TURN @ plain.gravity_world, atol=1e-6)


def test_another_parent_frame_re_expresses_pose_and_covariance() -> None:
    """The tangent is the parent frame's: both blocks turn with it, and nothing mixes."""
    plain, moved = solve_exact(log()), solve_exact(at_parent())
    # Scales are medians over axes, so the weights differ a little: far less than sigma.
    assert_close(TURN @ moved.t_parent_imu + SHIFT, TURN @ moved.R_parent_imu, plain, 0.1)
    both = np.kron(np.eye(2), TURN)
    expected = both.T @ plain.P @ both
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(moved.P / scale, expected / scale, atol=0.06)


def test_another_imu_frame_turns_the_rotation_and_the_biases() -> None:
    plain, turned = solve_exact(log()), solve_exact(at_imu())
    np.testing.assert_allclose(turned.R_parent_imu, plain.R_parent_imu @ TURN, atol=1e-8)
    np.testing.assert_allclose(turned.t_parent_imu, plain.t_parent_imu, atol=1e-8)
    np.testing.assert_allclose(turned.accel_bias, TURN.T @ plain.accel_bias, atol=1e-7)
    np.testing.assert_allclose(turned.gyro_bias, TURN.T @ plain.gyro_bias, atol=1e-9)
    np.testing.assert_allclose(turned.P, plain.P, rtol=1e-5, atol=1e-15)
    assert turned.accel_bias_std is not None
    assert np.all(turned.accel_bias_std > 0)


@pytest.mark.slow
def test_with_all_of_the_table_free_frames_hardly_matter() -> None:
    """Errors along axes have priors, so other axes are other priors: less than half a sigma."""
    plain, imu, parent, world = map(solve, (log(), at_imu(), at_parent(), in_world()))
    assert_close(imu.t_parent_imu, imu.R_parent_imu @ TURN.T, plain, 0.5)
    assert_close(TURN @ parent.t_parent_imu + SHIFT, TURN @ parent.R_parent_imu, plain, 0.5)
    assert_close(world.t_parent_imu, world.R_parent_imu, plain, 0.5)


def test_sigma_scales_with_the_noise() -> None:
    quiet, loud = make_log().noisy(4), make_log().noisy(4, (4 * MEMS[0], 4 * MEMS[1]))
    np.testing.assert_allclose(solve_exact(loud).sigma / solve_exact(quiet).sigma, 4.0, rtol=0.05)


def test_when_the_log_began_does_not_matter() -> None:
    late = log().with_imu(log().imu.t + 4096.0)
    later = solve_exact(late.with_joints(t=log().path.tracks[0].t + 4096.0))
    plain = solve_exact(log())
    np.testing.assert_allclose(later.t_parent_imu, plain.t_parent_imu, atol=1e-7)
    assert later.time_offset == pytest.approx(plain.time_offset, abs=1e-8)


def test_the_unit_of_length_follows_the_stated_gravity() -> None:
    """Everything measured in other units of length is the same answer in those units."""
    one_log = make_log().noisy(5)
    steps = tuple(
        replace(step, p=3.0 * step.p) if isinstance(step, FixedStep) else step
        for step in one_log.path.steps
    )
    longer = one_log.with_imu(accel=3.0 * one_log.imu.accel)
    longer = replace(longer, path=replace(longer.path, steps=steps))
    one, other = solve_exact(one_log), solve_exact(longer, gravity_norm=3.0 * GRAVITY)
    off = other.t_parent_imu / 3.0 - one.t_parent_imu
    assert np.all(np.abs(off) < 0.1 * one.sigma[:3])
    np.testing.assert_allclose(other.sigma / np.repeat([3.0, 1.0], 3), one.sigma, rtol=0.05)
