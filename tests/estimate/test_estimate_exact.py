"""Without noise the answer is exact: any window, degree, mount, offset, rate, tilt or hole.

Where the world, the parent frame or the IMU is turned, the answer turns with it.

The arm moves in quintics, whose jerk jumps at starts and stops: the error is quadrature of order
dt², so the tolerance is a micrometre at 500 Hz and grows with the interval squared.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from imucalib_cli.errors import InputError
from imucalib_cli.estimate.options import WindowChoice
from imucalib_cli.robot.path import FixedStep
from tests.estimate.estimate_arm import (
    GRAVITY,
    MEMS,
    Log,
    Moves,
    Solved,
    arm_path,
    make_log,
    random_mount,
    solve,
    solve_exact,
)
from tests.slow import slow_after
from tools.errors import pose_off

MICROMETRE = 1e-6
ANGLE = np.radians(1e-4)
DOWN = (0.0, 0.0, -GRAVITY)
MARS = (0.3, -0.2, -3.7)

Row = tuple[dict[str, Any], dict[str, Any], float]
"""Arguments of make_log, options, and the largest error in µm."""


@cache
def plain() -> Log:
    return make_log()


def assert_exact(
    found: Solved, log: Log, metres: float = 2.0, seconds: float = 2e-7, angle: float = ANGLE
) -> None:
    assert found.distance < metres * MICROMETRE
    assert found.angle < angle
    assert abs(found.time_offset - log.time_offset) < seconds
    assert found.trusted, (found.unobservable, found.distrust)


def leaning(tilt: float) -> Any:
    return Rotation.from_rotvec([0.6 * tilt, 0.8 * tilt, 0]).apply(DOWN)


def rates(imu: float, robot: float, seconds: float | None) -> Row:
    given = {"imu_rate": imu, "robot_rate": robot, "time_offset": 0.0123}
    # Quadrature on the IMU's interval: a tenth of a micrometre at 500 Hz.
    return given, {"window": WindowChoice(seconds=seconds)}, max(1.0, 4.0 * (100 / imu) ** 2)


GROUPS: list[dict[str, Row]] = [
    {
        f"window of {seconds} s": (
            {"imu_rate": 500.0, "robot_rate": 500.0},
            {"window": WindowChoice(seconds=seconds)},
            1.0,
        )
        for seconds in (0.05, 0.5, 0.1, 0.2, 0.35)
    },
    {f"degree {degree}": ({}, {"degree": degree}, 2.0) for degree in (2, 4, 3)},
    # The same instant is stamped later by the IMU where the offset is positive.
    {f"offset {o} s": ({"time_offset": o}, {}, 2.0) for o in (0.9, -0.2173, 0.5, -0.5, -0.0421)},
    {"stated offset": ({"time_offset": 0.1234}, {"time_offset": 0.1234}, 2.0)},
    {f"mount {seed}": ({"mount": random_mount(seed)}, {}, 2.0) for seed in range(6)},
    {
        f"base leans by {tilt:.2f} rad": ({"gravity_world": leaning(tilt)}, {}, 2.0)
        for tilt in (0.5, np.pi, 0.05, 1.5, np.pi / 2, 2.5)
    },
    {"no gravity": ({"gravity_world": (0.0, 0.0, 0.0)}, {"gravity": "none"}, 2.0)},
    {"gravity fixed": ({}, {"gravity": "fixed"}, 2.0)},
    {"on Mars": ({"gravity_world": MARS}, {"gravity_norm": float(np.linalg.norm(MARS))}, 2.0)},
    {
        f"{imu} and {robot} Hz, window {seconds}": rates(imu, robot, seconds)
        for seconds in (None, 0.5)
        for imu, robot in ((97, 211), (500, 100), (200, 125), (100, 500), (400, 50))
    },
]
ROWS = {name: row for group in GROUPS for name, row in group.items()}


@pytest.mark.parametrize("name", [name for group in GROUPS for name in slow_after(1, group)])
def test_noise_free_log_gives_exact_pose(name: str) -> None:
    given, options, most = ROWS[name]
    log = make_log(**given)
    found = solve_exact(log, **options)
    assert_exact(found, log, most)
    gravity = np.array(given.get("gravity_world", DOWN))
    np.testing.assert_allclose(found.gravity_world, gravity, atol=most * 2e-5)
    assert "gravity" not in options or np.array_equal(found.gravity_world, gravity)
    np.testing.assert_allclose(found.accel_bias, 0.0, atol=most * 1e-5)
    np.testing.assert_allclose(found.gyro_bias, 0.0, atol=most * 1e-7)
    if "time_offset" in options:
        assert found.time_offset == pytest.approx(log.time_offset, abs=1e-12)
    assert (found.time_offset_std is None) == ("time_offset" in options)
    if name.startswith("window"):
        seconds = options["window"].seconds
        assert found.window.seconds == pytest.approx(seconds, abs=1.001 / given["imu_rate"])


@pytest.mark.parametrize("seed", slow_after(1, range(3)))
def test_free_robot_and_sensor_errors_cost_little_accuracy(seed: int) -> None:
    """With every unknown free, the error of the quadrature has more to move."""
    log = make_log(mount=random_mount(seed))
    found = solve(log)
    assert_exact(found, log, 12.0, seconds=1e-6)
    assert found.warnings == ()


def test_time_offset_beyond_search_range_is_untrusted() -> None:
    found = solve_exact(make_log(time_offset=1.02), max_offset=0.5)
    assert not found.trusted
    assert any("--max-offset" in reason or "explain" in reason for reason in found.distrust)


def test_biases_are_estimated_in_the_imu_frame() -> None:
    log = plain().noisy(0, (0.0, 0.0))
    found = solve_exact(log)
    assert_exact(found, log)
    np.testing.assert_allclose(found.accel_bias, [0.1, -0.05, 0.08], atol=2e-5)
    np.testing.assert_allclose(found.gyro_bias, [0.01, -0.02, 0.005], atol=1e-7)


def test_unevenly_sampled_streams_use_their_stamps() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(1, 3990) / 200 + np.clip(rng.normal(size=3989) * 5e-4, -2e-3, 2e-3)
    t_robot = np.sort(np.arange(0, 20, 0.008) + rng.normal(size=2500) * 8e-4)
    log = replace(make_log(imu_t=t), path=arm_path(t_robot, Moves().joints(t_robot)[0]))
    found = solve_exact(log)
    assert_exact(found, log)
    assert {found.notes["imu_stamps"], found.notes["robot_stamps"]} == {"as stamped"}


@pytest.mark.parametrize("seed", range(3))
def test_late_samples_of_the_robot_are_told_from_jitter_in_noise(seed: int) -> None:
    """The size of the residuals hardly differs there; their spectrum does."""
    log, rng = make_log(), np.random.default_rng(seed)
    (track,) = log.path.tracks
    t = np.sort(track.t + rng.normal(size=len(track.t)) * 3e-4)
    late, jittered = arm_path(t, Moves().joints(t)[0]), log.with_joints(t=t).path
    for path, expected in ((late, "as stamped"), (jittered, "ticks")):
        noisy = replace(log, path=path).noisy(seed)
        assert solve_exact(noisy).notes["robot_stamps"] == expected


@pytest.mark.parametrize(
    ("stream", "seed", "metres", "angle"),
    [("imu", 1, 2.0, 2 * ANGLE), ("robot", 3, 5.0, 3 * ANGLE)],
)
def test_jittered_stamps_are_replaced_by_ticks(
    stream: str, seed: int, metres: float, angle: float
) -> None:
    rng = np.random.default_rng(seed)
    t = plain().imu.t + np.clip(rng.normal(size=4000) * 5e-4, -2e-3, 2e-3)
    log = plain().with_imu(t) if stream == "imu" else plain().with_joints(t=t)
    found = solve_exact(log)
    assert found.notes[f"{stream}_stamps"] == "ticks"
    # The mean of the jitter stays in the offset and in its sigma; its drift, in the pose: the
    # rate of the ticks is known to 1e-6, so they drift off by ten microseconds.
    mean = 5e-4 / np.sqrt(4000)
    assert_exact(found, log, metres, seconds=4 * mean, angle=angle)
    assert found.time_offset_std is not None
    # The drift of the ticks is added.
    assert 0.9 < found.time_offset_std / mean < 1.7


def outside(t: np.ndarray) -> np.ndarray:
    """Instants outside of a gap."""
    return (t < 7.0) | (t > 8.3)


def lost_samples(log: Log) -> Log:
    return log.kept(np.random.default_rng(2).random(4000) >= 0.02)


def gap_of_the_imu(log: Log) -> Log:
    return log.kept(outside(log.imu.t))


def gap_of_the_joints(log: Log) -> Log:
    """Stamps of IMU and joints coincide, so the first sample after the gap is no guess."""
    t = np.arange(0, 20, 0.005)
    t = t[outside(t)]
    return log.with_joints(t=t, values=Moves().joints(t)[0])


def garbage_in_a_gap(log: Log) -> Log:
    """Two samples alone in a gap are garbage: no window may reach them."""
    alone = np.abs(log.imu.t - 7.65) < 0.004
    accel = np.where(alone[:, None], 1e4, log.imu.accel)
    return log.with_imu(accel=accel).kept(outside(log.imu.t) | alone)


@pytest.mark.parametrize(
    ("spoil", "options", "gaps", "metres"),
    [
        (lost_samples, {}, 0, 3.0),
        (gap_of_the_imu, {}, 1, 2.0),
        (gap_of_the_joints, {}, 1, 2.0),
        (gap_of_the_joints, {"time_offset": 0.0}, 1, 2.0),
        (garbage_in_a_gap, {}, 2, 2.0),
    ],
)
def test_gaps_are_bridged_or_left_out(
    spoil: Callable[[Log], Log], options: dict[str, Any], gaps: int, metres: float
) -> None:
    log = spoil(plain())
    found = solve_exact(log, **options)
    assert_exact(found, log, metres)
    assert found.residuals.gaps == gaps
    assert found.residuals.windows_dropped == 0
    assert found.residuals.accel_rms.max() < 1e-3


def test_too_short_or_non_overlapping_log_is_refused() -> None:
    with pytest.raises(InputError, match="usable samples of 40"):
        solve_exact(plain().kept(plain().imu.t < 0.2 - 1e-9))
    with pytest.raises(InputError, match="overlap between gaps"):
        solve_exact(plain().with_imu(plain().imu.t + 500.0))


TURN = Rotation.from_rotvec([0.7, -1.1, 0.4]).as_matrix()
SHIFT = np.array([0.3, -0.2, 0.5])
STEP = FixedStep(R=TURN, p=SHIFT)


@cache
def log() -> Log:
    return make_log().noisy(3)


def in_world() -> Log:
    return replace(log(), path=replace(log().path, steps=(STEP, *log().path.steps)))


def at_parent() -> Log:
    return replace(log(), path=replace(log().path, steps=(*log().path.steps, STEP)))


def at_imu() -> Log:
    return log().with_imu(gyro=log().imu.gyro @ TURN, accel=log().imu.accel @ TURN)


def assert_close(t: np.ndarray, R: np.ndarray, plain: Solved, sigmas: float) -> None:
    """A pose is another estimate's, within so many of its sigmas."""
    error = pose_off(R, t, plain.R_parent_imu, plain.t_parent_imu)
    assert np.all(np.abs(error) < sigmas * plain.sigma)


def test_result_does_not_depend_on_world_frame() -> None:
    plain, turned = solve_exact(log()), solve_exact(in_world())
    assert_close(turned.t_parent_imu, turned.R_parent_imu, plain, 1e-4)
    np.testing.assert_allclose(turned.P, plain.P, rtol=1e-3, atol=1e-15)
    np.testing.assert_allclose(turned.gravity_world, TURN @ plain.gravity_world, atol=1e-6)


def test_other_parent_frame_transforms_pose_and_covariance() -> None:
    """The tangent is the parent frame's: both blocks turn with it, and nothing mixes."""
    plain, moved = solve_exact(log()), solve_exact(at_parent())
    # Scales are medians over axes, so the weights differ a little: far less than sigma.
    assert_close(TURN @ moved.t_parent_imu + SHIFT, TURN @ moved.R_parent_imu, plain, 0.1)
    both = np.kron(np.eye(2), TURN)
    expected = both.T @ plain.P @ both
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(moved.P / scale, expected / scale, atol=0.06)


def test_other_imu_frame_rotates_rotation_and_biases() -> None:
    plain, turned = solve_exact(log()), solve_exact(at_imu())
    np.testing.assert_allclose(turned.R_parent_imu, plain.R_parent_imu @ TURN, atol=1e-8)
    np.testing.assert_allclose(turned.t_parent_imu, plain.t_parent_imu, atol=1e-8)
    np.testing.assert_allclose(turned.accel_bias, TURN.T @ plain.accel_bias, atol=1e-7)
    np.testing.assert_allclose(turned.gyro_bias, TURN.T @ plain.gyro_bias, atol=1e-9)
    np.testing.assert_allclose(turned.P, plain.P, rtol=1e-5, atol=1e-15)
    assert turned.accel_bias_std is not None
    assert np.all(turned.accel_bias_std > 0)


@pytest.mark.slow
def test_frames_change_free_estimate_by_less_than_half_sigma() -> None:
    """Errors along axes have priors, so other axes are other priors: less than half a sigma."""
    plain, imu, parent, world = map(solve, (log(), at_imu(), at_parent(), in_world()))
    assert_close(imu.t_parent_imu, imu.R_parent_imu @ TURN.T, plain, 0.5)
    assert_close(TURN @ parent.t_parent_imu + SHIFT, TURN @ parent.R_parent_imu, plain, 0.5)
    assert_close(world.t_parent_imu, world.R_parent_imu, plain, 0.5)


def test_sigma_scales_with_the_noise() -> None:
    quiet, loud = make_log().noisy(4), make_log().noisy(4, (4 * MEMS[0], 4 * MEMS[1]))
    np.testing.assert_allclose(solve_exact(loud).sigma / solve_exact(quiet).sigma, 4.0, rtol=0.05)


def test_result_does_not_depend_on_start_time() -> None:
    late = log().with_imu(log().imu.t + 4096.0)
    later = solve_exact(late.with_joints(t=log().path.tracks[0].t + 4096.0))
    plain = solve_exact(log())
    np.testing.assert_allclose(later.t_parent_imu, plain.t_parent_imu, atol=1e-7)
    assert later.time_offset == pytest.approx(plain.time_offset, abs=1e-8)


def test_length_scale_follows_the_stated_gravity() -> None:
    """Everything measured in other units of length is the same answer in those units."""
    one_log = make_log().noisy(5)
    steps = tuple(
        replace(step, p=3.0 * step.p) if isinstance(step, FixedStep) else step
        for step in one_log.path.steps
    )
    longer = one_log.with_imu(accel=3.0 * one_log.imu.accel)
    longer = replace(longer, path=replace(longer.path, steps=steps))
    one, other = solve_exact(one_log), solve_exact(longer, gravity_norm=3.0 * GRAVITY)
    off = other.t_parent_imu / 3.0 - one.t_parent_imu
    assert np.all(np.abs(off) < 0.1 * one.sigma[:3])
    np.testing.assert_allclose(other.sigma / np.repeat([3.0, 1.0], 3), one.sigma, rtol=0.05)


@pytest.mark.parametrize("seed", slow_after(1, range(3)))
def test_white_noise_in_windows_of_five_samples_is_not_of_the_kinematics(seed: int) -> None:
    """So short windows amplify what two estimates of one noise differ by."""
    found = solve_exact(make_log(imu_rate=250.0).noisy(seed), window=WindowChoice(samples=5))
    assert "window.noisy" not in found.codes
    assert found.covered
