"""The kinematic path from the world to the IMU's parent link, over any source of motion.

A path is a product of steps, each fixed, driven by a joint value or given as a pose over time.
Joint states through a URDF, /tf, odometry, motion capture and an arm on a moving base are all
the same product; only the steps differ.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """Samples of one publisher on the chosen clock: what moves a path."""

    name: str
    """For messages: the topic, and joints or frames."""
    kind: Literal["joints", "pose"]
    t: Floats
    """(N,), s since the log's start, as stamped: may jitter, repeat or have gaps."""
    values: Floats
    """(N, J) joint positions, rad or m; or (N, 7) position xyz, m, and quaternion xyzw."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FixedStep:
    """A constant transform."""

    R: Floats
    """(3, 3)."""
    p: Floats
    """(3,), m."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointStep:
    """A joint's motion about or along its axis, after its origin (a FixedStep of its own)."""

    name: str
    kind: Literal["revolute", "prismatic"]
    axis: Floats
    """(3,), unit vector in the joint frame."""
    track: int
    """Index into the path's tracks."""
    column: int
    multiplier: float = 1.0
    """With offset: position = multiplier * value + offset, as <mimic> has it."""
    offset: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseStep:
    """A pose track T_parent_child, or its inverse where the path runs from child to parent."""

    track: int
    inverse: bool = False


Step = FixedStep | JointStep | PoseStep


@dataclass(frozen=True, kw_only=True, eq=False)
class KinematicPath:
    """T_world_parent as a product of steps, a function of the tracks' values."""

    world: str
    parent: str
    steps: tuple[Step, ...]
    tracks: tuple[Track, ...]

    def poses(self, values: tuple[Floats, ...]) -> tuple[Floats, Floats]:
        """Pose of the parent link in the world for M instants.

        Args:
            values: For each track its values at the M instants, (M, J) or (M, 7). Quaternions
                need not be normalised.

        Returns:
            R_world_parent (M, 3, 3) and p_world_parent (M, 3), m.
        """
        raise NotImplementedError
