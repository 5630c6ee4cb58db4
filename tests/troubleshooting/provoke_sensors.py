"""IMUs in other units, and IMUs that do not measure what they should."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.robot.rotations import matrix_from_rotvec
from tests.troubleshooting.scene import Scene, Seen, clean, noisy, provokes, row, with_imu

if TYPE_CHECKING:
    from collections.abc import Callable

    from imucalib_cli.simulate.recording import Recording


ARM, BODY = "rihibot", "barbot"
_DEG = 180.0 / np.pi
_G = 9.80665
BIAS = np.array([0.6, 0.0, 0.0])


def readings(gyro: Any = 1.0, accel: Any = 1.0, *arguments: str) -> Callable[[Scene], Seen]:
    """The arm's log with its IMU's values multiplied."""

    def provocation(scene: Scene) -> Seen:
        imu = noisy(ARM).imu
        recording = with_imu(noisy(ARM), gyro=imu.gyro * gyro, accel=imu.accel * accel)
        return scene.run_arm(recording, *arguments)

    return provocation


provokes("gyro-degrees")(readings(gyro=_DEG))
provokes("gyro-twice")(readings(gyro=1.0 / _DEG))
provokes("gyro-unit-unknown")(readings(gyro=5.0 * _DEG))
provokes("accel-g")(readings(accel=1.0 / _G))
provokes("accel-mg")(readings(accel=1000.0 / _G))
provokes("accel-unit-wrong")(readings(1.0, 1.0, "--accel-unit", "g"))
provokes("gyro-unit-wrong")(readings(1.0, 1.0, "--gyro-unit", "deg/s"))
provokes("accel-unit-unknown")(readings(1.0, 0.5))
provokes("gravity-removed")(readings(accel=0.01))
provokes("gravity-none-wrong")(readings(1.0, 1.0, "--gravity", "none"))
provokes("accel-down")(readings(accel=-1.0))
provokes("gyro-reversed")(readings(gyro=-1.0))
provokes("left-handed")(readings((1, -1, 1), (1, -1, 1)))
provokes("axes-not-shared")(readings(gyro=(1, -1, -1)))
provokes("accel-scale")(readings(accel=(1.0, 1.01, 0.995)))
provokes("gyro-scale")(readings(gyro=1.01))
provokes("accel-scale-gross")(readings(accel=(1.0, 1.2, 1.0)))
provokes("zero-gyro")(readings(gyro=0.0))
provokes("zero-both")(readings(0.0, 0.0))
provokes("dead-axis")(readings(gyro=(1, 0, 1)))
provokes("impossible-values")(readings(accel=1e6))


@provokes("dead-axis-quiet")
def _(scene: Scene) -> Seen:
    quiet = clean(ARM)
    return scene.run_arm(with_imu(quiet, gyro=quiet.imu.gyro * (1, 0, 1)))


@provokes("not-finite")
def _(scene: Scene) -> Seen:
    gyro = noisy(ARM).imu.gyro.copy()
    gyro[::300, 1] = np.nan
    return scene.run_arm(with_imu(noisy(ARM), gyro=gyro))


@provokes("frozen")
def _(scene: Scene) -> Seen:
    return scene.run_arm(_stuck(15.0, 17.5))


@provokes("frozen-most")
def _(scene: Scene) -> Seen:
    return scene.run_arm(_stuck(10.0, 24.1))


def _stuck(start: float, stop: float) -> Recording:
    imu = noisy(ARM).imu
    gyro, accel = imu.gyro.copy(), imu.accel.copy()
    held = slice(row(start), row(stop))
    gyro[held], accel[held] = gyro[held.start], accel[held.start]
    return with_imu(noisy(ARM), gyro=gyro, accel=accel)


@provokes("saturated")
def _(scene: Scene) -> Seen:
    gyro = noisy(ARM).imu.gyro
    limit = 0.7 * float(np.abs(gyro).max())
    return scene.run_arm(with_imu(noisy(ARM), gyro=np.clip(gyro, -limit, limit)))


@provokes("gyro-delay")
def _(scene: Scene) -> Seen:
    imu = noisy(ARM).imu
    later = np.stack([np.interp(imu.t - 5e-3, imu.t, axis) for axis in imu.gyro.T], axis=1)
    return scene.run_arm(with_imu(noisy(ARM), gyro=later))


def _turned(degrees: float) -> Recording:
    R = matrix_from_rotvec(np.radians([0.0, 0.0, degrees]))
    return with_imu(noisy(ARM), gyro=noisy(ARM).imu.gyro @ R.T)


@provokes("axes-turned")
def _(scene: Scene) -> Seen:
    return scene.run_arm(_turned(1.0))


@provokes("axes-turned-far")
def _(scene: Scene) -> Seen:
    return scene.run_arm(_turned(5.0))


@provokes("accel-bias-large")
def _(scene: Scene) -> Seen:
    return scene.run_arm(with_imu(noisy(ARM), accel=noisy(ARM).imu.accel + BIAS))
