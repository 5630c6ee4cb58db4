"""What the user states exactly is believed where it is true, and contradicted where it is not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from tests.estimate.estimate_arm import (
    GRAVITY,
    INDUSTRIAL,
    MOUNT,
    UNLIKELY,
    Moves,
    calibrated,
    codes,
    known,
    make_log,
    nees,
    pose_error,
    sigma,
    told,
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


@pytest.mark.parametrize("what", slow_after(1, WRONG))
def test_a_wrong_value_is_contradicted_with_its_size_and_nothing_else_is_blamed(what: str) -> None:
    stated, option, step = WRONG[what]
    log = make_log(MOVES).noisy(1, INDUSTRIAL)
    estimate = calibrated(log, MatchedOptions(**stated))
    assert not estimate.trusted
    found = told(estimate, "prior.contradicted")
    assert found["option"] == option
    assert found["step"] == pytest.approx(step, abs=4.0 * found["std"])
    assert not codes(estimate) & {"unknown.found", "unknown.implausible"}


def test_a_base_that_is_not_as_level_as_stated_is_told() -> None:
    gravity = Rotation.from_rotvec([0.03, 0.0, 0.0]).apply([0.0, 0.0, -GRAVITY])
    log = make_log(MOVES, gravity_world=gravity).noisy(1, INDUSTRIAL)
    found = told(calibrated(log, MatchedOptions(tilt_std=1e-3)), "prior.contradicted")
    assert found["option"] == "--tilt-std"
    assert abs(found["step"]) == pytest.approx(0.03, abs=1e-4)
    level = calibrated(log, MatchedOptions(tilt_std=0.03))
    assert level.trusted


@pytest.mark.parametrize("seed", slow_after(1, range(3)))
def test_true_values_are_believed(seed: int) -> None:
    log = make_log(MOVES).noisy(seed, INDUSTRIAL)
    options = MatchedOptions(gravity="fixed", gravity_std=0.0, time_offset=0.0)
    estimate = calibrated(log, options)
    assert estimate.trusted
    assert nees(estimate, MOUNT) < UNLIKELY


@pytest.mark.parametrize("seed", slow_after(1, range(4)))
def test_zeros_of_joints_that_stand_still_are_in_sigma(seed: int) -> None:
    """They turn what is found as the mount, and no log without their motion tells."""
    rng = np.random.default_rng(seed)
    moves = replace(MOVES, amplitude=(*MOVES.amplitude[:3], 0.0, 0.0, 0.0))
    log = make_log(moves).noisy(seed, INDUSTRIAL)
    zeros = [0.0, *1e-3 * rng.normal(size=5)]
    estimate = calibrated(log.with_joints(values=log.path.tracks[0].values + zeros))
    assert told(estimate, "robot.joints_still")["joints"] == ("j3", "j4", "j5")
    assert nees(estimate, MOUNT) < UNLIKELY
    exact = calibrated(log, MatchedOptions(robot="exact"))
    assert "robot.joints_still" not in codes(exact)
    assert nees(exact, MOUNT) < UNLIKELY


@pytest.mark.slow
def test_a_wrong_value_is_sized_where_the_clocks_are_far_apart() -> None:
    log = make_log(MOVES).noisy(1, INDUSTRIAL)
    late = replace(log.imu, t=log.imu.t + 6.0)
    options = MatchedOptions(gravity_norm=9.7, gravity_std=0.0, max_offset=10.0)
    estimate = calibrate_matched(late, log.path, options)
    step = told(estimate, "prior.contradicted")["step"]
    assert step == pytest.approx(GRAVITY - 9.7, abs=2e-3)


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
    held = known((np.inf, np.inf, 0.0, *[np.inf] * 3))
    free, part = (
        calibrate_matched(stepped, log.path, MatchedOptions(pose=pose)) for pose in (None, held)
    )
    assert "change.clock" in codes(part)
    np.testing.assert_array_less(0.5 * sigma(free)[3:], sigma(part)[3:])


def test_short_gaps_between_windows_are_no_loss() -> None:
    log = make_log(MOVES).noisy(1, INDUSTRIAL)
    assert "windows.between_gaps" not in codes(calibrated(log.kept(log.imu.t % 0.45 > 0.05)))
    assert "windows.between_gaps" in codes(calibrated(log.kept(log.imu.t % 0.8 > 0.4)))
