"""A robot without a fixed base: an IMU on its trunk, three joints, and an IMU behind them.

Its motion is analytic, and the IMUs' readings are differences of it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.robot.path import (
    FixedStep,
    JointStep,
    KinematicPath,
    PoseStep,
    Track,
)
from imucalib_cli.signals.samples import ImuSamples
from tests.estimate.estimate_arm import GRAVITY, MEMS, Log, Mount

Place = tuple[Floats, Floats]

H = 1e-4
"""Step of the differences that give the readings, s."""
AXES = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
ORIGINS = ((0.0, 0.08, -0.05), (0.0, 0.02, -0.05), (0.0, 0.0, -0.35))
BASE = FixedStep(
    R=Rotation.from_euler("xyz", [0.1, -0.05, 0.7]).as_matrix(), p=np.array([0.03, -0.02, 0.08])
)
"""Pose of the trunk's IMU in the trunk."""
FOOT = Mount(R=Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix(), t=np.array([0.05, 0.02, -0.12]))
"""Pose of the foot's IMU in the last link."""
SHANK = Mount(R=Rotation.from_rotvec([-0.3, 0.8, 1.2]).as_matrix(), t=np.array([-0.03, 0.04, -0.1]))
"""Pose of the shank's IMU in the link before."""


def readings_of(place: Callable[[Floats], Place], mount: FixedStep, t: Floats) -> Place:
    """Readings of an IMU, rad/s and m/s², on a frame whose pose is a function of time."""

    def of_imu(t: Floats) -> Place:
        R, p = place(t)
        return R @ mount.R, p + R @ mount.p

    (R, p), (R_later, p_later), (R_sooner, p_sooner) = of_imu(t), of_imu(t + H), of_imu(t - H)
    force = (p_later - 2 * p + p_sooner) / H**2 + [0, 0, GRAVITY]
    turned = Rotation.from_matrix(np.swapaxes(R_sooner, 1, 2) @ R_later).as_rotvec()
    return turned / (2 * H), np.einsum("nji,nj->ni", R, force)


@dataclass(frozen=True, kw_only=True)
class Walk:
    """A gait that never repeats, and the errors of robot and sensors."""

    seed: int = 0
    seconds: float = 30.0
    rates: tuple[float, float] = (200.0, 200.0)
    """Hz, of the trunk's IMU and of the other one; joints come with the former."""
    axes: tuple[tuple[float, float, float], ...] = AXES
    offsets: tuple[float, float] = (0.0, 0.0)
    """s: stamps of the trunk's IMU and of the other one less those of the joints, at the start."""
    drifts: tuple[float, float] = (0.0, 0.0)
    """s/s, by which these stamps gain on those of the joints."""
    base_delay: float = 0.0
    """s: of the trunk's gyroscope behind its accelerometer."""
    base_off: tuple[float, float] = (0.0, 0.0)
    """m and rad, standard deviations of the trunk IMU's pose about the URDF's."""
    scale: float = 0.0
    """Scale errors of both IMUs, standard deviation."""
    turned: float = 0.0
    """rad: gyroscopes against their accelerometers, standard deviation about each axis."""
    longer: float = 0.0
    """Relative excess of both accelerometers' readings."""
    zero: float = 0.0
    """rad: of all joints but the last, standard deviation."""
    length: float = 0.0
    """m: of all origins, but the last one along the last axis, which is the mount's."""
    noisy: bool = False
    """MEMS noise and biases of both IMUs, and an encoder's noise."""

    def _sines(self, name: int, count: int, size: float, hertz: tuple[float, ...]) -> Floats:
        """Amplitudes, rates and phases, (3, tones, count)."""
        rng = np.random.default_rng([self.seed, name])
        tones = np.array(hertz)[:, None] * np.ones(count)
        amplitude = size * rng.uniform(0.3, 1.0, tones.shape)
        rate = 2 * np.pi * tones * rng.uniform(0.85, 1.15, tones.shape)
        return np.stack([amplitude, rate, rng.uniform(0, 2 * np.pi, tones.shape)])

    @cached_property
    def _motion(self) -> tuple[Floats, Floats, Floats]:
        return (
            self._sines(1, 3, 0.10, (0.3, 0.7, 1.3)),
            self._sines(2, 3, 0.04, (0.5, 1.1, 1.9)),
            self._sines(3, len(self.axes), 0.35, (0.4, 0.9, 1.4)),
        )

    def trunk(self, t: Floats) -> Place:
        """R_world_trunk and p_world_trunk."""
        turn, sway, _ = self._motion
        p = sum_of(sway, t)
        p[:, 0] += 0.5 * t
        return Rotation.from_euler("ZYX", sum_of(turn, t)).as_matrix(), p

    def joints(self, t: Floats) -> Floats:
        """(N, J), rad."""
        return sum_of(self._motion[2], t)

    def link(self, t: Floats, count: int) -> Place:
        """R_world_link and p_world_link of the link behind so many joints."""
        R, p = self.trunk(t)
        q = self.joints(t) + self.zeros
        for axis, origin, angle in zip(self.axes[:count], self._origins, q.T, strict=False):
            p = p + R @ origin
            R = R @ Rotation.from_rotvec(np.outer(angle, axis)).as_matrix()
        return R, p

    @cached_property
    def zeros(self) -> Floats:
        """(J,), rad: true less reported positions."""
        zeros = self.zero * np.random.default_rng([self.seed, 4]).normal(size=len(self.axes))
        zeros[-1:] = 0.0
        return np.asarray(zeros)

    @cached_property
    def _origins(self) -> Floats:
        off = self.length * np.random.default_rng([self.seed, 6]).normal(size=(len(ORIGINS), 3))
        for last in self.axes[-1:]:
            off[len(self.axes) - 1] *= np.asarray(last) == 0.0
        return np.asarray(ORIGINS + off)

    def log(self) -> Log:
        """The log of the IMU behind the joints."""
        rng = np.random.default_rng([self.seed, 5])
        t, t_foot = (np.arange(0.0, self.seconds, 1 / rate) for rate in self.rates)
        off, turn = (rng.normal(size=3) * each for each in self.base_off)
        base = FixedStep(R=Rotation.from_rotvec(turn).as_matrix() @ BASE.R, p=BASE.p + off)
        gyro, accel = (
            readings_of(self.trunk, base, t - late)[sensor]
            for sensor, late in enumerate((self.base_delay, 0.0))
        )
        trunk = self._worn(rng, self.rates[0], gyro, accel)
        imu = self._imu(rng, FOOT, len(self.axes), t_foot)
        q = self.joints(t)
        q = q + (3e-5 * rng.normal(size=q.shape) if self.noisy else 0.0)
        tracks = (
            Track(name="/imu/trunk", kind="imu", t=self._stamps(t, 0), values=np.hstack(trunk)),
            Track(name="/joint_states", kind="joints", t=t, values=q, names=("j0", "j1", "j2")),
        )
        steps: list[PoseStep | FixedStep | JointStep] = [PoseStep(track=0), BASE.inverse]
        for column, (axis, origin) in enumerate(zip(self.axes, ORIGINS, strict=False)):
            steps.append(FixedStep(R=np.eye(3), p=np.array(origin)))
            along = np.array(axis)
            name = f"j{column}"
            steps.append(JointStep(name=name, kind="revolute", axis=along, track=1, column=column))
        path = KinematicPath(
            world="free fall",
            parent="foot" if self.axes else "trunk",
            steps=tuple(steps),
            tracks=tracks if self.axes else tracks[:1],
        )
        return Log(imu=imu, path=path, mount=FOOT)

    def shank(self) -> Log:
        """The same log for an IMU behind all joints but the last."""
        path, count = logged(self).path, len(self.axes) - 1
        t = np.arange(0.0, self.seconds, 1 / self.rates[1])
        imu = self._imu(np.random.default_rng([self.seed, 7]), SHANK, count, t)
        path = replace(path, parent="shank", steps=path.steps[: 2 + 2 * count])
        return Log(imu=imu, path=path, mount=self.seen(SHANK, count))

    @property
    def first_off(self) -> Floats:
        """(3,), m: true less reported place of the first joint in the trunk."""
        return np.asarray(self._origins[0] - ORIGINS[0])

    def seen(self, mount: Mount, count: int) -> Mount:
        """The mount behind so many joints that fits the URDF, which contains no errors.

        It absorbs the zero of the last joint, and the error of its origin along its axis.
        """
        axis = np.array(self.axes[count - 1])
        Z = Rotation.from_rotvec(self.zeros[count - 1] * axis).as_matrix()
        off = self._origins[count - 1] - ORIGINS[count - 1]
        return Mount(R=Z @ mount.R, t=Z @ mount.t + axis * (off @ axis))

    def _imu(self, rng: np.random.Generator, mount: Mount, count: int, t: Floats) -> ImuSamples:
        """Samples of an IMU behind so many joints."""
        place = FixedStep(R=mount.R, p=mount.t)
        gyro, accel = readings_of(lambda t: self.link(t, count), place, t)
        gyro, accel = self._worn(rng, self.rates[1], gyro, accel)
        return ImuSamples(t=self._stamps(t, 1), gyro=gyro, accel=accel)

    def _stamps(self, t: Floats, which: int) -> Floats:
        return t * (1.0 + self.drifts[which]) + self.offsets[which]

    def _worn(
        self, rng: np.random.Generator, rate: float, gyro: Floats, accel: Floats
    ) -> tuple[Floats, Floats]:
        """Readings with the errors of a sensor."""
        gyro, accel = (each * (1.0 + self.scale * rng.normal(size=3)) for each in (gyro, accel))
        accel = accel * (1.0 + self.longer)
        if self.turned:
            gyro = gyro @ Rotation.from_rotvec(self.turned * rng.normal(size=3)).as_matrix().T
        if not self.noisy:
            return gyro, accel
        noise_a, noise_g = (density * np.sqrt(rate / 2) for density in MEMS)
        gyro = gyro + 0.003 * rng.normal(size=3) + noise_g * rng.normal(size=gyro.shape)
        accel = accel + 0.03 * rng.normal(size=3) + noise_a * rng.normal(size=accel.shape)
        return gyro, accel


def sum_of(tones: Floats, t: Floats) -> Floats:
    """(N, count) of tones (3, T, count): amplitudes, rates and phases."""
    amplitude, rate, phase = tones
    return np.asarray((amplitude * np.sin(t[:, None, None] * rate + phase)).sum(axis=1))


@lru_cache(maxsize=8)
def logged(walk: Walk) -> Log:
    """The log of a walk, made once."""
    return walk.log()
