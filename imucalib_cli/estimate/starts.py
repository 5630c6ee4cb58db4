"""Rotations to start from, so that no guess is needed."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate import columns
from imucalib_cli.robot.rotations import matrix_from_rotvec, nearest_rotation

Floats = NDArray[np.float64]

_TURNS = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
"""rad: how far the starts of a partly fixed rotation stand from what it is fixed to."""


def start_rotations(
    normal: Floats, *, turns: NDArray[np.bool_], known: Floats, told: bool
) -> list[Floats]:
    """Rotations of which one is in the basin of the least cost.

    Args:
        normal: (COUNT, COUNT), normal matrix.
        turns: (3,), about which of the parent's axes the rotation may leave the known one.
        known: (3, 3), what it is fixed to, or what a prior is about.
        told: Whether there is such a prior.
    """
    if turns.all():
        starts = [_relaxed_rotation(normal), *cube_rotations()]
        return [known, *starts] if told else starts
    if not turns.any():
        return [known]
    axes = np.eye(3)[turns]
    # One axis: all around it. Two: the disc of turns about axes between them.
    heading = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    rays = (
        [axes[0], -axes[0]]
        if len(axes) == 1
        else [np.array([np.cos(h), np.sin(h)]) @ axes for h in heading]
    )
    return [known, *(matrix_from_rotvec(angle * ray) @ known for ray in rays for angle in _TURNS)]


def _relaxed_rotation(normal: Floats) -> Floats:
    """Rotation nearest to the unconstrained 3x3 matrix that fits best."""
    rest = np.r_[1:22]
    x = least_squares(normal[np.ix_(rest, rest)], normal[rest, columns.ONE])
    return nearest_rotation(x[3:12].reshape(3, 3))


def least_squares(matrix: Floats, rhs: Floats) -> Floats:
    """Minimum-norm x, (n,) or (n, m), of matrix x = -rhs, columns of the matrix scaled to one."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    inverse = np.linalg.pinv(matrix / np.outer(scale, scale), rcond=1e-10, hermitian=True)
    return np.asarray(-(inverse / np.outer(scale, scale)) @ rhs)


def cube_rotations() -> list[Floats]:
    """The 24 rotations of the cube: no rotation is further than 63 degrees from one of them."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            M = np.zeros((3, 3))
            M[range(3), order] = signs
            if np.linalg.det(M) > 0:
                found.append(M)
    return found
