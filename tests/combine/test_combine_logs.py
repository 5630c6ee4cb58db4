"""Answers from statistics alone: one log with other priors, and several logs together."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.combine import scatter
from imucalib_cli.combine.logs import Combined, combine_logs, solve_again
from imucalib_cli.estimate.model.state import State
from tests.estimate.estimate_arm import (
    LINKS,
    MOUNT,
    Log,
    Mount,
    Moves,
    Solved,
    make_log,
    prior,
    solve,
)
from tests.slow import slow_after
from tools.errors import nees, pose_off


@cache
def recordings(count: int, seed: int, scatter: tuple[float, float] = (0.0, 0.0)) -> tuple[Log, ...]:
    """Logs of one arm, whose links are 0.3 mm off, on a mount that scatters, m and rad."""
    rng = np.random.default_rng(seed)
    links = [
        (x + bool(x) * 3e-4 * rng.normal(), z + bool(z) * 3e-4 * rng.normal(), turn)
        for x, z, turn in LINKS[:-1]
    ]
    found = []
    for index in range(count):
        off = rng.normal(size=6) * np.repeat(scatter, 3)
        mount = Mount(R=Rotation.from_rotvec(off[3:]).as_matrix() @ MOUNT.R, t=MOUNT.t + off[:3])
        moves = Moves(seed=100 * seed + index, seconds=15.0)
        log = make_log(moves, mount, links=(*links, LINKS[-1]))
        x, y, z = 0.05 * rng.normal(size=3)
        log = log.noisy(1000 * seed + index, accel_bias=(x, y, z), gyro_bias=(y / 10, z / 10, 0.0))
        found.append(log)
    return tuple(found)


def together(estimates: list[Solved]) -> Combined:
    logs = [each.log_statistics for each in estimates]
    return combine_logs(logs, [log.options for log in logs])


def error_of(state: State, mount: Mount) -> Floats:
    """(6,), pose of a state less a pose."""
    return pose_off(state.R, state.t, mount.R, mount.t)


OTHER: dict[str, dict[str, Any]] = {
    "robot exact": {"robot": "exact"},
    "one component known": {"pose": prior(tz=1e-5)},
    "robot known": {"robot": (1e-3, 2e-4)},
    "bias known": {"accel_bias_std": 0.02},
    "two components held": {"pose": prior(ty=0.0, rz=0.0)},
    "gravity along -z": {"gravity": "fixed"},
}


@pytest.mark.parametrize("name", slow_after(2, OTHER))
def test_other_priors_give_the_result_of_a_run(name: str) -> None:
    """But for the noise's level and the point of linearisation, which a run finds anew."""
    (recording,) = recordings(1, 1)
    log = solve(recording).log_statistics
    answer, _ = solve_again(log, replace(log.options, **OTHER[name]))
    run = solve(recording, **OTHER[name])
    sigma = np.maximum(run.sigma, 1e-8)
    off = error_of(answer.state, Mount(R=run.R_parent_imu, t=run.t_parent_imu))
    assert np.abs(off / sigma).max() < 0.1
    stated = np.sqrt(np.maximum(np.diag(answer.pose_covariance), 1e-16))
    np.testing.assert_allclose(stated / sigma, 1.0, atol=0.05)


def test_wrong_fixed_component_is_contradicted() -> None:
    log = solve(recordings(1, 1)[0]).log_statistics
    _, findings = solve_again(log, replace(log.options, pose=prior(tx=0.0, dt=(5e-3, 0.0, 0.0))))
    (found,) = [each for each in findings if each.code == "prior.contradicted"]
    assert found.values["option"] == "--fix tx"
    assert found.values["step"] == pytest.approx(-5e-3, abs=1e-3)


def by_sum(estimates: list[Solved]) -> tuple[Floats, Floats]:
    """Mean step and covariance of the pose by one system with all unknowns of all logs in it.

    The mount does not scatter, and robot and sensor are exact, so that nothing is learnt.
    """
    each = [found.log_statistics.equations for found in estimates]
    sizes = [equations.layout.size - 6 for equations in each]
    n = 6 + sum(sizes)
    A, b, B, start = np.zeros((n, n)), np.zeros(n), np.zeros((n, n)), 6
    first = each[0].at
    for equations, size in zip(each, sizes, strict=True):
        places = np.r_[0:6, start : start + size]
        information = equations.information / equations.level
        move = np.zeros(equations.layout.size)
        move[:6] = error_of(first, Mount(R=equations.at.R, t=equations.at.t))
        A[np.ix_(places, places)] += information
        B[np.ix_(places, places)] += equations.noise / equations.level**2
        b[places] += equations.score / equations.level + information @ move
        start += size
    # Priors are far wider than what the logs show, so that they have no effect here.
    inverse = np.linalg.inv(A)
    return (-inverse @ b)[:6], (inverse @ B @ inverse)[:6, :6]


def test_logs_of_unmoved_mount_equal_sum_of_statistics(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # As good as no scatter between logs.
    monkeypatch.setattr(scatter, "USUAL", (1e-9, 1e-9))
    monkeypatch.setattr(scatter, "_RANGE", (1e-2, 1.0))
    logs = [make_log(Moves(seed=seed, seconds=15.0)).noisy(seed) for seed in (1, 2, 3)]
    estimates = [solve(log, robot="exact", sensor_model="ideal") for log in logs]
    answer = together(estimates).answer
    step, C = by_sum(estimates)
    first, sigma = estimates[0].log_statistics.equations.at, np.sqrt(np.diag(C))
    moved = error_of(answer.state, Mount(R=first.R, t=first.t))
    np.testing.assert_allclose(moved / sigma, step / sigma, atol=1e-3)
    stated = np.sqrt(np.diag(answer.pose_covariance))
    np.testing.assert_allclose(stated / sigma, 1.0, atol=1e-3)


@pytest.mark.slow
def test_disagreeing_log_is_found_and_its_offset_measured() -> None:
    away = np.array([0.004, 0.0, 0.0])
    moves = Moves(seed=77, seconds=15.0)
    stranger = make_log(moves, Mount(R=MOUNT.R, t=MOUNT.t + away)).noisy(77)
    found = together([solve(log) for log in (*recordings(4, 3), stranger)])
    assert [own.disagrees for own in found.own] == [False] * 4 + [True]
    np.testing.assert_allclose(found.own[-1].distance[:3], away, atol=1e-3)


def test_wrong_zero_of_the_robot_is_found_and_no_log_disagrees() -> None:
    zeros = np.array([0.0, 0.0, 0.0, 1e-2, 0.0, 0.0])
    logs = [
        make_log(Moves(seed=seed, seconds=15.0), zeros=zeros).noisy(seed, "industrial")
        for seed in range(3)
    ]
    combined = together([solve(log) for log in logs])
    part = next(
        each.part
        for each in combined.answer.layout.placed
        if each.labels == ("j3",) and each.unknown.name == "joint_zero"
    )
    value, std = combined.answer.state.x[part], combined.answer.std[part]
    assert abs(value[0] + 1e-2) < 4.0 * std[0] < 2e-3
    assert not any(own.disagrees for own in combined.own)
    pose, covariance = error_of(combined.answer.state, MOUNT), combined.answer.pose_covariance
    assert nees(pose, covariance) < 22.5


def test_each_log_keeps_its_own_biases() -> None:
    logs = recordings(2, 3)
    estimates = [solve(log) for log in logs]
    for own, found, log in zip(together(estimates).own, estimates, logs, strict=True):
        part = found.log_statistics.equations.layout.part("gyro_bias")
        assert found.gyro_bias_std is not None
        off = (own.state.x[part] - log.gyro_bias) / found.gyro_bias_std
        # Another log's are eighty sigmas off; chance exceeds this once in a hundred such tests.
        assert np.abs(off).max() < 3.3


@pytest.mark.slow
@pytest.mark.parametrize("scatter", [(0.0, 0.0), (2e-4, 5e-4)])
def test_combined_sigma_matches_errors(scatter: tuple[float, float]) -> None:
    """Over 30 arms of five logs: their mean square has a standard deviation of 0.6."""
    squares = []
    for seed in range(30):
        answer = together([solve(log) for log in recordings(5, 10 + seed, scatter)]).answer
        error = error_of(answer.state, MOUNT)
        squares.append(nees(error, answer.pose_covariance))
    assert np.mean(squares) < 6.0 + 3.0 * 0.6
    if any(scatter):
        # Without scatter sigma holds what five logs cannot rule out, and is larger.
        assert np.mean(squares) > 6.0 - 3.0 * 0.6
