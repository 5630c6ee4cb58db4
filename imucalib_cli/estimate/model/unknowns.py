"""The table of unknowns: every quantity that is estimated, one entry each.

Each entry has a prior that physics or data sheets give. No entry is switched on or off by a test of
its own: it is always there, and its prior decides how far it may go. Entries that share a ``scale``
share one standard deviation that no data sheet tells (how good this robot and this sensor are); it
is learnt from the log (solution/scales.py).

To add an unknown, add one entry to TABLE. What an entry does is one of a few kinds:

- ``Reading``: the sensor's reading is the ideal one plus value times basis(samples).
- ``JointCurve``: a joint's position is the reported one plus value times basis(q, dq/dt).
- ``Origin``: a constant translation of the chain, behind the first step that moves.
- ``PoseScale``: positions of a pose stream, relative.
- ``Clock``: stamps of a sensor are later by value times basis(age).
- ``Gravity``, ``Mount``: gravity in the world, and the pose that is wanted.
- ``BaseReading``, ``BaseMount``, ``BaseClock``: of the IMU that tells how the base moves, if one
  does: its readings, its pose in its link, its stamps against those of the joints.

Never in the table, because no log can tell them: the zero of the first joint (it turns the base),
the zero of the last joint and all that follows it (they are part of the mount), and where the base
stands. A URDF whose last link is wrong gives the pose that this URDF needs.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from imucalib_cli.robot.rotations import cross

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from imucalib_cli.arrays import Floats
    from imucalib_cli.signals.samples import Sensor

SENSORS: Final[tuple[Sensor, Sensor]] = ("accel", "gyro")
Group = Literal["mount", "bias", "gravity", "offset", "sensor", "robot"]

PLAY_RATE: Final = 0.01
"""rad/s or m/s: below it play does not yet lie on one side of the teeth."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """Readings of an IMU at instants evenly apart, for the basis of a Reading."""

    accel: Floats
    """(M, 3), m/s², IMU axes."""
    gyro: Floats
    """(M, 3), rad/s, IMU axes."""
    age: Floats
    """(M,), time since the middle of the log over the log's duration, -0.5 to 0.5."""
    dt: float
    """s."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Error of a sensor's reading: measured = ideal + value * basis(measured)."""

    sensor: Sensor
    basis: Callable[[Samples], Floats]
    """Gives (size, M, 3), in the IMU's axes."""
    turns: bool = False
    """Whether it turns the sensor's axes: it is taken off to the second order."""

    def own_response(self, dt: float) -> Floats:
        """(size, 3, 7), what an axis of the basis has about an instant at which it alone reads 1.

        The reading's noise is then in the column and in the residual alike.
        """
        quiet, middle = np.zeros((7, 3)), 3

        def basis(reading: Floats) -> Floats:
            accel, gyro = (reading, quiet) if self.sensor == "accel" else (quiet, reading)
            return self.basis(Samples(accel=accel, gyro=gyro, age=quiet[:, 0], dt=dt))

        pulses = quiet + np.eye(3)[:, None] * (np.arange(7) == middle)[:, None]
        found = [basis(pulse)[:, :, axis] for axis, pulse in enumerate(pulses)]
        return np.stack(found, axis=1) - np.moveaxis(basis(quiet), 1, 2)


@dataclass(frozen=True, eq=False)
class JointCurve:
    """Error of a joint's position: true = reported + value * basis(reported, rate)."""

    basis: Callable[[Floats, Floats], Floats]
    """Of (M,) positions, rad or m, and (M,) rates; gives (size, M)."""
    every: bool = True
    """For every joint that moves; else for those behind the first that does, but the last."""
    sliding: bool = True
    """For sliding joints too."""
    only: str | None = None
    """The one joint that it is for; None: all."""


@dataclass(frozen=True)
class Origin:
    """Translation of a constant step of the chain, in the frame before it."""


@dataclass(frozen=True)
class PoseScale:
    """Scale of the positions of a pose stream: true = reported * (1 + value)."""


@dataclass(frozen=True, eq=False)
class Clock:
    """Stamps: IMU stamp - robot stamp of the same instant = value * (accel, gyro)."""

    accel: Callable[[Floats], Floats]
    """Of (M,) seconds since the middle of the log; gives (M,)."""
    gyro: Callable[[Floats], Floats]


@dataclass(frozen=True)
class Gravity:
    """Gravity in the world: its direction (rotation vector) or its magnitude."""

    what: Literal["direction", "magnitude"]


@dataclass(frozen=True)
class Mount:
    """T_parent_imu: its translation or its rotation, in the parent frame."""

    what: Literal["translation", "rotation"]


@dataclass(frozen=True, eq=False)
class BaseReading:
    """Error of a reading of the IMU that tells how the base moves."""

    reading: Reading


@dataclass(frozen=True)
class BaseMount:
    """Pose of that IMU in its link: its translation or its rotation, in the link's frame."""

    what: Literal["translation", "rotation"]


@dataclass(frozen=True, eq=False)
class BaseClock:
    """Stamps of that IMU: its stamp - robot stamp of the same instant = value * basis."""

    basis: Callable[[Floats], Floats]
    """Of (M,) seconds since the middle of its readings; gives (M,)."""


Effect = (
    Reading
    | JointCurve
    | Origin
    | PoseScale
    | Clock
    | Gravity
    | Mount
    | BaseReading
    | BaseMount
    | BaseClock
)

_OF_ROBOT: Final = (JointCurve, Origin, PoseScale, BaseReading, BaseMount, BaseClock)

_GROUPS: Final[dict[type, Group]] = {
    Reading: "sensor",
    Clock: "sensor",
    JointCurve: "robot",
    Origin: "robot",
    PoseScale: "robot",
    Gravity: "gravity",
    Mount: "mount",
    BaseReading: "sensor",
    BaseMount: "robot",
    BaseClock: "offset",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Unknown:
    """One entry of the table."""

    name: str
    labels: tuple[str, ...] = ("",)
    """Of its components; joints and origins are named by the robot instead."""
    unit: str
    std: float = np.inf
    """Prior, 1 sigma; inf where nothing is known beforehand. With a scale: of components that the
    user leaves open where they tell others."""
    scale: str | None = None
    """Which learnt standard deviation its components share."""
    effect: Effect
    healthy: float = np.inf
    """Largest value, in the unit, that a sound robot and a sound sensor have."""
    least: float = 0.0
    """Values smaller than it are not named: they are no fault, or interpolation looks like them."""
    positive: bool = False
    """Whether a value below zero can only be something else that looks like it."""
    of_log: bool = False
    """Whether every recording has its own; else it is the robot's or the sensor's."""
    words: str
    """What it is, for people."""
    among: Group | None = None
    """Its group, where the effect does not tell."""

    @property
    def of_robot(self) -> bool:
        """Whether all IMUs on a robot that it concerns see the same; else it is the IMU's own."""
        return isinstance(self.effect, _OF_ROBOT)

    @property
    def group(self) -> Group:
        """What it belongs to, for options that hold all of a kind."""
        return self.among or _GROUPS[type(self.effect)]


@dataclass(frozen=True, kw_only=True)
class Scale:
    """A standard deviation that the log teaches, between two limits."""

    low: float
    high: float
    like: Mapping[str, float] = field(default_factory=dict)
    """How large it mostly is over others that the same parts or the same measurement make."""
    walking: float | None = None
    """Upper limit on robots whose base an IMU tells: those that walk, if it is another."""

    def highest(self, *, walks: bool) -> float:
        """Upper limit on a robot."""
        return self.walking if walks and self.walking is not None else self.high


def _axes(samples: Samples) -> Floats:
    """One unit along each of the sensor's axes."""
    return np.repeat(np.eye(3)[:, None], len(samples.age), axis=1)


def _ramp(samples: Samples) -> Floats:
    return _axes(samples) * samples.age[:, None]


def _each_axis(values: Floats) -> Floats:
    """Axis by axis of what is read."""
    return np.asarray(np.eye(3)[:, None] * values)


def _turned(values: Floats) -> Floats:
    """What a small turn from the gyroscope's axes to the accelerometer's takes from a reading."""
    return -cross(np.eye(3)[:, None], values[None])


def _skewed(values: Floats) -> Floats:
    """Each of two axes fed by the other alike: (3, M, 3), of yz, xz and xy."""
    basis = np.zeros((3, len(values), 3))
    for left_out, (one, other) in enumerate(((1, 2), (0, 2), (0, 1))):
        basis[left_out, :, one], basis[left_out, :, other] = values[:, other], values[:, one]
    return basis


def _of_the_other(values: Floats) -> Floats:
    """Each axis of one sensor fed by each of the other: (9, M, 3), row by row."""
    basis = np.zeros((3, 3, len(values), 3))
    for axis in range(3):
        basis[axis, :, :, axis] = values.T
    return basis.reshape(9, len(values), 3)


def with_ends(inner: Floats) -> Floats:
    """Differences, the first and the last repeated at the ends, which no window uses."""
    return np.concatenate([inner[:1], inner, inner[-1:]])


def _second_derivative(values: Floats, dt: float) -> Floats:
    return with_ends((values[2:] - 2.0 * values[1:-1] + values[:-2]) / dt**2)[None]


def _derivative(values: Floats, dt: float) -> Floats:
    return with_ends((values[2:] - values[:-2]) / (2.0 * dt))


def _swayed(samples: Samples) -> Floats:
    """Acceleration of a sway that follows the force: gravity's own, at rest in the world, is 0."""
    f, w, dt = samples.accel, samples.gyro, samples.dt
    by_turning = cross(w, 2.0 * _derivative(f, dt) + cross(w, f)) + cross(_derivative(w, dt), f)
    return -(_second_derivative(f, dt) + by_turning)


_XYZ: Final = ("x", "y", "z")
_SKEWS: Final = ("yz", "xz", "xy")
_PAIRS: Final = tuple(f"{gyro} by {accel}" for gyro in "xyz" for accel in "xyz")

SCALES: Final[dict[str, Scale]] = {
    "sensor_scale": Scale(low=5e-7, high=2e-2),
    "sensor_axes": Scale(low=5e-7, high=2e-2),
    "g_sensitivity": Scale(low=1e-8, high=3e-4),
    "driver_filter": Scale(low=3e-8, high=3e-4),
    "mount_give": Scale(low=3e-8, high=3e-3),
    "base_place": Scale(low=3e-4, high=1e-2),
    "base_turn": Scale(low=1e-3, high=5e-2),
    "joint_zero": Scale(low=3e-4, high=5e-3, walking=2e-2),
    "length": Scale(low=2e-6, high=3e-3, like={"joint_zero": 0.5}),
    "joint_harmonic": Scale(low=5e-7, high=2e-3, like={"joint_play": 1.0, "joint_zero": 0.5}),
    "joint_lag": Scale(low=5e-7, high=4e-3),
    "joint_play": Scale(low=3e-7, high=1e-3),
}
"""From as good as exact to the worst that is sold, in the unit of their entries.

A tenth of the best that is made cannot be told from exact, which a simulated system is. The best
are sensors calibrated over temperature to 5e-6, measuring arms to 20 micrometres, encoders on the
output. The worst are consumer sensors, hobby arms, legs whose joints are turned to a stop by hand
to be zeroed, encoders behind a worn gear, a field bus cycle of delay. The IMU on a moving base is
placed by measured holes or by eye. Zeros are never taken to be better than one arc minute, as
calibrated arms have them: those of joints that stand still in a log are known by the others' alone.

Zeros and lengths are found by one measurement, which puts its error down to either: at the end of a
link of half a metre they count alike. A zero is set at one position of the joint, where the error
once a turn is a part of it. That error and the play are made by the same teeth: catalogues of
strain wave gears give one arc minute for either."""

_OWN: Final[tuple[Unknown, ...]] = (
    Unknown(
        name="translation",
        labels=_XYZ,
        unit="m",
        std=10.0,
        effect=Mount("translation"),
        words="place of the IMU in its parent link",
    ),
    Unknown(
        name="rotation",
        labels=_XYZ,
        unit="rad",
        std=np.pi,
        effect=Mount("rotation"),
        words="rotation of the IMU in its parent link",
    ),
    Unknown(
        name="accel_bias",
        among="bias",
        labels=_XYZ,
        unit="m/s²",
        std=10.0,
        healthy=0.5,
        effect=Reading("accel", _axes),
        of_log=True,
        words="bias of the accelerometer",
    ),
    Unknown(
        name="gyro_bias",
        among="bias",
        labels=_XYZ,
        unit="rad/s",
        std=1.0,
        healthy=0.2,
        effect=Reading("gyro", _axes),
        of_log=True,
        words="bias of the gyroscope",
    ),
    Unknown(
        name="accel_bias_ramp",
        labels=_XYZ,
        unit="m/s²",
        std=0.03,
        healthy=0.3,
        effect=Reading("accel", _ramp),
        least=np.inf,
        of_log=True,
        words="change of the accelerometer's bias over the log",
    ),
    Unknown(
        name="gyro_bias_ramp",
        labels=_XYZ,
        unit="rad/s",
        std=0.003,
        healthy=0.03,
        effect=Reading("gyro", _ramp),
        least=np.inf,
        of_log=True,
        words="change of the gyroscope's bias over the log",
    ),
    Unknown(
        name="gravity_direction",
        labels=("x", "y"),
        unit="rad",
        std=np.pi,
        effect=Gravity("direction"),
        of_log=True,
        words="direction of gravity in the world",
    ),
    Unknown(
        name="gravity_norm",
        unit="m/s²",
        std=0.02,
        healthy=0.06,
        effect=Gravity("magnitude"),
        least=0.045,
        of_log=True,
        words="magnitude of gravity less the nominal one",
    ),
    Unknown(
        name="time_offset",
        among="offset",
        unit="s",
        std=0.1,
        effect=Clock(accel=np.ones_like, gyro=np.ones_like),
        of_log=True,
        words="IMU stamp less robot stamp, gyroscope",
    ),
    Unknown(
        name="clock_drift",
        unit="s/s",
        std=50e-6,
        healthy=500e-6,
        least=1e-5,  # less than good quartz: jitter of stamps looks like it
        effect=Clock(accel=np.positive, gyro=np.positive),
        of_log=True,
        words="gain of the IMU's clock on the robot's",
    ),
    Unknown(
        name="gyro_delay",
        unit="s",
        std=2e-3,
        healthy=0.02,
        effect=Clock(accel=lambda age: -np.ones_like(age), gyro=np.zeros_like),
        of_log=True,
        words="delay of the gyroscope behind the accelerometer",
    ),
    Unknown(
        name="accel_filter",
        unit="s²",
        scale="driver_filter",
        healthy=1e-3,
        effect=Reading("accel", lambda s: _second_derivative(s.accel, s.dt)),
        positive=True,
        words="low-pass filter of the accelerometer beside its delay",
    ),
    Unknown(
        name="gyro_filter",
        unit="s²",
        scale="driver_filter",
        healthy=1e-3,
        effect=Reading("gyro", lambda s: _second_derivative(s.gyro, s.dt)),
        positive=True,
        words="low-pass filter of the gyroscope beside its delay",
    ),
    Unknown(
        name="accel_scale",
        labels=_XYZ,
        unit="1",
        scale="sensor_scale",
        healthy=0.05,
        effect=Reading("accel", lambda s: _each_axis(s.accel)),
        words="scale error of the accelerometer",
    ),
    Unknown(
        name="gyro_scale",
        labels=_XYZ,
        unit="1",
        scale="sensor_scale",
        healthy=0.05,
        effect=Reading("gyro", lambda s: _each_axis(s.gyro)),
        words="scale error of the gyroscope",
    ),
    Unknown(
        name="gyro_misalignment",
        labels=_XYZ,
        unit="rad",
        scale="sensor_axes",
        healthy=0.05,
        effect=Reading("gyro", lambda s: _turned(s.gyro), turns=True),
        words="turn of the gyroscope's axes against the accelerometer's",
    ),
    Unknown(
        name="accel_skew",
        labels=_SKEWS,
        unit="rad",
        scale="sensor_axes",
        healthy=0.05,
        effect=Reading("accel", lambda s: _skewed(s.accel)),
        words="half of what axes of the accelerometer are off square",
    ),
    Unknown(
        name="gyro_skew",
        labels=_SKEWS,
        unit="rad",
        scale="sensor_axes",
        healthy=0.05,
        effect=Reading("gyro", lambda s: _skewed(s.gyro)),
        words="half of what axes of the gyroscope are off square",
    ),
    Unknown(
        name="gyro_g_sensitivity",
        labels=_PAIRS,
        unit="rad s/m",
        scale="g_sensitivity",
        healthy=2e-3,
        effect=Reading("gyro", lambda s: _of_the_other(s.accel)),
        words="response of the gyroscope to acceleration",
    ),
    Unknown(
        name="mount_give",
        among="robot",
        unit="m/(m/s²)",
        scale="mount_give",
        healthy=1e-4,
        effect=Reading("accel", _swayed),
        least=1e-4,
        positive=True,
        words="give of the mount or the arm",
    ),
    Unknown(
        name="joint_zero",
        unit="rad",
        scale="joint_zero",
        healthy=0.02,
        effect=JointCurve(lambda q, _: np.ones((1, len(q))), every=False, sliding=False),
        words="zero of a joint: true less reported position",
    ),
    Unknown(
        name="joint_harmonic",
        labels=("sin", "cos"),
        unit="rad",
        scale="joint_harmonic",
        healthy=0.01,
        effect=JointCurve(lambda q, _: np.stack([np.sin(q), np.cos(q)]), sliding=False),
        words="joint error once a turn (eccentric encoder)",
    ),
    Unknown(
        name="joint_lag",
        unit="s",
        scale="joint_lag",
        # A cycle of a slow controller. From there on its second order, of which no column knows,
        # is more than the zeros of an ordinary arm are off.
        healthy=0.01,
        effect=JointCurve(lambda _, rate: rate[None]),
        words="delay of a joint's position",
    ),
    Unknown(
        name="joint_play",
        unit="rad",
        scale="joint_play",
        healthy=0.005,
        effect=JointCurve(lambda _, rate: np.tanh(rate / PLAY_RATE)[None]),
        words="play of a joint, to either side with its motion",
    ),
    Unknown(
        name="origin",
        labels=_XYZ,
        unit="m",
        scale="length",
        healthy=0.02,
        effect=Origin(),
        words="origin between two joints: true less URDF",
    ),
    Unknown(
        name="pose_scale",
        unit="1",
        std=2e-3,
        healthy=0.02,
        effect=PoseScale(),
        words="scale of a pose stream's positions",
    ),
    Unknown(
        name="base_translation",
        labels=_XYZ,
        unit="m",
        std=3e-3,
        scale="base_place",
        healthy=0.02,
        effect=BaseMount("translation"),
        words="place of the base IMU in its link: true less URDF",
    ),
    Unknown(
        name="base_rotation",
        labels=_XYZ,
        unit="rad",
        std=5e-3,
        scale="base_turn",
        healthy=0.1,
        effect=BaseMount("rotation"),
        words="rotation of the base IMU in its link: true less URDF",
    ),
    Unknown(
        name="base_time_offset",
        unit="s",
        std=0.02,
        effect=BaseClock(np.ones_like),
        of_log=True,
        words="stamp of the base IMU's accelerometer less joint stamp",
    ),
    Unknown(
        name="base_clock_drift",
        unit="s/s",
        std=50e-6,
        healthy=500e-6,
        effect=BaseClock(np.positive),
        of_log=True,
        words="gain of the base IMU's clock on the robot's",
    ),
    Unknown(
        name="base_gyro_delay",
        unit="s",
        std=2e-3,
        healthy=0.02,
        effect=BaseReading(Reading("gyro", lambda s: -_derivative(s.gyro, s.dt)[None])),
        of_log=True,
        words="delay of the gyroscope behind the accelerometer, base IMU",
    ),
)


def _of_the_base(unknown: Unknown, reading: Reading) -> Unknown:
    """The same error of the IMU that tells how the base moves."""
    return replace(
        unknown,
        name=f"base_{unknown.name}",
        among=unknown.among,
        effect=BaseReading(reading),
        words=f"{unknown.words}, base IMU",
    )


TABLE: Final[tuple[Unknown, ...]] = (
    *_OWN,
    *(
        _of_the_base(each, each.effect)
        for each in _OWN
        if isinstance(each.effect, Reading) and each.name != "mount_give"
    ),
)
"""Whatever is wrong with one IMU may be wrong with the other, by the same priors."""

LEAN: Final = tuple(
    each
    for each in TABLE
    if each.name.removeprefix("base_")
    in {"translation", "rotation", "accel_bias", "gyro_bias", "gravity_direction", "time_offset"}
    and not isinstance(each.effect, BaseMount)
)
"""What is found first, before the rest of the table is linearised about it."""
