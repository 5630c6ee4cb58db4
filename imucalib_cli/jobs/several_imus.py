"""Solve the IMUs of one log together."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec.structs import asdict, replace

from imucalib_cli.combine.imus import OnRobot, groups, solve_agreeing
from imucalib_cli.estimate.checks.answer import answer_findings
from imucalib_cli.estimate.matched import estimate_of
from imucalib_cli.findings import gravest_first, note, warning
from imucalib_cli.messages import OF_ANSWER

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.solution.normal_equations import Answer, LogStatistics
    from imucalib_cli.findings import Finding
    from imucalib_cli.robot.path import KinematicPath

_KEPT: Final = ("window", "residuals", "consistency", "imu_check", "notes")
"""Fields of an estimate about its data, which other IMUs do not change."""
_UNEXPLAINED: Final = {
    "window.noisy",
    "window.dependent",
    "parts.disagree",
    "residual.beyond_noise",
}
"""Codes of unexplained residuals, which may look like an error of the robot."""


def solve_imus_together(imus: Sequence[tuple[str, Estimate, KinematicPath]]) -> list[Estimate]:
    """Solve IMUs again with common errors of the robot, if their chains share any part of it.

    Each comes with its name, its own estimate and its path. One that cannot be trusted, has
    unexplained residuals, or does not agree with the others keeps its own estimate; a finding
    reports a disagreement.
    """
    found = [estimate for _, estimate, _ in imus]
    members: list[tuple[int, str, LogStatistics, OnRobot]] = []
    # sorted by name, so that the order in the log does not matter
    for place, (name, estimate, path) in sorted(enumerate(imus), key=lambda each: each[1][0]):
        log, codes = estimate.statistics, {each.code for each in estimate.findings}
        is_sound = estimate.trusted and not codes & _UNEXPLAINED
        if log is not None and is_sound and not log.widened.any():
            members.append((place, name, log, OnRobot.of(log, path)))
    for group in groups([on_robot for *_, on_robot in members]):
        places, names, logs, _ = zip(*(members[each] for each in group), strict=True)
        solved = solve_agreeing(logs, [log.equations.solve(log.options) for log in logs])
        for each, answer in solved.answers.items():
            others = tuple(names[other] for other in solved.answers if other != each)
            finding = note("imus.together", others=others)
            found[places[each]] = _again(found[places[each]], logs[each], answer, finding)
        for each, change in solved.disagreeing.items():
            others = tuple(name for other, name in enumerate(names) if other != each)
            finding = warning("imus.disagree", imu=names[each], others=others, **asdict(change))
            alone = found[places[each]]
            found[places[each]] = replace(alone, findings=(*alone.findings, finding))
    return found


def _again(estimate: Estimate, log: LogStatistics, answer: Answer, finding: Finding) -> Estimate:
    """The common estimate: findings on the data stay, those on the answer are made anew."""
    of_data = (each for each in estimate.findings if each.code not in OF_ANSWER)
    findings = gravest_first((*of_data, finding, *answer_findings(answer, log)))
    kept = {name: getattr(estimate, name) for name in _KEPT}
    details = estimate.details
    if details is not None:
        kept["details"] = replace(details, state=answer.state)
    return replace(estimate_of(answer, log, findings=findings, **kept), statistics=log)
