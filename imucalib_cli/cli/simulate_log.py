"""Options of a simulated log and of its camera as typed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imucalib_cli.cli.simulate_motion import seconds

if TYPE_CHECKING:
    from imucalib_cli.simulate.camera.config import CameraConfig
    from imucalib_cli.simulate.config import SystemConfig
    from imucalib_cli.simulate.options import LogOptions

LOG, CAMERA = "Log", "Camera"


@dataclass(frozen=True, kw_only=True)
class LogTexts:
    """How the log is written."""

    compression: Annotated[
        str | None,
        typer.Option(
            help=".mcap: zstd, lz4, none; .bag: lz4, bz2, none. Default: the first.",
            rich_help_panel=LOG,
        ),
    ] = None
    imu_topic: Annotated[str | None, typer.Option(rich_help_panel=LOG)] = None
    robot_topic: Annotated[str | None, typer.Option(rich_help_panel=LOG)] = None
    imu_frame: Annotated[
        str | None, typer.Option(help="frame_id of Imu messages.", rich_help_panel=LOG)
    ] = None
    topic_each: Annotated[
        bool,
        typer.Option("--topic-each", help="A topic per joint publisher.", rich_help_panel=LOG),
    ] = False
    joint_order: Annotated[
        str,
        typer.Option(
            help="chain, alphabetical, reversed, or all names, by commas.", rich_help_panel=LOG
        ),
    ] = "chain"

    def options(self, system: SystemConfig) -> LogOptions:
        """Options of the log of a system."""
        from imucalib_cli.simulate.options import LogOptions

        return LogOptions(
            compression=self.compression,  # type: ignore[arg-type] # the storage knows its own
            imu_topic=self.imu_topic,
            robot_topic=self.robot_topic,
            imu_frame=self.imu_frame,
            topic_each=self.topic_each,
            joint_order=_order(self.joint_order, system),
        )


@dataclass(frozen=True, kw_only=True)
class CameraTexts:
    """What looks at the pattern, if anything does."""

    camera: Annotated[
        bool,
        typer.Option(
            "--camera",
            help="Move before an AprilGrid, write images of it too, and the files Kalibr needs.",
            rich_help_panel=CAMERA,
        ),
    ] = False
    camera_config: Annotated[
        Path | None,
        typer.Option(
            help="A camera of your own, as configs/cameras has them.",
            rich_help_panel=CAMERA,
            readable=False,
        ),
    ] = None
    camera_offset: Annotated[
        str | None,
        typer.Option(
            help="Camera stamp - robot stamp of the same instant.", rich_help_panel=CAMERA
        ),
    ] = None
    image_noise: Annotated[
        float | None, typer.Option(help="Std, grey levels.", rich_help_panel=CAMERA)
    ] = None
    image_blur: Annotated[
        float | None, typer.Option(help="Std of a Gaussian, pixels.", rich_help_panel=CAMERA)
    ] = None

    def load(self, system: SystemConfig) -> tuple[SystemConfig, CameraConfig | None]:
        """The system as it moves, and its camera if one was asked for.

        Raises:
            ChoiceError: There is none for the system.
            InputError: The camera's file cannot be used.
        """
        if not self.camera and self.camera_config is None:
            return system, None
        from imucalib_cli.simulate.camera.config import load_camera

        return load_camera(self.camera_config or system.name, system)

    def noise(self) -> dict[str, Any]:
        """Its part of the options of the corruption; None where not given."""
        return {
            "camera_offset": seconds("--camera-offset", self.camera_offset),
            "image_noise": self.image_noise,
            "image_blur": self.image_blur,
        }


def _order(text: str, system: SystemConfig) -> tuple[str, ...]:
    names = () if system.arm is None else tuple(joint.name for joint in system.arm.joints)
    match text:
        case "chain":
            return ()
        case "alphabetical":
            return tuple(sorted(names))
        case "reversed":
            return names[::-1]
        case _:
            return tuple(name.strip() for name in text.split(","))
