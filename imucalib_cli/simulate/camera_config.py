"""Configuration of a camera on a system and of the pattern in front of it, from YAML."""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.configuration import builtin_names, load_named
from imucalib_cli.errors import InputError
from imucalib_cli.simulate.config import (  # noqa: TC001 - types of fields, checked when read
    ArmMotion,
    FixedFrame,
)
from imucalib_cli.simulate.options import Vector  # noqa: TC001 - as above

if TYPE_CHECKING:
    from pathlib import Path

    from imucalib_cli.arrays import Floats
    from imucalib_cli.simulate.config import SystemConfig

_FOLDER = "cameras"


@dataclass(frozen=True, kw_only=True)
class Intrinsics:
    """A pinhole with radial-tangential distortion; pixel centres have whole coordinates."""

    width: int
    """Pixels."""
    height: int
    fx: float
    """Pixels, as the next three."""
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2 of Kalibr's ``radtan``, which are OpenCV's first four."""

    @property
    def opencv(self) -> tuple[Floats, Floats]:
        """Camera matrix (3, 3), pixels, and distortion (4,), as OpenCV takes them."""
        matrix = [[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]]
        return np.array(matrix), np.array(self.distortion)


@dataclass(frozen=True, kw_only=True)
class AprilGrid:
    """A board of tags of the family 36h11, ids row by row from the lower left, and its pose."""

    tag_rows: int
    tag_cols: int
    tag_size: float
    """m, edge of a tag with its black border."""
    tag_spacing: float
    """Gap between tags as a share of ``tag_size``."""
    xyz: Vector
    """m, p_world_target, of the outer corner of the lower left tag."""
    rpy: Vector
    """R_world_target: x along rows, y up the board, z towards the viewer."""


@dataclass(frozen=True, kw_only=True)
class Shades:
    """Grey levels of a rendered image, 0 to 255."""

    black: float
    white: float
    background: float


@dataclass(frozen=True, kw_only=True)
class KalibrLeast:
    """Least noise written for Kalibr, which refuses zeros. In its own units."""

    accel_noise: float
    accel_walk: float
    gyro_noise: float
    gyro_walk: float


@dataclass(frozen=True, kw_only=True)
class CameraConfig:
    """A camera, its target, and the arm's moves: one YAML file."""

    frame: FixedFrame
    """The optical frame: z forward, x right, y down."""
    topic: str
    rate: float
    """Images/s."""
    intrinsics: Intrinsics
    border: float
    """Pixels: a tag with a corner closer to the image's edge is not detected."""
    target: AprilGrid
    shades: Shades
    kalibr_least: KalibrLeast
    motion: ArmMotion | None = None
    """In front of the pattern, instead of the arm's own."""

    def __post_init__(self) -> None:
        lens, target = self.intrinsics, self.target
        sizes = (lens.width, lens.height, lens.fx, lens.fy, self.rate, target.tag_size)
        if min(sizes) <= 0 or not 0 < target.tag_spacing <= 1:
            raise ValueError("sizes, focal lengths and rate must be positive, spacing 0 to 1")
        if min(astuple(self.kalibr_least)) <= 0:
            raise ValueError("kalibr_least must be positive")
        if min(target.tag_rows, target.tag_cols) < 3:  # Kalibr's ConfigReader.py: int >= 3
            raise ValueError("a grid has at least 3 rows and 3 columns of tags")


def load_camera(
    name_or_file: str | Path, system: SystemConfig
) -> tuple[SystemConfig, CameraConfig]:
    """Read a camera by its system's name or from the user's own YAML file.

    Returns:
        The system with the camera's moves and optical frame, and the camera.

    Raises:
        ChoiceError: There is no such camera.
        InputError: The file cannot be read, is no camera configuration, or does not fit the system.
    """
    camera = load_named(
        CameraConfig,
        name_or_file,
        builtin_names(_FOLDER),
        folder=_FOLDER,
        unknown="no camera for {name}: choose {names}, or give --camera-config",
    )
    frames = tuple(frame for frame in system.frames if frame.link != camera.frame.link)
    arm, motion = system.arm, camera.motion
    joints = 0 if arm is None else len(arm.joints)
    if motion is not None:
        if any(len(v) != joints for v in (motion.start_deg, *(m.to_deg for m in motion.moves))):
            raise InputError(
                f"{name_or_file}: start_deg and to_deg need {joints} numbers, one a joint"
            )
        if arm is not None:
            arm = replace(arm, **vars(motion))
    return replace(system, frames=(*frames, camera.frame), arm=arm), camera
