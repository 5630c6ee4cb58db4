"""Is a pose that somebody told the pose that a log shows? Yes, no, or the log cannot tell."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from imucalib_cli.findings import Severity
from imucalib_cli.results.calibration import Tolerance
from imucalib_cli.results.difference import SIGMAS, Difference, Part, difference
from imucalib_cli.results.difference_words import (
    both_words,
    bound_words,
    norm_words,
    range_words,
    sigmas_words,
    tolerance_words,
    vector_words,
)
from imucalib_cli.results.requirement import CODES
from imucalib_cli.results.summary import unobservable_lines
from imucalib_cli.results.uncertain_pose import UncertainPose, pose_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.results.calibration import Calibration, Nominal, SourceFile

Verdict = Literal["yes", "no", "unknown"]

WITHIN = Tolerance(translation=5e-3, rotation=math.radians(0.5))
"""Default tolerance."""
SIGNIFICANT = math.erfc(SIGMAS / math.sqrt(2.0))
"""Chance of a difference beyond SIGMAS of one component. A difference that noise gives more often
than that is no difference, however small the tolerance: of three components together one often
exceeds two sigma."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Verification:
    """The answer for one IMU, with the evidence for it."""

    verdict: Verdict
    reason: str
    """One sentence: the figures, and what to do where there is something to do."""
    translation: Verdict
    rotation: Verdict
    within: Tolerance
    difference: Difference
    """Found less told, in the found pose's parent frame."""
    calibration: Calibration
    told: Nominal
    urdf: SourceFile | None
    """That told it; None where the log's own frames did."""


def verify(
    calibration: Calibration,
    told: Nominal,
    within: Tolerance = WITHIN,
    urdf: SourceFile | None = None,
) -> Verification:
    """Decide whether a told pose is right within a tolerance.

    For translation and rotation alike: yes if everything within two sigma of what was found lies
    within the tolerance of what was told, no if nothing does, else unknown. A no from one of them
    is a no; a yes takes both. A result that contradicts itself answers nothing. A direction that
    was not determined withholds a yes, but not a no from the others.

    Args:
        calibration: What a log shows.
        told: The pose in question, in the result's parent frame.
        within: What is near enough; finite.
        urdf: Where it was told.
    """
    found = pose_of(calibration)
    apart = difference(_exact(found, told), found)
    translation, rotation = (
        _verdict(apart, part, bound)
        for part, bound in zip(apart.parts, (within.translation, within.rotation), strict=True)
    )
    doubts = grave_doubts(calibration)
    verdict: Verdict = "unknown"
    if not doubts and "no" in {translation, rotation}:
        verdict = "no"
    elif not doubts and translation == rotation == "yes":
        verdict = "yes"
    asked = tolerance_words(within)
    place = f"{calibration.child} in {calibration.parent}"
    source = "the log's own frames say" if urdf is None else f"{urdf.path} says"
    by = f"{source} (joint '{told.joint}')" if told.joint else source
    match verdict:
        case "yes":
            said = f"{place} is where {by}, within {asked}: {both_words(apart)} away"
        case "no":
            faults = _faults(apart, found.parent, within, translation, rotation)
            said = f"{place} is not where {by}: {faults}"
        case "unknown":
            said = f"cannot tell whether {place} is where {by}, within {asked}: " + "; ".join(
                doubts or _gaps(calibration, apart, within, (translation, rotation))
            )
    return Verification(
        verdict=verdict,
        reason=said + assumed(calibration),
        translation=translation,
        rotation=rotation,
        within=within,
        difference=apart,
        calibration=calibration,
        told=told,
        urdf=urdf,
    )


def grave_doubts(calibration: Calibration) -> list[str]:
    """Reasons against a result that make its sigma worthless, and so every answer from it.

    Directions that were not determined are none of them, nor is a sigma that is larger than
    someone required: both are in the covariance.
    """
    return [
        f"the result contradicts itself or its model: {finding.message}"
        for finding in calibration.estimate.findings
        if finding.severity is Severity.UNTRUSTED and finding.code not in CODES
    ]


def exceeds(apart: Difference, part: Part, bound: float) -> bool:
    """Whether a part of a difference is beyond a bound, whatever noise may have done."""
    test = apart.significance(part)
    if part.bounds is None or test is None or not part.meaningful:
        return False
    return part.bounds[0] > bound and test.p_value < SIGNIFICANT


def _exact(found: UncertainPose, told: Nominal) -> UncertainPose:
    return UncertainPose(
        parent=found.parent,
        child=found.child,
        R=told.R_parent_imu,
        t=told.t_parent_imu,
        covariance=np.zeros((6, 6)),
        unknown_translation=np.zeros((0, 3)),
        unknown_rotation=np.zeros((0, 3)),
    )


def _verdict(apart: Difference, part: Part, bound: float) -> Verdict:
    if exceeds(apart, part, bound):
        return "no"
    sure = part.bounds is not None and part.meaningful and not len(part.unknown)
    return "yes" if sure and part.bounds is not None and part.bounds[1] <= bound else "unknown"


def _faults(apart: Difference, parent: str, within: Tolerance, *verdicts: Verdict) -> str:
    """What is beyond which tolerance, by how many sigma, and along which axes."""
    said = []
    bounds = (within.translation, within.rotation)
    for part, bound, verdict in zip(apart.parts, bounds, verdicts, strict=True):
        if verdict != "no":
            continue
        said.append(
            f"the {part.kind} is off by {norm_words(part)} ({sigmas_words(part)}), more than "
            f"{bound_words(part, bound)}; as a vector in {parent} {vector_words(part)}"
        )
    return "; ".join(said)


def _gaps(
    calibration: Calibration,
    apart: Difference,
    within: Tolerance,
    verdicts: tuple[Verdict, Verdict],
) -> Iterator[str]:
    """Why neither yes nor no."""
    if apart.covariance is None:
        yield (
            f"--method {calibration.estimate.method} states no sigma, and the pose found is "
            f"{both_words(apart)} away: use --method matched"
        )
        return
    blind = list(unobservable_lines(calibration))
    yield from blind
    bounds = (within.translation, within.rotation)
    for part, bound, verdict in zip(apart.parts, bounds, verdicts, strict=True):
        open_directions = len(part.unknown) or not part.meaningful
        if verdict != "unknown" or open_directions or part.bounds is None:
            continue
        yield (
            f"the {part.kind} is off by {norm_words(part)}, so by {range_words(part)} within two "
            f"sigma, and the tolerance of {bound_words(part, bound)} lies in between: "
            f"{_remedy(calibration)}, or ask for another tolerance"
        )


def _remedy(calibration: Calibration) -> str:
    if calibration.estimate.sigma_source == "segments":
        return (
            "the robot model, not noise, sets sigma, so correct the URDF's lengths and joint zeros"
        )
    return "record longer or livelier motion"


def assumed(calibration: Calibration) -> str:
    """A clause on components of the pose that were told to the estimator, not found by it.

    They agree with what was told for the simple reason that it was told.
    """
    stds = str(calibration.provenance.options.get("pose.std", "")).split()
    names = [
        name
        for name, std in zip(("tx", "ty", "tz", "rx", "ry", "rz"), stds, strict=False)
        if std != "inf"
    ]
    return f"; told beforehand, not found by the log alone: {', '.join(names)}" if names else ""
