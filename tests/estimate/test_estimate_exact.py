"""Without noise the answer is exact: any window, degree, mount, offset, rate, tilt or hole.

The arm moves in quintics, whose jerk jumps at starts and stops: what is left is quadrature of
order dt², so the tolerance is a micrometre at 500 Hz and grows with the interval squared.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib_cli.errors import InputError
from imucalib_cli.estimate.options import WindowChoice
from tests.estimate.estimate_arm import (
    GRAVITY,
    MOUNT,
    Log,
    Moves,
    arm_path,
    calibrated,
    make_log,
    parent_motion,
    random_mount,
    readings,
    rotation_error,
    taken_as_exact,
)
from tests.slow import slow_after

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate

MICROMETRE = 1e-6
ANGLE = np.radians(1e-4)


def assert_exact(
    estimate: Estimate,
    log: Log,
    metres: float = 2 * MICROMETRE,
    seconds: float = 2e-7,
    angle: float = ANGLE,
) -> None:
    assert np.linalg.norm(estimate.t_parent_imu - log.mount.t) < metres
    assert np.linalg.norm(rotation_error(estimate.R_parent_imu, log.mount.R)) < angle
    assert abs(estimate.time_offset - log.time_offset) < seconds
    assert estimate.trusted, (estimate.unobservable, estimate.distrust)


@pytest.fixture(scope="module")
def fine() -> Log:
    return make_log(imu_rate=500.0, robot_rate=500.0)


@pytest.fixture(scope="module")
def plain() -> Log:
    return make_log()


@pytest.mark.parametrize("seconds", slow_after(1, [0.05, 0.5, 0.1, 0.2, 0.35]))
def test_every_window_gives_the_same_micrometre(fine: Log, seconds: float) -> None:
    estimate = taken_as_exact(fine, window=WindowChoice(seconds=seconds))
    assert_exact(estimate, fine, MICROMETRE)
    assert estimate.window.seconds == pytest.approx(seconds, abs=1.001 / 500)
    np.testing.assert_allclose(estimate.accel_bias, 0.0, atol=1e-5)
    np.testing.assert_allclose(estimate.gyro_bias, 0.0, atol=1e-7)
    np.testing.assert_allclose(estimate.gravity_world, [0, 0, -GRAVITY], atol=1e-5)


@pytest.mark.parametrize("seed", slow_after(1, range(3)))
def test_what_may_be_wrong_with_robot_and_sensor_takes_nothing(seed: int) -> None:
    """With every unknown free: what is left of the quadrature then has more to move."""
    log = make_log(mount=random_mount(seed))
    estimate = calibrated(log)
    assert_exact(estimate, log, 12 * MICROMETRE, seconds=1e-6)
    assert estimate.warnings == ()


@pytest.mark.parametrize("degree", slow_after(1, [2, 4, 3]))
def test_every_degree_is_exact(plain: Log, degree: int) -> None:
    assert_exact(taken_as_exact(plain, degree=degree), plain)


@pytest.mark.parametrize("offset", slow_after(1, [0.9, -0.2173, 0.5, -0.5, -0.0421]))
def test_offsets_are_found_and_are_imu_stamp_minus_robot_stamp(offset: float) -> None:
    # The same instant is stamped later by the IMU where the offset is positive.
    log = make_log(time_offset=offset)
    assert log.imu.t[0] == pytest.approx(offset)
    estimate = taken_as_exact(log)
    assert_exact(estimate, log)
    assert estimate.time_offset_std is not None


def test_an_offset_that_is_told_is_kept() -> None:
    log = make_log(time_offset=0.1234)
    estimate = taken_as_exact(log, time_offset=0.1234)
    assert_exact(estimate, log)
    assert estimate.time_offset == pytest.approx(0.1234, abs=1e-12)
    assert estimate.time_offset_std is None
    wrong = taken_as_exact(log, time_offset=0.1)
    assert np.linalg.norm(wrong.t_parent_imu - log.mount.t) > 1e-3


def test_an_offset_beyond_the_search_is_not_trusted() -> None:
    estimate = taken_as_exact(make_log(time_offset=1.02), max_offset=0.5)
    assert not estimate.trusted
    assert any("--max-offset" in reason or "explain" in reason for reason in estimate.distrust)


@pytest.mark.parametrize("seed", slow_after(1, range(6)))
def test_any_mount_is_found_without_a_guess(seed: int) -> None:
    log = make_log(mount=random_mount(seed))
    assert_exact(taken_as_exact(log), log)


@pytest.mark.parametrize("tilt", slow_after(1, [0.5, np.pi, 0.05, 1.5, np.pi / 2, 2.5]))
def test_a_base_may_lean_or_hang_from_the_ceiling(tilt: float) -> None:
    gravity = Rotation.from_rotvec([0.6 * tilt, 0.8 * tilt, 0]).apply([0, 0, -GRAVITY])
    log = make_log(gravity_world=gravity)
    estimate = taken_as_exact(log)
    assert_exact(estimate, log)
    np.testing.assert_allclose(estimate.gravity_world, gravity, atol=2e-5)


def test_gravity_may_be_absent_fixed_or_of_another_planet(plain: Log) -> None:
    space = make_log(gravity_world=np.zeros(3))
    estimate = taken_as_exact(space, gravity="none")
    assert_exact(estimate, space)
    np.testing.assert_array_equal(estimate.gravity_world, 0.0)
    estimate = taken_as_exact(plain, gravity="fixed")
    assert_exact(estimate, plain)
    np.testing.assert_array_equal(estimate.gravity_world, [0, 0, -GRAVITY])
    mars = make_log(gravity_world=np.array([0.3, -0.2, -3.7]))
    assert_exact(taken_as_exact(mars, gravity_norm=float(np.linalg.norm([0.3, -0.2, -3.7]))), mars)


def test_biases_are_found_in_the_imu_frame(plain: Log) -> None:
    log = plain.noisy(0, (0.0, 0.0))
    estimate = taken_as_exact(log)
    assert_exact(estimate, log)
    np.testing.assert_allclose(estimate.accel_bias, [0.1, -0.05, 0.08], atol=2e-5)
    np.testing.assert_allclose(estimate.gyro_bias, [0.01, -0.02, 0.005], atol=1e-7)


@pytest.mark.parametrize(
    ("imu_rate", "robot_rate"),
    slow_after(1, [(97, 211), (500, 100), (200, 125), (100, 500), (400, 50)]),
)
@pytest.mark.parametrize("seconds", slow_after(1, [None, 0.5]))
def test_rates_need_not_agree(imu_rate: float, robot_rate: float, seconds: float | None) -> None:
    log = make_log(imu_rate=imu_rate, robot_rate=robot_rate, time_offset=0.0123)
    window = WindowChoice(seconds=seconds)
    # Quadrature on the IMU's interval: a tenth of a micrometre at 500 Hz.
    assert_exact(
        taken_as_exact(log, window=window), log, max(MICROMETRE, 4e-6 * (100 / imu_rate) ** 2)
    )


def test_both_streams_taken_late_are_read_as_stamped() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(1, 3990) / 200 + np.clip(rng.normal(size=3989) * 5e-4, -2e-3, 2e-3)
    log = make_log(imu_t=t)
    t_robot = np.sort(np.arange(0, 20, 0.008) + rng.normal(size=2500) * 8e-4)
    both = replace(log, path=arm_path(t_robot, Moves().joints(t_robot)[0]))
    estimate = taken_as_exact(both)
    assert_exact(estimate, both)
    assert (estimate.notes["imu_stamps"], estimate.notes["robot_stamps"]) == (
        "as stamped",
        "as stamped",
    )


@pytest.mark.parametrize("stream", ["imu", "robot"])
def test_stamps_that_jitter_are_read_as_ticks(plain: Log, stream: str) -> None:
    rng = np.random.default_rng(1 if stream == "imu" else 3)
    t = plain.imu.t + np.clip(rng.normal(size=4000) * 5e-4, -2e-3, 2e-3)
    imu = plain.with_imu(t, plain.imu.gyro, plain.imu.accel)
    log = imu if stream == "imu" else plain.with_joints(t=t)
    estimate = taken_as_exact(log)
    assert estimate.notes[f"{stream}_stamps"] == "ticks"
    # The mean of the jitter stays in the offset, and its sigma says so; its drift, in the pose: the
    # rate of the ticks is known to 1e-6, so they drift off by ten microseconds.
    mean = 5e-4 / np.sqrt(4000)
    metres, angle = (2, 2) if stream == "imu" else (5, 3)
    assert_exact(estimate, log, metres * MICROMETRE, seconds=4 * mean, angle=angle * ANGLE)
    assert estimate.time_offset_std is not None
    # What the ticks drift is added.
    assert 0.9 < estimate.time_offset_std / mean < 1.7


def test_lost_samples_are_bridged(plain: Log) -> None:
    kept = np.random.default_rng(2).random(4000) >= 0.02
    log = plain.kept(kept)
    assert_exact(taken_as_exact(log), log, 3 * MICROMETRE)


def assert_one_gap(log: Log, **options: Any) -> None:
    estimate = taken_as_exact(log, **options)
    assert_exact(estimate, log)
    assert estimate.residuals.gaps == 1
    assert estimate.residuals.windows_dropped == 0
    assert estimate.residuals.accel_rms.max() < 1e-3


def test_no_window_straddles_a_gap_of_the_imu(plain: Log) -> None:
    assert_one_gap(plain.kept((plain.imu.t < 7.0) | (plain.imu.t > 8.3)))


@pytest.mark.parametrize("options", [{}, {"time_offset": 0.0}])
def test_no_window_straddles_a_gap_of_the_joints(plain: Log, options: dict[str, float]) -> None:
    """Stamps of IMU and joints coincide: the first sample after the gap is itself, not a guess."""
    t = np.arange(0, 20, 0.005)
    t = t[(t < 7.0) | (t > 8.3)]
    assert_one_gap(plain.with_joints(t=t, values=Moves().joints(t)[0]), **options)


def test_garbage_beside_gaps_stays_out_of_every_window(plain: Log) -> None:
    """Two samples alone in a gap are garbage: no window may reach them."""
    t = plain.imu.t
    rows = (t < 7.0) | (np.abs(t - 7.65) < 0.004) | (t > 8.3)
    accel = np.where((np.abs(t - 7.65) < 0.004)[:, None], 1e4, plain.imu.accel)
    log = plain.with_imu(t, plain.imu.gyro, accel).kept(rows)
    estimate = taken_as_exact(log)
    assert estimate.residuals.gaps == 2
    assert_exact(estimate, log)
    assert estimate.residuals.windows_dropped == 0


def test_disordered_repeated_and_missing_values_are_left_out_and_counted(plain: Log) -> None:
    order = np.arange(4000)
    order[1000], order[1001] = 1001, 1000
    order[2000] = 1999
    accel = plain.imu.accel[order].copy()
    accel[3000] = np.nan
    log = plain.with_imu(plain.imu.t[order], plain.imu.gyro[order], accel)
    estimate = taken_as_exact(log)
    assert_exact(estimate, log)
    assert any("1 with repeated stamps, 1 not finite" in warning for warning in estimate.warnings)


def test_what_is_too_short_is_refused_in_words(plain: Log) -> None:
    with pytest.raises(InputError, match="usable samples of 40"):
        taken_as_exact(plain.kept(plain.imu.t < 0.2 - 1e-9))
    with pytest.raises(InputError, match="overlap between gaps"):
        taken_as_exact(plain.with_imu(plain.imu.t + 500.0, plain.imu.gyro, plain.imu.accel))


def test_the_helper_is_pinocchios_own_sensor_frame() -> None:
    """The lever-arm formula of the truth against pinocchio's frame at the IMU itself."""
    import pinocchio as pin

    from tests.estimate.estimate_arm import _model

    moves, t = Moves(), np.array([3.3, 7.7])
    motion = parent_motion(moves, t)
    gyro, accel = readings(motion, MOUNT, np.array([0, 0, -GRAVITY]))
    model, _, frame = _model()
    parent = model.frames[frame]
    place = parent.placement * pin.SE3(MOUNT.R, MOUNT.t)
    imu = model.addFrame(pin.Frame("imu", parent.parentJoint, 0, place, pin.FrameType.OP_FRAME))
    data = model.createData()
    for k, (q, v, a) in enumerate(zip(*moves.joints(t), strict=True)):
        pin.forwardKinematics(model, data, q, v, a)
        pin.updateFramePlacements(model, data)
        up = data.oMf[imu].rotation.T @ np.array([0, 0, GRAVITY])
        linear = pin.getFrameClassicalAcceleration(model, data, imu, pin.LOCAL).linear
        np.testing.assert_allclose(accel[k], linear + up, atol=1e-11)
        angular = pin.getFrameVelocity(model, data, imu, pin.LOCAL).angular
        np.testing.assert_allclose(gyro[k], angular, atol=1e-11)
