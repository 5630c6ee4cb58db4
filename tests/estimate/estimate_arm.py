"""A UR10e with an analytic motion, and what its IMU reads by pinocchio: truth for estimates.

`make_log` builds a log, with flaws where they are asked for; `solve` estimates the pose from it and
returns the estimate together with its error.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
import pytest
from msgspec import Struct
from msgspec.structs import asdict, replace
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from imucalib_cli.estimate.estimate import Estimate
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.model.windows import Windowing, odd_length, plan_windows
from imucalib_cli.estimate.options import MatchedOptions, PosePrior
from imucalib_cli.robot.path import FixedStep, JointStep, KinematicPath, Track
from imucalib_cli.signals.prepare import clean_imu
from imucalib_cli.signals.samples import ImuSamples
from imucalib_cli.signals.trajectory import Trajectory
from tests.by_pinocchio import Motion, follow
from tests.slow import slow_after
from tools.errors import nees, pose_error

if TYPE_CHECKING:
    from imucalib_cli.estimate.solution.normal_equations import LogStatistics

Floats = NDArray[np.float64]
Triple = tuple[float, float, float]

EXACT = MatchedOptions(robot="exact", sensor_model="ideal", gravity_std=0.0)
"""Robot, sensor and gravity have no errors."""
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
BOTH_GRADES = pytest.mark.parametrize("grade", slow_after(1, GRADES))
NAMES = ("tx", "ty", "tz", "rx", "ry", "rz")


class Moves(Struct, frozen=True, kw_only=True):
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


class Mount(Struct, frozen=True, kw_only=True, eq=False):
    """True pose of the IMU in the parent link."""

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


def model() -> tuple[pin.Model, int]:
    """The arm in pinocchio, and the frame of the parent link."""
    arm, parent, place = pin.Model(), 0, pin.SE3.Identity()
    for index, (x, z, turn) in enumerate(LINKS):
        parent = arm.addJoint(parent, pin.JointModelRZ(), place, f"j{index}")
        place = pin.SE3(pin.utils.rotate("x", turn), np.array([x, 0.0, z]))
    frame = arm.addFrame(pin.Frame("parent", parent, 0, place, pin.FrameType.OP_FRAME))
    return arm, frame


@lru_cache(maxsize=64)
def _parent_motion(moves: Moves, instants: bytes) -> Motion:
    arm, frame = model()
    (motion,) = follow(arm, [frame], *moves.joints(np.frombuffer(instants)))
    return motion


def parent_motion(moves: Moves, t: Floats) -> Motion:
    """The parent link by pinocchio, at any instants."""
    return _parent_motion(moves, np.ascontiguousarray(t).tobytes())


def readings(motion: Motion, mount: Mount, gravity_world: Floats) -> tuple[Floats, Floats]:
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


class Flaws(Struct, frozen=True, kw_only=True):
    """Errors of an IMU, none by default. Each is exact, none is interpolated."""

    drift: float = 0.0
    """Seconds that the IMU's clock gains in a second of the robot's."""
    clock_jump: tuple[float, float] = (0.0, 0.0)
    """Instant, s, from which the IMU's stamps are later, and by how much, s."""
    gyro_delay: float = 0.0
    """s: the gyroscope's stamps less the accelerometer's."""
    accel_scale: Triple = (1.0, 1.0, 1.0)
    """Measured over true, IMU axes."""
    accel_skew: Triple = (0.0, 0.0, 0.0)
    """Shares of z in y, of z in x and of y in x."""
    gyro_scale: Triple = (1.0, 1.0, 1.0)
    gyro_turn: Triple = (0.0, 0.0, 0.0)
    """Rotation vector of the gyroscope's axes in the accelerometer's, rad."""
    bias_step: tuple[float, Triple, Triple] = (0.0, (0.0,) * 3, (0.0,) * 3)
    """Instant, s, from which the biases of gyroscope and accelerometer differ, and by how much."""
    mount_after: tuple[float, Mount] | None = None
    """Instant, s, from which the IMU sits elsewhere, and where."""


class Log(Struct, frozen=True, kw_only=True, eq=False):
    """Input of an estimator, and the truth."""

    imu: ImuSamples
    path: KinematicPath
    mount: Mount
    time_offset: float = 0.0
    gyro_bias: Triple = (0.0, 0.0, 0.0)
    """rad/s, that :meth:`noisy` added."""

    def with_imu(
        self, t: Floats | None = None, gyro: Floats | None = None, accel: Floats | None = None
    ) -> Log:
        """Other stamps or readings of the IMU."""
        given = {"t": t, "gyro": gyro, "accel": accel}
        changes: Any = {name: each for name, each in given.items() if each is not None}
        return replace(self, imu=replace(self.imu, **changes))

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
        grade: str | tuple[float, float] = "mems",
        accel_bias: Triple = (0.1, -0.05, 0.08),
        gyro_bias: Triple = (0.01, -0.02, 0.005),
    ) -> Log:
        """White noise of a grade, or of two densities, and constant biases on the IMU."""
        densities = GRADES[grade] if isinstance(grade, str) else grade
        rng = np.random.default_rng(seed)
        root = np.sqrt(0.5 / np.median(np.diff(self.imu.t)))
        noise = rng.normal(size=(2, len(self.imu.t), 3)) * root
        noisy = self.with_imu(
            gyro=self.imu.gyro + gyro_bias + densities[1] * noise[1],
            accel=self.imu.accel + accel_bias + densities[0] * noise[0],
        )
        return replace(noisy, gyro_bias=gyro_bias)


def make_log(
    moves: Moves | None = None,
    mount: Mount = MOUNT,
    *,
    imu_rate: float = 200.0,
    robot_rate: float = 200.0,
    imu_t: Floats | None = None,
    time_offset: float = 0.0,
    gravity_world: Floats | Triple = (0.0, 0.0, -GRAVITY),
    links: tuple[Triple, ...] = LINKS,
    zeros: Floats | float = 0.0,
    flaws: Flaws | None = None,
) -> Log:
    """A log without noise.

    Args:
        moves: The arm's motion.
        mount: Of the IMU.
        imu_rate: Hz.
        robot_rate: Hz.
        imu_t: Stamps of the IMU's samples instead of a constant rate.
        time_offset: Added to the IMU's stamps.
        gravity_world: Of the world the arm stands in.
        links: The URDF's; the true arm always has LINKS.
        zeros: (6,), rad, reported less true positions of the joints.
        flaws: Of the IMU.
    """
    moves, flaws = moves or Moves(), flaws or Flaws()
    stamps = np.arange(0.0, moves.seconds, 1 / imu_rate) if imu_t is None else imu_t
    # The robot's time at each stamp; the clocks agree in the middle of the log.
    middle = 0.5 * moves.seconds if flaws.drift else 0.0
    t = middle + (stamps - middle) / (1.0 + flaws.drift)
    start, jump = flaws.clock_jump
    t = np.where(t < start, t, t - jump)

    def ideal(instants: Floats, sensor: int) -> Floats:
        """Readings of a gyroscope (0) or an accelerometer (1) without flaws."""
        motion, gravity = parent_motion(moves, instants), np.asarray(gravity_world)
        read = readings(motion, mount, gravity)[sensor]
        if flaws.mount_after is None:
            return read
        instant, other = flaws.mount_after
        later = (instants >= instant)[:, None]
        return np.where(later, readings(motion, other, gravity)[sensor], read)

    yz, xz, xy = flaws.accel_skew
    skewed = np.array([[1.0, xy, xz], [0.0, 1.0, yz], [0.0, 0.0, 1.0]])
    turn = Rotation.from_rotvec(flaws.gyro_turn).as_matrix()
    step, gyro_step, accel_step = flaws.bias_step
    stepped = (stamps >= step)[:, None]
    t_robot = np.arange(0.0, moves.seconds, 1 / robot_rate)
    return Log(
        imu=ImuSamples(
            t=stamps + time_offset,
            # Rows are vectors: v @ turn is turn' v, from accelerometer axes to gyroscope axes.
            gyro=(ideal(t - flaws.gyro_delay, 0) @ turn) * flaws.gyro_scale + stepped * gyro_step,
            accel=(ideal(t, 1) @ skewed.T) * flaws.accel_scale + stepped * accel_step,
        ),
        path=arm_path(t_robot, moves.joints(t_robot)[0] + zeros, links),
        mount=mount,
        time_offset=time_offset,
    )


def windowing_of(log: Log, seconds: float) -> Windowing:
    """The streams of a log through windows of this length."""
    trajectory = Trajectory.of(log.path)
    grid = clean_imu(log.imu).grid(trajectory.interval, use_ticks=False)
    return Windowing(grid, trajectory, plan_windows(odd_length(seconds / grid.dt), 3, grid.dt))


class Solved(Estimate, frozen=True, kw_only=True, eq=False):
    """An estimate and the truth of its log."""

    mount: Mount

    @property
    def error(self) -> Floats:
        """(6,), translation and rotation error in the parent frame."""
        return pose_error(self, self.mount.R, self.mount.t)

    @property
    def distance(self) -> float:
        """Error of the translation, m."""
        return float(np.linalg.norm(self.error[:3]))

    @property
    def angle(self) -> float:
        """Error of the rotation, rad."""
        return float(np.linalg.norm(self.error[3:]))

    @property
    def P(self) -> Floats:
        """(6, 6), the stated covariance."""
        assert self.covariance is not None
        return self.covariance

    @property
    def sigma(self) -> Floats:
        """(6,), as stated."""
        return np.asarray(np.sqrt(np.diag(self.P)))

    @property
    def nees(self) -> float:
        """Square of the pose error in stated sigmas; chi-squared of six degrees of freedom."""
        return nees(self.error, self.P)

    @property
    def covered(self) -> bool:
        """Whether the error is as the covariance says; by chance it is not, once in 1000 logs."""
        return self.nees < float(chi2.ppf(0.999, 6))

    @property
    def codes(self) -> list[str]:
        """Of all findings."""
        return [each.code for each in self.findings]

    @property
    def named(self) -> set[str]:
        """Unknowns that were found to be off and move the pose."""
        return {str(e.values["name"]) for e in self.findings if e.code == "unknown.found"}

    @property
    def corrected(self) -> dict[str, tuple[Floats, Floats]]:
        """Value and 1 sigma of each correction."""
        return {
            name: (np.array(each.value), np.array(each.std))
            for name, each in self.corrections.items()
        }

    @property
    def log_statistics(self) -> LogStatistics:
        """From which it can be solved again."""
        assert self.statistics is not None
        return self.statistics

    def parameter(self, name: str) -> tuple[Floats, Floats]:
        """Value and 1 sigma of each component of an unknown."""
        own = [(each.value, each.std) for each in self.parameters if each.name == name]
        values, stds = zip(*own, strict=True)
        return np.array(values), np.array(stds)

    def finding(self, code: str) -> dict[str, Any]:
        """Values of the only finding with a code."""
        (found,) = (each for each in self.findings if each.code == code)
        return dict(found.values)


def beside(estimate: Estimate, mount: Mount) -> Solved:
    """An estimate with the truth."""
    return Solved(**asdict(estimate) | {"mount": mount})


@lru_cache(maxsize=64)
def solve(log: Log, *, details: bool = False, **options: Any) -> Solved:
    """Estimate the pose.

    Args:
        log: Solved once with each set of options.
        details: As of the estimator.
        options: Fields of MatchedOptions.
    """
    chosen = MatchedOptions(**options)
    return beside(calibrate_matched(log.imu, log.path, chosen, details=details), log.mount)


def solve_well(log: Log, **options: Any) -> Solved:
    """The estimate, which is trusted, and whose covariance is true."""
    found = solve(log, **options)
    assert found.trusted, found.distrust
    assert found.covered
    return found


def solve_exact(log: Log, **options: Any) -> Solved:
    """Estimate the pose, with robot, sensor and gravity taken as exact."""
    exact = {"robot": "exact", "sensor_model": "ideal", "gravity_std": 0.0}
    return solve(log, **{**exact, **options})


def prior(
    mount: Mount = MOUNT, *, dt: Any = (0.0, 0.0, 0.0), turn: Any = (0.0, 0.0, 0.0), **std: float
) -> PosePrior:
    """Prior knowledge of a pose.

    Args:
        mount: Its mean, before dt and turn.
        dt: Added to the translation, m.
        turn: Rotation vector that turns the rotation on the left, rad.
        std: 1 sigma of components by name, m and rad; 0 holds one, and the others are free.
    """
    R = Rotation.from_rotvec(turn).as_matrix() @ mount.R
    stds = tuple(std.get(name, np.inf) for name in NAMES)
    return PosePrior(std=stds, R_parent_imu=R, t_parent_imu=mount.t + dt)
