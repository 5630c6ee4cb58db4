"""Faults put into readings of which all else is known, and values of no IMU."""

import numpy as np
import pytest
from msgspec.structs import replace

from imucalib_cli.arrays import Floats
from imucalib_cli.errors import InputError
from imucalib_cli.signals.imu.checks import refuse_impossible
from imucalib_cli.signals.imu.faults import Fault, dead_axes, flat_tops, held_samples, sensor_faults
from imucalib_cli.signals.imu.repair import rows_at_fault
from imucalib_cli.signals.samples import ImuSamples, Sensor
from imucalib_cli.signals.stretches import stretches_of
from imucalib_cli.signals.timing.stamps import gap_breaks
from imucalib_cli.signals.trajectory import Trajectory
from imucalib_cli.signals.turning import Turning, compare_turning
from tests.estimate.estimate_arm import INDUSTRIAL, MEMS, Log, make_log

MPU = (np.radians(250 / 32768), 2 * 9.80665 / 32768)
WIDE = (np.radians(2000 / 32768), 16 * 9.80665 / 32768)
COARSE = (np.radians(0.1), 0.04)
"""Quanta of gyroscope and accelerometer."""


@pytest.fixture(scope="module")
def clean() -> Log:
    return make_log(time_offset=0.2)


def _rounded(values: Floats, quantum: float) -> Floats:
    return np.asarray(np.round(values / quantum) * quantum if quantum else values)


def _sensed(log: Log, densities: tuple[float, float], quanta: tuple[float, float]) -> Log:
    imu = log.noisy(1, densities).imu if densities[0] else log.imu
    return log.with_imu(imu.t, _rounded(imu.gyro, quanta[0]), _rounded(imu.accel, quanta[1]))


def _turning(log: Log) -> Turning:
    return compare_turning(log.imu.t, log.imu.gyro, Trajectory.of(log.path), 1.0)


@pytest.mark.parametrize("quanta", [(0.0, 0.0), MPU, WIDE, COARSE])
@pytest.mark.parametrize("densities", [(0.0, 0.0), INDUSTRIAL, MEMS])
def test_healthy_sensor_has_no_fault(
    clean: Log, densities: tuple[float, float], quanta: tuple[float, float]
) -> None:
    log = _sensed(clean, densities, quanta)
    imu = log.imu
    assert sensor_faults(imu, _turning(log)) == []
    assert held_samples(imu) == ()
    assert dead_axes(imu.gyro) == dead_axes(imu.accel) == ""
    assert _turning(log).held_robot() == []


@pytest.mark.parametrize("quanta", [(0.0, 0.0), COARSE])
@pytest.mark.parametrize("times", [2, 4])
def test_held_samples_are_found(clean: Log, quanta: tuple[float, float], times: int) -> None:
    imu = _sensed(clean, MEMS, quanta).imu
    rate = 1.0 / float(np.median(np.diff(imu.t)))
    held = np.arange(len(imu)) // times * times
    (finding,) = held_samples(replace(imu, gyro=imu.gyro[held], accel=imu.accel[held]))
    assert finding.values["share"] == pytest.approx(1.0 - 1.0 / times, abs=0.02)
    assert finding.values["rate"] == pytest.approx(rate / times, rel=0.05)


def test_repeats_of_one_sensor_or_at_rest_are_not_held_samples(clean: Log) -> None:
    """A gyroscope that is slower than the accelerometer, and a coarse sensor that rests."""
    imu = _sensed(clean, MEMS, (0.0, 0.0)).imu
    held = np.arange(len(imu)) // 2 * 2
    assert held_samples(replace(imu, gyro=imu.gyro[held])) == ()
    resting = replace(imu, gyro=np.zeros_like(imu.gyro), accel=np.full_like(imu.accel, 5.7))
    assert held_samples(resting) == ()


def test_rotation_rates_agree_for_any_mount(clean: Log) -> None:
    turning = _turning(_sensed(clean, MEMS, (0.0, 0.0)))
    assert turning.lag == pytest.approx(0.2, abs=0.01)
    assert turning.ratio is not None
    assert turning.ratio.value == pytest.approx(1.0, abs=0.01)
    assert turning.correlation > 0.99
    # biases that estimate_arm adds
    np.testing.assert_allclose(turning.bias, (0.01, -0.02, 0.005), atol=2e-3)


@pytest.mark.parametrize(
    ("densities", "quanta"), [(MEMS, (0.0, 0.0)), (INDUSTRIAL, WIDE), (INDUSTRIAL, COARSE)]
)
def test_sensor_frozen_in_motion_is_found(
    clean: Log, densities: tuple[float, float], quanta: tuple[float, float]
) -> None:
    imu = _sensed(clean, densities, quanta).imu
    first, end = 1100, 1500
    gyro, accel = imu.gyro.copy(), imu.accel.copy()
    gyro[first:end], accel[first:end] = gyro[first], accel[first]
    for frozen in ({"gyro": gyro, "accel": accel}, {"gyro": gyro}, {"accel": accel}):
        found = replace(imu, **frozen)
        faults = sensor_faults(found, _turning(replace(clean, imu=found)))
        assert {fault.sensor for fault in faults} == set(frozen)
        for fault in faults:
            assert (fault.kind, fault.axes) == ("frozen", "xyz")
            assert fault.rows[first:end].all()
            # At rest before and after, a coarse sensor repeats itself anyway.
            assert fault.rows.sum() < 1.5 * (end - first)


def test_single_frozen_axis_is_found(clean: Log) -> None:
    imu = _sensed(clean, MEMS, WIDE).imu
    gyro = imu.gyro.copy()
    gyro[2000:2300, 1] = gyro[2000, 1]
    (fault,) = sensor_faults(replace(imu, gyro=gyro), _turning(clean))
    assert (fault.sensor, fault.kind, fault.axes) == ("gyro", "frozen", "y")
    assert fault.rows[2000:2300].all()
    assert fault.rows.sum() == 300


@pytest.mark.parametrize(
    ("densities", "quanta"), [(MEMS, WIDE), (INDUSTRIAL, WIDE), (MEMS, (0, 0))]
)
def test_saturation_is_found_on_both_sides(
    clean: Log, densities: tuple[float, float], quanta: tuple[float, float]
) -> None:
    imu = _sensed(clean, densities, quanta).imu
    limit = 0.6 * float(np.abs(imu.gyro).max())
    gyro = np.clip(imu.gyro, -limit, limit)
    log = clean.with_imu(imu.t, gyro, imu.accel)
    (fault,) = sensor_faults(log.imu, _turning(log))
    assert (fault.sensor, fault.kind) == ("gyro", "saturated")
    clipped = (np.abs(gyro) == limit).any(axis=1)
    # A short reading of a quiet sensor at its limit may be real.
    assert fault.rows.sum() >= (1.0 if densities is MEMS else 0.8) * clipped.sum()
    assert not fault.rows[~clipped].any()
    assert set(np.abs(fault.value)) == {limit}


def test_saturated_accelerometer_is_found(clean: Log) -> None:
    imu = _sensed(clean, MEMS, WIDE).imu
    limit = float(np.percentile(np.abs(imu.accel[:, 0]), 97))
    accel = imu.accel.copy()
    accel[:, 0] = np.clip(accel[:, 0], -limit, limit)
    (fault,) = sensor_faults(replace(imu, accel=accel), _turning(clean))
    assert (fault.sensor, fault.kind, fault.axes) == ("accel", "saturated", "x")
    assert fault.rows.sum() == (np.abs(accel[:, 0]) == limit).sum()


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_one_flat_top_is_not_a_frozen_axis(sensor: Sensor) -> None:
    """A slow swing at 50 Hz: a dozen samples at the limit, and other peaks just below it."""
    t = np.arange(1500) / 50.0
    swings = np.cos(np.outer(t, (0.9, 1.4, 0.7)))
    swings[(t > 12.0) & (t < 16.0), 0] *= 1.01
    noisy = swings + np.random.default_rng(3).normal(scale=1e-3, size=swings.shape)
    cut = np.minimum(noisy, (1.0035, 9.0, 9.0))
    readings = {"gyro": 2.0 * noisy, "accel": 9.8 * noisy}
    readings[sensor] = {"gyro": 2.0, "accel": 9.8}[sensor] * cut
    (fault,) = sensor_faults(ImuSamples(t=t, **readings), None)
    assert (fault.sensor, fault.kind, fault.axes) == (sensor, "saturated", "x")
    assert fault.rows.sum() == (cut[:, 0] == 1.0035).sum() < 20


def _struck(quantum: float = 0.0, seed: int = 4) -> Floats:
    """Strikes of 6 to 14 ms, some m/s² of noise-free motion, and a MEMS sensor's noise, 500 Hz."""
    rng = np.random.default_rng(seed)
    t = np.arange(30_000) / 500.0
    accel = 3.0 * np.sin(np.outer(t, (3.0, 5.0, 7.0))) + (0.0, 0.0, 9.8)
    for start in range(100, len(t) - 100, 125):
        length = int(rng.integers(3, 7))
        size = rng.exponential(60.0) * rng.normal(size=3)
        accel[start : start + length] += np.outer(np.hanning(length + 2)[1:-1], size)
    return _rounded(accel + rng.normal(scale=0.05, size=accel.shape), quantum)


@pytest.mark.parametrize("quantum", [0.0, 8 * 9.80665 / 32768])
def test_clipped_peaks_of_one_or_two_samples_are_found(quantum: float) -> None:
    accel = _struck(quantum)
    limit = 8 * 9.80665
    cut = np.clip(accel, -limit, limit)
    lengths = stretches_of((np.abs(cut) == limit).any(axis=1)).lengths
    assert len(lengths) > 20
    assert np.median(lengths) <= 2
    imu = ImuSamples(t=np.arange(len(cut)) / 500.0, gyro=0.1 * _struck(seed=5), accel=cut)
    (fault,) = sensor_faults(imu, None)
    assert (fault.sensor, fault.kind) == ("accel", "saturated")
    assert set(np.abs(fault.value)) == {limit}
    assert fault.rows.sum() >= 0.9 * (np.abs(cut) == limit).any(axis=1).sum()


@pytest.mark.parametrize("quantum", [0.0, 0.3, 0.9, 1.0, 1.5, 4.0])
@pytest.mark.parametrize("motion", ["rest", "swing", "postures", "strikes", "turns"])
def test_largest_value_of_healthy_sensor_is_not_a_limit(motion: str, quantum: float) -> None:
    """Quanta of so many standard deviations of the noise."""
    rng = np.random.default_rng(6)
    t = np.arange(20_000) / 200.0
    values = {
        "rest": np.zeros((len(t), 3)),
        "swing": 20.0 * np.sin(np.outer(t, (3.1, 1.6, 6.3))),
        "postures": np.repeat(rng.choice([0.0, 5.0, -5.0, 9.8], size=(200, 3)), 100, axis=0),
        "strikes": 20.0 * _struck()[: len(t)],
        "turns": 9.8 * np.cos(np.cumsum(0.01 * rng.normal(size=(len(t), 3)), axis=0)),
    }[motion] + rng.normal(size=(len(t), 3))
    assert not [top for top in flat_tops(_rounded(values, quantum)) if top.shape == "certain"]


def test_a_steady_rotation_is_not_saturation() -> None:
    """A plateau without noise: the rate is flat, and the kinematics turn as fast."""
    t = np.arange(0.0, 12.0, 0.005)
    rate = np.clip(3.0 * np.sin(t), -1.5, 1.5)
    gyro = np.stack([np.zeros_like(t), np.zeros_like(t), rate], axis=1)
    accel = np.tile([0.0, 0.0, 9.80665], (len(t), 1))
    imu = ImuSamples(t=t, gyro=gyro, accel=accel)
    assert flat_tops(gyro)  # from the values alone it looks like one
    bins = int(12.0 / 0.05)
    mean = np.abs(rate.reshape(bins, -1).mean(axis=1))
    turning = Turning(0.0, mean, mean, np.zeros(3), 0.0, 1.0)
    assert sensor_faults(imu, turning) == []
    lively = np.where(mean < 1.3, mean, 1.1 * mean)
    cut = Turning(0.0, lively, mean, np.zeros(3), 0.0, 1.0)
    (fault,) = sensor_faults(imu, cut)
    assert (fault.sensor, fault.kind, fault.axes) == ("gyro", "saturated", "z")


def test_dead_axes_are_distinguished_from_axes_at_rest() -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(size=(2000, 3)) * (0.01, 0.0, 0.01)
    assert dead_axes(values) == "y"
    assert dead_axes(values * (1, 1, 0)) == "yz"
    planar = np.stack([np.zeros(2000), np.zeros(2000), np.sin(np.arange(2000) / 50)], axis=1)
    assert dead_axes(planar) == ""
    assert dead_axes(_rounded(planar, 0.01)) == ""


def test_windows_do_not_cross_excluded_rows() -> None:
    t, zeros = np.arange(2000) / 1000.0, np.zeros((2000, 3))
    rows = np.zeros(2000, dtype=bool)
    rows[500:503] = True  # 3 ms: alone it would be bridged
    fault = Fault("gyro", "frozen", rows, "xyz", np.zeros(3))
    out = rows_at_fault(ImuSamples(t=t, gyro=zeros, accel=zeros), [fault])
    assert out[500:503].all()
    assert out.sum() < 40
    assert len(gap_breaks(t[~out])) == 1


def test_clock_mismatch_or_slow_robot_is_not_a_frozen_robot(clean: Log) -> None:
    imu = clean.noisy(3).imu
    apart, turning = (
        compare_turning(imu.t + shift, imu.gyro, Trajectory.of(clean.path), 1.0)
        for shift in (4.7, 0.0)
    )
    assert apart.held_robot() == []
    # Where nearly all rates are alike, their correlation has no information.
    derived = np.full_like(turning.derived, 0.1)
    derived[5] = 1.0
    half = len(derived) // 2
    derived[half:] = 0.0
    measured = np.where(np.arange(len(derived)) < half, turning.measured, 1.0)
    assert replace(turning, derived=derived, measured=measured).held_robot() == []


def test_smooth_clipping_is_saturation_only_at_known_range() -> None:
    """It ends so gradually that the values do not show it."""
    t, top, quantum = np.arange(4000) / 200.0, 2 * 9.80665, MPU[1]
    # Barely beyond the range, so that the slope before the flat top is that of any motion.
    swing = 1.004 * top * np.sin(2 * np.pi * 0.5 * t)
    rest = 0.3 * np.sin(1.3 * t), 9.8 + 0.2 * np.cos(0.7 * t)
    accel = _rounded(np.stack([np.clip(swing, -top, top), *rest], axis=1), quantum)
    gyro = 0.01 * np.stack([np.sin(0.4 * t), np.cos(0.3 * t), np.sin(0.2 * t)], axis=1)
    imu = ImuSamples(t=t, gyro=gyro, accel=accel)
    assert sensor_faults(imu, None) == []
    (fault,) = sensor_faults(imu, None, (top, 2 * top))
    assert (fault.sensor, fault.kind, fault.axes) == ("accel", "saturated", "x")
    assert fault.value == pytest.approx([-top, top], rel=1e-4)
    assert fault.rows.sum() == (np.abs(swing) >= top - quantum / 2).sum()
    # At another range the same top is the motion's.
    assert sensor_faults(imu, None, (3 * top,)) == []


def _imu(gyro: float = 0.1, accel: float = 9.8, *, share: float = 1.0) -> ImuSamples:
    """A level IMU of which a share of the rows has these values instead."""
    count = 1000
    stream = ImuSamples(
        topic="/imu",
        t=np.arange(count, dtype=np.float64) * 0.01,
        gyro=np.full((count, 3), 0.1),
        accel=np.tile([0.0, 0.0, 9.8], (count, 1)),
    )
    rows = np.random.default_rng(0).permutation(count)[: round(share * count)]
    stream.gyro[rows, 0] = gyro
    stream.accel[rows, 2] = accel
    return stream


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"gyro": 1.01e3}, "gyro is beyond 1000 rad/s in 1000 of 1000 messages"),
        ({"gyro": -1e8}, "gyro is beyond 1000 rad/s"),
        ({"accel": 1e8}, "accel is beyond 100000 m/s²"),
        ({"accel": -1.01e5, "share": 0.6}, "accel is beyond 100000 m/s² in 600 of 1000"),
    ],
)
def test_impossible_imu_values_are_refused(values: dict[str, float], says: str) -> None:
    with pytest.raises(InputError) as caught:
        refuse_impossible(_imu(**values))
    assert str(caught.value).startswith(f"/imu: {says}")
    refuse_impossible(_imu(**values | {"share": 0.001}))  # the estimator interpolates
