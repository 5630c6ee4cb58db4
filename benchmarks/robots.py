"""Imperfect robots and sensors with a known truth: logs in memory for sweeps.py.

Motions are analytic (quintic moves, pauses, a wobbling base) and accelerations are pinocchio's, so
the truth owes nothing to the package. The errors are in the estimator's inputs. Every kind of error
is drawn for every seed and multiplied by the row's size, so that the rows of a seed share their
motion, their mount and their draws.

No log shows some errors, and the inputs have none of these:

- the zero of the last joint, the flange after it and the part of its origin along its axis are the
  same as another mount;
- the zero of the first joint is the same as another heading of the world, and so is the direction
  of its axis (with a moving base both could be found, but have no error there either, so that the
  robots compare).
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, lfilter, lfilter_zi
from scipy.spatial.transform import Rotation

from imucalib_cli.robot.path import FixedStep, JointStep, KinematicPath, PoseStep, Track
from imucalib_cli.signals.samples import ImuSamples

if TYPE_CHECKING:
    from collections.abc import Iterator

Floats = NDArray[np.float64]
Driver = Callable[[float], tuple[Floats, Floats]]
"""A filter: from the rate, Hz, to numerator and denominator."""

GRAVITY = 9.80665
"""m/s², CGPM 1901: the estimator's mean."""
MEMS = (300e-6 * GRAVITY, float(np.radians(0.014)))
INDUSTRIAL = (17e-6 * GRAVITY, float(np.radians(0.002)))
"""One-sided densities of accelerometer and gyroscope, m/s²/sqrt(Hz) and rad/s/sqrt(Hz), of a
consumer's MEMS IMU and of an ADIS1649x, by their data sheets."""
ACCEL_BIAS, GYRO_BIAS = 0.1, 0.01
"""1 sigma of the constant biases, m/s² and rad/s: ten milli-g, half a degree per second."""
MOUNT_RADIUS = 0.15
"""m: the IMU sits within this of the parent's origin."""
MAX_OFFSET = 0.03
"""s: the time offset is uniform between this and its negative."""
LINK_MASS = 10.0
"""kg, of the first link; each further one has seven tenths, as arms have, by a random factor."""
OFF_CENTRE = 0.02
"""m, 1 sigma of each component: of a link's centre of mass from the middle of the link."""
LEAD = 0.5
"""s the sensors run before the log starts, so that a driver's filter has settled."""
TRACK_RATE = 100.0
"""Hz, of the tracked base."""
EDGE = 0.5
"""s of rest of the arm at both ends of a log."""


class Robot(Struct, frozen=True, kw_only=True, eq=False):
    """A chain of joints that turn about their z, perhaps on a tracked base."""

    origins: tuple[FixedStep, ...]
    """Where each joint sits in the link before it."""
    flange: FixedStep
    home: tuple[float, ...]
    """rad, one for each joint."""
    amplitude: tuple[float, ...]
    """Of the postures about home, rad; with `moves` within the maker's joint speeds."""
    moves: tuple[float, float] = (1.5, 3.0)
    """Shortest and longest move, s."""
    moving_base: bool = False


def _origin(xyz: tuple[float, float, float], roll: float, yaw: float = 0.0) -> FixedStep:
    R = Rotation.from_euler("xyz", [roll, 0.0, yaw]).as_matrix()
    return FixedStep(R=R, p=np.array(xyz))


_RIGHT = np.pi / 2

_UR10E = (
    _origin((0.0, 0.0, 0.0), 0.0),
    _origin((0.0, 0.0, 0.1807), _RIGHT),
    _origin((-0.6127, 0.0, 0.0), 0.0),
    _origin((-0.57155, 0.0, 0.0), 0.0),
    _origin((0.0, 0.0, 0.17415), _RIGHT),
    _origin((0.0, 0.0, 0.11985), -_RIGHT),
)
_PANDA = (
    _origin((0.0, 0.0, 0.333), 0.0),
    _origin((0.0, 0.0, 0.0), -_RIGHT),
    _origin((0.0, -0.316, 0.0), _RIGHT),
    _origin((0.0825, 0.0, 0.0), _RIGHT),
    _origin((-0.0825, 0.384, 0.0), -_RIGHT),
    _origin((0.0, 0.0, 0.0), _RIGHT),
    _origin((0.088, 0.0, 0.0), _RIGHT),
)
# The first four joints of a Kinova Gen3, turned by 0.3 rad on top of a cart; its first frame hangs
# upside down, as the maker has it.
_MOBILE = (
    _origin((0.2, 0.05, 0.4 + 0.15643), np.pi, 0.3),
    _origin((0.0, 0.005375, -0.12838), _RIGHT),
    _origin((0.0, -0.21038, -0.006375), -_RIGHT),
    _origin((0.0, 0.006375, -0.21038), _RIGHT),
)

ROBOTS = {
    "ur10e": Robot(
        origins=_UR10E,
        flange=_origin((0.0, 0.0, 0.11655), 0.0),
        home=(0.0, -1.4, 1.6, -1.5, -1.57, 0.3),
        amplitude=(0.5, 0.4, 0.5, 0.9, 0.9, 1.2),
    ),
    "panda": Robot(
        origins=_PANDA,
        flange=_origin((0.0, 0.0, 0.107), 0.0),
        home=(0.0, -0.4, 0.0, -2.0, 0.0, 1.8, 0.7),
        amplitude=(0.5, 0.4, 0.5, 0.5, 0.8, 0.8, 0.9),
    ),
    "mobile": Robot(
        origins=_MOBILE,
        flange=_origin((0.0, -0.20843, -0.006375), -_RIGHT),
        home=(0.0, 0.5, 0.0, 1.3),
        amplitude=(0.5, 0.5, 0.5, 0.5),
        moving_base=True,
    ),
}
"""UR10e by its DH parameters, Franka Panda by its modified ones, Kinova Gen3 on a cart."""


class Row(Struct, frozen=True, kw_only=True):
    """Sizes of the errors: 1 sigma unless stated otherwise; an exact robot by default."""

    noise: tuple[float, float] = (0.0, 0.0)  # densities of accelerometer and gyroscope
    scale: float = 0.0  # of each axis of both sensors, measured over true less one
    gyro_delay: float = 0.0  # s, the gyroscope's stamps less the accelerometer's
    zero: float = 0.0  # of each joint, rad
    origin: float = 0.0  # of each component of each joint's origin, m
    axis: float = 0.0  # of each joint's axis across itself, both ways, rad
    gravity: float = 0.0  # of the local norm about the standard one, m/s²
    gravity_between: tuple[float, float] | None = None  # m/s², the norm is uniform instead
    encoder: float = 0.0  # white noise of each joint sample, rad
    eccentricity: float = 0.0  # of errors of the reading as sin q, and as cos q, rad
    twice: float = 0.0  # of errors of the reading as sin 2q, and as cos 2q, rad
    four: float = 0.0  # likewise of 4q
    gain: float = 0.0  # of each joint's reading, as by a gear ratio, relative
    lag: float = 0.0  # of each joint's reading behind the joint, s
    play: float = 0.0  # of the error that changes sign with the direction of motion, rad
    softness: float = 0.0  # rad/Nm, of each joint by a random factor; weight bends it
    payload: float = 0.0  # kg that the last link carries beside its own mass
    ground: float = 0.0  # exact tilt of a fixed base under the robot's moment, rad/Nm
    track_noise: tuple[float, float] = (0.0, 0.0)  # of a tracked base's components, m and rad
    track_scale: float = 0.0  # of the tracker's lengths
    track_delay: float = 0.0  # of its stamps behind those of the joints, s
    long_link: float = 0.0  # one joint's origin is longer by exactly this share
    gross_zero: float = 0.0  # one joint's zero has exactly this error, rad, either way
    bracket: float = 0.0  # of each angle by which a unit of force turns the mount, rad/(m/s²)
    driver: Driver | None = None  # filter of the IMU's driver
    ramp: tuple[float, float] = (0.0, 0.0)  # exact drift of the biases, m/s² and rad/s a log
    walk: tuple[float, float] = (0.0, 0.0)  # of the biases, m/s²/sqrt(s) and rad/s/sqrt(s)


def _exponential(alpha: float) -> Driver:
    return lambda _rate: (np.array([alpha]), np.array([1.0, alpha - 1.0]))


def _moving_average(samples: int) -> Driver:
    return lambda _rate: (np.full(samples, 1.0 / samples), np.array([1.0]))


def _butterworth(rate: float) -> tuple[Floats, Floats]:
    b, a = butter(2, 40.0, fs=rate)
    return np.asarray(b), np.asarray(a)


_QUIET = Row(
    noise=INDUSTRIAL,
    scale=0.0005,
    gyro_delay=1e-4,
    zero=1e-4,
    origin=5e-5,
    gravity=0.015,
    track_noise=(5e-5, 5e-5),
    track_scale=0.002,
)
_EVERYDAY = Row(
    noise=MEMS,
    scale=0.005,
    gyro_delay=1e-3,
    zero=1e-3,
    origin=5e-4,
    gravity=0.015,
    encoder=3e-5,
    track_noise=(5e-5, 5e-5),
    track_scale=0.002,
)

ROWS = {
    "exact-mems": Row(noise=MEMS),
    "exact-industrial": Row(noise=INDUSTRIAL),
    "quiet": _QUIET,
    "everyday": _EVERYDAY,
    "worn": replace(_EVERYDAY, eccentricity=4e-4, lag=1e-3, play=2e-4),
    "tilted": replace(_EVERYDAY, axis=1e-3),
    "elastic": replace(_EVERYDAY, softness=5e-5),
    "stiffer": replace(_QUIET, softness=5e-6),
    "geared": replace(_EVERYDAY, gain=2e-3, twice=5e-4),
    "magnetic": replace(_QUIET, twice=3e-4, four=2e-4),
    "bracket": replace(_QUIET, bracket=2e-5),
    "late-tracker": replace(_QUIET, track_delay=5e-3),
    "gross-link": Row(noise=MEMS, long_link=0.01),
    "gross-zero": Row(noise=MEMS, gross_zero=0.01),
    "gross-scale": Row(noise=MEMS, scale=0.03),
    "earth": Row(noise=MEMS, gravity_between=(9.764, 9.834)),
    "average-0.2": replace(_QUIET, driver=_exponential(0.2)),
    "moving-9": replace(_QUIET, driver=_moving_average(9)),
    "butterworth-40": replace(_QUIET, driver=_butterworth),
    "bias-ramp": Row(noise=MEMS, ramp=(0.03, 1e-3)),
    "bias-walk": Row(noise=MEMS, walk=(2e-3, 5e-5)),
}
"""Each sweep by its name, in the order of the table."""

ANY = "any"
"""A robot, or a row, that is drawn anew with each seed."""


def robot_of(name: str, seed: int) -> Robot:
    """A robot by its name, or any: three to seven joints, one in four on a tracked base."""
    if name != ANY:
        return ROBOTS[name]
    rng = np.random.default_rng([seed, 0])
    count = int(rng.integers(3, 8))
    origins = []
    for index in range(count):
        # With parallel last axes, errors that no log shows of the last one are hidden of both.
        parallel = rng.uniform() < 0.2 and index < count - 1
        roll = 0.0 if parallel else rng.choice([_RIGHT, -_RIGHT])
        length = rng.uniform(0.0, 0.5) if index == 1 or rng.uniform() < 0.7 else 0.0
        xyz = length * _direction(rng)
        origins.append(_origin(tuple(xyz), roll, rng.choice([0.0, rng.uniform(-np.pi, np.pi)])))
    return Robot(
        origins=tuple(origins),
        flange=_origin((0.0, 0.0, rng.uniform(0.0, 0.2)), 0.0),
        home=tuple(rng.uniform(-2.0, 2.0, count)),
        amplitude=tuple(rng.uniform(0.3, 1.2, count)),
        moves=(rng.uniform(0.8, 1.6), 3.0),
        moving_base=bool(rng.uniform() < 0.25),
    )


def row_of(name: str, seed: int) -> Row:
    """A row by its name, or any: one in four errors is not there, the others of all sizes."""
    if name != ANY:
        return ROWS[name]
    rng = np.random.default_rng([seed, 1])

    def size(low: float, high: float) -> float:
        """As often of one order of magnitude as of another."""
        drawn = np.exp(rng.uniform(np.log(low), np.log(high)))
        return float(drawn) if rng.uniform() < 0.75 else 0.0

    grade, loud = MEMS if rng.uniform() < 0.6 else INDUSTRIAL, rng.choice([0.3, 0.6, 1.0, 2.0])
    drivers = (*[None] * 6, _exponential(0.5), _moving_average(5), _butterworth)
    return Row(
        noise=(loud * grade[0], loud * grade[1]),
        scale=size(2e-4, 1.5e-2),
        gyro_delay=size(5e-5, 1.5e-3),
        zero=size(1e-4, 4e-3),
        origin=size(3e-5, 2e-3),
        gravity=0.015,
        encoder=size(1e-6, 1e-4),
        eccentricity=size(5e-5, 1.5e-3),
        lag=size(1e-4, 2e-3),
        play=size(5e-5, 6e-4),
        track_noise=(5e-5, 5e-5),
        track_scale=0.002,
        ramp=(size(3e-3, 0.03), size(1e-4, 2e-3)),
        walk=(size(2e-4, 2e-3), size(5e-6, 5e-5)),
        driver=drivers[int(rng.integers(len(drivers)))],
        axis=size(5e-5, 2e-3),
        track_delay=size(2e-4, 8e-3),
        softness=size(5e-7, 5e-5),
        twice=size(2e-5, 1e-3),
        gain=size(5e-5, 5e-3),
    )


Motion = Callable[[Floats], tuple[Floats, Floats, Floats]]
"""From instants (N,) to positions, rates and accelerations, (N, coordinates) each."""


def _moves(
    rng: np.random.Generator,
    seconds: float,
    home: ArrayLike,
    amplitude: ArrayLike,
    lengths: tuple[float, float],
) -> Motion:
    """Quintic moves between random postures about home, at rest in between."""
    first, scale = np.asarray(home, dtype=float), np.asarray(amplitude)
    starts, durations, postures = [], [], [first]
    now = EDGE
    longest_pause = rng.uniform(0.2, 1.0)
    while now + (length := rng.uniform(*lengths)) < seconds - EDGE:
        starts.append(now)
        durations.append(length)
        postures.append(first + rng.uniform(-1, 1, len(first)) * scale)
        now += length + rng.uniform(0.1, longest_pause)
    start, duration, posture = np.array(starts), np.array(durations), np.array(postures)

    def at(t: Floats) -> tuple[Floats, Floats, Floats]:
        move = np.clip(np.searchsorted(start, t, side="right") - 1, 0, None)
        T = duration[move][:, None]
        s = np.clip((t - start[move])[:, None] / T, 0.0, 1.0)
        step = posture[move + 1] - posture[move]
        q = posture[move] + step * s**3 * (10 - 15 * s + 6 * s**2)
        v = step * 30 * s**2 * (1 - s) ** 2 / T
        return q, v, step * 60 * s * (1 - s) * (1 - 2 * s) / T**2

    return at


def _wobble(rng: np.random.Generator, coordinates: int) -> Motion:
    """Two sines a coordinate that never rest: a cart on soft wheels."""
    shape = (2, coordinates)
    amplitude = rng.uniform(0.005, 0.02, shape)
    rate = 2 * np.pi * rng.uniform(0.3, 1.5, shape)
    phase = rng.uniform(0.0, 2 * np.pi, shape)

    def at(t: Floats) -> tuple[Floats, Floats, Floats]:
        angle = rate * t[:, None, None] + phase
        sine, cosine = amplitude * np.sin(angle), amplitude * np.cos(angle)
        return sine.sum(axis=1), (rate * cosine).sum(axis=1), (-(rate**2) * sine).sum(axis=1)

    return at


def _motion(robot: Robot, seed: list[int], seconds: float) -> Motion:
    """Of x, y, yaw, pitch and roll of a moving base, then of the joints."""
    rng = np.random.default_rng(seed)
    arm = _moves(rng, seconds, robot.home, robot.amplitude, robot.moves)
    if not robot.moving_base:
        return arm
    drive = _moves(rng, seconds, np.zeros(3), (0.6, 0.6, 1.0), (2.0, 4.0))
    parts = (drive, _wobble(rng, 2), arm)

    def at(t: Floats) -> tuple[Floats, Floats, Floats]:
        q, v, a = (np.hstack(each) for each in zip(*(part(t) for part in parts), strict=True))
        return q, v, a

    return at


class Truth:
    """The true robot in pinocchio, with the IMU in its true place."""

    def __init__(
        self, robot: Robot, R: Floats, t: Floats, row: Row, rng: np.random.Generator
    ) -> None:
        """With links whose masses are drawn by ``rng``; the base has no weight."""
        self._model, joint, still = pin.Model(), 0, pin.SE3.Identity()
        self.moves = robot.moving_base
        kinds: tuple[Any, ...] = ()
        if self.moves:
            kinds = (pin.JointModelPX, pin.JointModelPY, pin.JointModelRZ)
        if self.moves or row.ground:
            kinds += (pin.JointModelRY, pin.JointModelRX)
        for kind in kinds:
            joint = self._model.addJoint(joint, kind(), still, f"base{joint}")
        self.base = joint
        for index, origin in enumerate(robot.origins):
            place = pin.SE3(origin.R, origin.p)
            joint = self._model.addJoint(joint, pin.JointModelRZ(), place, f"j{index}")
        place = pin.SE3(robot.flange.R, robot.flange.p) * pin.SE3(R, t)
        self._imu = self._model.addFrame(pin.Frame("imu", joint, 0, place, pin.FrameType.OP_FRAME))
        first = self.base + 1
        places = [self._model.jointPlacements[j] for j in range(first + 1, self._model.njoints)]
        for link, end in enumerate(each.translation for each in (*places, place)):
            mass = LINK_MASS * 0.7**link * np.exp(0.3 * rng.normal())
            centre = 0.5 * end + OFF_CENTRE * rng.normal(size=3)
            body = pin.Inertia(mass, centre, np.zeros((3, 3)))
            self._model.appendBodyToJoint(first + link, body, still)
        carried = pin.Inertia(row.payload, np.array([0.05, -0.03, 0.1]), np.zeros((3, 3)))
        self._model.appendBodyToJoint(joint, carried, still)
        self._data = self._model.createData()

    def gyro(self, motion: Motion, t: Floats) -> Floats:
        """(N, 3), rad/s, IMU frame."""
        args = (self._model, self._data, self._imu, pin.LOCAL)
        return np.array([pin.getFrameVelocity(*args).angular for _ in self._along(motion, t)])

    def accel(self, motion: Motion, t: Floats, gravity: float) -> Floats:
        """(N, 3), specific force, m/s², IMU frame."""
        forces = []
        for _ in self._along(motion, t):
            place = pin.updateFramePlacement(self._model, self._data, self._imu)
            own = pin.getFrameClassicalAcceleration(self._model, self._data, self._imu, pin.LOCAL)
            forces.append(own.linear + gravity * place.rotation[2])
        return np.array(forces)

    def torques(self, motion: Motion, t: Floats) -> Floats:
        """(N, joints of base and robot), Nm, that hold and move links and payload."""
        moves = zip(*motion(t), strict=True)
        return np.array([pin.rnea(self._model, self._data, *each).copy() for each in moves])

    def tilting(self, motion: Motion, compliance: float, seconds: float) -> Motion:
        """With a base that tilts under the robot's moment."""

        def upright(t: Floats) -> tuple[Floats, Floats, Floats]:
            q, v, a = (np.pad(each, ((0, 0), (2, 0))) for each in motion(t))
            return q, v, a

        t = np.arange(-LEAD - 1.0, seconds + 1.0, 0.01)
        tilt = make_interp_spline(t, -compliance * self.torques(upright, t)[:, :2], k=5)

        def at(t: Floats) -> tuple[Floats, Floats, Floats]:
            q, v, a = (
                np.hstack([tilt(t, order), each[:, 2:]]) for order, each in enumerate(upright(t))
            )
            return q, v, a

        return at

    def base_poses(self, motion: Motion, t: Floats) -> tuple[Floats, Floats]:
        """Of a moving base: (N, 3, 3) and (N, 3), m, in the world."""
        poses = [self._data.oMi[self.base].copy() for _ in self._along(motion, t)]
        return np.array([pose.rotation for pose in poses]), np.array([p.translation for p in poses])

    def _along(self, motion: Motion, t: Floats) -> Iterator[None]:
        """Take the model to each instant."""
        for q, v, a in zip(*motion(t), strict=True):
            yield pin.forwardKinematics(self._model, self._data, q, v, a)


class Case(Struct, frozen=True, kw_only=True, eq=False):
    """Input of an estimator, and the truth."""

    imu: ImuSamples
    path: KinematicPath
    """The estimator's: wrong constants, and tracks as read."""
    true_path: KinematicPath
    """Right constants and true tracks, at the same stamps."""
    R: Floats
    """(3, 3), R_parent_imu."""
    t: Floats
    """(3,), t_parent_imu, m."""
    time_offset: float
    """Of the accelerometer, s; without the delay of a driver's filter."""
    drawn: dict[str, Any] = field(default_factory=dict)
    """Errors by name, in SI units: lists and numbers, as in JSON."""


def make_case(
    robot: str,
    row: str | Row,
    seed: int,
    *,
    seconds: float = 40.0,
    imu_rate: float = 200.0,
    joint_rate: float = 125.0,
) -> Case:
    """One log of a robot with errors of a row's sizes.

    Args:
        robot: One of ROBOTS, or ANY.
        row: One of ROWS, or ANY, or a row of one's own.
        seed: Of motion, mount and all errors; the same draws in every row.
        seconds: Length of the log.
        imu_rate: Hz.
        joint_rate: Hz.
    """
    true, sizes = robot_of(robot, seed), row_of(row, seed) if isinstance(row, str) else row
    key = [zlib.crc32(robot.encode()), seed]
    motion = _motion(true, [*key, 0], seconds)
    rng = np.random.default_rng([*key, 1])
    R = np.asarray(Rotation.random(rng=rng).as_matrix())
    direction = rng.normal(size=3)
    t = MOUNT_RADIUS * np.cbrt(rng.uniform()) * direction / np.linalg.norm(direction)
    time_offset = float(rng.uniform(-MAX_OFFSET, MAX_OFFSET))
    phase = float(rng.uniform(0.0, 1.0 / imu_rate))

    sag_rng = np.random.default_rng([*key, 4, 2])
    soft = sizes.softness * np.exp(0.5 * sag_rng.normal(size=len(true.origins)))
    truth = Truth(true, R, t, sizes, sag_rng)
    if sizes.ground and not truth.moves:
        motion = truth.tilting(motion, sizes.ground, seconds)
    imu, sensor = _imu(
        truth, motion, sizes, [*key, 2], np.arange(-LEAD + phase, seconds, 1 / imu_rate)
    )
    wrong, joints = _described(true, sizes, [*key, 3])
    tracks, exact, reading = _tracks(
        truth,
        motion,
        sizes,
        [*key, 4],
        seconds=seconds,
        rate=joint_rate,
        zeros=joints["zero"],
        soft=soft,
    )
    return Case(
        imu=replace(imu, t=imu.t + time_offset),
        path=_path(wrong, tracks),
        true_path=_path(true, exact),
        R=R,
        t=t,
        time_offset=time_offset,
        drawn={
            name: np.asarray(value).tolist()
            for name, value in {**sensor, **joints, **reading}.items()
        },
    )


def _imu(
    truth: Truth, motion: Motion, row: Row, key: list[int], t: Floats
) -> tuple[ImuSamples, dict[str, Any]]:
    """Samples at the robot's time, the lead cut off, and what was drawn."""
    rng, noise_rng = np.random.default_rng([*key, 0]), np.random.default_rng([*key, 1])
    rate = 1.0 / (t[1] - t[0])
    drawn: dict[str, Any] = {
        "accel_scale": 1.0 + row.scale * rng.normal(size=3),
        "gyro_scale": 1.0 + row.scale * rng.normal(size=3),
        "gyro_delay": row.gyro_delay * rng.normal(),
        "gravity": GRAVITY + row.gravity * rng.normal(),
        "accel_bias": ACCEL_BIAS * rng.normal(size=3),
        "gyro_bias": GYRO_BIAS * rng.normal(size=3),
        "accel_ramp": row.ramp[0] * _direction(rng),
        "gyro_ramp": row.ramp[1] * _direction(rng),
    }
    share, turning = rng.uniform(), np.random.default_rng([*key, 2]).normal(size=(3, 3))
    drawn["bracket"] = row.bracket * turning
    if row.gravity_between is not None:
        low, high = row.gravity_between
        drawn["gravity"] = low + share * (high - low)
    samples = []
    force, angular = _on_bracket(truth, motion, t, drawn)
    for index, (sensor, values) in enumerate((("accel", force), ("gyro", angular))):
        white, walk = noise_rng.normal(size=(2, len(t), 3))
        # The bias is as drawn in the middle of the log, where the ramp passes through zero.
        drift = np.outer((t - t[-1] / 2) / t[-1], drawn[f"{sensor}_ramp"])
        steps = row.walk[index] / np.sqrt(rate) * walk
        measured = values * drawn[f"{sensor}_scale"] + drawn[f"{sensor}_bias"] + drift
        measured += np.cumsum(steps, axis=0) + row.noise[index] * np.sqrt(rate / 2) * white
        if row.driver is not None:
            b, a = row.driver(rate)
            settled = lfilter_zi(b, a)[:, None] * measured[0]
            measured, _ = lfilter(b, a, measured, axis=0, zi=settled)
        samples.append(measured[t >= 0.0])
    return ImuSamples(t=t[t >= 0.0], accel=samples[0], gyro=samples[1]), drawn


def _on_bracket(
    truth: Truth, motion: Motion, t: Floats, drawn: dict[str, Any]
) -> tuple[Floats, Floats]:
    """(N, 3) each, force and rate on a mount that turns with the force; the rate is late."""
    late, h = t - drawn["gyro_delay"], 1e-4
    force = truth.accel(motion, t, drawn["gravity"])
    rate = truth.gyro(motion, late)
    if not drawn["bracket"].any():
        return force, rate
    before, now, after = (
        Rotation.from_rotvec(truth.accel(motion, at, drawn["gravity"]) @ drawn["bracket"])
        for at in (late - h, late, late + h)
    )
    turning = (before.inv() * after).as_rotvec() / (2.0 * h)
    return Rotation.from_rotvec(force @ drawn["bracket"]).apply(force, inverse=True), (
        now.apply(rate, inverse=True) + turning
    )


def _direction(rng: np.random.Generator) -> Floats:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def _described(true: Robot, row: Row, key: list[int]) -> tuple[Robot, dict[str, Any]]:
    """The robot with wrong constants, and all draws; errors of zeros go into the joints' tracks."""
    rng, count = np.random.default_rng(key), len(true.origins)
    errors = row.origin * rng.normal(size=(count, 3))
    zeros = row.zero * rng.normal(size=count)
    lengthened = np.array([origin.p for origin in true.origins])
    # In the parent's axes: along the last joint's axis is the mount's business, see above.
    along = true.origins[-1].R[:, 2]
    for values in (errors, lengthened):
        values[-1] -= along * (along @ values[-1])
    # Of a fixed robot the first origin, and the second's part along the first axis, move the whole
    # robot and matter to nobody; they are no candidates for the one that is too long.
    if not true.moving_base:
        lengthened[0] = 0.0
        lengthened[1, 2] = 0.0
    long = rng.choice(np.flatnonzero(np.linalg.norm(lengthened, axis=1) > 0.0))
    errors[long] += row.long_link * lengthened[long]
    off = rng.integers(1, count - 1)
    zeros[off] += row.gross_zero * rng.choice([-1.0, 1.0])
    zeros[[0, -1]] = 0.0
    tilts = np.zeros((count, 3))
    tilts[1:, :2] = row.axis * np.random.default_rng([*key, 1]).normal(size=(count - 1, 2))
    turns = Rotation.from_rotvec(tilts).as_matrix()
    origins = tuple(
        replace(origin, R=origin.R @ turn, p=origin.p + error)
        for origin, turn, error in zip(true.origins, turns, errors, strict=True)
    )
    drawn: dict[str, Any] = {"zero": zeros, "origin": errors, "axis": tilts}
    if row.long_link:
        drawn["long_link"] = long
    if row.gross_zero:
        drawn["gross_zero"] = off
    return replace(true, origins=origins), drawn


def _tracks(
    truth: Truth,
    motion: Motion,
    row: Row,
    key: list[int],
    *,
    seconds: float,
    rate: float,
    zeros: Floats,
    soft: Floats,
) -> tuple[tuple[Track, ...], tuple[Track, ...], dict[str, Any]]:
    """Tracks as read, as they were, and what was drawn."""
    rng, noise_rng, more_rng = (np.random.default_rng([*key, each]) for each in (0, 1, 3))
    t = np.arange(0.0, seconds, 1 / rate)
    q, v, _ = (values[:, truth.base :] for values in motion(t))
    count = q.shape[1]
    drawn: dict[str, Any] = {
        "eccentricity": row.eccentricity * rng.normal(size=(2, count)),
        "twice": row.twice * more_rng.normal(size=(2, count)),
        "gain": row.gain * more_rng.normal(size=count),
        "four": row.four * more_rng.normal(size=(2, count)),
        "lag": row.lag * rng.normal(size=count),
        "play": row.play * rng.normal(size=count),
        "track_scale": row.track_scale * rng.normal() if truth.moves else 0.0,
        "track_delay": row.track_delay * rng.normal() if truth.moves else 0.0,
    }
    eccentric = drawn["gain"] * q
    for name, times in (("eccentricity", 1), ("twice", 2), ("four", 4)):
        sine, cosine = drawn[name]
        eccentric += sine * np.sin(times * q) + cosine * np.cos(times * q)
    # Play changes sides smoothly, within about a hundredth of a radian per second.
    read = q + zeros + eccentric - drawn["lag"] * v + drawn["play"] * np.tanh(v / 0.01)
    read += row.encoder * noise_rng.normal(size=q.shape)
    if row.softness:
        # A motor's encoder reads more than the joint behind it, which the weight pulls down.
        read += soft * truth.torques(motion, t)[:, truth.base :]
    names = tuple(f"j{index}" for index in range(count))
    joints = Track(name="/joint_states", kind="joints", t=t, values=read, names=names)
    read_tracks, exact = (joints,), (replace(joints, values=q),)
    if not truth.moves:
        return read_tracks, exact, drawn
    t = np.arange(0.0, seconds, 1 / TRACK_RATE)
    R, p = truth.base_poses(motion, t)
    true = Track(name="/base", kind="pose", t=t, values=_pose_values(R, p))
    shift, turn = noise_rng.normal(size=(2, len(t), 3)) * np.array(row.track_noise)[:, None, None]
    R = Rotation.from_rotvec(turn).as_matrix() @ R
    p = p * (1.0 + drawn["track_scale"]) + shift
    late = replace(true, t=t + drawn["track_delay"], values=_pose_values(R, p))
    return (*read_tracks, late), (*exact, true), drawn


def _pose_values(R: Floats, p: Floats) -> Floats:
    return np.hstack([p, Rotation.from_matrix(R).as_quat()])


def _path(robot: Robot, tracks: tuple[Track, ...]) -> KinematicPath:
    """A robot in the package's own kinematics."""
    steps: list[FixedStep | JointStep | PoseStep] = [PoseStep(track=1)] * robot.moving_base
    for index, origin in enumerate(robot.origins):
        joint = JointStep(
            name=f"j{index}", kind="revolute", axis=np.array([0.0, 0.0, 1.0]), track=0, column=index
        )
        steps += [origin, joint]
    steps.append(robot.flange)
    return KinematicPath(world="world", parent="flange", steps=tuple(steps), tracks=tracks)
