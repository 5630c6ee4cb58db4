"""A UR10e whose motion is analytic and whose accelerations are pinocchio's: truth for estimates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.model.windows import Windowing, odd_length, plan_windows
from imucalib_cli.estimate.options import MatchedOptions, PosePrior
from imucalib_cli.robot.path import FixedStep, JointStep, KinematicPath, Track
from imucalib_cli.signals.prepare import clean_imu
from imucalib_cli.signals.samples import ImuSamples
from imucalib_cli.signals.trajectory import Trajectory

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.solution.normal_equations import LogStatistics

Floats = NDArray[np.float64]

EXACT = MatchedOptions(robot="exact", sensor_model="ideal", gravity_std=0.0)
"""For a robot, a sensor and a gravity that are what they are taken for."""
LINKS = (
    (0.0, 0.1807, np.pi / 2),
    (-0.6127, 0.0, 0.0),
    (-0.57155, 0.0, 0.0),
    (0.0, 0.17415, np.pi / 2),
    (0.0, 0.11985, -np.pi / 2),
    (0.0, 0.11655, 0.0),
)
"""After each joint, which turns about z: x and z of the next, m, and its turn about x, rad."""
HOME = np.array([0.0, -1.4, 1.6, -1.5, -1.57, 0.3])
LIVELY = (0.5, 0.4, 0.5, 0.9, 0.9, 1.2)
GRAVITY = 9.80665
MEMS = (300e-6 * GRAVITY, float(np.radians(0.014)))
INDUSTRIAL = (17e-6 * GRAVITY, float(np.radians(0.002)))
"""One-sided densities of accelerometer and gyroscope, m/s²/sqrt(Hz), rad/s/sqrt(Hz)."""
GRADES = {"mems": MEMS, "industrial": INDUSTRIAL}
UNLIKELY = float(chi2.ppf(0.999, 6))
"""Of the squared pose error in stated sigmas."""


@dataclass(frozen=True, kw_only=True)
class Moves:
    """Quintic moves from random posture to random posture, with pauses."""

    seed: int = 0
    seconds: float = 20.0
    amplitude: tuple[float, ...] = LIVELY
    move: float = 1.6
    pause: float = 0.4

    def joints(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Positions, rates and accelerations, (N, 6) each, rad."""
        rng = np.random.default_rng(self.seed)
        q, v, a = np.tile(HOME, (len(t), 1)), np.zeros((len(t), 6)), np.zeros((len(t), 6))
        here, start = np.zeros(6), 0.5
        while start + self.move < self.seconds - 0.5:
            there = rng.uniform(-1, 1, 6) * self.amplitude
            s = np.clip((t - start) / self.move, 0, 1)[:, None]
            q += (there - here) * (10 * s**3 - 15 * s**4 + 6 * s**5)
            v += (there - here) * (30 * s**2 - 60 * s**3 + 30 * s**4) / self.move
            a += (there - here) * (60 * s - 180 * s**2 + 120 * s**3) / self.move**2
            here, start = there, start + self.move + self.pause
        return q, v, a


@dataclass(frozen=True, kw_only=True, eq=False)
class Mount:
    """Where the IMU really is."""

    R: Floats
    t: Floats


MOUNT = Mount(
    R=Rotation.from_euler("xyz", [np.pi, 0.02, np.pi / 2 + 0.1]).as_matrix(),
    t=np.array([-0.0225, 0.1, 0.03]),
)


def random_mount(seed: int) -> Mount:
    """Any rotation, any place within a quarter of a metre."""
    rng = np.random.default_rng(seed)
    return Mount(R=Rotation.random(rng=rng).as_matrix(), t=rng.uniform(-0.25, 0.25, 3))


def _model() -> tuple[pin.Model, pin.Data, int]:
    model, parent, place = pin.Model(), 0, pin.SE3.Identity()
    for index, (x, z, turn) in enumerate(LINKS):
        parent = model.addJoint(parent, pin.JointModelRZ(), place, f"j{index}")
        place = pin.SE3(pin.utils.rotate("x", turn), np.array([x, 0.0, z]))
    frame = model.addFrame(pin.Frame("parent", parent, 0, place, pin.FrameType.OP_FRAME))
    return model, model.createData(), frame


@dataclass(frozen=True, kw_only=True, eq=False)
class ParentMotion:
    """The parent link: pose in the world, rates and classical acceleration in its own axes."""

    q: Floats
    R: Floats
    p: Floats
    omega: Floats
    alpha: Floats
    acceleration: Floats


@lru_cache(maxsize=64)
def _parent_motion(moves: Moves, instants: bytes) -> ParentMotion:
    t = np.frombuffer(instants)
    model, data, frame = _model()
    q, v, a = moves.joints(t)
    R, p, rates = np.empty((len(t), 3, 3)), np.empty((len(t), 3)), np.empty((3, len(t), 3))
    for k in range(len(t)):
        pin.forwardKinematics(model, data, q[k], v[k], a[k])
        pin.updateFramePlacements(model, data)
        R[k], p[k] = data.oMf[frame].rotation, data.oMf[frame].translation
        rates[0, k] = pin.getFrameVelocity(model, data, frame, pin.LOCAL).angular
        spatial = pin.getFrameAcceleration(model, data, frame, pin.LOCAL)
        rates[1, k] = spatial.angular
        rates[2, k] = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL).linear
    return ParentMotion(q=q, R=R, p=p, omega=rates[0], alpha=rates[1], acceleration=rates[2])


def parent_motion(moves: Moves, t: Floats) -> ParentMotion:
    """By pinocchio, at any instants."""
    return _parent_motion(moves, np.ascontiguousarray(t).tobytes())


def readings(motion: ParentMotion, mount: Mount, gravity_world: Floats) -> tuple[Floats, Floats]:
    """Exact gyroscope and accelerometer of a mount, IMU frame."""
    lever = np.cross(motion.alpha, mount.t)
    lever += np.cross(motion.omega, np.cross(motion.omega, mount.t))
    gravity = np.einsum("nji,j->ni", motion.R, gravity_world)
    return motion.omega @ mount.R, (motion.acceleration + lever - gravity) @ mount.R


def arm_path(
    t: Floats, q: Floats, links: tuple[tuple[float, float, float], ...] = LINKS
) -> KinematicPath:
    """The same chain in the package's own kinematics."""
    steps: list[JointStep | FixedStep] = []
    for index, (x, z, turn) in enumerate(links):
        joint = JointStep(
            name=f"j{index}", kind="revolute", axis=np.array([0.0, 0.0, 1.0]), track=0, column=index
        )
        R = Rotation.from_euler("x", turn).as_matrix()
        steps += [joint, FixedStep(R=R, p=np.array([x, 0.0, z]))]
    names = tuple(f"j{index}" for index in range(6))
    track = Track(name="/joint_states", kind="joints", t=t, values=q, names=names)
    return KinematicPath(world="base", parent="flange", steps=tuple(steps), tracks=(track,))


@dataclass(frozen=True, kw_only=True, eq=False)
class Log:
    """What an estimator is given, and what is true."""

    imu: ImuSamples
    path: KinematicPath
    mount: Mount
    time_offset: float = 0.0

    def with_imu(self, t: Floats, gyro: Floats, accel: Floats) -> Log:
        return replace(self, imu=ImuSamples(t=t, gyro=gyro, accel=accel))

    def with_joints(self, **changes: Any) -> Log:
        """Other stamps or values of the joints."""
        (track,) = self.path.tracks
        return replace(self, path=replace(self.path, tracks=(replace(track, **changes),)))

    def kept(self, rows: NDArray[np.bool_]) -> Log:
        """Only some of the IMU's samples."""
        return replace(self, imu=self.imu.at(rows))

    def noisy(
        self,
        seed: int,
        densities: tuple[float, float] = MEMS,
        accel_bias: tuple[float, float, float] = (0.1, -0.05, 0.08),
        gyro_bias: tuple[float, float, float] = (0.01, -0.02, 0.005),
    ) -> Log:
        """White noise and constant biases on the IMU."""
        rng = np.random.default_rng(seed)
        root = np.sqrt(0.5 / np.median(np.diff(self.imu.t)))
        noise = rng.normal(size=(2, len(self.imu.t), 3)) * root
        return self.with_imu(
            self.imu.t,
            self.imu.gyro + gyro_bias + densities[1] * noise[1],
            self.imu.accel + accel_bias + densities[0] * noise[0],
        )


def make_log(
    moves: Moves | None = None,
    mount: Mount = MOUNT,
    *,
    imu_rate: float = 200.0,
    robot_rate: float = 200.0,
    imu_t: Floats | None = None,
    time_offset: float = 0.0,
    gravity_world: Floats | None = None,
    links: tuple[tuple[float, float, float], ...] = LINKS,
) -> Log:
    """A log without noise.

    Args:
        moves: The arm's motion.
        mount: Of the IMU.
        imu_rate: Hz.
        robot_rate: Hz.
        imu_t: Instants of the IMU's samples instead of a constant rate.
        time_offset: Added to the IMU's stamps.
        gravity_world: Of the world the arm stands in; default along -z.
        links: What the estimator is told of the arm; the truth stays.
    """
    moves = moves or Moves()
    t = np.arange(0.0, moves.seconds, 1 / imu_rate) if imu_t is None else imu_t
    t_robot = np.arange(0.0, moves.seconds, 1 / robot_rate)
    gravity = np.array([0.0, 0.0, -GRAVITY]) if gravity_world is None else gravity_world
    gyro, accel = readings(parent_motion(moves, t), mount, gravity)
    return Log(
        imu=ImuSamples(t=t + time_offset, gyro=gyro, accel=accel),
        path=arm_path(t_robot, moves.joints(t_robot)[0], links),
        mount=mount,
        time_offset=time_offset,
    )


def windowing_of(log: Log, seconds: float) -> Windowing:
    """Its streams through windows of so many seconds."""
    trajectory = Trajectory.of(log.path)
    grid = clean_imu(log.imu).grid(trajectory.interval, use_ticks=False)
    return Windowing(grid, trajectory, plan_windows(odd_length(seconds / grid.dt), 3, grid.dt))


def rotation_error(R: Floats, truth: Floats) -> Floats:
    """Rotation vector of R times truth inverse, rad, parent frame."""
    return np.asarray(Rotation.from_matrix(R @ truth.T).as_rotvec())


def calibrated(log: Log, options: MatchedOptions | None = None) -> Estimate:
    """What the estimator says."""
    return calibrate_matched(log.imu, log.path, options or MatchedOptions())


def taken_as_exact(log: Log, **options: Any) -> Estimate:
    """The same with robot, sensor and gravity believed."""
    return calibrated(log, replace(EXACT, **options))


def pose_error(estimate: Estimate, mount: Mount) -> Floats:
    """(6,), translation and rotation error in the parent frame."""
    turned = rotation_error(estimate.R_parent_imu, mount.R)
    return np.concatenate([estimate.t_parent_imu - mount.t, turned])


def covariance(estimate: Estimate) -> Floats:
    """(6, 6), as stated."""
    assert estimate.covariance is not None
    return estimate.covariance


def sigma(estimate: Estimate) -> Floats:
    """(6,), as stated."""
    return np.asarray(np.sqrt(np.diag(covariance(estimate))))


def nees(estimate: Estimate, mount: Mount) -> float:
    """Square of the pose error in stated sigmas; chi-squared of six degrees of freedom."""
    error = pose_error(estimate, mount)
    return float(error @ np.linalg.solve(covariance(estimate), error))


def statistics(estimate: Estimate) -> LogStatistics:
    """From which it can be solved again."""
    assert estimate.statistics is not None
    return estimate.statistics


def parameter(estimate: Estimate, name: str) -> tuple[Floats, Floats]:
    """Value and 1 sigma of each component of an unknown."""
    values, stds = zip(
        *((each.value, each.std) for each in estimate.parameters if each.name == name), strict=True
    )
    return np.array(values), np.array(stds)


def codes(estimate: Estimate) -> set[str]:
    """Of all findings."""
    return {each.code for each in estimate.findings}


def told(estimate: Estimate, code: str) -> dict[str, Any]:
    """What the one finding of a code says."""
    (found,) = (each for each in estimate.findings if each.code == code)
    return dict(found.values)


def known(std: tuple[float, ...], mount: Mount = MOUNT) -> PosePrior:
    """What is told of a mount, about the truth."""
    return PosePrior(std=std, R_parent_imu=mount.R, t_parent_imu=mount.t)
