"""Noise: its statistics, its signs, and that a seed gives the same numbers every time."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imucalib_cli.errors import InputError
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import NoiseOptions, PhysicsOptions
from imucalib_cli.simulate.physics import record
from imucalib_cli.simulate.recording import ImuRecord, Recording, rows_kept
from tests.simulate.simulate_samples import joints, pose, recorded

RATE = 200.0
_ARRAYS = ("t", "stamp", "received", "gyro", "accel")


def still(n: int, system: str = "rihibot") -> Recording:
    """A recording whose IMU reads zero n times at 200 Hz."""
    short = record(load_system(system), PhysicsOptions(duration=0.1))
    t = np.arange(n) / RATE
    zero = np.zeros((n, 3))
    return replace(short, imu=ImuRecord.ideal(t, zero, zero))


@pytest.fixture(scope="module")
def long() -> Recording:
    return still(200_000)


@pytest.fixture(scope="module")
def arm() -> Recording:
    return recorded("rihibot", duration=6.0, robot_rate=125.0)


@pytest.fixture(scope="module")
def bar() -> Recording:
    return recorded("barbot", duration=20.0)


@pytest.mark.parametrize(
    ("options", "accel", "gyro"),
    [
        pytest.param(
            NoiseOptions(accel_noise=0.003, gyro_noise=2e-4), 0.03, 2e-3, id="density at half rate"
        ),
        pytest.param(NoiseOptions(accel_white=0.2, gyro_white=0.05), 0.2, 0.05, id="of a sample"),
        pytest.param(NoiseOptions(accel_white=0.03, accel_noise=0.004), 0.05, 0.0, id="both add"),
    ],
)
def test_white_noise_has_its_std_and_is_uncorrelated(
    long: Recording, options: NoiseOptions, accel: float, gyro: float
) -> None:
    noisy = corrupt(long, options, 1).imu
    np.testing.assert_allclose(noisy.accel.std(axis=0), accel, rtol=0.01)
    np.testing.assert_allclose(noisy.gyro.std(axis=0), gyro, rtol=0.01)
    step = (noisy.accel[1:] * noisy.accel[:-1]).mean(axis=0) / noisy.accel.var(axis=0)
    np.testing.assert_allclose(step, 0.0, atol=0.01)


def test_measured_is_true_plus_bias(arm: Recording) -> None:
    options = NoiseOptions(accel_bias=(0.1, -0.2, 0.3), gyro_bias=(0.01, 0.02, -0.03))
    biased = corrupt(arm, options, 0).imu
    np.testing.assert_allclose(biased.accel - arm.imu.accel, [[0.1, -0.2, 0.3]] * 3001, atol=1e-12)
    np.testing.assert_allclose(biased.gyro - arm.imu.gyro, [[0.01, 0.02, -0.03]] * 3001, atol=1e-12)


def test_bias_walk_grows_with_the_root_of_time() -> None:
    short = still(int(25 * RATE) + 1)
    options = NoiseOptions(accel_bias_walk=0.01, gyro_bias_walk=0.002)
    runs = [corrupt(short, options, seed).imu for seed in range(100)]
    at_rest = np.array([run.accel[0] for run in runs])
    np.testing.assert_array_equal(at_rest, 0.0)
    assert np.std([run.accel[-1] for run in runs]) == pytest.approx(0.05, rel=0.1)
    assert np.std([run.gyro[-1] for run in runs]) == pytest.approx(0.01, rel=0.1)


def test_coloured_noise_has_std_and_correlation_from_first_sample(long: Recording) -> None:
    options = NoiseOptions(accel_coloured=0.3, gyro_coloured=0.02, coloured_time=0.05)
    noisy = corrupt(long, options, 3).imu
    np.testing.assert_allclose(noisy.accel.std(axis=0), 0.3, rtol=0.03)
    np.testing.assert_allclose(noisy.gyro.std(axis=0), 0.02, rtol=0.03)
    lag = 10  # samples, one correlation time
    correlation = (noisy.accel[lag:] * noisy.accel[:-lag]).mean() / noisy.accel.var()
    assert correlation == pytest.approx(np.exp(-1), abs=0.02)
    short, slow = still(2), NoiseOptions(accel_coloured=1.0, coloured_time=10.0)
    first = [corrupt(short, slow, seed).imu.accel[0] for seed in range(400)]
    assert np.std(first) == pytest.approx(1.0, rel=0.08)


def test_spikes_affect_one_axis_per_sensor_and_are_marked(long: Recording) -> None:
    run = corrupt(long, NoiseOptions(spikes=0.005, spike_accel=20.0, spike_gyro=2.0), 1)
    thrown = np.abs(run.imu.accel).max(axis=1) > 0
    np.testing.assert_array_equal(thrown, run.imu.spiked)
    assert thrown.mean() == pytest.approx(0.005, rel=0.1)
    for values, size in ((run.imu.accel[thrown], 20.0), (run.imu.gyro[thrown], 2.0)):
        np.testing.assert_array_equal(np.sort(np.abs(values), axis=1), [[0, 0, size]] * len(values))
        assert {-size, 0.0, size} == set(np.unique(values))


def test_noise_effects_are_independent(long: Recording) -> None:
    plain = corrupt(long, NoiseOptions(accel_noise=0.003), 5)
    more = corrupt(long, NoiseOptions(accel_noise=0.003, spikes=0.01, dropouts=0.1), 5)
    kept = np.isin(plain.imu.t, more.imu.t)
    calm = ~more.imu.spiked
    np.testing.assert_array_equal(plain.imu.accel[kept][calm], more.imu.accel[calm])


def test_lost_messages_are_whole_and_counted(long: Recording) -> None:
    options = NoiseOptions(dropouts=0.02, robot_dropouts=0.5)
    run = corrupt(long, options, 1)
    assert len(long.imu.t) - len(run.imu.t) == run.imu.dropped
    assert run.imu.dropped == pytest.approx(4000, rel=0.1)
    assert len(run.imu.accel) == len(run.imu.stamp) == len(run.imu.received) == len(run.imu.t)
    left = joints(run)
    assert len(joints(long).t) - len(left.t) == left.dropped > 0
    np.testing.assert_array_equal(
        left.position, joints(long).position[np.isin(joints(long).t, left.t)]
    )


@pytest.mark.parametrize("offset", [-0.042, 0.3])
def test_time_offset_is_imu_stamp_minus_robot_stamp(arm: Recording, offset: float) -> None:
    run = corrupt(arm, NoiseOptions(time_offset=offset), 0)
    np.testing.assert_allclose(run.imu.stamp - run.imu.t, offset, atol=1e-12)
    np.testing.assert_array_equal(joints(run).stamp, joints(run).t)
    np.testing.assert_array_equal(run.imu.received, run.imu.t)  # the recorder has one clock


def test_jitter_keeps_stamp_order(long: Recording) -> None:
    mild = corrupt(long, NoiseOptions(stamp_jitter=5e-4), 1).imu
    assert (mild.stamp - mild.t).std() == pytest.approx(5e-4, rel=0.02)
    wild = corrupt(long, NoiseOptions(stamp_jitter=1.0), 1).imu
    assert np.diff(wild.stamp).min() > 0
    np.testing.assert_array_equal(wild.accel, long.imu.accel)


def test_messages_arrive_late_and_in_order(long: Recording) -> None:
    run = corrupt(long, NoiseOptions(delay=0.004, delay_jitter=0.003), 1).imu
    assert (run.received - run.t).min() >= 0.004
    assert np.diff(run.received).min() >= 0
    assert (run.received - run.t).mean() > 0.007  # queueing only adds
    np.testing.assert_array_equal(run.stamp, run.t)


def test_encoders_round_to_their_resolution(arm: Recording) -> None:
    read = joints(corrupt(arm, NoiseOptions(encoder_step=1e-4), 0)).position
    counts = read / 1e-4
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    error = read - joints(arm).position
    assert 4e-5 < np.abs(error).max() <= 5e-5 + 1e-12


def test_noise_of_encoders_and_poses_has_its_std(arm: Recording, bar: Recording) -> None:
    read = joints(corrupt(arm, NoiseOptions(encoder_noise=3e-5), 0)).position
    assert (read - joints(arm).position).std() == pytest.approx(3e-5, rel=0.05)
    run = pose(corrupt(bar, NoiseOptions(pose_noise=1e-3, pose_noise_rotation=2e-3), 0))
    assert (run.position - pose(bar).position).std() == pytest.approx(1e-3, rel=0.05)
    turn = (
        Rotation.from_quat(run.quaternion_xyzw)
        * Rotation.from_quat(pose(bar).quaternion_xyzw).inv()
    )
    assert turn.as_rotvec().std() == pytest.approx(2e-3, rel=0.05)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**63), n=st.integers(1, 6))
def test_zero_noise_changes_nothing_for_few_samples(seed: int, n: int) -> None:
    few = rows_kept(_FEW.imu, np.arange(6) < n)
    same = corrupt(replace(_FEW, imu=few), NoiseOptions(), seed)
    for field in _ARRAYS:
        np.testing.assert_array_equal(getattr(same.imu, field), getattr(few, field))


_FEW = still(6)


def test_each_publisher_has_independent_noise() -> None:
    clean = recorded("rihibot", duration=1.0, robot_rate=100.0, publishers=2)
    run = corrupt(clean, NoiseOptions(robot_stamp_jitter=1e-3), 1)
    first, second = (joints(run, k).stamp - joints(run, k).t for k in (0, 1))
    assert abs(np.corrcoef(first[: len(second)], second)[0, 1]) < 0.4


def test_adding_noise_twice_is_refused(arm: Recording) -> None:
    with pytest.raises(InputError, match="noise already"):
        corrupt(corrupt(arm, NoiseOptions(), 0), NoiseOptions(), 0)


def test_readings_saturate_at_range_and_are_counted_in_truth() -> None:
    noise = NoiseOptions(accel_white=1.0, gyro_white=0.1, accel_range=2.0, gyro_range=10.0)
    noisy = corrupt(still(5_000), noise, seed=2)
    free = corrupt(still(5_000), replace(noise, accel_range=None), seed=2).imu
    assert np.abs(noisy.imu.accel).max() == 2.0
    np.testing.assert_array_equal(noisy.imu.accel, np.clip(free.accel, -2.0, 2.0))
    beyond = (np.abs(free.accel) > 2.0).any(axis=1)
    np.testing.assert_array_equal(noisy.imu.saturated, beyond)
    assert 0.1 < beyond.mean() < 0.2  # three axes of 4.6 %
