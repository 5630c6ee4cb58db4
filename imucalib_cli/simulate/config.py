"""Configuration of a simulated system from YAML: geometry, masses, motion and rates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

from imucalib_cli.simulate.options import ZERO, Vector


@dataclass(frozen=True, kw_only=True)
class Origin:
    """A fixed transform as in URDF."""

    xyz: Vector
    """m."""
    rpy: Vector
    """rad, fixed axes x, y, z."""


@dataclass(frozen=True, kw_only=True)
class ImuMount:
    """Pose of the IMU on the system's parent link."""

    link: str
    """Name of the IMU's frame."""
    xyz: Vector
    """m, true position in the parent link."""
    rpy: Vector
    """rad, true orientation."""
    nominal: Origin
    """The nominal pose in the URDF."""


@dataclass(frozen=True, kw_only=True)
class PlacedImu(ImuMount):
    """An IMU with its link and its topic."""

    parent: str
    """The link that carries it."""
    topic: str


@dataclass(frozen=True, kw_only=True)
class FixedFrame:
    """Another frame fixed to a link."""

    link: str
    parent: str
    xyz: Vector
    rpy: Vector


@dataclass(frozen=True, kw_only=True)
class Rates:
    """Rates of integration and recording."""

    step: float
    """s, longest integration step."""
    imu: float
    """Hz."""
    robot: float
    """Hz, of joint states or poses."""


@dataclass(frozen=True, kw_only=True)
class Topics:
    """Names of the topics and frames published."""

    imu: str
    robot: str


@dataclass(frozen=True, kw_only=True)
class ArmJoint:
    """A revolute joint about its own z axis."""

    name: str
    parent: str
    child: str
    xyz: Vector
    rpy: Vector
    range_deg: float
    """Limit either way, degrees."""
    velocity_deg: float
    """Limit, degrees/s."""
    effort: float
    """Limit, N m."""

    @property
    def direction(self) -> Vector:
        """The axis in the joint's frame."""
        return (0.0, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class LegJoint(ArmJoint):
    """A revolute joint about one of its axes."""

    axis: Literal["x", "y", "z"]

    @property
    def direction(self) -> Vector:
        """The axis in the joint's frame."""
        x, y, z = (float(axis == self.axis) for axis in "xyz")
        return x, y, z


@dataclass(frozen=True, kw_only=True)
class ArmLink:
    """A link's mass, distributed as a solid cylinder."""

    name: str
    mass: float
    """kg."""
    com: Vector
    """m, centre of mass in the link frame."""
    radius: float
    length: float
    axis: Literal["x", "y", "z"]
    """The cylinder's axis."""

    @property
    def inertia(self) -> Vector:
        """Principal moments about the centre of mass along x, y, z, kg m²."""
        along = self.mass * self.radius**2 / 2
        across = self.mass * (3 * self.radius**2 + self.length**2) / 12
        x, y, z = (along if axis == self.axis else across for axis in "xyz")
        return x, y, z


@dataclass(frozen=True, kw_only=True)
class Drives:
    """Position controllers, one number a joint."""

    stiffness: tuple[float, ...]
    """N m/rad."""
    damping: tuple[float, ...]
    """N m s/rad."""
    rotor_inertia: tuple[float, ...]
    """kg m², seen at the joint."""
    gravity_compensation: float
    """Share of the links' weight that the controller compensates."""


@dataclass(frozen=True, kw_only=True)
class Move:
    """One reference move and the standstill after it."""

    to_deg: tuple[float, ...]
    seconds: float
    rest: float
    """s."""


@dataclass(frozen=True, kw_only=True)
class Jointed:
    """Links under position control; a joint stands after the one that carries it."""

    joints: tuple[ArmJoint, ...]
    links: tuple[ArmLink, ...]
    drives: Drives


@dataclass(frozen=True, kw_only=True)
class ArmMotion:
    """Start of an arm, and its moves."""

    start_deg: tuple[float, ...]
    start_rest: float
    """s."""
    moves: tuple[Move, ...]


@dataclass(frozen=True, kw_only=True)
class Arm(ArmMotion, Jointed):
    """A serial arm, its first joint on the world."""


@dataclass(frozen=True, kw_only=True)
class Push:
    """A force (world axes, N) and a torque (body axes, N m) for one push."""

    force: Vector = (0.0, 0.0, 0.0)
    torque: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class FreeBody:
    """A floating box and its pushes; times in s."""

    size: Vector
    """m, edge lengths along x, y, z."""
    mass: float
    inertia: Vector
    """kg m², principal, along x, y, z."""
    com: ClassVar[Vector] = ZERO
    """m, centre of mass."""
    start_rest: float
    push: float
    pushes: tuple[Push, ...]
    stop: float
    brake: float
    """1/s."""
    pause: float
    ramp: float


@dataclass(frozen=True, kw_only=True)
class Trunk:
    """The body that carries the legs; its link is the system's parent."""

    size: Vector
    """m, edge lengths along x, y, z."""
    mass: float
    com: Vector
    """m, centre of mass."""
    inertia: Vector
    """kg m², about the centre of mass, along x, y, z."""


@dataclass(frozen=True, kw_only=True)
class Foot:
    """A ball at the end of a leg of three joints: about x, about y, about y."""

    link: str
    """The last link of the leg."""
    xyz: Vector
    """m, the ball's centre in that link."""
    radius: float
    phase: float
    """Share of the gait's period by which its stance begins later than at phase zero."""


@dataclass(frozen=True, kw_only=True)
class Ground:
    """The level plane under the feet."""

    friction: float
    time_constant: float
    """s, of the contact, a critically damped spring; shorter is harder."""
    depth: float
    """m, over which the contact becomes so hard: forces begin at zero, and nothing jumps."""


@dataclass(frozen=True, kw_only=True)
class Walk:
    """One part of the gait."""

    seconds: float
    forward: float
    """m/s."""
    left: float
    turn_deg: float
    """Degrees/s, to the left."""
    lift: float
    """m, height of a step; zero stands."""


@dataclass(frozen=True, kw_only=True)
class Sway:
    """A sinusoidal motion of the trunk over its feet."""

    of: Literal["x", "y", "z", "roll", "pitch", "yaw"]
    amplitude: float
    """m, or degrees of a turn."""
    period: float
    """s."""


@dataclass(frozen=True, kw_only=True)
class Swing:
    """A sinusoidal motion of a joint that belongs to no leg."""

    joint: str
    amplitude_deg: float
    period: float
    """s."""


@dataclass(frozen=True, kw_only=True)
class Gait:
    """Joint references without feedback of the trunk's pose."""

    height: float
    """m, of the trunk's origin over the balls' centres."""
    wider: float
    """m, distance of a foot outside its hip."""
    period: float
    """s, of a stride."""
    stance: float
    """Share of the period in which a foot stands."""
    start_rest: float
    """s."""
    blend: float
    """s, from one walk to the next."""
    walks: tuple[Walk, ...]
    sways: tuple[Sway, ...]
    swings: tuple[Swing, ...]


@dataclass(frozen=True, kw_only=True)
class Legged(Jointed):
    """A robot that walks: a floating trunk, joints of one axis each, feet on the ground."""

    joints: tuple[LegJoint, ...]
    trunk: Trunk
    feet: tuple[Foot, ...]
    ground: Ground
    gait: Gait

    def leg(self, foot: Foot) -> list[int]:
        """Numbers of the joints that carry a foot, from the trunk on.

        Raises:
            ValueError: The leg is not one that :class:`Foot` describes.
        """
        carried = {joint.child: number for number, joint in enumerate(self.joints)}
        numbers: list[int] = []
        link = foot.link
        while link in carried and len(numbers) < 4:  # one more than a leg has
            numbers.insert(0, carried[link])
            link = self.joints[numbers[0]].parent
        joints = [self.joints[number] for number in numbers]
        axes = "".join(joint.axis for joint in joints)
        origins = [*(joint.xyz for joint in joints[1:]), foot.xyz]
        along = [tuple(value != 0 for value in origin) for origin in origins]
        turned = any(any(joint.rpy) for joint in joints)
        straight = [(False, True, False), (False, False, True), (False, False, True)]
        if axes != "xyy" or along != straight or turned:
            raise ValueError(
                f"the foot of {foot.link} needs a leg of three joints without rpy, about x, y, y; "
                "the second is beside the first along y, the third below it, the foot below that"
            )
        return numbers

    def __post_init__(self) -> None:
        legs = {number for foot in self.feet for number in self.leg(foot)}
        others = {j.name for number, j in enumerate(self.joints) if number not in legs}
        for swing in self.gait.swings:
            if swing.joint not in others:
                raise ValueError(
                    f"swings: {swing.joint} is not a joint outside the legs; "
                    f"there are {', '.join(sorted(others)) or 'none'}"
                )
        if not self.feet or not self.gait.walks:
            raise ValueError("legged: state at least one foot and one walk")
        gait, ground = self.gait, self.ground
        times = [gait.period, gait.blend, ground.time_constant, ground.depth]
        times += [walk.seconds for walk in gait.walks]
        times += [sway.period for sway in gait.sways] + [swing.period for swing in gait.swings]
        if min(times) <= 0 or not 0 < gait.stance < 1:
            raise ValueError(
                "legged: times and depth must be positive, stance a share between 0 and 1"
            )


@dataclass(frozen=True, kw_only=True)
class SystemConfig:
    """A system: one YAML file. Exactly one of arm, free_body and legged is given."""

    name: str
    description: str
    gravity: float
    """m/s², norm; zero for none."""
    duration: float
    """s."""
    world: str
    parent: str
    imu: ImuMount
    frames: tuple[FixedFrame, ...]
    rates: Rates
    topics: Topics
    arm: Arm | None = None
    free_body: FreeBody | None = None
    legged: Legged | None = None
    imus: tuple[PlacedImu, ...] = ()
    """Further IMUs, beside ``imu`` on ``parent``."""
    bandwidth: float | None = None
    """Hz, of the low-pass in every IMU; None: none, each reading is of one instant."""

    @property
    def mover(self) -> Arm | FreeBody | Legged:
        """The part that moves."""
        movers = [each for each in (self.arm, self.free_body, self.legged) if each is not None]
        if len(movers) != 1:
            raise ValueError("state one of arm, free_body and legged")
        return movers[0]

    @property
    def every_imu(self) -> tuple[PlacedImu, ...]:
        """All IMUs; the one on ``parent`` is the first."""
        first = PlacedImu(**vars(self.imu), parent=self.parent, topic=self.topics.imu)
        return first, *self.imus

    @property
    def joints(self) -> tuple[ArmJoint, ...]:
        """The published joints; a free body has none."""
        return self.mover.joints if isinstance(self.mover, Jointed) else ()

    def __post_init__(self) -> None:
        mover = self.mover
        if min(self.rates.step, self.rates.imu, self.rates.robot, self.duration) <= 0:
            raise ValueError("rates and duration must be positive")
        if isinstance(mover, Jointed):
            roots = {each.parent for each in mover.joints} - {each.child for each in mover.joints}
            if len(roots) > 1:
                raise ValueError(
                    f"joints: their links make one tree, and {', '.join(sorted(roots))} are "
                    "children of none of them"
                )
            n, drives = len(mover.joints), mover.drives
            lists = [drives.stiffness, drives.damping, drives.rotor_inertia]
            if isinstance(mover, Arm):
                lists += [mover.start_deg, *(move.to_deg for move in mover.moves)]
                if min(move.seconds for move in mover.moves) <= 0.0:
                    raise ValueError("moves: their seconds must be positive")
            if any(len(values) != n for values in lists):
                raise ValueError(f"drives, start_deg and to_deg need {n} numbers, one a joint")
        for what in ("link", "topic"):
            names = [getattr(imu, what) for imu in self.every_imu]
            if len(set(names)) < len(names):
                raise ValueError(f"imus: each needs a {what} of its own")
