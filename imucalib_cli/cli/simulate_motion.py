"""Options of a simulation's motion and mount as typed, turned into those of the physics."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from imucalib_cli.cli.quantities import parse_choice, parse_number, parse_seconds
from imucalib_cli.errors import ChoiceError

if TYPE_CHECKING:
    from imucalib_cli.simulate.options import PhysicsOptions

MOTION = "Motion and mount"
SECONDS = "seconds, such as 0.042 or -42ms"
VECTOR = 'three numbers "x y z"'


@dataclass(frozen=True, kw_only=True)
class MotionTexts:
    """What the user wrote; None takes the system's own."""

    duration: Annotated[float | None, typer.Option(help="s.", rich_help_panel=MOTION)] = None
    imu_rate: Annotated[
        float | None, typer.Option(help="Hz, any number.", rich_help_panel=MOTION)
    ] = None
    robot_rate: Annotated[
        float | None,
        typer.Option(help="Joint states or poses, Hz, any number.", rich_help_panel=MOTION),
    ] = None
    step: Annotated[
        str | None, typer.Option(help="Longest integration step.", rich_help_panel=MOTION)
    ] = None
    gravity: Annotated[
        float | None, typer.Option(help="Its norm, m/s².", rich_help_panel=MOTION)
    ] = None
    base_tilt_deg: Annotated[
        str | None,
        typer.Option(
            help='Gravity turned about x and y of the world: "x y".', rich_help_panel=MOTION
        ),
    ] = None
    mount_xyz: Annotated[
        str | None,
        typer.Option(help='True IMU position in its link, m: "x y z".', rich_help_panel=MOTION),
    ] = None
    mount_rpy: Annotated[
        str | None,
        typer.Option(help='True IMU orientation, rad: "r p y".', rich_help_panel=MOTION),
    ] = None
    profile: Annotated[
        str, typer.Option(help="Pushes of barbot: smooth or hard.", rich_help_panel=MOTION)
    ] = "smooth"
    publishers: Annotated[
        int,
        typer.Option(
            min=1, help="Joint publishers, each with part of the joints.", rich_help_panel=MOTION
        ),
    ] = 1

    def options(self) -> PhysicsOptions:
        """Options of the physics.

        Raises:
            ChoiceError: A text is no quantity of its kind.
        """
        from imucalib_cli.simulate.options import PhysicsOptions

        profile = parse_choice("--profile", self.profile, ("smooth", "hard"))
        return PhysicsOptions(
            duration=self.duration,
            imu_rate=self.imu_rate,
            robot_rate=self.robot_rate,
            step=seconds("--step", self.step),
            gravity=self.gravity,
            base_tilt=_tilt(self.base_tilt_deg),
            mount_xyz=vector("--mount-xyz", self.mount_xyz),
            mount_rpy=vector("--mount-rpy", self.mount_rpy),
            profile="hard" if profile == "hard" else "smooth",
            publishers=self.publishers,
        )


def seconds(option: str, text: str | None) -> float | None:
    """A duration, if one was given."""
    return None if text is None else parse_seconds(option, text, SECONDS)


def vector(option: str, text: str | None) -> tuple[float, float, float] | None:
    """Three numbers, if they were given."""
    if text is None:
        return None
    values = [parse_number(option, part, VECTOR) for part in text.replace(",", " ").split()]
    if len(values) != 3:
        raise ChoiceError(f"{option} {text}: expected {VECTOR}")
    return values[0], values[1], values[2]


def _tilt(text: str | None) -> tuple[float, float]:
    if text is None:
        return 0.0, 0.0
    allowed = 'two angles "x y" in degrees'
    parts = text.replace(",", " ").split()
    values = [parse_number("--base-tilt-deg", part, allowed) for part in parts]
    if len(values) != 2:
        raise ChoiceError(f"--base-tilt-deg {text}: expected {allowed}")
    return math.radians(values[0]), math.radians(values[1])
