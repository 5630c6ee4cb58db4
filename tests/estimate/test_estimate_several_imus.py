"""Several IMUs of one log solved together, against an analytic robot and a plain dense system."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.linalg import inv, solve
from scipy.stats import chi2

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.estimate.several_imus import (
    OnRobot,
    System,
    groups,
    solve_agreeing,
    solve_together,
)
from imucalib_cli.jobs.several_imus import together
from imucalib_cli.robot.path import JointStep
from tests.estimate.estimate_arm import (
    codes,
    known,
    nees,
    parameter,
    pose_error,
    sigma,
    statistics,
    told,
)
from tests.estimate.estimate_walk import FOOT, SHANK, Walk
from tests.slow import slow_after

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.model.layout import Placed
    from imucalib_cli.estimate.solution.normal_equations import Answer, LogStatistics
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples
    from tests.estimate.estimate_walk import Floats

    Imu = tuple[str, Estimate, KinematicPath]

FLOATING = MatchedOptions(gravity="none")


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


def imu(name: str, samples: ImuSamples, path: KinematicPath) -> Imu:
    return name, calibrate_matched(samples, path, FLOATING), path


@lru_cache(maxsize=16)
def imus(seed: int) -> tuple[Imu, Imu]:
    """Shank and foot, each by itself."""
    log = walk(seed)
    return imu("/imu/shank", *log.shank()), imu("/imu/foot", *log.log())


@lru_cache(maxsize=16)
def joined(seed: int) -> list[Estimate]:
    """Both of them, solved together."""
    return together(imus(seed))


def alone(log: LogStatistics) -> Answer:
    return log.equations.solve(log.options)


def errors(seed: int, found: list[Estimate]) -> tuple[Floats, Floats]:
    """(2, 6) of shank and foot, and (2,) their squares in stated sigmas."""
    log = walk(seed)
    seen = list(zip(found, (log.seen(SHANK, 2), log.seen(FOOT, 3)), strict=True))
    return np.array([pose_error(*each) for each in seen]), np.array([nees(*each) for each in seen])


def test_one_imu_is_solved_as_by_itself() -> None:
    log = statistics(imus(2)[1][1])
    own, (found,) = alone(log), solve_together([log])
    np.testing.assert_allclose(found.state.t, own.state.t, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.state.R, own.state.R, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.state.x, own.state.x, rtol=0, atol=1e-10)
    scale = np.sqrt(np.diag(own.covariance)) + 1e-300
    difference = (found.covariance - own.covariance) / np.outer(scale, scale)
    assert np.abs(difference).max() < 1e-8
    each = imus(2)[1]
    assert together([each]) == [each[1]]


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
    logs = [statistics(each) for _, each, _ in imus(2)]
    system = System.of(logs)
    u = system.problem.bounds.mean(axis=1)
    std: dict[tuple[object, ...], float] = {}
    expected: dict[tuple[object, ...], float] = {}
    sums = []
    for place, log in enumerate(logs):
        layout, sums_of_one = log.equations.layout, []
        known = layout.std_at(layout.bounds.mean(axis=1))
        for placed in layout.placed:
            for index, at in enumerate(range(placed.part.start, placed.part.stop)):
                parts = named(place, placed, index)
                std |= dict.fromkeys(parts, float(known[at]))
                if placed.unknown.name == "time_offset":
                    expected |= dict.fromkeys(parts, float(log.equations.at.x[at]))
                sums_of_one.append(parts)
        sums.append(sums_of_one)
    P = np.diag([each**-2 for each in std.values()])
    H, right = P.copy(), P @ [expected.get(name, 0.0) for name in std]
    maps = [np.array([[each.get(name, 0.0) for name in std] for each in one]) for one in sums]
    for log, T in zip(logs, maps, strict=True):
        equations = log.equations
        A, b = equations.information / equations.level, equations.score / equations.level
        H += T.T @ A @ T
        right += T.T @ (A @ equations.at.x - b)
    values = solve(H, right, assume_a="pos")
    step, covariance = system.problem.solve(u)
    for log, part, T in zip(logs, system.parts, maps, strict=True):
        found = log.equations.at.x + part.held + part.to_own @ step
        C = T @ inv(H) @ T.T
        sigma = np.sqrt(np.diag(C))
        assert np.abs((found - T @ values) / sigma).max() < 1e-5
        difference = part.to_own @ covariance @ part.to_own.T - C
        assert np.abs(difference / np.outer(sigma, sigma)).max() < 1e-5


@pytest.mark.parametrize("seeds", slow_after(1, [[2, 3], range(24)]))
def test_errors_are_smaller_together_and_sigma_stays_true(seeds: Sequence[int]) -> None:
    before, after, squares = [], [], 0.0
    for seed in seeds:
        mine, found = imus(seed), joined(seed)
        assert all("imus.together" in codes(each) for each in found)
        before.append(errors(seed, [each for _, each, _ in mine])[0])
        off, square = errors(seed, found)
        after.append(off)
        squares += float(square.sum())
    rms = [np.sqrt((np.array(each)[:, :, :3] ** 2).sum(axis=2).mean()) for each in (before, after)]
    assert rms[1] < 0.95 * rms[0]
    assert squares < chi2.ppf(0.999, 12 * len(seeds))


@pytest.mark.parametrize("seeds", slow_after(1, [[2, 3], range(4)]))
def test_what_is_shared_is_one_and_found_better(seeds: Sequence[int]) -> None:
    """The place of the trunk's IMU, which a first joint that is elsewhere looks like."""
    before, after = [], []
    for seed in seeds:
        mine, log = imus(seed), walk(seed)
        true = log.base_off[0] * np.random.default_rng([seed, 5]).normal(size=3) - log.first_off
        alone_each = [parameter(each, "base_translation")[0] for _, each, _ in mine]
        one, other = (parameter(each, "base_translation")[0] for each in joined(seed))
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
        before += [each - true for each in alone_each]
        after.append(one - true)
    assert np.mean(np.square(after)) < 0.8 * np.mean(np.square(before))


def test_the_order_of_imus_does_not_matter() -> None:
    one, other = imus(2)
    found, turned = joined(2), together([other, one])[::-1]
    for each, again in zip(found, turned, strict=True):
        np.testing.assert_array_equal(each.t_parent_imu, again.t_parent_imu)
        np.testing.assert_array_equal(each.covariance, again.covariance)
        assert each.findings == again.findings


def another_robot(path: KinematicPath, zero: float) -> KinematicPath:
    """A path whose first joint is off by so much."""
    steps = list(path.steps)
    assert isinstance(steps[3], JointStep)
    steps[3] = replace(steps[3], offset=zero)
    return replace(path, steps=tuple(steps))


def test_of_two_that_disagree_both_stay_alone_and_say_so() -> None:
    shank, foot = imus(2)
    samples, path = walk(2).shank()
    wrong = imu(shank[0], samples, another_robot(path, 0.01))
    assert wrong[1].trusted
    for each, before, other in zip(
        together([wrong, foot]), (wrong[1], foot[1]), (foot[0], wrong[0]), strict=True
    ):
        np.testing.assert_array_equal(each.t_parent_imu, before.t_parent_imu)
        said = told(each, "imus.disagree")
        assert said["others"] == (other,)
        assert said["sigmas"] > 6.0


@pytest.mark.slow
def test_of_three_the_one_that_disagrees_is_left_out() -> None:
    shank, foot = imus(2)
    samples, path = walk(2).shank()
    wrong = imu("/imu/thigh", samples, another_robot(path, 0.01))
    logs = [statistics(each) for _, each, _ in (shank, wrong, foot)]
    solved = solve_agreeing(logs, [alone(log) for log in logs])
    assert list(solved.strangers) == [1]
    for place, answer in zip((0, 2), solve_together([logs[0], logs[2]]), strict=True):
        np.testing.assert_array_equal(solved.answers[place].state.t, answer.state.t)


@pytest.mark.parametrize("std", slow_after(1, [((0.0,) * 3 + (np.inf,) * 3,), ((0.0,) * 6,)]))
def test_what_is_held_of_the_mounts_stays_held(std: tuple[float, ...]) -> None:
    log, found = walk(2), []
    for name, (samples, path), mount in (
        ("/imu/shank", log.shank(), log.seen(SHANK, 2)),
        ("/imu/foot", log.log(), FOOT),
    ):
        held = replace(FLOATING, pose=known(std, mount))
        estimate = calibrate_matched(samples, path, held)
        found.append((name, estimate, path))
    for each, mount in zip(together(found), (log.seen(SHANK, 2), FOOT), strict=True):
        assert "imus.together" in codes(each)
        np.testing.assert_allclose(each.t_parent_imu, mount.t, rtol=0, atol=1e-12)
        assert (sigma(each)[:3] == 0.0).all()
        assert ((sigma(each)[3:] > 0.0) == (np.array(std[3:]) > 0.0)).all()


def test_an_imu_that_is_not_to_be_trusted_takes_nobody_along() -> None:
    (name, shank, path), foot = imus(2)
    vague = replace(shank, statistics=replace(statistics(shank), widened=1e-6 * np.eye(6)))
    assert together([(name, vague, path), foot]) == [vague, foot[1]]


def test_only_chains_of_one_robot_with_free_errors_are_solved_together() -> None:
    on_robot = [OnRobot.of(statistics(each), path) for _, each, path in imus(2)]
    shank, foot = on_robot
    assert groups([shank, foot]) == [[0, 1]]
    elsewhere = replace(foot, joints={**foot.joints, "j0": "/other/joint_states"})
    assert groups([shank, elsewhere]) == []
    assert groups([shank, replace(foot, root=("map",)), foot]) == [[0, 2]]
    exact = replace(foot.log, options=replace(foot.log.options, robot="exact"))
    assert groups([shank, replace(foot, log=exact)]) == []


def test_where_chains_part_at_the_base_their_first_joints_may_be_elsewhere() -> None:
    """The base IMU's place is then not quite one place for both."""
    logs = [statistics(each) for _, each, _ in imus(2)]
    renamed = [
        replace(placed, joint=None if placed.joint is None else replace(placed.joint, name="k"))
        for placed in logs[1].equations.layout.placed
    ]
    layout = replace(logs[1].equations.layout, placed=tuple(renamed))
    other = replace(logs[1], equations=replace(logs[1].equations, layout=layout))

    def variances(logs: list[LogStatistics]) -> Floats:
        """Of the base IMU's place, at scales in the middle of their ranges."""
        system = System.of(logs)
        own, middle = system.parts[0].to_own, system.problem.bounds.mean(axis=1)
        part = logs[0].equations.layout.part("base_translation")
        return np.diag(own @ system.problem.covariance(middle) @ own.T)[part]

    assert (variances([logs[0], other]) > variances(logs)).all()
