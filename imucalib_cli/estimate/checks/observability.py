"""Which directions of the pose the motion did not determine, and which motion would."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from imucalib_cli.estimate.entries import Unobservable
from imucalib_cli.estimate.solution.algebra import embedded, inverse_of, inverse_with_priors
from imucalib_cli.estimate.solution.fit import DETERMINED
from imucalib_cli.estimate.solution.solve import WEAKEST_STD
from imucalib_cli.tree import plain

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.estimate.entries import Kind
    from imucalib_cli.estimate.solution.normal_equations import Answer


_LEVEL: Final = "; or state that the base is level (--gravity fixed, or --tilt-std)"
_PARTS: Final = {"translation": slice(0, 3), "rotation": slice(3, 6)}


def excitation(answer: Answer, *, everything: bool = False) -> Floats:
    """Covariance (n, n) by the motion with common noise, so that low noise does not replace motion.

    With ``everything`` held and known components of the mount count as free too.
    """
    layout = answer.layout
    free = layout.free.copy()
    for each in layout.placed:
        # All other unknowns have priors.
        free[each.part] &= each.unknown.lean
    std = layout.std_at(answer.u)
    if everything:
        for name in _PARTS:
            part = layout.part(name)
            free[part] = True
            std[part] = WEAKEST_STD[name]
    return embedded(inverse_with_priors(answer.motion[np.ix_(free, free)], std[free]), free)


def undetermined(answer: Answer) -> Bools:
    """(6,), components of the mount that the motion does not show, whatever is stated of them."""
    places = answer.layout.pose
    std = np.sqrt(np.diag(excitation(answer, everything=True))[places])
    return np.asarray(std > DETERMINED)


def unobservable(answer: Answer) -> tuple[Unobservable, ...]:
    """Directions of the pose that the motion did not determine, and motions that would.

    By the larger of the estimate's covariance and that of ordinary noise with this motion, so that
    a log without noise does not make a motionless direction look known.
    """
    pose = np.ix_(answer.layout.pose, answer.layout.pose)
    both = answer.covariance, excitation(answer)
    found = _directions(*(each[pose] for each in both))
    gravity = answer.layout.part("gravity_direction")
    if not answer.layout.free[gravity].any():
        return tuple(found)
    level = _directions(*(_given(each, gravity)[pose] for each in both))
    helps = not any(each.kind == "rotation" for each in level)
    return tuple(
        replace(each, motion=each.motion + _LEVEL) if helps and each.kind == "rotation" else each
        for each in found
    )


def _given(covariance: Floats, part: slice) -> Floats:
    """(n, n), covariance if some components were known."""
    across = covariance[:, part]
    return np.asarray(covariance - across @ inverse_of(covariance[part, part]) @ across.T)


def _directions(covariance: Floats, excitation: Floats) -> list[Unobservable]:
    """Eigen-directions of (6, 6) beyond the limits, translation first, the least known first."""
    rotation = _beyond("rotation", covariance, excitation)
    swept = [_swept(matrix, rotation) for matrix in (covariance, excitation)]
    # A single unknown turn is about the only axis of the motion.
    turns_about = np.array(rotation[0].direction_parent) if len(rotation) == 1 else None
    translation = _beyond("translation", swept[0], swept[1], turns_about)
    if len(translation) == 1:
        translation = [_with_way_out(translation[0])]
    return [*translation, *rotation]


def _with_way_out(lost: Unobservable) -> Unobservable:
    """With advice for a robot that cannot move so, as one that drives on a plane."""
    axis = int(np.argmax(np.abs(lost.direction_parent)))
    held, about = "", "--prior-std"
    if abs(lost.direction_parent[axis]) > 0.99:  # within 8 deg of an axis
        name = f"t{'xyz'[axis]}"
        held = f"--fix {name} holds it at the URDF's value, "
        about = f"--prior-std {name}=5mm"
    words = f"; if the robot cannot, {held}{about} says how accurately that is known"
    return replace(lost, motion=lost.motion + words)


def _swept(covariance: Floats, rotation: Sequence[Unobservable]) -> Floats:
    """Covariance in which an unknown turn of the IMU sweeps its place around a circle.

    To first order the turn moves the place along the circle's tangent only; a large turn makes it
    as unknown across.
    """
    wide = np.array(covariance)
    for turn in rotation:
        u = np.array(turn.direction_parent)
        plane = np.eye(3) - np.outer(u, u)
        size = float(np.linalg.eigvalsh(plane @ covariance[:3, :3] @ plane)[-1])
        if size > DETERMINED**2:
            wide[:3, :3] += size * plane
    return wide


def _beyond(
    kind: Kind,
    covariance: Floats,
    excitation: Floats,
    turns_about: Floats | None = None,
) -> list[Unobservable]:
    """Eigen-directions of one kind beyond its limit, the least known first."""
    part = _PARTS[kind]
    blocks = [matrix[part, part] for matrix in (covariance, excitation)]
    if max(np.linalg.eigvalsh(block)[-1] for block in blocks) <= DETERMINED**2:
        return []
    values, vectors = np.linalg.eigh(max(blocks, key=lambda block: float(np.trace(block))))
    found = []
    for variance, direction in zip(values[::-1], vectors.T[::-1], strict=True):
        if variance <= DETERMINED**2:
            break
        std, axis = float(np.sqrt(variance)), _readable(direction)
        found.append(
            Unobservable(
                kind=kind,
                direction_parent=plain(axis),
                std=std if std < 0.5 * WEAKEST_STD[kind] else None,
                motion=_motion(kind, axis, turns_about),
            )
        )
    return found


def widen(covariance: Floats, directions: Sequence[Unobservable]) -> Floats:
    """Covariance (6, 6) in which every unobservable direction has its stated sigma."""
    wide = np.array(covariance)
    for direction in directions:
        part = _PARTS[direction.kind]
        u = np.array(direction.direction_parent)
        std = WEAKEST_STD[direction.kind] if direction.std is None else direction.std
        missing = std**2 - float(u @ wide[part, part] @ u)
        if missing > 0.0:
            wide[part, part] += missing * np.outer(u, u)
    return wide


def _readable(direction: Floats) -> Floats:
    """Unit vector of the sign whose largest component is positive, rounding noise removed."""
    direction = np.where(np.abs(direction) < 1e-6, 0.0, direction)
    direction = direction / np.linalg.norm(direction)
    return np.asarray(direction * np.sign(direction[np.argmax(np.abs(direction))]))


def _motion(kind: str, direction: Floats, turns_about: Floats | None) -> str:
    """The cheapest motion that would determine a direction (3,), parent frame.

    ``turns_about`` is the only axis about which the link turns already, unless that is the
    direction itself.
    """
    names = "xyz"
    had = direction if turns_about is None else turns_about
    across = sorted(range(3), key=lambda axis: abs(had[axis]))[:2]
    first, second = (names[axis] for axis in sorted(across))
    if kind == "rotation":
        return (
            f"rotate the parent link about its {first} and {second} axes (axes across this "
            "direction) by ±30° within 2 s, several times"
        )
    which = "this direction" if turns_about is None else "the one about which it turns already"
    return (
        f"rotate the parent link about its {first} or {second} axis (any axis across {which}) by "
        "±30° within 2 s, several times"
    )
