"""What a study runs its methods on: how systems are recorded, and by which sensors."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Literal

from imucalib_cli.simulate.load import load_grade
from imucalib_cli.simulate.options import ZERO, NoiseOptions, PhysicsOptions

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """How a study's systems are recorded."""

    imu_rate: float
    """Hz."""
    robot_rate: float
    """Hz."""
    duration: float | None = None
    """s; None is the whole plan."""
    profile: Literal["smooth", "hard"] = "smooth"
    """How a free body is pushed."""

    def __post_init__(self) -> None:
        """Refuse what cannot be recorded."""
        if min(self.imu_rate, self.robot_rate, self.duration or 1.0) <= 0.0:
            raise ValueError("imu_rate, robot_rate and duration must be above zero")

    @property
    def physics(self) -> PhysicsOptions:
        """For the simulation."""
        return PhysicsOptions(
            duration=self.duration,
            imu_rate=self.imu_rate,
            robot_rate=self.robot_rate,
            profile=self.profile,
        )


@dataclass(frozen=True, kw_only=True)
class Condition:
    """Sensors under which methods are compared."""

    name: str
    grade: str = "ideal"
    """Of configs/imu_grades.yaml."""
    biases: bool = False
    """Whether those of the grade, and their walks, are there."""
    noise: NoiseOptions = field(default_factory=NoiseOptions)
    """What is beside the grade; it wins."""
    seeds: int | None = None
    """Where fewer tell enough; None takes the study's."""

    def __post_init__(self) -> None:
        """Refuse what is no grade when the parameters are read, not in the middle of a study."""
        load_grade(self.grade)

    @property
    def sensors(self) -> NoiseOptions:
        """Noise of the grade, and of what is beside it."""
        graded = load_grade(self.grade)
        if not self.biases:
            graded = replace(
                graded, accel_bias=ZERO, gyro_bias=ZERO, accel_bias_walk=0.0, gyro_bias_walk=0.0
            )
        nothing = NoiseOptions()
        given = {f.name: getattr(self.noise, f.name) for f in fields(NoiseOptions)}
        stated = {name: v for name, v in given.items() if v != getattr(nothing, name)}
        return replace(graded, **stated)


def condition_of(conditions: Sequence[Condition], name: object) -> Condition:
    """The one of a name."""
    return next(condition for condition in conditions if condition.name == name)
