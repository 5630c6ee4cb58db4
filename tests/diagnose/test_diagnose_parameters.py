"""Joint zeros and lengths: found to their size, and silent where nothing can be known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest

from imucalib_cli.diagnose.bench import Bench, make_bench
from imucalib_cli.diagnose.parameters import (
    Explanation,
    Parameter,
    explain_by_parameters,
    with_parameters,
)
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import NoiseOptions, PhysicsOptions
from imucalib_cli.simulate.physics import record
from imucalib_cli.study.trial import streams_of

if TYPE_CHECKING:
    from imucalib_cli.robot.path import KinematicPath


def zero(joint: str) -> Parameter:
    return Parameter(kind="zero", joint=joint)


def length(joint: str) -> Parameter:
    return Parameter(kind="length", joint=joint)


@cache
def bench() -> tuple[Bench, KinematicPath]:
    physics = PhysicsOptions(duration=40.0, imu_rate=125, robot_rate=125)
    noise = NoiseOptions(accel_noise=1.7e-4, gyro_noise=3.5e-5)
    imu, path = streams_of(corrupt(record(load_system("rihibot"), physics), noise, seed=1))
    made = make_bench(imu, MatchedOptions(), seconds=0.2, imu_ticks=False, robot_ticks=False)
    return made, path


def explanation(told: dict[Parameter, float]) -> Explanation | None:
    made, path = bench()
    trial = made.trial(with_parameters(path, told))
    assert trial is not None
    return explain_by_parameters(made, trial)


@pytest.mark.parametrize(
    ("told", "within"),
    [
        ({zero("elbow_joint"): 0.010, zero("wrist_1_joint"): -0.008}, 1.5e-4),
        ({zero("shoulder_lift_joint"): 0.010, zero("wrist_2_joint"): -0.008}, 1.5e-4),
        ({zero("wrist_2_joint"): np.radians(20.0)}, 1.5e-4),
        ({length("elbow_joint"): 0.006127}, 1e-4),
        ({length("wrist_1_joint"): -0.004}, 1e-4),
    ],
    ids=["parallel zeros", "crossed zeros", "large zero", "longer", "shorter"],
)
def test_constants_of_the_chain_are_found_to_their_size(
    told: dict[Parameter, float], within: float
) -> None:
    found = explanation(told)
    assert found is not None
    assert found.rivals == ()
    assert set(found.values) == set(told)
    for parameter, value in told.items():
        assert found.values[parameter] == pytest.approx(-value, abs=within)


@pytest.mark.parametrize(
    "parameter",
    [
        zero("shoulder_pan_joint"),  # turns the world
        zero("wrist_3_joint"),  # turns the mount
        length("shoulder_lift_joint"),  # has no length
        length("wrist_3_joint"),  # slides along the last axis
    ],
)
def test_what_the_pose_absorbs_is_not_named(parameter: Parameter) -> None:
    made, path = bench()
    right, wrong = made.trial(path), made.trial(with_parameters(path, {parameter: 0.05}))
    assert right is not None
    assert wrong is not None
    assert wrong.score == pytest.approx(right.score, abs=0.02)
    assert explain_by_parameters(made, wrong) is None


def test_a_scale_error_of_the_sensor_is_no_fault_of_the_chain() -> None:
    made, path = bench()
    loud = replace(made, grid=replace(made.grid, gyro=1.03 * made.grid.gyro))
    trial = loud.trial(path)
    assert trial is not None
    assert trial.shares[1] > 0.02
    assert explain_by_parameters(loud, trial) is None
