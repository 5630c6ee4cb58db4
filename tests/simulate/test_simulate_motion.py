"""References and pushes: smooth where they say so, and rates that belong to their positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucalib_cli.simulate.config import Arm, FreeBody, Move
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.motion import ArmReference, PushPlan


def the_arm() -> Arm:
    arm = load_system("rihibot").arm
    assert arm is not None
    return arm


def the_bar() -> FreeBody:
    bar = load_system("barbot").free_body
    assert bar is not None
    return bar


ARM, BAR = the_arm(), the_bar()


@given(st.floats(0.0, 200.0))
def test_reference_rates_belong_to_reference_positions(t: float) -> None:
    reference = ArmReference(ARM, 201.0)
    ahead, behind = reference(t + 1e-5)[0], reference(max(t - 1e-5, 0.0))[0]
    rate = (ahead - behind) / (t + 1e-5 - max(t - 1e-5, 0.0))
    np.testing.assert_allclose(reference(t)[1], rate, atol=1e-4)


def test_moves_arrive_rest_and_repeat_from_the_second_on() -> None:
    moves = (
        Move(to_deg=(10.0,) * 6, seconds=1.0, rest=0.5),
        Move(to_deg=(20.0,) * 6, seconds=2.0, rest=0.5),
        Move(to_deg=(30.0,) * 6, seconds=1.0, rest=1.0),
    )
    short = replace(ARM, start_deg=(0.0,) * 6, start_rest=1.0, moves=moves)
    reference = ArmReference(short, 20.0)
    arrived = {0.5: 0, 2.0: 10, 2.4: 10, 4.5: 20, 6.0: 30, 7.0: 30, 9.0: 20, 10.5: 30, 13.5: 20}
    found = {t: round(float(np.degrees(reference(t)[0][0])), 6) for t in arrived}
    assert found == arrived
    single = ArmReference(replace(short, moves=moves[:1]), 20.0)
    np.testing.assert_allclose(np.degrees(single(19.0)[0]), 10.0)  # nothing to repeat: it stays


def test_smooth_pushes_have_no_jumps_and_hard_ones_do() -> None:
    t = np.arange(0, 30, 1e-3)
    largest = {}
    for profile in ("smooth", "hard"):
        plan = PushPlan(BAR, profile)
        values = np.array([np.concatenate(plan(x)[:2]) for x in t.tolist()])
        largest[profile] = np.abs(np.diff(values, axis=0)).max()
    assert largest["smooth"] < 0.5 * 1.875 / 0.3 * 1e-3 * 1.01
    assert largest["hard"] == pytest.approx(0.5)


def test_pushes_are_in_the_papers_order() -> None:
    plan = PushPlan(BAR, "hard")
    middle = [5.01 + 8.785 * k + 1.5 for k in range(14)]
    forces = [plan(t)[0].tolist() for t in middle]
    torques = [plan(t)[1].tolist() for t in middle]
    assert forces[0] == [0.0, 0.0, 0.5]
    assert np.count_nonzero(torques[1]) == 3
    assert forces[2:8] == (0.5 * np.kron(np.eye(3), [[1], [-1]])).tolist()
    assert torques[8:] == (0.2 * np.kron(np.eye(3), [[1], [-1]])).tolist()
    assert plan(127.99)[2] == 8.0  # the last pause ends with the log
    assert plan(128.01)[0].any()
