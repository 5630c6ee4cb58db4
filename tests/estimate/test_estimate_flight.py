"""Bodies whose pose a tracker measures: noise that neighbouring samples do not show."""

import pytest

from imucalib_cli.estimate.options import WindowChoice
from tests.estimate.estimate_arm import solve, solve_well
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
    found = solve_well(Flight(seed=seed, smooth=0.03).log())
    assert found.window.seconds > 0.4
    assert found.distance < 6e-4


@pytest.mark.slow
@SEEDS
def test_sigma_is_honest_in_windows_that_are_too_short(seed: int) -> None:
    """There noise fills the column of the tracker's filter."""
    found = solve(Flight(seed=seed, vibration=1.0).log(), window=WindowChoice(seconds=0.4))
    assert (abs(found.error) < 5.0 * found.sigma).all()


def test_short_windows_stay_where_poses_are_exact() -> None:
    found = solve_well(Flight(by_hand=True, place_noise=0.0, turn_noise=0.0).log())
    assert found.window.seconds == pytest.approx(0.2, abs=0.06)
