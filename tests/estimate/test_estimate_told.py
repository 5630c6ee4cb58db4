"""What the user states exactly is believed where it is true, and contradicted where it is not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions, PosePrior
from imucalib_cli.robot.path import JointStep, KinematicPath
from imucalib_cli.signals.samples import ImuSamples
from tests.estimate.estimate_arm import (
    GRAVITY,
    INDUSTRIAL,
    MOUNT,
    UNLIKELY,
    Moves,
    calibrated,
    make_log,
    nees,
    pose_error,
)
from tests.slow import slow_after

MOVES = Moves(seed=4, seconds=24.0)
BIASED: dict[str, Any] = {"accel_bias_std": 0.0}
WRONG: dict[str, tuple[dict[str, Any], str, float]] = {
    "gravity": ({"gravity_norm": 9.7, "gravity_std": 0.0}, "--gravity", GRAVITY - 9.7),
    "offset": ({"time_offset": 0.012}, "--time-offset", -0.012),
    "bias": (BIASED, "--accel-bias", 0.1),
    "bias within": ({"accel_bias_std": 3e-3}, "--accel-bias", 0.1),
}


@pytest.mark.parametrize("what", slow_after(2, WRONG))
def test_a_wrong_value_is_contradicted_with_its_size_and_nothing_else_is_blamed(what: str) -> None:
    stated, option, step = WRONG[what]
    log = make_log(MOVES).noisy(1, INDUSTRIAL)
    estimate = calibrated(log, MatchedOptions(**stated))
    assert not estimate.trusted
    (found,) = (each for each in estimate.findings if each.code == "prior.contradicted")
    assert found.values["option"] == option
    assert float(str(found.values["step"])) == pytest.approx(
        step, abs=4.0 * float(str(found.values["std"]))
    )
    codes = {each.code for each in estimate.findings}
    assert not codes & {"unknown.found", "unknown.implausible"}


def test_a_base_that_is_not_as_level_as_stated_is_told() -> None:
    gravity = Rotation.from_rotvec([0.03, 0.0, 0.0]).apply([0.0, 0.0, -GRAVITY])
    log = make_log(MOVES, gravity_world=gravity).noisy(1, INDUSTRIAL)
    estimate = calibrated(log, MatchedOptions(tilt_std=1e-3))
    (found,) = (each for each in estimate.findings if each.code == "prior.contradicted")
    assert found.values["option"] == "--tilt-std"
    assert abs(float(str(found.values["step"]))) == pytest.approx(0.03, abs=1e-4)
    level = calibrated(log, MatchedOptions(tilt_std=0.03))
    assert level.trusted


@pytest.mark.parametrize("seed", slow_after(1, range(3)))
def test_true_values_are_believed(seed: int) -> None:
    log = make_log(MOVES).noisy(seed, INDUSTRIAL)
    options = MatchedOptions(gravity="fixed", gravity_std=0.0, time_offset=0.0)
    estimate = calibrated(log, options)
    assert estimate.trusted
    assert nees(estimate, MOUNT) < UNLIKELY


def with_zeros(path: KinematicPath, zeros: dict[int, float]) -> KinematicPath:
    """The same path, constants added to the positions of some joints."""
    steps = tuple(
        replace(step, offset=step.offset + zeros.get(step.column, 0.0))
        if isinstance(step, JointStep)
        else step
        for step in path.steps
    )
    return replace(path, steps=steps)


@pytest.mark.parametrize("seed", slow_after(1, range(4)))
def test_zeros_of_joints_that_stand_still_are_in_sigma(seed: int) -> None:
    """They turn what is found as the mount, and no log without their motion tells."""
    rng = np.random.default_rng(seed)
    moves = replace(MOVES, amplitude=(*MOVES.amplitude[:3], 0.0, 0.0, 0.0))
    log = make_log(moves).noisy(seed, INDUSTRIAL)
    wrong = with_zeros(log.path, {joint: 1e-3 * float(rng.normal()) for joint in range(1, 6)})
    estimate = calibrate_matched(log.imu, wrong, MatchedOptions())
    (found,) = (each for each in estimate.findings if each.code == "robot.joints_still")
    assert found.values["joints"] == ("j3", "j4", "j5")
    assert nees(estimate, MOUNT) < UNLIKELY
    exact = calibrated(log, MatchedOptions(robot="exact"))
    assert "robot.joints_still" not in {each.code for each in exact.findings}
    assert nees(exact, MOUNT) < UNLIKELY


def test_a_wrong_value_is_sized_where_the_clocks_are_far_apart() -> None:
    log = make_log(MOVES).noisy(1, INDUSTRIAL)
    late = replace(log.imu, t=log.imu.t + 6.0)
    options = MatchedOptions(gravity_norm=9.7, gravity_std=0.0, max_offset=10.0)
    estimate = calibrate_matched(late, log.path, options)
    (found,) = (each for each in estimate.findings if each.code == "prior.contradicted")
    assert float(str(found.values["step"])) == pytest.approx(GRAVITY - 9.7, abs=2e-3)


def test_no_log_tells_hidden_errors_from_the_mount_however_sharp_it_is() -> None:
    moves = replace(MOVES, amplitude=(*MOVES.amplitude[:3], 0.0, 0.0, 0.0))
    log = make_log(moves)
    estimate = calibrated(log, MatchedOptions(robot=(1e-3, 5e-4)))
    hidden = {"joint_zero": ("j2", "j3", "j4", "j5"), "origin": ("j4", "j5")}
    found = [
        (each.std, each.prior_std)
        for each in estimate.parameters
        if each.name in hidden and each.label.split()[0] in hidden[each.name]
    ]
    assert len(found) == 4 + 2 * 3
    std, prior_std = zip(*found, strict=True)
    np.testing.assert_allclose(std, prior_std, rtol=1e-6)
    # The robot is exact, so that none of the prior's milliradian may be seen in it.
    assert np.linalg.norm(pose_error(estimate, MOUNT)[3:]) < 1e-5


def test_a_clock_that_was_set_moves_a_pose_of_which_a_part_is_held() -> None:
    log = make_log(MOVES).noisy(1, INDUSTRIAL)
    stepped = replace(log.imu, t=np.where(log.imu.t > 14.0, log.imu.t + 0.05, log.imu.t))
    held = PosePrior(
        std=(np.inf, np.inf, 0.0, np.inf, np.inf, np.inf),
        R_parent_imu=MOUNT.R,
        t_parent_imu=MOUNT.t,
    )
    free, part = (
        calibrate_matched(stepped, log.path, MatchedOptions(pose=pose)) for pose in (None, held)
    )
    codes = {each.code for each in part.findings}
    assert "change.clock" in codes
    assert free.covariance is not None
    assert part.covariance is not None
    wide, narrow = (np.sqrt(np.diag(C)[3:]) for C in (free.covariance, part.covariance))
    np.testing.assert_array_less(0.5 * wide, narrow)


def test_short_gaps_between_windows_are_no_loss() -> None:
    log = make_log(MOVES).noisy(1, INDUSTRIAL)
    kept = log.imu.t % 0.45 > 0.05
    gappy = ImuSamples(t=log.imu.t[kept], gyro=log.imu.gyro[kept], accel=log.imu.accel[kept])
    estimate = calibrate_matched(gappy, log.path, MatchedOptions())
    assert "windows.between_gaps" not in {each.code for each in estimate.findings}
    half = log.imu.t % 0.8 > 0.4
    lost = ImuSamples(t=log.imu.t[half], gyro=log.imu.gyro[half], accel=log.imu.accel[half])
    estimate = calibrate_matched(lost, log.path, MatchedOptions())
    assert "windows.between_gaps" in {each.code for each in estimate.findings}
