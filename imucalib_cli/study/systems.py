"""Systems of the studies, recorded once a process."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.physics import record
from imucalib_cli.study.trial import robot_of

if TYPE_CHECKING:
    from imucalib_cli.robot.urdf import Robot
    from imucalib_cli.simulate.options import PhysicsOptions
    from imucalib_cli.simulate.recording import Recording


@cache
def clean_recording(system: str, physics: PhysicsOptions) -> Recording:
    """Noise-free run of a system."""
    return record(load_system(system), physics)


@cache
def robot_model(system: str) -> Robot | None:
    """The system's URDF, parsed; None for a free body."""
    config = load_system(system)
    return robot_of(config) if config.arm is not None else None
