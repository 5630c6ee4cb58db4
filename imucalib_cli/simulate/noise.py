"""Add the errors of sensors and drivers to a clean recording: simulate once, corrupt many times.

Every effect has its own random stream, so that switching one on or off does not change the others
for the same seed.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.robot.rotations import (
    matrix_from_quaternion,
    matrix_from_rotvec,
    quaternion_from_matrix,
)
from imucalib_cli.simulate.recording import (
    CameraRecord,
    ImuRecord,
    JointRecord,
    Messages,
    PoseRecord,
    Record,
    Recording,
    rows_kept,
)

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.simulate.options import NoiseOptions

Robot = JointRecord | PoseRecord

MAX_JITTER = 0.45
"""Largest jitter in sample intervals, so that stamps never change order."""


def corrupt(recording: Recording, noise: NoiseOptions, seed: int) -> Recording:
    """Add noise, biases, offsets and losses to a clean recording.

    The same recording, options and seed give the same numbers, bit for bit.

    Raises:
        ChoiceError: An option is out of range.
        InputError: The recording is corrupted already.
    """
    if recording.seed is not None:
        raise InputError("this recording has noise already; corrupt the clean one")
    _check(noise)
    imu_seed, robot_seed, camera_seed, *other_seeds = np.random.SeedSequence(seed).spawn(
        3 + len(recording.others)
    )
    imu, *others = (
        _corrupt_imu(record, noise, number, seed)
        for number, (record, seed) in enumerate(
            zip(recording.imus, (imu_seed, *other_seeds), strict=True)
        )
    )
    parts = zip(recording.robot, robot_seed.spawn(len(recording.robot)), strict=True)
    return replace(
        recording,
        imu=imu,
        others=tuple(others),
        robot=tuple(_corrupt_robot(record, noise, part_seed) for record, part_seed in parts),
        camera=recording.camera and _corrupt_camera(recording.camera, noise, camera_seed),
        noise=noise,
        seed=seed,
    )


def _corrupt_camera(
    record: CameraRecord, noise: NoiseOptions, seed: np.random.SeedSequence
) -> CameraRecord:
    s = _streams(seed, 3)
    corners = record.corners + noise.corner_noise * s[0].standard_normal(record.corners.shape)
    record = replace(record, corners=corners)
    return _publish(record, noise, noise.camera_offset, 0.0, s[1:])


def _corrupt_robot(record: Robot, noise: NoiseOptions, seed: np.random.SeedSequence) -> Robot:
    s = _streams(seed, 4)
    std = noise.encoder_noise if isinstance(record, JointRecord) else noise.pose_noise
    position = record.position + std * s[0].standard_normal(record.position.shape)
    if isinstance(record, JointRecord):
        if noise.encoder_step:
            position = np.round(position / noise.encoder_step) * noise.encoder_step
    elif noise.pose_noise_rotation:
        turn = noise.pose_noise_rotation * s[0].standard_normal(position.shape)
        R = matrix_from_rotvec(turn) @ matrix_from_quaternion(record.quaternion_xyzw)
        record = replace(record, quaternion_xyzw=quaternion_from_matrix(R))
    record = replace(record, position=position)
    record = _publish(record, noise, 0.0, noise.robot_stamp_jitter, s[1:3])
    return _lose(record, noise.robot_dropouts, s[3])


def _corrupt_imu(
    imu: ImuRecord, noise: NoiseOptions, number: int, seed: np.random.SeedSequence
) -> ImuRecord:
    """Biases are as large in every IMU, and on other axes by its number."""
    s = _streams(seed, 11)
    shape = imu.accel.shape
    accel_bias, gyro_bias = (
        np.roll(bias, number) * (-1) ** number + _walk(stream, walk, imu.t)
        for bias, stream, walk in (
            (noise.accel_bias, s[0], noise.accel_bias_walk),
            (noise.gyro_bias, s[1], noise.gyro_bias_walk),
        )
    )
    accel_std, gyro_std = white_std(noise, imu)
    accel = imu.accel + accel_bias + accel_std * s[2].standard_normal(shape)
    gyro = imu.gyro + gyro_bias + gyro_std * s[3].standard_normal(shape)
    memory = float(np.exp(-_interval(imu) / noise.coloured_time))
    accel += _coloured(s[4], noise.accel_coloured, memory, shape)
    gyro += _coloured(s[5], noise.gyro_coloured, memory, shape)
    spiked = s[6].random(len(imu.t)) < noise.spikes
    accel += _spikes(s[7], noise.spike_accel, spiked)
    gyro += _spikes(s[7], noise.spike_gyro, spiked)
    saturated = _cut_off(accel, noise.accel_range or np.inf)
    saturated |= _cut_off(gyro, noise.gyro_range or np.inf)
    imu = replace(
        imu,
        accel=accel,
        gyro=gyro,
        accel_bias=accel_bias,
        gyro_bias=gyro_bias,
        spiked=spiked,
        saturated=saturated,
    )
    imu = _publish(imu, noise, noise.time_offset, noise.stamp_jitter, s[8:10])
    return _lose(imu, noise.dropouts, s[10])


def white_std(noise: NoiseOptions, imu: ImuRecord) -> tuple[float, float]:
    """Standard deviation of the white noise of each sample and axis, m/s² and rad/s."""
    to_sample = np.sqrt(0.5 / _interval(imu))
    return (
        float(np.hypot(noise.accel_noise * to_sample, noise.accel_white)),
        float(np.hypot(noise.gyro_noise * to_sample, noise.gyro_white)),
    )


def _publish(
    record: Record,
    noise: NoiseOptions,
    offset: float,
    jitter: float,
    streams: list[np.random.Generator],
) -> Record:
    """Set stamps on the publisher's clock and receive times on the robot's; losses come later."""
    n = len(record.t)
    limit = MAX_JITTER * _interval(record)
    error = np.clip(jitter * streams[0].standard_normal(n), -limit, limit)
    late = noise.delay + noise.delay_jitter * streams[1].standard_exponential(n)
    # A queue keeps messages in order: a late one delays those after it.
    received = np.maximum.accumulate(record.t + late)
    return replace(record, stamp=record.t + offset + error, received=received)


def _lose(record: Record, share: float, rng: np.random.Generator) -> Record:
    kept = rng.random(len(record.t)) >= share
    return replace(rows_kept(record, kept), dropped=int((~kept).sum()))


def _interval(record: Messages) -> float:
    """Sample interval, s."""
    return float(np.median(np.diff(record.t))) if len(record.t) > 1 else 1.0


def _streams(seed: np.random.SeedSequence, number: int) -> list[np.random.Generator]:
    return [np.random.default_rng(child) for child in seed.spawn(number)]


def _walk(rng: np.random.Generator, density: float, t: Floats) -> Floats:
    """Random walk of density per sqrt(s) that starts at zero; (N, 3)."""
    steps = rng.standard_normal((len(t), 3)) * np.sqrt(np.diff(t, prepend=t[:1]))[:, None]
    return np.asarray(density * np.cumsum(steps, axis=0))


def _coloured(
    rng: np.random.Generator, std: float, memory: float, shape: tuple[int, ...]
) -> Floats:
    """First-order Gauss-Markov noise in its steady state; (N, 3)."""
    if std == 0:
        return np.zeros(shape)
    from scipy.signal import lfilter

    drive = np.sqrt(1 - memory**2) * rng.standard_normal(shape)
    drive[0] /= np.sqrt(1 - memory**2)
    return np.asarray(std * lfilter([1.0], [1.0, -memory], drive, axis=0))


def _spikes(rng: np.random.Generator, size: float, spiked: Bools) -> Floats:
    """Errors of ``size``, with random sign, on one axis of every spiked sample; (N, 3)."""
    thrown = np.zeros((len(spiked), 3))
    rows = np.flatnonzero(spiked)
    sign = rng.choice([-1.0, 1.0], len(rows))
    thrown[rows, rng.integers(0, 3, len(rows))] = size * sign
    return thrown


def _cut_off(values: Floats, limit: float) -> Bools:
    """Clip (N, 3) in place to plus or minus a limit; return the rows beyond it."""
    beyond = np.asarray((np.abs(values) > limit).any(axis=1))
    np.clip(values, -limit, limit, out=values)
    return beyond


def _check(noise: NoiseOptions) -> None:
    values = vars(noise)
    for name, value in values.items():
        if name in {"time_offset", "camera_offset"} or isinstance(value, tuple):
            if not np.isfinite(value).all():
                raise ChoiceError(f"{name}: must be a finite number")
        elif value is not None and not (np.isfinite(value) and value >= 0):
            raise ChoiceError(f"{name} {value:g}: must not be negative")
    for name in ("spikes", "dropouts", "robot_dropouts"):
        if values[name] >= 1:
            raise ChoiceError(f"{name} {values[name]:g}: a share, below 1")
    for name in ("accel_range", "gyro_range"):
        if values[name] == 0:
            raise ChoiceError(
                f"{name} 0: must be positive; leave it out for a sensor without limit"
            )
    if noise.coloured_time == 0:
        raise ChoiceError("coloured_time 0: must be positive; use white noise instead")
