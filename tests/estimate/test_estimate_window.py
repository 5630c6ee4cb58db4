"""Which window is used: the user's, or as long as the noise of the joints asks for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib_cli.estimate.options import MatchedOptions, WindowChoice
from imucalib_cli.estimate.window_choice import choose_window
from imucalib_cli.signals.kernels import matched_filter
from imucalib_cli.signals.prepare import clean_imu
from imucalib_cli.signals.trajectory import Trajectory
from tests.estimate.estimate_arm import Log, Moves, arm_path, calibrated, make_log

MOVES = Moves(seconds=30.0)


def with_encoders(log: Log, std: float, seed: int = 0) -> Log:
    values = log.path.tracks[0].values
    noise = np.random.default_rng(seed).normal(scale=std, size=values.shape)
    return log.with_joints(values=values + noise)


def window_of(log: Log, choice: WindowChoice, degree: int = 3) -> tuple[int, float, int]:
    trajectory = Trajectory.of(log.path)
    grid = clean_imu(log.imu).grid(trajectory.interval, use_ticks=False)
    length, window = choose_window(choice, grid, trajectory, degree)
    assert (length - 1) * grid.dt == pytest.approx(window.seconds)
    return length, window.seconds, window.samples


@pytest.fixture(scope="module")
def log() -> Log:
    return make_log(MOVES).noisy(0)


def test_quiet_joints_take_the_shortest(log: Log) -> None:
    assert window_of(log, WindowChoice())[1] == pytest.approx(0.2)


def test_noisy_encoders_take_longer_windows_and_ever_longer(log: Log) -> None:
    seconds = [window_of(with_encoders(log, std), WindowChoice())[1] for std in (1e-5, 1e-4, 1e-3)]
    assert seconds[0] < seconds[1] < seconds[2] <= 1.0
    estimate = calibrated(with_encoders(log, 1e-4))
    assert estimate.window.seconds > 0.2
    assert "kinematics" in estimate.window.reason


@pytest.mark.slow
def test_the_longer_window_is_what_saves_the_lever_arm(log: Log) -> None:
    noisy = with_encoders(log, 3e-4)
    errors = []
    for choice in (WindowChoice(), WindowChoice(seconds=0.05)):
        estimate = calibrated(noisy, MatchedOptions(window=choice))
        errors.append(float(np.linalg.norm(estimate.t_parent_imu - log.mount.t)))
    assert errors[0] < 2e-3
    assert errors[1] > 5 * errors[0]


@pytest.mark.parametrize("samples", [7, 101])
def test_samples_asked_for_are_samples_used(log: Log, samples: int) -> None:
    length, seconds, used = window_of(log, WindowChoice(samples=samples))
    assert (length, used) == (samples, samples)
    assert seconds == pytest.approx((samples - 1) / 200)


def test_samples_are_the_imus_even_on_a_finer_grid() -> None:
    slow = make_log(MOVES, imu_rate=100.0, robot_rate=500.0)
    length, seconds, used = window_of(slow, WindowChoice(samples=21))
    assert (length, used) == (101, 21)
    assert seconds == pytest.approx(0.2)


@pytest.mark.parametrize("seconds", [0.05, 0.333])
def test_seconds_asked_for_are_met_to_a_sample(log: Log, seconds: float) -> None:
    length, used, _ = window_of(with_encoders(log, 1e-3), WindowChoice(seconds=seconds))
    assert length % 2 == 1
    assert abs(used - seconds) <= 1.001 / 200


@pytest.mark.parametrize(("degree", "shortest"), [(2, 5), (3, 5), (4, 7), (5, 7)])
def test_a_window_is_never_too_short_for_its_degree(log: Log, degree: int, shortest: int) -> None:
    assert window_of(log, WindowChoice(samples=3), degree)[0] == shortest
    matched_filter(shortest, degree, 2, 0.005)


def test_joints_in_short_bursts_do_not_break_the_choice(log: Log) -> None:
    """No stretch of joint states is as long as a window: nothing to divide by."""
    t = np.arange(0, 30, 0.005)
    burst = t[(t % 0.5) < 0.18]
    path = arm_path(burst, MOVES.joints(burst)[0])
    assert window_of(replace(log, path=path), WindowChoice())[1] >= 0.2
