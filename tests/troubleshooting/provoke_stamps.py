"""Stamps that are broken, and clocks that differ."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.simulate.recording import rows_kept
from tests.troubleshooting.scene import (
    Scene,
    Seen,
    noisy,
    provokes,
    robot_of,
    row,
    with_imu,
    with_robot,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from imucalib_cli.simulate.recording import Recording

    Floats = NDArray[np.float64]

ARM = "rihibot"


def with_stamps(stamp: Floats, received: Floats | None = None) -> Recording:
    """The arm's log with other header stamps of the IMU."""
    recording = noisy(ARM)
    if received is None:
        received = recording.imu.received
    return with_imu(recording, stamp=stamp, received=received)


def stamps() -> Floats:
    return np.array(noisy(ARM).imu.stamp)


@provokes("stamps-zero")
def _(scene: Scene) -> Seen:
    return scene.run_arm(with_stamps(np.full_like(stamps(), -1.7e9)))


@provokes("stamps-backwards")
def _(scene: Scene) -> Seen:
    t = stamps()
    return scene.run_arm(with_stamps(t[::-1].copy()))


@provokes("stamps-same")
def _(scene: Scene) -> Seen:
    return scene.run_arm(with_stamps(np.full_like(stamps(), 3.0)), "--clock", "header")


@provokes("never-meet")
def _(scene: Scene) -> Seen:
    return scene.run_arm(with_stamps(stamps() + 1000.0), "--clock", "header")


@provokes("other-epoch")
def _(scene: Scene) -> Seen:
    return scene.run_arm(with_stamps(stamps() - 1000.0))


@provokes("other-pace")
def _(scene: Scene) -> Seen:
    return scene.run_arm(with_stamps(stamps() * 1.05))


@provokes("set-back")
def _(scene: Scene) -> Seen:
    t = stamps()
    t[row(16.0) :] -= 4.0
    return scene.run_arm(with_stamps(t))


@provokes("clock-steps")
def _(scene: Scene) -> Seen:
    t = stamps()
    t[row(16.0) :] += 0.15
    return scene.run_arm(with_stamps(t))


@provokes("stamps-jump")
def _(scene: Scene) -> Seen:
    t = stamps()
    t[row(16.0) :] += 9e5
    return scene.run_arm(with_stamps(t), "--clock", "header")


@provokes("stray-stamps")
def _(scene: Scene) -> Seen:
    t = stamps()
    t[::500] = -1.7e9
    t[101::500] = t[100::500]
    return scene.run_arm(with_stamps(t))


@provokes("rate-changes")
def _(scene: Scene) -> Seen:
    """From the middle on the IMU sends every other sample."""
    recording = noisy(ARM)
    imu = recording.imu
    rows = np.arange(len(imu.t))
    kept = (imu.t < 12.0) | (rows % 2 == 0)
    names = ("t", "stamp", "received", "gyro", "accel")
    return scene.run_arm(with_imu(recording, **{n: getattr(imu, n)[kept] for n in names}))


@provokes("bursts")
def _(scene: Scene) -> Seen:
    t = stamps()
    ends = np.minimum((np.arange(len(t)) // 10 + 1) * 10, len(t)) - 1
    arrived = t[ends] + np.random.default_rng(1).gamma(2.0, 0.001, len(t))[ends]
    arrived = np.maximum.accumulate(arrived + np.arange(len(t)) % 10 * 1e-6)
    return scene.run_arm(with_stamps(arrived, arrived))


@provokes("junk-at-once")
def _(scene: Scene) -> Seen:
    """A tenth of the log is sent again within a millisecond, without the gyroscope's values."""
    recording = noisy(ARM)
    imu, middle, count = recording.imu, len(stamps()) // 2, len(stamps()) // 10
    order = np.insert(np.arange(len(imu.t)), middle, np.arange(middle - count, middle))
    again = slice(middle, middle + count)
    changes = {name: getattr(imu, name)[order] for name in ("t", "gyro", "accel")}
    changes["gyro"][again] = 0.0
    for name in ("stamp", "received"):
        changes[name] = getattr(imu, name)[order]
        changes[name][again] = getattr(imu, name)[middle - 1] + 1e-6 * np.arange(1, count + 1)
    return scene.run_arm(with_imu(recording, **changes))


@provokes("imu-jitter")
def _(scene: Scene) -> Seen:
    t = stamps()
    return scene.run_arm(with_stamps(t + np.random.default_rng(1).normal(0.0, 1e-3, len(t))))


@provokes("robot-jitter")
def _(scene: Scene) -> Seen:
    recording = noisy(ARM)
    t = robot_of(recording).stamp
    shaken = t + np.random.default_rng(1).normal(0.0, 1e-3, len(t))
    return scene.run_arm(with_robot(recording, stamp=shaken))


@provokes("held-values")
def _(scene: Scene) -> Seen:
    recording = noisy(ARM)
    held = robot_of(recording).position[np.arange(len(robot_of(recording).t)) // 5 * 5]
    return scene.run_arm(with_robot(recording, position=held))


@provokes("clock-drift")
def _(scene: Scene) -> Seen:
    return scene.run_arm(with_stamps(stamps() * (1.0 + 2e-4)))


@provokes("clock-shift")
def _(scene: Scene) -> Seen:
    t = stamps()
    t[row(16.0) :] += 5e-3
    return scene.run_arm(with_stamps(t))


@provokes("offset-beyond")
def _(scene: Scene) -> Seen:
    return scene.run_arm(with_stamps(stamps() + 1.7))


@provokes("offset-given")
def _(scene: Scene) -> Seen:
    return scene.run_arm(with_stamps(stamps() + 0.7), "--time-offset", "none")


@provokes("missing")
def _(scene: Scene) -> Seen:
    recording = noisy(ARM)
    imu = recording.imu
    kept = np.abs(imu.t - imu.t[len(imu.t) // 2]) > 0.1 * imu.t[-1]
    return scene.run_arm(replace(recording, imu=rows_kept(imu, kept)))
