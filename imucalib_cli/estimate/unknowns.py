"""The table of unknowns: every quantity that is estimated, one entry each.

Each entry has a prior from physics or data sheets. No entry is switched on or off by a test of its
own, but for the payload and the bending of the base, which cannot be distinguished from other
errors where no joint bends: an entry is always there, and its prior decides how far it may go.
Entries with the same ``scale`` share one standard deviation that no data sheet states (how good
this robot and this sensor are); it is learnt from the log (solution/scales.py).

To add an unknown, add one entry to ENTRIES. Its effect is one of the kinds of effects.py.

Never in the table, because no log determines them: the zero of the first joint (it turns the base),
the zero of the last joint and all that follows it (they are part of the mount), and the place of
the base. A URDF whose last link is wrong gives the pose that this URDF needs.
"""

from __future__ import annotations

from operator import methodcaller
from pickle import PicklingError
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from imucalib_cli.estimate.effects import (
    EACH_AXIS,
    Clock,
    Effect,
    Gravity,
    JointCurve,
    Mount,
    OfBase,
    Origin,
    PayloadMass,
    PoseStream,
    Reading,
    Samples,
)
from imucalib_cli.robot.rotations import cross, skew
from imucalib_cli.signals.kernels import with_ends
from imucalib_cli.signals.samples import GRAVITY_STD

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from imucalib_cli.arrays import Floats
    from imucalib_cli.signals.samples import Sensor

Group = Literal["mount", "bias", "gravity", "offset", "sensor", "robot"]

PLAY_RATE: Final = 0.01
"""rad/s or m/s: a slower joint does not surely touch one side of its teeth."""

# Matrices M of vectors v @ M, one for each component of an error.
_ALIKE: Final = np.eye(3)[None]
"""All axes alike."""
_ACROSS: Final = np.abs(skew(np.eye(3)))
"""yz, xz and xy: each of two axes reads the same share of the other."""
_BY_EACH: Final = np.einsum("gi,aj->gaji", np.eye(3), np.eye(3)).reshape(9, 3, 3)
"""Each axis reads a share of each."""

_GROUPS: Final[dict[type, Group]] = {
    Reading: "sensor",
    Clock: "sensor",
    Gravity: "gravity",
    Mount: "mount",
}
"""Of effects, also of the base IMU; all others are the robot's."""


class Unknown(Struct, frozen=True, kw_only=True, eq=False):
    """One entry of the table."""

    name: str
    labels: tuple[str, ...] = ("",)
    """Of its components; joints and origins are named after the robot instead."""
    unit: str
    std: float = np.inf
    """Prior, 1 sigma; inf where nothing is known beforehand. With a scale: of components that the
    user leaves open while stating others."""
    scale: str | None = None
    """Name of the learnt standard deviation that its components share."""
    effect: Effect
    healthy: float = np.inf
    """Largest value, in the unit, of a sound robot and a sound sensor."""
    least: float = 0.0
    """Smaller values are not reported: they are no fault, or interpolation looks like them."""
    harmless: bool = False
    """Whether a value beyond the healthy leaves the pose as good as its sigma says."""
    positive: bool = False
    """Whether a negative value can only be something else that looks like it."""
    lean: bool = False
    """Whether it is solved first: nothing works without it, and the rest of the table is then
    linearised about it."""
    of_log: bool = False
    """Whether every recording has its own; else it belongs to the robot or the sensor."""
    words: str
    """What it is, for people."""
    among: Group | None = None
    """Its group, where it is not that of its effect."""

    def __reduce__(self) -> tuple[Callable[[str], Unknown], tuple[str]]:
        """Pickle the name of an entry of the table: functions of an effect cannot be pickled."""
        if _BY_NAME.get(self.name) is not self:
            raise PicklingError(f"{self.name} is no entry of the table")
        return unknown_named, (self.name,)

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Its effect, and what the same components change of the other sensor."""
        also = self.effect.also if isinstance(self.effect, Reading) else None
        return (self.effect,) if also is None else (self.effect, also)

    @property
    def of_either(self) -> Effect:
        """Its effect, whether of the one IMU or the other."""
        return self.effect.effect if isinstance(self.effect, OfBase) else self.effect

    @property
    def of_robot(self) -> bool:
        """Whether it is the same for all IMUs on a robot; else each IMU has its own."""
        return isinstance(self.effect, (JointCurve, Origin, PoseStream, OfBase))

    @property
    def is_sensor_scale(self) -> bool:
        """Whether it is stated as measured over true."""
        return self.scale == "sensor_scale"

    @property
    def group(self) -> Group:
        """Group, for options that hold all unknowns of a kind."""
        return self.among or _GROUPS.get(type(self.of_either), "robot")


class Scale(Struct, frozen=True, kw_only=True):
    """A standard deviation that is learnt from the log, between two limits."""

    low: float
    high: float
    like: Mapping[str, float] = field(default_factory=dict)
    """Its usual ratio to other scales that the same parts or the same measurement determine."""
    usual: float | None = None
    """Its size in what is sold most; None where no size is more usual than others."""
    walking: float | None = None
    """Upper limit on robots whose base is measured by an IMU: those that walk, if it differs."""
    one_gross: bool = False
    """Whether one part alone may be wrong, as what is set or typed one by one, others as usual."""

    def highest(self, *, walks: bool) -> float:
        """Upper limit on a robot."""
        return self.walking if walks and self.walking is not None else self.high


_XYZ: Final = ("x", "y", "z")
_PLANES: Final = ("yz", "xz", "xy")


def _second_derivative(values: Floats, dt: float) -> Floats:
    return with_ends((values[2:] - 2.0 * values[1:-1] + values[:-2]) / dt**2)


def _derivative(values: Floats, dt: float) -> Floats:
    return with_ends((values[2:] - values[:-2]) / (2.0 * dt))


def _swayed(samples: Samples, matrices: Floats) -> Floats:
    """(..., M, 3), acceleration of a sway in proportion to the force."""
    f, w, dt = samples.accel, samples.gyro, samples.dt
    forces = (f, _derivative(f, dt), _second_derivative(f, dt))
    away, speed, change = (each @ matrices for each in forces)
    # The mount gives against the force that it exerts.
    by_turning = cross(w, 2.0 * speed + cross(w, away)) + cross(_derivative(w, dt), away)
    return np.asarray(-(change + by_turning))


def _seen_turned(samples: Samples, matrices: Floats) -> Floats:
    """(..., M, 3), error of the force, read in axes that turn with it."""
    return np.asarray(cross(samples.accel, samples.accel @ matrices))


def _apart(samples: Samples, places: Floats) -> Floats:
    """(..., M, 3), acceleration of each axis where it is, rows of (..., 3, 3), m, IMU axes."""
    w, along = samples.gyro, np.einsum("...aa->...a", places)
    turning = _derivative(w, samples.dt) @ np.einsum("jai,...ai->...ja", skew(np.eye(3)), places)
    towards = (w**2).sum(axis=1)[:, None] * along[..., None, :]
    return np.asarray(turning + w * (w @ np.swapaxes(places, -1, -2)) - towards)


_OF_Y_AND_Z: Final = np.einsum("xa,ij->xiaj", [[-1, 1, 0], [-1, 0, 1]], np.eye(3)).reshape(6, 3, 3)
"""Places of the axes y and z, along x, y and z, from the middle of all three."""


def _rate_turned(samples: Samples, matrices: Floats) -> Floats:
    """(..., M, 3), error of the rate, read in axes that turn with the force."""
    turn = samples.accel @ matrices
    rate = _derivative(samples.accel, samples.dt) @ matrices
    return np.asarray(rate + cross(samples.gyro, turn))


_PAIRS: Final = tuple(f"{gyro} by {accel}" for gyro in "xyz" for accel in "xyz")

SCALES: Final[dict[str, Scale]] = {
    "sensor_scale": Scale(low=5e-7, high=2e-2),
    "sensor_axes": Scale(low=5e-7, high=2e-2, usual=1e-2),
    "sensor_turn": Scale(low=5e-7, high=2e-2, usual=1e-2),
    "accel_place": Scale(low=1e-6, high=3e-3),
    "accel_square": Scale(low=1e-7, high=3e-4),
    "g_sensitivity": Scale(low=1e-8, high=3e-4),
    "driver_filter": Scale(low=3e-8, high=3e-4),
    "mount_give": Scale(low=3e-8, high=3e-3),
    "mount_turn": Scale(low=1e-8, high=3e-3),
    "pose_turn": Scale(low=1e-5, high=5e-2),
    "pose_age": Scale(low=1e-5, high=0.1),
    "pose_filter": Scale(low=3e-8, high=3e-4),
    "base_place": Scale(low=3e-4, high=1e-2),
    "base_turn": Scale(low=1e-3, high=5e-2),
    "joint_zero": Scale(low=3e-4, high=5e-3, walking=2e-2, one_gross=True),
    "length": Scale(low=2e-6, high=3e-3, like={"joint_zero": 0.5}, one_gross=True),
    "joint_axis": Scale(low=2e-6, high=5e-3, like={"length": 0.4}),
    "joint_harmonic": Scale(low=5e-7, high=2e-3, like={"joint_play": 1.0, "joint_zero": 0.5}),
    "joint_second_harmonic": Scale(low=5e-7, high=2e-3, like={"joint_harmonic": 0.5}),
    "joint_fourth_harmonic": Scale(low=5e-7, high=2e-3, like={"joint_second_harmonic": 0.5}),
    "joint_gain": Scale(low=5e-7, high=2e-2),
    "joint_lag": Scale(low=5e-7, high=4e-3),
    "joint_filter": Scale(low=3e-8, high=3e-4),
    "joint_play": Scale(low=3e-7, high=1e-3),
    "joint_sag": Scale(low=3e-7, high=2e-3),
}
"""From as good as exact to the worst that is sold, in the unit of their entries.

A tenth of the best that is made cannot be distinguished from exact, as a simulated system is. The
best are sensors calibrated over temperature to 5e-6, measuring arms to 20 micrometres, encoders on
the output, joints of 1e6 Nm/rad. The worst are consumer sensors, hobby arms, legs whose joints are
zeroed by turning them to a stop by hand, encoders behind a worn gear, a field bus cycle of delay,
20 kg on a joint of 1e4 Nm/rad. The IMU on a moving base and the markers on one are placed by
measured holes or by eye. A compass is off by some degrees, and positions by satellites are up to a
tenth of a second old; a tracker gives both at once. Zeros are never assumed better than one arc
minute, as on calibrated arms, but in a system of one quality: zeros of joints that stand still in a
log are known only from those of the others.

Axes have a usual size, since a log of one or two joints shows few of their components: if these
are small by chance, the others would be taken to be small too. Data sheets of consumer sensors
state 0.5 to 2 %, those of industrial ones 0.05 deg.

Axes of an accelerometer are parts of one chip, or three chips on one board: they are tenths of a
millimetre to some millimetres apart.

The rotation between the triads of the two sensors is that of two chips in one package, and no log
shows it without the pose. It is not assumed as small as the skews of each triad, which a log shows:
a sensor that is square would then be taken to be without it.

Zeros and lengths are found by one measurement, whose error goes into either: at the end of a link
of half a metre they count alike. Axes come from the machine that makes the lengths: some hundredths
of a millimetre over the width of a bearing. A zero is set at one position of the joint, where the
error once a turn is a part of it. The same teeth make that error and the play: catalogues of strain
wave gears give one arc minute for either. An encoder's disk that is off its axis errs once a turn,
one that is not round errs twice; over half a turn the one looks like the other, and the first is
the larger."""


def measured_over_true(error: Floats, std: Floats) -> tuple[Floats, Floats]:
    """Scale of a sensor, and its sigma, from its error: readings are ideal + error * readings."""
    return 1.0 / (1.0 - error), std / (1.0 - error) ** 2


def _of_each_sensor(
    name: str,
    words: str,
    error: Callable[[Floats, Samples], Floats],
    matrices: Floats,
    *,
    cancels: bool = False,
    units: tuple[str, str],
    std: tuple[float, float] = (np.inf, np.inf),
    healthy: tuple[float, float],
    **others: Any,
) -> tuple[Unknown, Unknown]:
    """The same kind of error of the accelerometer and of the gyroscope.

    The error is a function of the sensor's readings (M, 3) and of those of both: it gives vectors
    (M, 3), which the matrices mix.
    """

    def entry(place: int, sensor: Sensor, noun: str) -> Unknown:
        effect = Reading(
            sensor, lambda s, mixing: error(s.of(sensor), s) @ mixing, matrices, cancels=cancels
        )
        return Unknown(
            name=f"{sensor}_{name}",
            unit=units[place],
            std=std[place],
            healthy=healthy[place],
            effect=effect,
            words=words.format(noun),
            **others,
        )

    return entry(0, "accel", "accelerometer"), entry(1, "gyro", "gyroscope")


# Reasons of the numbers below. Priors: quartz keeps 50 ppm; filters of the two sensors of one
# chip differ by some ms; biases of consumer parts drift by 3 mg and 0.2 deg/s while they warm up;
# mocap and odometry arrive some ms late and keep lengths to 0.2 %. Limits of the healthy: the
# MPU-6050, a hobby part, states scales to 3 %, axes to 2 %, a nonlinearity of 0.5 %, which is
# 2.5e-4 s²/m at 2 g, and responses to acceleration of 2e-4 rad s/m; its biases reach 0.8 m/s² and
# 0.35 rad/s, of which 0.5 and 0.2 are worth a word. Axes of an accelerometer lie within its
# package, 5 mm. Clocks ten times worse than quartz are broken. Drivers of phones and of IMUs at
# 20 Hz give one sensor 45 ms before the other, filtered by 32 ms (a phone and three drones):
# twice as much is sound. Zeros and axes of one degree, origins of 20 mm and play of 0.3 deg are
# another robot than the URDF's, and a gear ratio 5 % off is that of another gear. What filters a
# joint's report by 30 ms is made for a display. By eye, a base IMU is placed to 20 mm and 0.1
# rad, markers, which are larger, to 50 mm and 0.2 rad. A compass beside motors is 0.1 rad off.
# Twice the oldest position that is sold is sound; a tracker smooths as a driver does.
ENTRIES: Final[tuple[Unknown, ...]] = (
    Unknown(
        name="translation",
        labels=_XYZ,
        unit="m",
        std=10.0,
        effect=Mount("translation"),
        lean=True,
        words="place of the IMU in its parent link",
    ),
    Unknown(
        name="rotation",
        labels=_XYZ,
        unit="rad",
        std=np.pi,
        effect=Mount("rotation"),
        lean=True,
        words="rotation of the IMU in its parent link",
    ),
    *_of_each_sensor(
        "bias",
        "bias of the {}",
        lambda values, _: np.ones_like(values),
        EACH_AXIS,
        among="bias",
        labels=_XYZ,
        units=("m/s²", "rad/s"),
        std=(10.0, 1.0),
        healthy=(0.5, 0.2),
        lean=True,
        of_log=True,
    ),
    *_of_each_sensor(
        "bias_ramp",
        "change of the {}'s bias over the log",
        lambda values, samples: np.ones_like(values) * samples.age[:, None],
        EACH_AXIS,
        labels=_XYZ,
        units=("m/s²", "rad/s"),
        std=(0.03, 0.003),
        healthy=(0.3, 0.03),
        least=np.inf,
        harmless=True,
        of_log=True,
    ),
    Unknown(
        name="gravity_direction",
        labels=("x", "y"),
        unit="rad",
        std=np.pi,
        effect=Gravity("direction"),
        lean=True,
        of_log=True,
        words="direction of gravity in the world",
    ),
    Unknown(
        name="gravity_norm",
        unit="m/s²",
        std=GRAVITY_STD,
        healthy=3.0 * GRAVITY_STD,
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
        effect=Clock(accel=(1.0, 0.0), gyro=(1.0, 0.0)),
        lean=True,
        of_log=True,
        words="IMU stamp less robot stamp, gyroscope",
    ),
    Unknown(
        name="clock_drift",
        unit="s/s",
        std=50e-6,
        healthy=500e-6,
        least=1e-5,  # less than good quartz: jitter of stamps looks like it
        effect=Clock(accel=(0.0, 1.0), gyro=(0.0, 1.0)),
        of_log=True,
        words="drift of the IMU's clock relative to the robot's",
    ),
    Unknown(
        name="gyro_delay",
        unit="s",
        std=2e-3,
        healthy=0.1,
        effect=Clock(accel=(-1.0, 0.0), gyro=(0.0, 0.0)),
        of_log=True,
        words="delay of the gyroscope behind the accelerometer",
    ),
    *_of_each_sensor(
        "filter",
        "low-pass filter of the {}, in addition to its delay",
        lambda values, samples: _second_derivative(values, samples.dt),
        _ALIKE,
        cancels=True,
        units=("s²", "s²"),
        scale="driver_filter",
        healthy=(4e-3, 4e-3),
        positive=True,
    ),
    *_of_each_sensor(
        "scale",
        "scale error of the {}",
        lambda values, _: values,
        EACH_AXIS,
        labels=_XYZ,
        units=("1", "1"),
        scale="sensor_scale",
        healthy=(0.05, 0.05),
    ),
    Unknown(
        name="accel_square",
        labels=_XYZ,
        unit="s²/m",
        scale="accel_square",
        healthy=5e-4,
        effect=Reading("accel", lambda s, mixing: s.accel**2 @ mixing),
        words="error of the accelerometer by the square of its reading",
    ),
    Unknown(
        name="accel_place",
        labels=tuple(f"{axis} along {along}" for axis in "yz" for along in "xyz"),
        unit="m",
        scale="accel_place",
        healthy=5e-3,
        effect=Reading("accel", _apart, _OF_Y_AND_Z),
        words="place at which an axis of the accelerometer measures, from the middle of all three",
    ),
    Unknown(
        name="gyro_misalignment",
        labels=_XYZ,
        unit="rad",
        scale="sensor_turn",
        healthy=0.05,
        effect=Reading("gyro", lambda s, mixing: s.gyro @ mixing, skew(np.eye(3)), turns=True),
        words="rotation of the gyroscope's axes relative to the accelerometer's",
    ),
    *_of_each_sensor(
        "skew",
        "half of the non-orthogonality of the {}'s axes",
        lambda values, _: values,
        _ACROSS,
        labels=_PLANES,
        units=("rad", "rad"),
        scale="sensor_axes",
        healthy=(0.05, 0.05),
    ),
    Unknown(
        name="gyro_g_sensitivity",
        labels=_PAIRS,
        unit="rad s/m",
        scale="g_sensitivity",
        healthy=2e-3,
        effect=Reading("gyro", lambda s, mixing: s.accel @ mixing, _BY_EACH),
        words="response of the gyroscope to acceleration",
    ),
    Unknown(
        name="mount_give",
        labels=(*_XYZ, *_PLANES),
        among="robot",
        unit="m/(m/s²)",
        scale="mount_give",
        healthy=1e-4,
        effect=Reading("accel", _swayed, np.concatenate([EACH_AXIS, _ACROSS]), sways="place"),
        least=1e-4,
        positive=True,
        words="compliance of the mount or the arm",
    ),
    Unknown(
        name="mount_turn",
        labels=_PAIRS,
        among="robot",
        unit="rad/(m/s²)",
        scale="mount_turn",
        healthy=2e-3,  # with an arm of 50 mm the largest give
        effect=Reading(
            "accel",
            _seen_turned,
            _BY_EACH,
            also=Reading("gyro", _rate_turned, _BY_EACH),
            sways="turn",
        ),
        least=1e-6,  # 10 µrad under gravity: 1 µm on an arm of 0.1 m
        words="turn of the mount under load",
    ),
    Unknown(
        name="joint_zero",
        unit="rad",
        scale="joint_zero",
        healthy=0.02,
        effect=JointCurve(
            lambda m: np.ones((1, len(m.position))),
            every=False,
            at_rest=True,
            sliding=False,
            followers=True,
        ),
        words="zero of a joint: true less reported position",
    ),
    *(
        Unknown(
            name=name,
            labels=("sin", "cos"),
            unit="rad",
            scale=name,
            healthy=0.01,
            effect=JointCurve(methodcaller("harmonic", doublings), sliding=False, at_rest=True),
            words=f"joint error {how_often}",
        )
        for doublings, (name, how_often) in enumerate(
            (
                ("joint_harmonic", "once a turn (eccentric encoder)"),
                ("joint_second_harmonic", "twice a turn (encoder)"),
                ("joint_fourth_harmonic", "four times a turn (encoder)"),
            )
        )
    ),
    Unknown(
        name="joint_gain",
        unit="1",
        scale="joint_gain",
        healthy=0.05,
        effect=JointCurve(lambda m: m.position[None], at_rest=True),
        words="scale of a joint's reading (gear ratio): true over reported, less one",
    ),
    Unknown(
        name="joint_lag",
        unit="s",
        scale="joint_lag",
        # A cycle of a slow controller.
        healthy=0.01,
        effect=JointCurve(lambda m: m.rate[None]),
        words="delay of a joint's position",
    ),
    Unknown(
        name="joint_filter",
        unit="s²",
        scale="joint_filter",
        healthy=1e-3,
        # What a filter adds to a reading is added to a report here, with the other sign.
        effect=JointCurve(lambda m: -m.change[None]),
        least=5e-5,  # less may be the second order of a delay, up to the largest that is sound
        positive=True,
        words="low-pass filter of a joint's position, in addition to its delay",
    ),
    Unknown(
        name="joint_play",
        unit="rad",
        scale="joint_play",
        healthy=0.005,
        effect=JointCurve(lambda m: np.stack([np.tanh(m.rate / PLAY_RATE), m.side])),
        labels=("returns", "stays"),
        words="play of a joint, to the side of its motion; at rest it returns, or stays there",
    ),
    Unknown(
        name="joint_sag",
        unit="rad/(Nm/kg)",
        scale="joint_sag",
        healthy=1e-2,  # 100 kg on a base of 1e4 Nm/rad: an arm on soft tyres
        effect=JointCurve(lambda m: m.load[None], loaded=True, sliding=False),
        positive=True,
        words="bending of a joint under the load that it carries",
    ),
    Unknown(
        name="payload",
        labels=("origin", *_XYZ),
        unit="rad/(Nm/kg)",
        scale="joint_sag",
        effect=PayloadMass(),
        words="bending of the joints by what the parent link carries",
    ),
    Unknown(
        name="origin",
        labels=_XYZ,
        unit="m",
        scale="length",
        healthy=0.02,
        effect=Origin("translation"),
        words="origin between two joints: true minus URDF",
    ),
    Unknown(
        name="joint_axis",
        labels=_XYZ,
        unit="rad",
        scale="joint_axis",
        healthy=0.02,
        effect=Origin("rotation"),
        words="direction of a joint's axis: true minus URDF",
    ),
    Unknown(
        name="pose_frame_place",
        labels=_XYZ,
        unit="m",
        scale="base_place",
        healthy=0.05,
        effect=Origin("translation", of_stream=True),
        words="place of the tracked frame in the robot: true minus URDF",
    ),
    Unknown(
        name="pose_frame_turn",
        labels=_XYZ,
        unit="rad",
        scale="base_turn",
        healthy=0.2,
        effect=Origin("rotation", of_stream=True),
        words="rotation of the tracked frame in the robot: true minus URDF",
    ),
    Unknown(
        name="pose_scale",
        unit="1",
        std=2e-3,
        healthy=0.02,
        effect=PoseStream("scale"),
        words="scale of a pose stream's positions",
    ),
    Unknown(
        name="pose_turn",
        labels=_XYZ,
        unit="rad",
        scale="pose_turn",
        healthy=0.1,
        effect=PoseStream("turn"),
        words="rotation of a pose stream's positions: true against reported",
    ),
    Unknown(
        name="pose_age",
        unit="s",
        scale="pose_age",
        healthy=0.2,
        effect=PoseStream("age"),
        words="age of a pose stream's positions behind its quaternions",
    ),
    Unknown(
        name="pose_filter",
        labels=("position", "rotation"),
        unit="s²",
        scale="pose_filter",
        healthy=4e-3,
        effect=PoseStream("filter"),
        words="low-pass filter of a pose stream, in addition to its delay; negative: prediction",
    ),
    Unknown(
        name="pose_delay",
        unit="s",
        std=5e-3,
        healthy=0.05,
        effect=PoseStream("delay"),
        of_log=True,
        words="delay of a pose stream's stamps behind the joints'",
    ),
    Unknown(
        name="base_translation",
        among="robot",
        labels=_XYZ,
        unit="m",
        std=3e-3,
        scale="base_place",
        healthy=0.02,
        effect=OfBase(Mount("translation")),
        words="place of the base IMU in its link: true minus URDF",
    ),
    Unknown(
        name="base_rotation",
        among="robot",
        labels=_XYZ,
        unit="rad",
        std=5e-3,
        scale="base_turn",
        healthy=0.1,
        effect=OfBase(Mount("rotation")),
        words="rotation of the base IMU in its link: true minus URDF",
    ),
    Unknown(
        name="base_time_offset",
        among="offset",
        unit="s",
        std=0.02,
        effect=OfBase(Clock(accel=(1.0, 0.0), gyro=(1.0, 0.0))),
        lean=True,
        of_log=True,
        words="stamp of the base IMU's accelerometer less joint stamp",
    ),
    Unknown(
        name="base_clock_drift",
        unit="s/s",
        std=50e-6,
        healthy=500e-6,
        effect=OfBase(Clock(accel=(0.0, 1.0), gyro=(0.0, 1.0))),
        of_log=True,
        words="gain of the base IMU's clock on the robot's",
    ),
    Unknown(
        name="base_gyro_delay",
        unit="s",
        std=2e-3,
        healthy=0.1,
        effect=OfBase(
            Reading("gyro", lambda s, mixing: -_derivative(s.gyro, s.dt) @ mixing, _ALIKE)
        ),
        of_log=True,
        words="delay of the gyroscope behind the accelerometer, base IMU",
    ),
)


TABLE: Final[tuple[Unknown, ...]] = (
    *ENTRIES,
    *(
        replace(
            each,
            name=f"base_{each.name}",
            effect=OfBase(each.effect),
            words=f"{each.words}, base IMU",
        )
        for each in ENTRIES
        if isinstance(each.effect, Reading) and not each.effect.sways
    ),
)
"""Whatever may be wrong with one IMU may be wrong with the other, by the same priors."""

_BY_NAME: Final = {each.name: each for each in TABLE}


def unknown_named(name: str) -> Unknown:
    """The entry of the table."""
    return _BY_NAME[name]


LEAN: Final = tuple(each for each in TABLE if each.lean)
"""The entries that are solved first."""
