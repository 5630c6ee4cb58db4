"""Robots without a fixed base, against their analytic motion: one IMU, and several together."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.linalg import inv
from scipy.linalg import solve as solve_dense
from scipy.signal import butter, sosfilt
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from imucalib_cli.arrays import Floats
from imucalib_cli.combine.imus import (
    OnRobot,
    System,
    groups,
    solve_agreeing,
    solve_together,
)
from imucalib_cli.estimate.effects import Origin
from imucalib_cli.estimate.model.layout import Placed
from imucalib_cli.estimate.options import MatchedOptions, WindowChoice
from imucalib_cli.estimate.solution.fit import Fit, lean_fit, whole_fit
from imucalib_cli.estimate.solution.normal_equations import Answer, LogStatistics
from imucalib_cli.jobs.several_imus import solve_imus_together
from imucalib_cli.robot.path import JointStep, KinematicPath
from imucalib_cli.signals.dead_reckoning import dead_reckon
from tests.estimate.estimate_arm import (
    GRAVITY,
    Log,
    Solved,
    beside,
    prior,
    solve,
    solve_well,
    windowing_of,
)
from tests.estimate.estimate_walk import BASE, Walk, logged, readings_of
from tests.slow import slow_after

Imu = tuple[str, Solved, KinematicPath]

LEG = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 1.0, 0.0))
"""Thigh and shin turn about parallel axes."""


def floating(walk: Walk, **options: Any) -> Solved:
    return solve(logged(walk), gravity="none", **options)


def test_dead_reckoning_is_motion_minus_free_fall() -> None:
    walk = Walk()
    t = np.arange(0.0, 20.0, 0.005)
    gyro, accel = readings_of(walk.trunk, BASE, t)
    quaternion, p = dead_reckon(gyro, accel, 0.005)
    R_body, p_body = walk.trunk(t)
    R, place = R_body @ BASE.R, p_body + R_body @ BASE.p
    turned = Rotation.from_matrix(R[0].T @ R).inv() * Rotation.from_quat(quaternion)
    assert turned.magnitude().max() < 2e-6
    falling = place + 0.5 * GRAVITY * t[:, None] ** 2 * np.array([0, 0, 1.0])
    error = p - falling @ R[0]
    # Over a tenth of a second, as a filter sees it.
    assert np.abs(np.diff(error[5:-5:20], 2, axis=0)).max() / 0.1**2 < 2e-4


@pytest.mark.parametrize("seconds", slow_after(1, [0.2, 0.1, 0.4]))
def test_noise_free_pose_is_exact_for_any_window(seconds: float) -> None:
    found = floating(Walk(seconds=15.0), window=WindowChoice(seconds=seconds))
    assert found.distance < 2e-6
    assert found.angle < 2e-6


@pytest.mark.parametrize("walks", slow_after(0, [2, 8]))
def test_sigma_matches_errors_with_noise_and_all_model_errors(walks: int) -> None:
    """The sum of squares is chi-squared of six degrees a walk."""
    total = 0.0
    for seed in range(walks):
        found = floating(Walk(seed=seed, noisy=True, scale=3e-3, zero=1e-3, base_off=(1e-3, 3e-3)))
        assert found.trusted
        assert found.distance < 1e-3
        assert found.angle < np.radians(0.1)
        total += found.nees
    assert chi2.ppf(0.001, 6 * walks) < total < chi2.ppf(0.999, 6 * walks)


def test_the_equations_about_another_point_are_the_same_at_the_fits_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With what the mean force of the base IMU says, which is in no window."""
    # Columns that are held for the last step are of the point before.
    monkeypatch.setattr("imucalib_cli.estimate.solution.fit._HELD", 0)
    options = MatchedOptions(gravity="none")
    fit = whole_fit(lean_fit(windowing_of(logged(Walk(noisy=True)), 0.3), options, 0.0), options)
    again = fit.equations_in(fit.layout, fit.windows.at)
    seen = fit.equations.information
    unit = np.sqrt(np.maximum(np.diag(seen), 1e-300))  # what bends by nothing is in no row
    off = (again.information - seen) / np.outer(unit, unit)
    assert np.abs(off).max() < 1e-6


def test_columns_that_are_held_for_the_next_step_give_the_same_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    options, windowing = MatchedOptions(gravity="none"), windowing_of(logged(Walk(noisy=True)), 0.3)

    def solved() -> Fit:
        return whole_fit(lean_fit(windowing, options, 0.0), options)

    held = solved()
    monkeypatch.setattr("imucalib_cli.estimate.solution.fit._HELD", 0)
    fresh = solved()
    assert not np.array_equal(held.covariance, fresh.covariance)
    assert np.abs((held.state.x - fresh.state.x) / fresh.std).max() < 0.01
    assert np.abs((held.state.t - fresh.state.t) / fresh.std[fresh.layout.pose][:3]).max() < 0.01
    assert held.std == pytest.approx(fresh.std, rel=0.01)


def test_three_clocks_have_offsets_and_drifts_of_their_own_and_the_gyroscope_is_late() -> None:
    """300 parts per million are 9 ms from one end of the log to the other, and eight sigma."""
    clocks: dict[str, Any] = {"offsets": (0.006, -0.011), "drifts": (300e-6, -200e-6)}
    found = floating(Walk(noisy=True, rates=(200.0, 333.0), base_delay=0.002, **clocks))
    (base,), (std,) = found.parameter("base_time_offset")
    # In the middle of 30 s.
    assert base == pytest.approx(0.006 + 15.0 * 300e-6, abs=5 * std)
    true = -0.011 - 15.0 * 200e-6
    assert found.time_offset == pytest.approx(true, abs=5 * (found.time_offset_std or 0.0))
    assert std < 1e-3
    for name, true, most in (
        ("base_clock_drift", 300e-6, 30e-6),
        ("clock_drift", -200e-6, 30e-6),
        ("base_gyro_delay", 0.002, np.inf),
    ):
        (value,), (std,) = found.parameter(name)
        assert value == pytest.approx(true, abs=4 * std)
        assert std < most
    assert found.covered


def test_gap_in_base_imu_is_excluded() -> None:
    log = logged(Walk(noisy=True))
    base, joints = log.path.tracks
    kept = (base.t < 9.0) | (base.t > 12.0)
    short = replace(base, t=base.t[kept], values=base.values[kept])
    found = solve(replace(log, path=replace(log.path, tracks=(short, joints))), gravity="none")
    whole = floating(Walk(noisy=True))
    assert found.residuals.gaps == 1
    assert found.residuals.windows_used < 0.95 * whole.residuals.windows_used
    assert found.covered


def test_two_imus_on_one_body_are_calibrated_to_each_other() -> None:
    found = solve_well(logged(Walk(axes=(), noisy=True)), gravity="none")
    assert found.distance < 1e-3
    assert found.angle < np.radians(0.05)


def test_vibration_between_two_imus_is_no_filter_of_both() -> None:
    """The same filter on both would only make the difference of their readings smaller."""
    log = logged(Walk(axes=(), noisy=True, seed=4))
    rng = np.random.default_rng(4)
    below_10_hertz = butter(2, 10.0, fs=200.0, output="sos")
    accel, gyro = sosfilt(below_10_hertz, rng.normal(size=(2, len(log.imu.t), 3)), axis=1)
    imu = replace(log.imu, accel=log.imu.accel + 0.2 * accel, gyro=log.imu.gyro + 0.02 * gyro)
    found = solve_well(replace(log, imu=imu), gravity="none")
    assert found.distance < 2e-3
    assert not [each for each in found.findings if each.code.startswith("unknown.")]


@pytest.mark.slow
def test_displaced_base_imu_is_found_where_observable() -> None:
    """A centimetre and three degrees: larger than any drawing is wrong."""
    walk = Walk(noisy=True, base_off=(5e-3, 0.03))
    found = floating(walk)
    assert "unknown.found" in found.codes
    assert found.covered
    assert floating(walk, base_std=(0.0,) * 6).distance > 0.01


@pytest.mark.slow
def test_base_imu_prior_is_in_sigma_where_unobservable() -> None:
    """One joint: a shift of both IMUs along its axis changes nothing."""
    walk = Walk(noisy=True, axes=((0.0, 1.0, 0.0),))
    held, known = (floating(walk, base_std=(std,) * 3 + (0.0,) * 3).sigma[1] for std in (0.0, 2e-3))
    assert known == pytest.approx(np.hypot(held, 2e-3), rel=0.05)


def test_zero_error_names_the_similar_origin_error() -> None:
    """The thigh's zero is off by 0.8 deg."""
    walk = Walk(seed=1, noisy=True, axes=LEG, zero=0.01)
    found = floating(walk, robot=(0.01, 3e-4))
    assert found.covered
    zeros = {
        each.values["labels"]: each.values["like"]
        for each in found.findings
        if each.values["name"] == "joint_zero"
    }
    assert zeros == {("j0",): "", ("j1",): "origin between two joints (j2 x)"}
    values = {each.label: each.value for each in found.parameters if each.name == "joint_zero"}
    assert values["j0"] == pytest.approx(walk.zeros[0], abs=2e-4)
    assert values["j1"] == pytest.approx(walk.zeros[1], abs=1e-3)


def test_parallel_joints_add_no_false_information() -> None:
    """Turned at the hip or at the foot, moving the knee with it: the log is the same."""
    equations = floating(Walk(axes=LEG, noisy=True)).log_statistics.equations
    pose = {"translation", "rotation", "origin", "joint_zero"}
    parts = [each.part for each in equations.layout.placed if each.unknown.name in pose]
    places = np.concatenate([np.arange(part.start, part.stop) for part in parts])
    A = equations.information[np.ix_(places, places)]
    unit = 1.0 / np.sqrt(np.diag(A))
    # A part in ten thousand of false columns would have held the hip to some milliradians.
    assert np.linalg.eigvalsh(A * np.outer(unit, unit))[0] < 1e-12


@pytest.mark.slow
def test_gravity_determines_common_accelerometer_scale() -> None:
    """It cancels between the two, and the lengths, which are wrong too, would follow the scale."""
    walk = Walk(seconds=61.0, noisy=True, scale=5e-3, longer=0.015, length=5e-4)
    with_gravity, without = (floating(walk, gravity_norm=norm) for norm in (GRAVITY, 0.0))
    assert with_gravity.covered
    assert with_gravity.distance < 3e-4
    assert without.distance > 8e-4


@pytest.mark.slow
def test_one_hour_log_keeps_precision() -> None:
    """The last minute of an hour gives the pose of the first, after a fall of 60 000 km."""
    log = Walk(seconds=3600.0).log()
    for start in (0.0, 3540.0):
        part = log.kept((log.imu.t >= start) & (log.imu.t < start + 60.0))
        found = solve(part, gravity="none")
        assert found.distance < 2e-6
        assert found.angle < 2e-6


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
    return [beside(*each) for each in zip(solve_imus_together(imus), mounts, strict=True)]


@lru_cache(maxsize=16)
def joined(seed: int) -> list[Solved]:
    return jointly(imus(seed))


def statistics(imus: Sequence[Imu]) -> list[LogStatistics]:
    return [found.log_statistics for _, found, _ in imus]


def alone(log: LogStatistics) -> Answer:
    return log.equations.solve(log.options)


def test_joint_solution_of_one_imu_equals_its_own() -> None:
    foot = imus(2)[1]
    (log,) = statistics([foot])
    own, (found,) = alone(log), solve_together([log])
    np.testing.assert_allclose(found.state.t, own.state.t, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.state.R, own.state.R, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.state.x, own.state.x, rtol=0, atol=1e-10)
    scale = np.sqrt(np.diag(own.covariance)) + 1e-300
    difference = (found.covariance - own.covariance) / np.outer(scale, scale)
    assert np.abs(difference).max() < 1e-8
    assert solve_imus_together([foot]) == [foot[1]]


def named(place: int, placed: Placed, index: int) -> dict[tuple[object, ...], float]:
    """A component as a sum of unknowns of the robot or of one IMU."""
    label = placed.labels[index]
    if isinstance(placed.unknown.effect, Origin):
        name, joint = placed.unknown.name, label.split(" ")[0]
        return {(name, joint, axis): float(e) for axis, e in enumerate(placed.directions[index])}
    shared = placed.unknown.name.startswith(("joint_", "base_"))
    return {("all" if shared else place, placed.unknown.name, label): 1.0}


def test_joint_solution_matches_dense_system() -> None:
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


@pytest.mark.parametrize("seeds", slow_after(0, [[2, 3], range(24)]))
def test_joint_solution_has_smaller_errors_and_correct_sigma(seeds: Sequence[int]) -> None:
    before = [found for seed in seeds for _, found, _ in imus(seed)]
    after = [found for seed in seeds for found in joined(seed)]
    assert all("imus.together" in each.codes for each in after)
    rms = [np.sqrt(np.mean([each.distance**2 for each in group])) for group in (before, after)]
    assert rms[1] < 0.95 * rms[0]
    assert sum(each.nees for each in after) < chi2.ppf(0.999, 12 * len(seeds))


@pytest.mark.parametrize("seeds", slow_after(1, [[2, 3], range(4)]))
def test_shared_unknowns_are_equal_and_more_accurate(seeds: Sequence[int]) -> None:
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


def test_result_does_not_depend_on_imu_order() -> None:
    turned = solve_imus_together(imus(2)[::-1])[::-1]
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


def test_two_disagreeing_imus_are_solved_alone_and_reported() -> None:
    foot = imus(2)[1]
    wrong = imu("/imu/shank", with_wrong_zero(walk(2).shank()))
    assert wrong[1].trusted
    sigmas = []
    for each, before, other in zip(
        jointly([wrong, foot]), (wrong[1], foot[1]), (foot[0], wrong[0]), strict=True
    ):
        np.testing.assert_array_equal(each.t_parent_imu, before.t_parent_imu)
        disagree = each.finding("imus.disagree")
        assert disagree["others"] == (other,)
        sigmas.append(disagree["sigmas"])
    # The one with the wrong zero moves farther from its own answer.
    assert sigmas[0] > max(6.0, 2.0 * sigmas[1])


@pytest.mark.slow
def test_disagreeing_imu_of_three_is_left_out() -> None:
    shank, foot = imus(2)
    wrong = imu("/imu/thigh", with_wrong_zero(walk(2).shank()))
    logs = statistics([shank, wrong, foot])
    solved = solve_agreeing(logs, [alone(log) for log in logs])
    assert list(solved.disagreeing) == [1]
    for place, answer in zip((0, 2), solve_together([logs[0], logs[2]]), strict=True):
        np.testing.assert_array_equal(solved.answers[place].state.t, answer.state.t)


@pytest.mark.parametrize("names", slow_after(0, ["tx ty tz", "tx ty tz rx ry rz"]))
def test_fixed_mount_components_stay_fixed(names: str) -> None:
    held = dict.fromkeys(names.split(), 0.0)
    logs = {"/imu/shank": walk(2).shank(), "/imu/foot": logged(walk(2))}
    found = jointly([imu(name, log, pose=prior(log.mount, **held)) for name, log in logs.items()])
    for each in found:
        assert "imus.together" in each.codes
        np.testing.assert_allclose(each.t_parent_imu, each.mount.t, rtol=0, atol=1e-12)
        assert (each.sigma[:3] == 0.0).all()
        assert ((each.sigma[3:] == 0.0) == ("rx" in held)).all()


def test_untrusted_imu_is_not_combined() -> None:
    (name, shank, path), foot = imus(2)
    vague = replace(shank, statistics=replace(shank.log_statistics, widened=1e-6 * np.eye(6)))
    assert solve_imus_together([(name, vague, path), foot]) == [vague, foot[1]]


def test_only_chains_of_one_inexact_robot_are_combined() -> None:
    shank, foot = (OnRobot.of(each.log_statistics, path) for _, each, path in imus(2))
    assert groups([shank, foot]) == [[0, 1]]
    elsewhere = replace(foot, joints={**foot.joints, "j0": "/other/joint_states"})
    assert groups([shank, elsewhere]) == []
    assert groups([shank, replace(foot, root=("map",)), foot]) == [[0, 2]]
    exact = replace(foot.log, options=replace(foot.log.options, robot="exact"))
    assert groups([shank, replace(foot, log=exact)]) == []


def test_chains_splitting_at_base_have_separate_base_offsets() -> None:
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
        _, covariance = system.problem.posterior(middle[None], np.ones(1))
        return np.diag(own @ covariance @ own.T)[part]

    apart = variances([shank, replace(foot, equations=equations)])
    assert (apart > variances([shank, foot])).all()


def test_joints_may_bend_behind_a_base_imu() -> None:
    """Both IMUs fall freely there, so gravity is in the acceleration that loads the joints."""
    names = {each.name for each in floating(Walk(noisy=True)).parameters}
    assert "joint_sag" in names
    assert "gravity_norm" not in names
