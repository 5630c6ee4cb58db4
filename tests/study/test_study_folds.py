"""Folds of moves: whole, disjoint, alike, and what is held out is out of every stream."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import NoiseOptions, PhysicsOptions
from imucalib_cli.study.folds import moves_of, stratified_folds, without
from imucalib_cli.study.systems import clean_recording


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
    assert left.corruption is not None
    assert len(left.corruption.accel_bias) == len(left.imu.t)
