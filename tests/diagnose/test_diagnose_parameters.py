"""Joint zeros and lengths: found to their size, and silent where nothing can be known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib_cli.diagnose.bench import Bench, make_bench
from imucalib_cli.diagnose.parameters import (
    Explanation,
    Parameter,
    explain_by_parameters,
    with_parameters,
)
from imucalib_cli.estimate.estimate import Correction
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.signals.samples import ImuSamples
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


def test_what_the_fit_corrected_is_not_asked_about_again() -> None:
    """Scales, misalignment and delay of a sensor are taken off before the robot is doubted."""
    made, path = bench()
    t, gyro, accel = made.grid.t, made.grid.gyro, made.grid.accel
    turn = np.array([0.01, -0.02, 0.015])
    late = np.stack([np.interp(t - 0.002, t, axis) for axis in gyro.T], axis=1)
    spoiled = ImuSamples(
        t=t,
        gyro=late @ Rotation.from_rotvec(turn).as_matrix() * 1.03,
        accel=accel * np.array([1.01, 1.0, 0.99]),
    )
    std = np.full(3, 1e-4)
    corrections = (
        Correction(name="gyro_delay", value=np.array([0.002]), std=std[:1]),
        Correction(name="gyro_misalignment", value=turn, std=std),
        Correction(name="gyro_scale", value=np.full(3, 1.03), std=std),
        Correction(name="accel_scale", value=np.array([1.01, 1.0, 0.99]), std=std),
    )
    shares = []
    for known in ((), corrections):
        again = make_bench(
            spoiled,
            MatchedOptions(),
            seconds=0.2,
            imu_ticks=False,
            robot_ticks=False,
            corrections=known,
        )
        trial = again.trial(path)
        assert trial is not None
        shares.append(trial.shares)
    assert shares[0][0] > 0.05
    assert shares[0][1] > 0.02
    assert shares[1][0] < 0.02
    assert shares[1][1] < 0.003
