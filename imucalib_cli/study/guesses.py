"""Initial guesses off by a fixed amount in a random direction (section 4.1 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.robot.rotations import matrix_from_rotvec

if TYPE_CHECKING:
    from imucalib_cli.simulate.recording import Recording

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Guess:
    """Where an optimiser starts."""

    R_parent_imu: Floats
    """(3, 3)."""
    t_parent_imu: Floats
    """(3,), m."""


def wrong_guess(recording: Recording, translation: float, rotation: float, seed: int) -> Guess:
    """The truth, displaced and turned by vectors of fixed norm and random direction.

    The directions are uniform on the sphere. The paper adds its vector to the rotation vector;
    turning by it instead makes the angle of the error the one that is stated.

    Args:
        recording: Whose truth is known.
        translation: Norm, m.
        rotation: Angle, rad.
        seed: Of the two directions.
    """
    directions = np.random.default_rng(seed).normal(size=(2, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return Guess(
        R_parent_imu=matrix_from_rotvec(rotation * directions[1]) @ recording.R_parent_imu,
        t_parent_imu=recording.t_parent_imu + translation * directions[0],
    )
