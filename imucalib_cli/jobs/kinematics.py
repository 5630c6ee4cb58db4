"""The kinematics report: estimated errors of the joints, and those that no log can show."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from imucalib_cli.digits import figures, sigma, with_std
from imucalib_cli.estimate.entries import CLEAR_SIGMAS
from imucalib_cli.layout import Table
from imucalib_cli.results.kinematics import (
    AXIS,
    KINDS,
    ORIGIN,
    ZERO,
    joint_of,
    sigmas,
)
from imucalib_cli.robot.path import parallel_joints
from imucalib_cli.signals.moves import joint_travels

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.estimate.entries import ParameterEntry
    from imucalib_cli.jobs.calibrate import Calibrated
    from imucalib_cli.layout import Block
    from imucalib_cli.robot.path import KinematicPath

_HEADS: Final = ("joint", "what", "true - URDF (1 sigma)", "prior (1 sigma)", "")
_UNITS: Final = {"rad": ("deg", math.degrees(1.0)), "m": ("mm", 1e3)}
_TAUGHT: Final = 0.9
"""Share of the prior sigma: with more of it left, the log gave no information."""
_BASE: Final = "not observable: looks like another place of the robot's base"
_WHAT: Final = {ORIGIN: "origin", AXIS: "axis about", ZERO: "zero"}
_OF_BASE: Final = {"base_translation": "place", "base_rotation": "rotation"}
"""Names of the errors of the base IMU's place in its link."""
_MOUNT: Final = "not observable: looks like another mount of the IMU"


def kinematics_report(each: Calibrated) -> Iterator[Block]:
    """Joint zeros, axes and origins of one IMU's chain, in its order, as lines and a table.

    The errors of the base IMU's place in its link come first, if there is a base IMU.
    """
    result, path = each.result, each.motion.path
    if not path.joint_steps:
        yield f"{result.child}: only poses move {path.parent}, so there are no joints to judge"
        return
    if each.result.provenance.options.get("robot") == "exact":
        yield f"{result.child}: the robot was taken to be exact (--robot)"
        return
    yield (
        f"the robot's joints between {path.world} and {path.parent}, by the motion of "
        f"{result.child} (apply --kinematics writes what is {CLEAR_SIGMAS:g} sigma off in "
        "the joints):"
    )
    parameters = result.diagnostics.parameters
    found: dict[tuple[str, str], list[ParameterEntry]] = {}
    for entry in parameters:
        if entry.name in KINDS:
            found.setdefault((joint_of(entry), entry.name), []).append(entry)
    rows = [
        _row(entry, "base IMU", f"{_OF_BASE[entry.name]} {entry.label}")
        for entry in parameters
        if entry.name in _OF_BASE
    ]
    travelling = (place for place, step in path.joint_steps.items() if joint_travels(path, step))
    moving = {*path.pose_steps, *travelling}
    for name, kind, why in _places(path, min(moving, default=0)):
        entries = found.get((name, kind), [])
        for entry in entries:
            component = entry.label.rpartition(" ")[2]
            what = _WHAT[kind] if kind == ZERO else f"{_WHAT[kind]} {component}"
            rows.append(_row(entry, name, what))
        # What an axis lacks is in the zeros.
        if not entries or (kind == ORIGIN and len(entries) < len("xyz")):
            some = f"{_WHAT[kind]}, other axes" if entries else _WHAT[kind]
            rows.append((name, some, "", "", why))
    yield Table(_HEADS, tuple(rows), frozenset(_HEADS[2:4]))
    for early, late in parallel_joints(path, moving):
        one, other = (path.reported(path.joint_steps[place]) for place in (early, late))
        yield (
            f"the axes of {one} and {other} are parallel: a wrong zero of {one} looks like the "
            f"opposite zero of {other} and a displaced origin between them, and only what is "
            "known beforehand shows which it is"
        )


def _places(path: KinematicPath, first: int) -> Iterator[tuple[str, str, str]]:
    """Joint, kind of error, and why no log could show it; ``first`` is the first moving step."""
    for place, step in path.joint_steps.items():
        name, is_base = path.reported(step), place <= first
        yield name, ORIGIN, _BASE if is_base else _MOUNT
        yield name, AXIS, _BASE if is_base else _MOUNT
        zero = "part of its origin" if step.kind == "prismatic" else _MOUNT
        yield name, ZERO, _BASE if is_base else zero


def _row(entry: ParameterEntry, joint: str, what: str) -> tuple[str, ...]:
    unit, scale = _UNITS[entry.unit]
    value, std, before = (
        0.0 if number is None else number * scale
        for number in (entry.value, entry.std, entry.prior_std)
    )
    off, learnt = sigmas(entry), " learnt" if entry.prior_learnt else ""
    remark = f"{figures(off, 2)} sigma" if off >= 1.0 else ""
    if off >= CLEAR_SIGMAS:
        remark = f"{figures(off, 3)} sigma: clear"
    elif std > _TAUGHT * before > 0.0:
        remark = "not determined by this log"
    return joint, f"{what}, {unit}", with_std(value, std), f"± {sigma(before)}{learnt}", remark
