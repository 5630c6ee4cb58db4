"""Configuration of a simulated system from YAML: geometry, masses, motion and rates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from imucalib_cli.simulate.options import (  # noqa: TC001 - type of fields, checked when read
    Vector,
)


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
class Arm:
    """A serial arm under position control."""

    joints: tuple[ArmJoint, ...]
    links: tuple[ArmLink, ...]
    drives: Drives
    start_deg: tuple[float, ...]
    start_rest: float
    moves: tuple[Move, ...]


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
    start_rest: float
    push: float
    pushes: tuple[Push, ...]
    stop: float
    brake: float
    """1/s."""
    pause: float
    ramp: float


@dataclass(frozen=True, kw_only=True)
class SystemConfig:
    """A system: one YAML file. Exactly one of ``arm`` and ``free_body`` is given."""

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

    @property
    def mover(self) -> Arm | FreeBody:
        """The arm or the free body, whichever is given."""
        mover = self.arm or self.free_body
        if mover is None:
            raise ValueError("state either arm or free_body")
        return mover

    def __post_init__(self) -> None:
        """Refuse values that the types allow but that make no sense."""
        if (self.arm is None) == (self.free_body is None):
            raise ValueError("state either arm or free_body")
        if min(self.rates.step, self.rates.imu, self.rates.robot, self.duration) <= 0:
            raise ValueError("rates and duration must be positive")
        if self.arm is not None:
            n, drives = len(self.arm.joints), self.arm.drives
            lists = [drives.stiffness, drives.damping, drives.rotor_inertia, self.arm.start_deg]
            lists += [move.to_deg for move in self.arm.moves]
            if any(len(values) != n for values in lists):
                raise ValueError(f"drives, start_deg and to_deg need {n} numbers, one a joint")
