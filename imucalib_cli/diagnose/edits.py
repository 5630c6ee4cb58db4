"""What of a kinematic path moves and how it is called, and the path with another zero."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.estimate.model.layout import STILL_JOINT
from imucalib_cli.robot.path import JointStep, PoseStep

if TYPE_CHECKING:
    from imucalib_cli.robot.path import KinematicPath

_TAILS = (1.0, 99.0)
"""Percentiles between which a joint's travel is measured."""


def joints_of(path: KinematicPath) -> tuple[JointStep, ...]:
    """The joint steps, from the world on."""
    return tuple(step for step in path.steps if isinstance(step, JointStep))


def turning_joints(path: KinematicPath) -> dict[tuple[int, int], str]:
    """Name of each reported position that turns a joint, by (track, column)."""
    return {
        (step.track, step.column): path.tracks[step.track].names[step.column]
        for step in joints_of(path)
        if step.kind == "revolute"
    }


def driven_key(path: KinematicPath, *, in_log: bool = False) -> tuple[object, ...]:
    """What drives a path: equal for links that are rigidly joined.

    With ``in_log`` only what moves in the log counts: equal for links that keep still in it.
    """
    keys: list[tuple[object, ...]] = []
    for step in path.steps:
        if isinstance(step, PoseStep):
            keys.append((path.tracks[step.track].name, step.inverse))
        elif isinstance(step, JointStep) and (not in_log or travels(path, step)):
            keys.append((step.name, step.kind, path.tracks[step.track].name, step.column))
    return tuple(keys)


def travels(path: KinematicPath, step: JointStep) -> bool:
    """Whether a joint moves farther than noise and sag do; single glitches are no motion."""
    positions = path.tracks[step.track].values[:, step.column]
    finite = positions[np.isfinite(positions)]
    return bool(len(finite)) and float(np.ptp(np.percentile(finite, _TAILS))) > STILL_JOINT


def with_zero(path: KinematicPath, reported: tuple[int, int], zero: float) -> KinematicPath:
    """The same path with a constant, rad, added to a reported position, by (track, column)."""
    steps = (
        replace(step, offset=step.offset + step.multiplier * zero)
        if isinstance(step, JointStep) and (step.track, step.column) == reported
        else step
        for step in path.steps
    )
    return replace(path, steps=tuple(steps))


def topic_of(name: str) -> str:
    """The topic in the name of a track."""
    return name.split(" ", 1)[0]


def label_of(name: str) -> str:
    """A track's name, without frames where the message has none."""
    return topic_of(name) if name.endswith("-> ?)") else name
