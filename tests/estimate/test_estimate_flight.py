"""Bodies whose pose a tracker measures: noise that neighbouring samples do not show."""

from dataclasses import replace

import pytest

from tests.estimate.estimate_arm import solve_well
from tests.estimate.estimate_flight import Flight
from tests.slow import slow_after

SEEDS = pytest.mark.parametrize("seed", slow_after(1, [0, 1, 2, 3]))


@SEEDS
def test_rotors_do_not_hide_noise_of_the_tracker(seed: int) -> None:
    """The place of an IMU that is loud at 85 Hz is as accurate as that of a quiet one."""
    found = solve_well(Flight(seed=seed, vibration=1.0).log())
    assert found.distance < 5e-4
    assert found.sigma[2] < 3e-4


@SEEDS
def test_windows_are_long_enough_for_a_tracker_that_smooths(seed: int) -> None:
    found = solve_well(Flight(seed=seed, smooth=0.03, vibration=1.0).log())
    assert found.window.seconds > 0.4
    assert found.distance < 6e-4


@SEEDS
def test_noise_is_no_prediction_of_the_tracker(seed: int) -> None:
    """It fills the column of the filter, and is in the unit of length too: 15 mm, 8 sigma."""
    poor = Flight(track_rate=30.0, place_noise=3e-3, turn_noise=3e-3, vibration=1.0)
    solve_well(replace(poor, seed=16 + seed).log())


def test_short_windows_stay_where_poses_are_exact() -> None:
    found = solve_well(Flight(by_hand=True, place_noise=0.0, turn_noise=0.0).log())
    assert found.window.seconds == pytest.approx(0.2, abs=0.06)
