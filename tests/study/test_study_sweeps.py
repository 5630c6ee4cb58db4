"""The imperfect robots of benchmarks/sweeps.py: without errors the truth must come back."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.robots import MEMS, ROBOTS, ROWS, Row, make_case
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from tests.slow import slow_after


@pytest.mark.parametrize("robot", slow_after(1, ROBOTS))
def test_no_errors_give_the_true_pose(robot: str) -> None:
    case = make_case(robot, Row(), seed=1)
    estimate = calibrate_matched(case.imu, case.path, MatchedOptions())
    turned = Rotation.from_matrix(estimate.R_parent_imu @ case.R.T).magnitude()
    assert estimate.trusted
    assert np.linalg.norm(estimate.t_parent_imu - case.t) < 2e-6
    assert turned < 1e-6
    assert estimate.time_offset == pytest.approx(case.time_offset, abs=1e-7)


def test_seed_gives_the_same_draws_in_every_row() -> None:
    small, large = (
        make_case("mobile", Row(noise=MEMS, scale=size, zero=size), 4, seconds=10.0)
        for size in (1e-3, 2e-3)
    )
    assert np.array_equal(small.R, large.R)
    assert small.time_offset == large.time_offset
    assert np.array(large.drawn["zero"]) == pytest.approx(2 * np.array(small.drawn["zero"]))
    scales = [np.array(case.drawn["accel_scale"]) - 1.0 for case in (small, large)]
    assert scales[1] == pytest.approx(2 * scales[0])


@pytest.mark.parametrize("name", [name for name, row in ROWS.items() if row.driver is not None])
def test_driver_filter_keeps_values_at_rest(name: str) -> None:
    driver = ROWS[name].driver
    assert driver is not None
    b, a = driver(200.0)
    assert np.sum(b) / np.sum(a) == pytest.approx(1.0)
