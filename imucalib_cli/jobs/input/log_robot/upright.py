"""The upright axis of a link on a base that drives on a plane, about which the link turns."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from imucalib_cli.errors import ChoiceError
from imucalib_cli.signals.trajectory import Trajectory

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.robot.path import KinematicPath

_INSTANTS: Final = 200
_PLANAR: Final = 0.94
"""Mean cosine of the tilt against the common axis: ramps and suspensions tilt less than 20 deg."""
_TURNS: Final = 0.999
"""Mean cosine below which the heading changes enough to determine the axis."""
_ALONG: Final = 0.97
"""Cosine to an axis of the link: an error of the height then changes nothing else much."""


def upright_component(path: KinematicPath) -> int:
    """Which of tx ty tz of a pose in the link at a path's end is the height.

    Raises:
        ChoiceError: The link tilts, or none of its axes is upright.
        InputError: A track has too few usable samples.
    """
    axis = _upright(path)
    component = int(np.argmax(np.abs(axis)))
    if abs(axis[component]) < _ALONG:
        numbers = " ".join(f"{number:.2f}" for number in axis)
        raise ChoiceError(
            f"--planar: no axis of {path.parent} is upright (upright is ({numbers}) in it), so "
            "no component of a pose is the height: name a link that stands upright with --parent, "
            "or give --prior-std instead of --planar"
        )
    return component


def _upright(path: KinematicPath) -> Floats:
    """(3,), unit vector in the link that keeps its direction in the world."""
    trajectory = Trajectory.of(path)
    R = path.poses(trajectory.values(np.linspace(*trajectory.span, _INSTANTS)))[0]
    mean = R.mean(axis=0)
    _, sizes, axes = np.linalg.svd(mean)
    if sizes[0] < _PLANAR:
        raise ChoiceError(
            f"--planar: {path.parent} turns about more than one axis, so its motion also "
            "determines the height: leave --planar out"
        )
    # A base that drives straight does not determine the axis: the world's z is taken as up.
    axis = axes[0] if sizes[1] < _TURNS else mean[2] / np.linalg.norm(mean[2])
    return np.asarray(axis * np.sign(axis[np.argmax(np.abs(axis))]))
