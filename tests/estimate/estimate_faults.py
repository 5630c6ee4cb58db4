"""The arm of estimate_arm.py with an IMU that is not ideal: each flaw exact, none interpolated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.estimate.estimate_arm import GRAVITY, LINKS, MOUNT, Log, Mount, Moves, make_log

Floats = NDArray[np.float64]
Triple = tuple[float, float, float]

SECONDS = 24.0


@dataclass(frozen=True, kw_only=True)
class Flaws:
    """How an IMU departs from the ideal one; all zero or one by default."""

    time_offset: float = 0.0
    """Of the accelerometer's stamps in the middle of the log, s."""
    drift: float = 0.0
    """Seconds the IMU's clock gains in a second of the robot's."""
    gyro_delay: float = 0.0
    """The gyroscope's stamps are later than the accelerometer's by so much, s."""
    accel_scale: Triple = (1.0, 1.0, 1.0)
    """Measured over true, IMU axes."""
    accel_skew: Triple = (0.0, 0.0, 0.0)
    """What z adds to y, z to x and y to x, as where the x axis is the frame's."""
    gyro_scale: Triple = (1.0, 1.0, 1.0)
    gyro_turn: Triple = (0.0, 0.0, 0.0)
    """Rotation vector of the gyroscope's axes in the accelerometer's, rad."""
    gravity: float = GRAVITY
    clock_jump: tuple[float, float] = (0.0, 0.0)
    """Instant, s, from which the IMU's stamps are later by so much, s."""


def flawed_log(
    flaws: Flaws | None = None,
    *,
    moves: Moves | None = None,
    mount: Mount = MOUNT,
    mount_after: tuple[float, Mount] | None = None,
    rate: float = 100.0,
    links: tuple[Triple, ...] = LINKS,
    zeros: Floats | None = None,
) -> Log:
    """A log without noise of an IMU with flaws.

    Args:
        flaws: Of the IMU.
        moves: The arm's motion.
        mount: Of the IMU.
        mount_after: The instant from which the IMU sits elsewhere, and where.
        rate: Of the IMU, Hz.
        links: What the estimator is told of the arm; the truth stays.
        zeros: (6,), rad: the joints read so much more than they are.
    """
    flaws, moves = flaws or Flaws(), moves or Moves(seconds=SECONDS)
    stamps = np.arange(0.0, moves.seconds, 1 / rate)
    middle = 0.5 * moves.seconds
    # The robot's time at each stamp: what the IMU's clock has gained is taken off.
    t = middle + (stamps - middle) / (1.0 + flaws.drift)
    start, jump = flaws.clock_jump
    t = np.where(t < start, t, t - jump)
    gravity = np.array([0.0, 0.0, -flaws.gravity])

    def ideal(instants: Floats) -> Log:
        """What a sensor without flaws reads at some instants."""
        instant, other = mount_after or (np.inf, mount)
        before, after = (
            make_log(moves, each, imu_t=instants, gravity_world=gravity, links=links)
            for each in (mount, other)
        )
        later = (instants >= instant)[:, None]
        gyro = np.where(later, after.imu.gyro, before.imu.gyro)
        accel = np.where(later, after.imu.accel, before.imu.accel)
        return before.with_imu(instants, gyro, accel)

    log = ideal(t)
    yz, xz, xy = flaws.accel_skew
    skewed = np.array([[1.0, xy, xz], [0.0, 1.0, yz], [0.0, 0.0, 1.0]])
    turn = Rotation.from_rotvec(flaws.gyro_turn).as_matrix()
    flawed = replace(log, time_offset=flaws.time_offset).with_imu(
        stamps + flaws.time_offset,
        # Rows are vectors: v @ turn is turn' v, the accelerometer's axes to the gyroscope's.
        (ideal(t - flaws.gyro_delay).imu.gyro @ turn) * flaws.gyro_scale,
        log.imu.accel @ skewed.T * flaws.accel_scale,
    )
    read_as = log.path.tracks[0].values + (0.0 if zeros is None else zeros)
    return flawed.with_joints(values=read_as)


def biased_from(
    log: Log, instant: float, *, gyro: Triple = (0, 0, 0), accel: Triple = (0, 0, 0)
) -> Log:
    """The same log with other biases from an instant on."""
    later = (log.imu.t >= instant)[:, None]
    return log.with_imu(log.imu.t, log.imu.gyro + later * gyro, log.imu.accel + later * accel)


def as_told(mount: Mount, *, last_zero: float = 0.0, last_length: float = 0.0) -> Mount:
    """The mount that a robot told wrongly at its end needs: no log can tell the two apart.

    Args:
        mount: The true one.
        last_zero: rad, that the last joint reads more than it is.
        last_length: m, that the URDF has the flange farther along the last joint's axis.
    """
    R = Rotation.from_euler("z", -last_zero).as_matrix()
    return Mount(R=R @ mount.R, t=R @ mount.t - [0.0, 0.0, last_length])
