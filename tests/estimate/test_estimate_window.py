"""Which window is used: the user's, or as long as the noise of the joints asks for."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from imucalib_cli.estimate.options import WindowChoice
from imucalib_cli.estimate.window_choice import choose_window
from imucalib_cli.signals.kernels import matched_filter
from imucalib_cli.signals.prepare import clean_imu
from imucalib_cli.signals.trajectory import Trajectory
from tests.estimate.estimate_arm import Log, Moves, arm_path, make_log, solve, solve_well

MOVES = Moves(seconds=20.0)


@cache
def log_of(encoders: float = 0.0) -> Log:
    """A log whose joints have noise, rad."""
    log = make_log(MOVES).noisy(0)
    values = log.path.tracks[0].values
    noise = np.random.default_rng(0).normal(scale=encoders, size=values.shape)
    return log.with_joints(values=values + noise)


def window_of(log: Log, degree: int = 3, **choice: Any) -> tuple[int, float, int]:
    """Samples of the grid, seconds, and samples of the IMU."""
    trajectory = Trajectory.of(log.path)
    grid = clean_imu(log.imu).grid(trajectory.interval, use_ticks=False)
    length, window = choose_window(WindowChoice(**choice), grid, trajectory, degree)
    assert (length - 1) * grid.dt == pytest.approx(window.seconds)
    return length, window.seconds, window.samples


def test_noisier_encoders_get_longer_windows() -> None:
    seconds = [window_of(log_of(std))[1] for std in (1e-5, 1e-4, 1e-3)]
    assert seconds[0] < seconds[1] < seconds[2] <= 1.0
    window = solve(log_of(1e-4)).window
    assert window.seconds > 0.2
    assert "kinematics" in window.reason


def test_gyroscope_shows_noise_that_interpolation_hides() -> None:
    """Joints at 12.5 Hz, stamped on receipt, were interpolated to the rate of the log."""
    log, rng = log_of(), np.random.default_rng(1)
    t = np.arange(0.0, MOVES.seconds, 0.08)
    received, read = t + rng.uniform(0.0, 0.04, len(t)), MOVES.joints(t)[0]
    stamps = log.path.tracks[0].t
    values = np.stack([np.interp(stamps, received, joint) for joint in read.T], axis=1)
    interpolated = log.with_joints(values=values)
    assert window_of(interpolated)[1] == pytest.approx(0.2)
    found = solve(interpolated)
    assert found.window.seconds > 0.5
    assert found.covered


def test_vibration_does_not_shorten_windows() -> None:
    """A loud accelerometer does not drown noise of the joints: it is loud at other frequencies."""
    log = log_of(1e-4)
    rng, t = np.random.default_rng(2), log.imu.t
    turns = 85.0 * t + np.cumsum(rng.normal(size=len(t))) * 1e-3
    shakes = 5.0 * np.sin(2 * np.pi * (turns[:, None] + rng.uniform(size=3)))
    found = solve_well(log.with_imu(t, log.imu.gyro, log.imu.accel + shakes))
    assert found.window.seconds >= solve(log).window.seconds
    assert found.distance < 1e-3


@pytest.mark.slow
def test_longer_window_keeps_lever_arm_accurate() -> None:
    chosen, short = (
        solve(log_of(3e-4), window=choice)
        for choice in (WindowChoice(), WindowChoice(seconds=0.05))
    )
    assert chosen.distance < 2e-3
    assert short.distance > 5 * chosen.distance


def test_samples_count_imu_samples_on_a_finer_grid() -> None:
    slow = make_log(MOVES, imu_rate=100.0, robot_rate=500.0)
    assert window_of(slow, samples=21) == pytest.approx((101, 0.2, 21))


@pytest.mark.parametrize(("degree", "shortest"), [(2, 5), (3, 5), (4, 7), (5, 7)])
def test_window_is_long_enough_for_its_degree(degree: int, shortest: int) -> None:
    assert window_of(log_of(), degree, samples=3)[0] == shortest
    matched_filter(shortest, degree, 2, 0.005)


def test_short_bursts_of_joints_do_not_break_window_choice() -> None:
    """No stretch of joint states is as long as a window: nothing to divide by."""
    t = np.arange(0, 30, 0.005)
    burst = t[(t % 0.5) < 0.18]
    log = replace(log_of(), path=arm_path(burst, MOVES.joints(burst)[0]))
    assert window_of(log)[1] >= 0.2
