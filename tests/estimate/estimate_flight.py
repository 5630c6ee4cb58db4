"""A body whose pose a tracker measures, in flight or held by hand, and an IMU that vibrates on it.

Its motion is analytic, and the IMU's readings are differences of it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.robot.path import FixedStep, KinematicPath, PoseStep, Track
from imucalib_cli.signals.samples import ImuSamples
from tests.estimate.estimate_arm import GRAVITY, Log, Mount
from tests.estimate.estimate_walk import Place, readings_of, sum_of

DENSITY = (70e-6 * GRAVITY, float(np.radians(0.0028)))
"""One-sided densities of the accelerometer and the gyroscope of an ICM-42688 by its data sheet,
m/s²/sqrt(Hz) and rad/s/sqrt(Hz)."""


@dataclass(frozen=True, kw_only=True)
class Flight:
    """Eight tones of each coordinate, the noise of a tracker, and vibration."""

    seed: int = 0
    seconds: float = 60.0
    imu_rate: float = 200.0
    track_rate: float = 100.0
    by_hand: bool = False
    """Else it leans into its acceleration, as a drone does that has no other thrust."""
    place_noise: float = 3e-4
    """m, of a sample."""
    turn_noise: float = 1e-3
    """rad, of a sample about each axis."""
    vibration: float = 0.0
    """m/s² rms of the accelerometer at most; a twentieth of it in rad/s of the gyroscope."""
    hertz: tuple[float, ...] = (85.0,)
    """Of the rotors, which wander."""
    smooth: float = 0.0
    """s, time constant of two low-pass filters of the tracker, one after the other."""

    @cached_property
    def _tones(self) -> Floats:
        """Of the place and of three angles, m and rad."""
        rng = np.random.default_rng([self.seed, 1])
        hertz = rng.uniform(0.1, 1.2, (8, 6))
        amplitude = 0.02 * rng.uniform(0.3, 1.0, hertz.shape) / hertz**1.5
        amplitude[:, 3:] *= 6.0
        return np.stack([amplitude, 2 * np.pi * hertz, rng.uniform(0, 2 * np.pi, hertz.shape)])

    def body(self, t: Floats) -> Place:
        """R_world_body and p_world_body."""
        moved = sum_of(self._tones, t)
        if self.by_hand:
            return Rotation.from_rotvec(moved[:, 3:]).as_matrix(), moved[:, :3]
        amplitude, rate, phase = self._tones
        thrust = sum_of(np.stack([-amplitude * rate**2, rate, phase])[:, :, :3], t)
        up = _unit(thrust + np.array([0.0, 0.0, GRAVITY]))
        yaw = moved[:, 5]
        left = _unit(np.cross(up, np.stack([np.cos(yaw), np.sin(yaw), 0 * yaw], axis=1)))
        return np.stack([np.cross(left, up), left, up], axis=2), moved[:, :3]

    def log(self) -> Log:
        """The log, whose mount is drawn too."""
        rng = np.random.default_rng([self.seed, 2])
        turn, t_body_imu = rng.normal(size=3), rng.uniform(-0.08, 0.08, 3)
        mount = Mount(R=Rotation.from_rotvec(turn).as_matrix(), t=t_body_imu)
        t = np.arange(rng.uniform(0.0, 0.01), self.seconds, 1 / self.imu_rate)
        gyro, accel = readings_of(self.body, FixedStep(R=mount.R, p=mount.t), t)
        noise_a, noise_g = (density * np.sqrt(self.imu_rate / 2) for density in DENSITY)
        accel = accel + 0.1 * rng.normal(size=3) + noise_a * rng.normal(size=accel.shape)
        gyro = gyro + 0.005 * rng.normal(size=3) + noise_g * rng.normal(size=gyro.shape)
        for hertz in self.hertz if self.vibration else ():
            shakes = self.vibration * self._vibration(rng, hertz, len(t))
            accel, gyro = accel + shakes[:, :3], gyro + 0.05 * shakes[:, 3:]
        path = KinematicPath(
            world="world", parent="body", steps=(PoseStep(track=0),), tracks=(self._track(rng),)
        )
        return Log(imu=ImuSamples(t=t, gyro=gyro, accel=accel), path=path, mount=mount)

    def _vibration(self, rng: np.random.Generator, hertz: float, count: int) -> Floats:
        """(N, 6), of an rms of a half to one."""
        wander = np.cumsum(rng.normal(size=count)) * 0.3 / np.sqrt(self.imu_rate)
        turns = np.cumsum(hertz + wander)[:, None] / self.imu_rate
        amplitude = np.sqrt(2.0) * rng.uniform(0.5, 1.0, 6)
        return np.asarray(amplitude * np.sin(2 * np.pi * (turns + rng.uniform(size=6))))

    def _track(self, rng: np.random.Generator) -> Track:
        t = np.arange(0.0, self.seconds, 1 / self.track_rate)
        R, p = self.body(t)
        off = Rotation.from_rotvec(self.turn_noise * rng.normal(size=p.shape))
        quaternions = (Rotation.from_matrix(R) * off).as_quat()
        same = np.sign((quaternions[1:] * quaternions[:-1]).sum(axis=1))
        quaternions[1:] *= np.cumprod(same)[:, None]
        values = np.hstack([p + self.place_noise * rng.normal(size=p.shape), quaternions])
        if self.smooth:
            share = 1.0 - np.exp(-1.0 / (self.track_rate * self.smooth))
            taps = np.convolve([1.0, share - 1.0], [1.0, share - 1.0])
            values = values[0] + lfilter([share**2], taps, values - values[0], axis=0)
        return Track(name="tracker", kind="pose", t=t, values=values)


def _unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])
