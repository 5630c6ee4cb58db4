"""verify: whether a given pose is right. diff: whether a mount moved. Or: cannot tell."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

from msgspec import UNSET

from imucalib_cli.digits import figures
from imucalib_cli.estimate.entries import POSE_NAMES
from imucalib_cli.findings import warning
from imucalib_cli.results.comparison import answers
from imucalib_cli.results.comparison.pose_comparison import PoseComparison, compare_poses
from imucalib_cli.results.fields import contradictions, unobservable_fields
from imucalib_cli.results.from_estimate import pose_entry, tree_from
from imucalib_cli.results.requirement import Tolerance
from imucalib_cli.results.result import SCHEMA
from imucalib_cli.tree import plain

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from imucalib_cli.results.pose import UncertainPose
    from imucalib_cli.results.result import Result, SourceFile
    from imucalib_cli.robot.mount import NominalPose

_MOVED: dict[answers.Verdict, Literal["moved", "not moved", "unknown"]] = {
    "yes": "not moved",
    "no": "moved",
    "unknown": "unknown",
}
"""The words of diff for a verdict on whether two poses agree."""
WITHIN = Tolerance(translation=5e-3, rotation=math.radians(0.5))
"""Default tolerance."""


def verify(
    result: Result,
    given: NominalPose,
    within: Tolerance = WITHIN,
    urdf: SourceFile | None = None,
    file: str = "",
    *,
    ignored: frozenset[int] = frozenset(),
) -> answers.VerifyAnswer:
    """Decide whether a given pose, in the result's parent frame, is right within a tolerance.

    Translation and rotation are judged alike: yes if all poses within two sigma of the estimate are
    within the tolerance of the given pose, no if none is, else unknown. One no is a no; a yes needs
    both. A result that contradicts itself gives no answer. ``ignored`` are components of the pose
    (of tx ty tz rx ry rz, parent frame) that need not be right. ``urdf`` is None where the pose is
    from the log's own frames, ``file`` empty where a log was calibrated.
    """
    found = result.uncertain_pose
    apart = compare_poses(found.exactly(given.R_parent_imu, given.t_parent_imu), found)
    apart = apart.without(ignored)
    left_out = tuple(POSE_NAMES[place] for place in sorted(ignored))
    verdicts = [apart.judge(part, within) for part in apart.parts]
    doubts = contradictions(result)
    verdict: answers.Verdict = "unknown" if doubts else apart.verdict(within)
    place = f"{result.child} in {result.parent}"
    source = "the log's own frames say" if urdf is None else f"{_named(urdf)} says"
    by = f"{source} (joint '{given.joint}')" if given.joint else source
    match verdict:
        case "yes":
            said = f"{place} is where {by}, within {within}: {apart} away"
        case "no":
            faults = (
                f"the {part.kind} is off by {part} ({part.in_sigmas}), more than "
                f"{within.words_of(part.kind)}; as a vector in {found.parent} {part.vector_words}"
                for part, answer in zip(apart.parts, verdicts, strict=True)
                if answer == "no"
            )
            said = f"{place} is not where {by}: {'; '.join(faults)}"
        case "unknown":
            why = doubts or _open_questions(result, apart, within)
            said = f"cannot tell whether {place} is where {by}, within {within}: {'; '.join(why)}"
    return answers.VerifyAnswer(
        schema=SCHEMA,
        comparison="verify",
        verdict=verdict,
        reason=said + _names_words("not checked", left_out) + _given_beforehand(result),
        parent=result.parent,
        child=result.child,
        within=within_entry(within),
        **apart.entries(*verdicts),
        significance=apart.significance(),
        nominal_pose=tree_from(
            answers.NominalPoseEntry,
            pose_entry(given.R_parent_imu, given.t_parent_imu),
            joint=given.joint,
            urdf=urdf,
        ),
        found=result,
        ignored=left_out,
        file=file or UNSET,
    )


def diff(
    first: tuple[str, Result],
    second: tuple[str, Result],
    poses: tuple[UncertainPose, UncertainPose],
    within: Tolerance | None = None,
) -> answers.DiffAnswer:
    """Decide whether the mount moved between two results, each with the name of its file.

    With a tolerance the rules are those of ``verify``; without one the significance of the
    difference decides (:meth:`PoseComparison.verdict`). ``poses`` are in the same frames.
    """
    apart = compare_poses(*poses)
    test = apart.test()
    sides = (first, second)
    doubts = [f"{name}: {said}" for name, result in sides for said in contradictions(result)]
    verdict: answers.Verdict = "unknown" if doubts else apart.verdict(within)
    place = f"{poses[0].child} in {poses[0].parent}"
    figures_said = f"{apart} apart{_chance(test)}"
    allowed = "" if within is None else f", within {within}"
    match verdict:
        case "no":
            said = f"{place} has moved: {figures_said}{allowed}"
        case "yes":
            said = (
                f"{place} has not moved{allowed}: {figures_said}; within two sigma it moved by no "
                f"more than {apart.farthest_words}"
            )
        case "unknown":
            why = doubts or [f"{n}: {gap}" for n, r in sides for gap in _gaps(r)]
            asked = "" if within is None else f", and {within} is allowed"
            too_wide = f"within two sigma it is up to {apart.farthest_words}{asked}"
            why = why or [f"{too_wide}: record longer or faster motion"]
            said = f"cannot tell whether {place} has moved: {figures_said}; {'; '.join(why)}"
    return answers.DiffAnswer(
        schema=SCHEMA,
        comparison="diff",
        verdict=_MOVED[verdict],
        reason=said,
        parent=poses[0].parent,
        child=poses[0].child,
        within=None if within is None else within_entry(within),
        **apart.entries(),
        significance=apart.significance(),
        test=test,
        covariance=plain(apart.covariance),
        warnings=[warning("diff.same_log", first=first[0], second=second[0]).message]
        if first[1].provenance.shares_data_with(second[1].provenance)
        else [],
        first=_side(*first),
        second=_side(*second),
    )


def within_entry(within: Tolerance) -> answers.Within:
    """A tolerance as answers write it."""
    # as asked, not as it is after being converted twice
    sizes = (within.translation * 1e3, math.degrees(within.rotation))
    return answers.Within(*(plain(float(f"{size:.12g}")) for size in sizes))


def _named(urdf: SourceFile) -> str:
    return "the URDF on standard input" if urdf.path == "-" else urdf.path


def _gaps(result: Result) -> Iterator[str]:
    """What a result does not determine."""
    if result.covariance is None:
        yield f"--method {result.diagnostics.method} states no sigma: use --method matched"
    yield from map(str, unobservable_fields(result))


def _open_questions(result: Result, apart: PoseComparison, within: Tolerance) -> Iterator[str]:
    if apart.covariance is None:
        yield (
            f"--method {result.diagnostics.method} states no sigma, and the pose found is "
            f"{apart} away: use --method matched"
        )
        return
    if not all(part.determined for part in apart.parts):
        yield from map(str, unobservable_fields(result))
    remedy = "record longer or faster motion"
    if result.diagnostics.sigma_source == "segments":
        remedy = (
            "the robot model, not noise, sets sigma, so correct the URDF's lengths and joint zeros"
        )
    for part in apart.parts:
        if part.determined and apart.judge(part, within) == "unknown":
            yield (
                f"the {part.kind} is off by {part}, so by {part.range_words} within two sigma, "
                f"and the tolerance of {within.words_of(part.kind)} lies in between: {remedy}, or "
                "ask for another tolerance"
            )


def _names_words(what: str, names: Sequence[str]) -> str:
    """A clause about components of the pose; empty where there are none."""
    return f"; {what}: {', '.join(names)}" if names else ""


def _given_beforehand(result: Result) -> str:
    """A clause about components of the pose that were given, so that they agree by construction."""
    stds = str(result.provenance.options.get("pose.std", "")).split()
    names = [name for name, std in zip(POSE_NAMES, stds, strict=False) if std != "inf"]
    return _names_words("given beforehand, not determined by the log alone", names)


def _chance(test: answers.TestEntry | None) -> str:
    if test is None:
        return ""
    chance = "less than 1e-12" if test.p_value < 1e-12 else figures(test.p_value, 2)
    chi2 = math.inf if test.chi2 is None else test.chi2
    return (
        f" (chi-squared {figures(chi2, 3)} with {test.degrees_of_freedom} degrees of freedom, "
        f"p {chance})"
    )


def _side(name: str, result: Result) -> answers.Side:
    logs = result.provenance.files
    return tree_from(answers.Side, result, file=name, imu=result.imu_topic, logs=logs)
