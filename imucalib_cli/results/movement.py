"""Has a mount moved between two results? And how surely?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from imucalib_cli.digits import figures
from imucalib_cli.findings import Finding, warning, warnings
from imucalib_cli.results.difference import Difference, Significance, difference
from imucalib_cli.results.difference_words import both_words, farthest_words, tolerance_words
from imucalib_cli.results.summary import unobservable_lines
from imucalib_cli.results.verification import exceeds, grave_doubts

if TYPE_CHECKING:
    from imucalib_cli.results.calibration import Calibration, Tolerance
    from imucalib_cli.results.uncertain_pose import UncertainPose

Movement = Literal["moved", "not moved", "unknown"]

RARE = 0.01
"""Chance below which a difference is not noise: one false alarm in a hundred comparisons."""


@dataclass(frozen=True, kw_only=True)
class Side:
    """One of the two results, and the name of its file."""

    name: str
    calibration: Calibration


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """The answer for one IMU, with the evidence for it."""

    verdict: Movement
    reason: str
    """One sentence with the figures."""
    parent: str
    child: str
    within: Tolerance | None
    difference: Difference
    """Second less first, in the first result's parent frame."""
    significance: Significance | None
    """Of all that is known in both; None where nothing is."""
    first: Side
    second: Side
    findings: tuple[Finding, ...]

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings in words."""
        return warnings(self.findings)


def compare(
    first: Side,
    second: Side,
    poses: tuple[UncertainPose, UncertainPose],
    within: Tolerance | None = None,
) -> Comparison:
    """Decide whether the mount moved between two results.

    Without a tolerance it moved if chi-squared of the difference, in the directions that both
    results know, is rarer than RARE in noise; with one, if the difference is beyond the tolerance
    by two sigma, as for ``verify``. It did not move if nothing is unknown and that is not so (with
    a tolerance: if the difference is within it by two sigma).

    Args:
        first: The earlier result.
        second: The later one.
        poses: Of both, expressed in the same frames.
        within: How far a mount may move.
    """
    apart = difference(*poses)
    test = apart.significance()
    moved = _moved(apart, test, within)
    open_directions = any(len(part.unknown) or not part.meaningful for part in apart.parts)
    settled = not open_directions and test is not None and _is_within(apart, within)
    doubts = _doubts(first, second)
    verdict: Movement = "unknown"
    if not doubts and (moved or settled):
        verdict = "moved" if moved else "not moved"
    place = f"{poses[0].child} in {poses[0].parent}"
    figures_said = f"{both_words(apart)} apart{_chance(test)}"
    match verdict:
        case "moved":
            said = f"{place} has moved: {figures_said}{_allowed(within)}"
        case "not moved":
            said = (
                f"{place} has not moved{_allowed(within)}: {figures_said}; within two sigma it "
                f"moved by no more than {farthest_words(apart)}"
            )
        case "unknown":
            why = doubts or _gaps(first, second) or [_too_wide(apart, within)]
            said = f"cannot tell whether {place} has moved: {figures_said}; {'; '.join(why)}"
    return Comparison(
        verdict=verdict,
        reason=said,
        parent=poses[0].parent,
        child=poses[0].child,
        within=within,
        difference=apart,
        significance=test,
        first=first,
        second=second,
        findings=_findings(first, second),
    )


def _moved(apart: Difference, test: Significance | None, within: Tolerance | None) -> bool:
    if within is None:
        return test is not None and test.p_value < RARE
    bounds = (within.translation, within.rotation)
    return any(exceeds(apart, part, b) for part, b in zip(apart.parts, bounds, strict=True))


def _is_within(apart: Difference, within: Tolerance | None) -> bool:
    if within is None:
        return True
    bounds = (within.translation, within.rotation)
    return all(
        part.bounds is not None and part.bounds[1] <= bound
        for part, bound in zip(apart.parts, bounds, strict=True)
    )


def _doubts(*sides: Side) -> list[str]:
    return [f"{side.name}: {doubt}" for side in sides for doubt in grave_doubts(side.calibration)]


def _gaps(*sides: Side) -> list[str]:
    """What one of the results does not know."""
    said = []
    for side in sides:
        if side.calibration.estimate.covariance is None:
            method = side.calibration.estimate.method
            said.append(f"{side.name}: --method {method} states no sigma: use --method matched")
        said += [f"{side.name}: {line}" for line in unobservable_lines(side.calibration)]
    return said


def _chance(test: Significance | None) -> str:
    if test is None:
        return ""
    chance = "less than 1e-12" if test.p_value < 1e-12 else figures(test.p_value, 2)
    return (
        f" (chi-squared {figures(test.chi2, 3)} with {test.freedom} degrees of freedom, p {chance})"
    )


def _allowed(within: Tolerance | None) -> str:
    if within is None:
        return ""
    return f", within {tolerance_words(within)}"


def _too_wide(apart: Difference, within: Tolerance | None) -> str:
    asked = "" if within is None else f", and {tolerance_words(within)} is allowed"
    most = farthest_words(apart)
    return f"within two sigma it is up to {most}{asked}: record longer or livelier motion"


def _findings(first: Side, second: Side) -> tuple[Finding, ...]:
    """What sigma cannot know of two results."""
    one, other = (
        {file.sha256 for file in side.calibration.provenance.files} for side in (first, second)
    )
    if not one & other:
        return ()
    return (warning("diff.same_log", first=first.name, second=second.name),)
