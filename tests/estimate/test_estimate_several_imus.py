"""Several IMUs of one log solved together, against an analytic robot and a plain dense system."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.linalg import inv
from scipy.linalg import solve as solve_dense
from scipy.stats import chi2

from imucalib_cli.estimate.several_imus import (
    OnRobot,
    System,
    groups,
    solve_agreeing,
    solve_together,
)
from imucalib_cli.jobs.several_imus import together
from imucalib_cli.robot.path import JointStep
from tests.estimate.estimate_arm import Solved, beside, prior, solve
from tests.estimate.estimate_walk import Walk, logged
from tests.slow import slow_after

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.estimate.model.layout import Placed
    from imucalib_cli.estimate.solution.normal_equations import Answer, LogStatistics
    from imucalib_cli.robot.path import KinematicPath
    from tests.estimate.estimate_arm import Log
    from tests.estimate.estimate_walk import Floats

    Imu = tuple[str, Solved, KinematicPath]


def walk(seed: int) -> Walk:
    """With errors of every kind that both IMUs share."""
    return Walk(
        seed=seed,
        seconds=20.0,
        noisy=True,
        scale=3e-3,
        zero=1e-3,
        length=5e-4,
        base_off=(1e-3, 3e-3),
        offsets=(0.004, -0.006),
    )


def imu(name: str, log: Log, **options: Any) -> Imu:
    return name, solve(log, gravity="none", **options), log.path


@lru_cache(maxsize=16)
def imus(seed: int) -> tuple[Imu, Imu]:
    """Shank and foot, each by itself."""
    return imu("/imu/shank", walk(seed).shank()), imu("/imu/foot", logged(walk(seed)))


def jointly(imus: Sequence[Imu]) -> list[Solved]:
    """All of them, solved together."""
    mounts = [alone.mount for _, alone, _ in imus]
    return [beside(*each) for each in zip(together(imus), mounts, strict=True)]


@lru_cache(maxsize=16)
def joined(seed: int) -> list[Solved]:
    return jointly(imus(seed))


def statistics(imus: Sequence[Imu]) -> list[LogStatistics]:
    return [found.log_statistics for _, found, _ in imus]


def alone(log: LogStatistics) -> Answer:
    return log.equations.solve(log.options)


def test_one_imu_is_solved_as_by_itself() -> None:
    foot = imus(2)[1]
    (log,) = statistics([foot])
    own, (found,) = alone(log), solve_together([log])
    np.testing.assert_allclose(found.state.t, own.state.t, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.state.R, own.state.R, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.state.x, own.state.x, rtol=0, atol=1e-10)
    scale = np.sqrt(np.diag(own.covariance)) + 1e-300
    difference = (found.covariance - own.covariance) / np.outer(scale, scale)
    assert np.abs(difference).max() < 1e-8
    assert together([foot]) == [foot[1]]


def named(place: int, placed: Placed, index: int) -> dict[tuple[object, ...], float]:
    """A component as a sum of unknowns of the robot or of one IMU."""
    label = placed.labels[index]
    if placed.unknown.name == "origin":
        axes = enumerate(placed.directions[index])
        return {("origin", label.split(" ")[0], axis): float(each) for axis, each in axes}
    shared = placed.unknown.name.startswith(("joint_", "base_"))
    return {("all" if shared else place, placed.unknown.name, label): 1.0}


def test_it_is_the_answer_of_one_dense_system() -> None:
    """Put together by names, in values instead of steps."""
    logs = statistics(imus(2))
    system = System.of(logs)
    std: dict[tuple[object, ...], float] = {}
    expected: dict[tuple[object, ...], float] = {}
    sums: list[list[dict[tuple[object, ...], float]]] = [[] for _ in logs]
    for place, log in enumerate(logs):
        layout = log.equations.layout
        known = layout.std_at(layout.bounds.mean(axis=1))
        for placed in layout.placed:
            for index, at in enumerate(range(placed.part.start, placed.part.stop)):
                parts = named(place, placed, index)
                std |= dict.fromkeys(parts, float(known[at]))
                if placed.unknown.name == "time_offset":
                    expected |= dict.fromkeys(parts, float(log.equations.at.x[at]))
                sums[place].append(parts)
    P = np.diag([each**-2 for each in std.values()])
    H, right = P.copy(), P @ [expected.get(name, 0.0) for name in std]
    maps = [np.array([[each.get(name, 0.0) for name in std] for each in one]) for one in sums]
    for log, T in zip(logs, maps, strict=True):
        equations = log.equations
        A, b = equations.information / equations.level, equations.score / equations.level
        H += T.T @ A @ T
        right += T.T @ (A @ equations.at.x - b)
    values = solve_dense(H, right, assume_a="pos")
    step, covariance = system.problem.solve(system.problem.bounds.mean(axis=1))
    for log, part, T in zip(logs, system.parts, maps, strict=True):
        found = log.equations.at.x + part.held + part.to_own @ step
        C = T @ inv(H) @ T.T
        sigma = np.sqrt(np.diag(C))
        assert np.abs((found - T @ values) / sigma).max() < 1e-5
        difference = part.to_own @ covariance @ part.to_own.T - C
        assert np.abs(difference / np.outer(sigma, sigma)).max() < 1e-5


@pytest.mark.parametrize("seeds", slow_after(1, [[2, 3], range(24)]))
def test_errors_are_smaller_together_and_sigma_stays_true(seeds: Sequence[int]) -> None:
    before = [found for seed in seeds for _, found, _ in imus(seed)]
    after = [found for seed in seeds for found in joined(seed)]
    assert all("imus.together" in each.codes for each in after)
    rms = [np.sqrt(np.mean([each.distance**2 for each in group])) for group in (before, after)]
    assert rms[1] < 0.95 * rms[0]
    assert sum(each.nees for each in after) < chi2.ppf(0.999, 12 * len(seeds))


@pytest.mark.parametrize("seeds", slow_after(1, [[2, 3], range(4)]))
def test_what_is_shared_is_one_and_found_better(seeds: Sequence[int]) -> None:
    """The place of the trunk's IMU, which a displaced first joint looks like."""
    before, after = [], []
    for seed in seeds:
        log = walk(seed)
        true = log.base_off[0] * np.random.default_rng([seed, 5]).normal(size=3) - log.first_off
        one, other = (each.parameter("base_translation")[0] for each in joined(seed))
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
        before += [each.parameter("base_translation")[0] - true for _, each, _ in imus(seed)]
        after.append(one - true)
    assert np.mean(np.square(after)) < 0.8 * np.mean(np.square(before))


def test_the_order_of_imus_does_not_matter() -> None:
    turned = together(imus(2)[::-1])[::-1]
    for each, again in zip(joined(2), turned, strict=True):
        np.testing.assert_array_equal(each.t_parent_imu, again.t_parent_imu)
        np.testing.assert_array_equal(each.covariance, again.covariance)
        assert each.findings == again.findings


def with_wrong_zero(log: Log) -> Log:
    """A path whose first joint is off by 0.01 rad."""
    steps = list(log.path.steps)
    assert isinstance(steps[3], JointStep)
    steps[3] = replace(steps[3], offset=0.01)
    return replace(log, path=replace(log.path, steps=tuple(steps)))


def test_of_two_that_disagree_both_stay_alone_and_say_so() -> None:
    foot = imus(2)[1]
    wrong = imu("/imu/shank", with_wrong_zero(walk(2).shank()))
    assert wrong[1].trusted
    for each, before, other in zip(
        jointly([wrong, foot]), (wrong[1], foot[1]), (foot[0], wrong[0]), strict=True
    ):
        np.testing.assert_array_equal(each.t_parent_imu, before.t_parent_imu)
        disagree = each.finding("imus.disagree")
        assert disagree["others"] == (other,)
        assert disagree["sigmas"] > 6.0


@pytest.mark.slow
def test_of_three_the_one_that_disagrees_is_left_out() -> None:
    shank, foot = imus(2)
    wrong = imu("/imu/thigh", with_wrong_zero(walk(2).shank()))
    logs = statistics([shank, wrong, foot])
    solved = solve_agreeing(logs, [alone(log) for log in logs])
    assert list(solved.strangers) == [1]
    for place, answer in zip((0, 2), solve_together([logs[0], logs[2]]), strict=True):
        np.testing.assert_array_equal(solved.answers[place].state.t, answer.state.t)


@pytest.mark.parametrize("names", slow_after(1, ["tx ty tz", "tx ty tz rx ry rz"]))
def test_what_is_held_of_the_mounts_stays_held(names: str) -> None:
    held = dict.fromkeys(names.split(), 0.0)
    logs = {"/imu/shank": walk(2).shank(), "/imu/foot": logged(walk(2))}
    found = jointly([imu(name, log, pose=prior(log.mount, **held)) for name, log in logs.items()])
    for each in found:
        assert "imus.together" in each.codes
        np.testing.assert_allclose(each.t_parent_imu, each.mount.t, rtol=0, atol=1e-12)
        assert (each.sigma[:3] == 0.0).all()
        assert ((each.sigma[3:] == 0.0) == ("rx" in held)).all()


def test_an_imu_that_is_not_to_be_trusted_takes_nobody_along() -> None:
    (name, shank, path), foot = imus(2)
    vague = replace(shank, statistics=replace(shank.log_statistics, widened=1e-6 * np.eye(6)))
    assert together([(name, vague, path), foot]) == [vague, foot[1]]


def test_only_chains_of_one_robot_with_free_errors_are_solved_together() -> None:
    shank, foot = (OnRobot.of(each.log_statistics, path) for _, each, path in imus(2))
    assert groups([shank, foot]) == [[0, 1]]
    elsewhere = replace(foot, joints={**foot.joints, "j0": "/other/joint_states"})
    assert groups([shank, elsewhere]) == []
    assert groups([shank, replace(foot, root=("map",)), foot]) == [[0, 2]]
    exact = replace(foot.log, options=replace(foot.log.options, robot="exact"))
    assert groups([shank, replace(foot, log=exact)]) == []


def test_where_chains_part_at_the_base_their_first_joints_may_be_elsewhere() -> None:
    """The base IMU's place is then not quite one place for both."""
    shank, foot = statistics(imus(2))
    layout = foot.equations.layout
    renamed = tuple(
        replace(placed, joint=None if placed.joint is None else replace(placed.joint, name="k"))
        for placed in layout.placed
    )
    equations = replace(foot.equations, layout=replace(layout, placed=renamed))

    def variances(logs: list[LogStatistics]) -> Floats:
        """Of the base IMU's place, at scales in the middle of their ranges."""
        system = System.of(logs)
        own, middle = system.parts[0].to_own, system.problem.bounds.mean(axis=1)
        part = shank.equations.layout.part("base_translation")
        return np.diag(own @ system.problem.covariance(middle) @ own.T)[part]

    apart = variances([shank, replace(foot, equations=equations)])
    assert (apart > variances([shank, foot])).all()
