"""Folds of moves: whole, disjoint, alike, and what is held out is out of every stream."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.results.pose import pose_error
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import NoiseOptions, PhysicsOptions
from imucalib_cli.study.contest import pose_only
from imucalib_cli.study.recordings import clean_recording, streams_of
from imucalib_cli.study.studies.folded import moves_of, stratified_folds, without
from tools.errors import nees

HARD = PhysicsOptions(imu_rate=250, robot_rate=250, profile="hard")


@pytest.mark.parametrize("name", ["rihibot", "barbot"])
def test_every_instant_is_in_one_fold_and_kinds_are_spread(name: str) -> None:
    system = load_system(name)
    moves = moves_of(system, system.duration)
    edges = [move.start for move in moves] + [moves[-1].stop]
    assert edges[0] == 0.0
    assert edges[-1] == np.inf
    assert all(a.stop == b.start for a, b in pairwise(moves))
    folds = stratified_folds(moves, 3)
    assert sorted(m.start for fold in folds for m in fold) == edges[:-1]
    counts = [Counter(move.kind for move in fold) for fold in folds]
    for kind in counts[0]:
        shares = [count[kind] for count in counts]
        assert min(shares) > 0
        assert max(shares) - min(shares) <= 1


def test_kinds_are_those_of_the_plan() -> None:
    arm = load_system("rihibot").arm
    assert arm is not None
    kinds = [move.kind for move in moves_of(load_system("rihibot"), 74.0)]
    # The configuration marks the moves of the wrist alone by a comment; the fourth is the first.
    assert kinds[:4] == ["arm", "arm", "arm", "wrist"]
    assert Counter(move.kind for move in moves_of(load_system("barbot"), 128.0)) == {
        "force": 7,
        "torque": 7,
    }


def test_a_held_out_move_is_in_no_stream() -> None:
    physics = PhysicsOptions(imu_rate=100, robot_rate=50, duration=12)
    clean = clean_recording("rihibot", physics)
    noisy = corrupt(clean, NoiseOptions(accel_white=0.1, time_offset=0.3), 1)
    moves = moves_of(clean.system, 12.0)
    left = without(noisy, [moves[1]])
    for record, whole in ((left.imu, noisy.imu), (left.robot[0], noisy.robot[0])):
        inside = (whole.t >= moves[1].start) & (whole.t < moves[1].stop)
        assert inside.any()
        np.testing.assert_array_equal(record.t, whole.t[~inside])
        np.testing.assert_array_equal(record.stamp, whole.stamp[~inside])
    assert len(left.imu.accel_bias) == len(left.imu.t)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("noise", "fold", "translation", "rotation_deg"),
    [
        (NoiseOptions(accel_white=0.00196133), 0, 5e-5, 1e-5),
        (NoiseOptions(gyro_white=0.0002), 1, 5e-6, 1e-3),
    ],
    ids=["noise of the accelerometer alone", "noise of the gyroscope alone"],
)
def test_switched_pushes_drop_out_where_only_the_pose_is_unknown(
    noise: NoiseOptions, fold: int, translation: float, rotation_deg: float
) -> None:
    """Weights must settle, and a sensor without noise must leave the other its digits."""
    clean = clean_recording("barbot", HARD)
    folds = stratified_folds(moves_of(clean.system, clean.system.duration), 3)
    imu, path = streams_of(without(corrupt(clean, noise, fold), folds[fold]))
    estimate = calibrate_matched(imu, path, pose_only(0.0))
    error = pose_error(
        estimate.R_parent_imu, estimate.t_parent_imu, clean.R_parent_imu, clean.t_parent_imu
    )
    assert error.translation < translation
    assert np.degrees(error.rotation) < rotation_deg


def test_a_covariance_that_lost_its_digits_is_not_to_be_trusted() -> None:
    """No noise at all in the gyroscope and much in the accelerometer: no log has that."""
    clean = clean_recording("barbot", replace(HARD, duration=40.0))
    folds = stratified_folds(moves_of(clean.system, 40.0), 3)
    noisy = corrupt(clean, NoiseOptions(accel_white=0.1), 9)
    imu, path = streams_of(without(noisy, folds[1]))
    estimate = calibrate_matched(imu, path, MatchedOptions(gravity="none", gravity_norm=0.0))
    covariance = np.asarray(estimate.covariance)
    if (np.diag(covariance) >= 0.0).all():
        error = estimate.t_parent_imu - clean.t_parent_imu
        assert nees(error, covariance[:3, :3]) < 30.0
    else:
        assert not estimate.trusted
