"""Gross faults of an arm whose joints bend: the bending does not hide them."""

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from benchmarks.robots import Case, make_case
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.robot.path import KinematicPath
from tools.errors import nees, pose_error
from tools.faults import EstimatorInputs


@cache
def bending(seed: int) -> Case:
    return make_case("ur10e", "elastic", seed, seconds=30.0)


def exchanged(path: KinematicPath, a: int, b: int) -> KinematicPath:
    """The same path with the positions of two joints exchanged."""
    (track,) = path.tracks
    values = track.values.copy()
    values[:, [a, b]] = values[:, [b, a]]
    return replace(path, tracks=(replace(track, values=values),))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [20, 23, 24])
def test_exchanged_joints_with_parallel_axes_are_named(seed: int) -> None:
    """The gyroscope sees their sum, so that the accelerometer alone contradicts."""
    case = bending(seed)
    inputs = EstimatorInputs(imu=case.imu, path=exchanged(case.path, 1, 2))
    estimate = inputs.judged(MatchedOptions()).explained
    assert not estimate.trusted
    assert estimate.findings[0].code == "cause.order"
    assert estimate.findings[0].values["names"] in {("j1", "j2"), ("j2", "j1")}


@pytest.mark.slow
@pytest.mark.parametrize("turned", ["accel", "gyro"])
@pytest.mark.parametrize("seed", [20, 23])
def test_wrong_axes_of_one_sensor_are_named(turned: str, seed: int) -> None:
    case = bending(seed)
    wrong = {turned: getattr(case.imu, turned) * [-1.0, 1.0, 1.0]}
    inputs = EstimatorInputs(imu=replace(case.imu, **wrong), path=case.path)
    estimate = inputs.judged(MatchedOptions()).explained
    assert not estimate.trusted
    assert estimate.findings[0].code == "cause.axes"


@pytest.mark.slow
@pytest.mark.parametrize("seed", [20, 21, 22, 23])
def test_bending_alone_is_no_gross_fault(seed: int) -> None:
    case = bending(seed)
    estimate = EstimatorInputs(imu=case.imu, path=case.path).judged(MatchedOptions()).explained
    assert estimate.trusted
    assert estimate.covariance is not None
    assert nees(pose_error(estimate, case.R, case.t), np.asarray(estimate.covariance)) < 30.0
