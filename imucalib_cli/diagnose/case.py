"""What a diagnosis is given, and what it gives back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from imucalib_cli.estimate.sentence import Says, says_any
from imucalib_cli.findings import status

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.findings import Finding as Seen
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples

    Floats = NDArray[np.float64]

HypothesisKind = Literal[
    "conjugate", "inverse", "link", "offset", "order", "quaternion", "sign", "unit", "zero"
]
"""Faults that another kinematic path, or another time offset, would explain."""
FindingKind = HypothesisKind | Literal["base", "chain", "length", "publishers", "ringing", "sensor"]
"""Those, and faults that are found otherwise; ``chain``: zeros and lengths together."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """A fit that is poor, and what else the log and the URDF would allow."""

    samples: ImuSamples
    path: KinematicPath
    options: MatchedOptions
    estimate: Estimate
    frames: tuple[str, ...] = ()
    """Other links or frames that could carry the IMU."""
    path_to: Callable[[str], KinematicPath] | None = None
    """Kinematics of such a frame; raises ImucalibError where the log does not tell them."""
    links: dict[str, tuple[str, str]] | None = None
    """Parent and child link of each joint, by the joint's name."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A cause that explains what the model as told does not."""

    kind: FindingKind
    """Of the fault."""
    names: tuple[str, ...]
    """The joints, links or topics at fault; empty where it is none of them."""
    sentence: str
    """Cause, figures and remedy."""
    size: tuple[float, ...] = ()
    """For each name how much: rad, m or s; empty where it is no matter of size."""
    moves: tuple[float, float] | None = None
    """m and rad by which the IMU's pose changes once it is mended; None where that is not known."""
    seen: Seen | None = None
    """That says the same with a code, where there is one."""


def needs_diagnosis(estimate: Estimate) -> bool:
    """Whether a result is poor for reasons that a cause may lie behind."""
    if estimate.method != "matched":
        return False
    if names_sensor(estimate):
        return False
    return status(estimate.findings) != "ok" or estimate.sigma_source == "segments"


def names_sensor(estimate: Estimate) -> bool:
    """Whether the fit itself has found the sensor to be the cause."""
    return any(says_any(reason, {Says.SENSOR}) for reason in estimate.distrust)
