"""The IMUs of one log: what each says by itself, and what they say together."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from imucalib_cli.estimate.checks import judge
from imucalib_cli.estimate.matched import estimate_of
from imucalib_cli.estimate.several_imus import OnRobot, groups, solve_agreeing
from imucalib_cli.findings import Severity, note, warning

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.solution.normal_equations import Answer, LogStatistics
    from imucalib_cli.findings import Finding
    from imucalib_cli.robot.path import KinematicPath

_KEPT: Final = ("window", "residuals", "consistency", "imu_check", "notes")
"""What an estimate says of the data, which other IMUs do not change."""
_UNEXPLAINED: Final = {"window.dependent", "residual.beyond_noise"}
"""Codes of findings on what no unknown explains: it may look like an error of the robot."""


def together(imus: Sequence[tuple[str, Estimate, KinematicPath]]) -> list[Estimate]:
    """Solve IMUs again with what is the robot's in common, where their chains share any of it.

    Those that cannot be trusted, or hang on something that no unknown explains, stay as they are,
    and so do those that do not agree with the others, which is told. Of each IMU its name, what it
    says by itself, and what carries it.
    """
    found = [estimate for _, estimate, _ in imus]
    # In an order of their own, whatever that of the log.
    places = sorted(range(len(imus)), key=lambda place: imus[place][0])
    names, logs, on_robot = [], [], []
    for place in places:
        name, estimate, path = imus[place]
        if estimate.statistics is not None and _is_sound(estimate, estimate.statistics):
            names.append((place, name))
            logs.append(estimate.statistics)
            on_robot.append(OnRobot.of(estimate.statistics, path))
    for group in groups(on_robot):
        those, several = [names[each] for each in group], [logs[each] for each in group]
        solved = solve_agreeing(several, [log.equations.solve(log.options) for log in several])
        for each, answer in solved.answers.items():
            place, others = those[each][0], _others(those, solved.answers, each)
            told = note("imus.together", others=others)
            found[place] = _again(found[place], several[each], answer, told)
        for each, change in solved.strangers.items():
            place, name = those[each]
            others = _others(those, range(len(those)), each)
            told = warning("imus.disagree", imu=name, others=others, **vars(change))
            found[place] = replace(found[place], findings=(*found[place].findings, told))
    return found


def _is_sound(estimate: Estimate, log: LogStatistics) -> bool:
    """Whether what an IMU says is wrong by no more than its own covariance, as far as it shows."""
    codes = {each.code for each in estimate.findings}
    return estimate.trusted and not log.widened.any() and not codes & _UNEXPLAINED


def _others(those: Sequence[tuple[int, str]], which: Iterable[int], one: int) -> tuple[str, ...]:
    return tuple(those[each][1] for each in which if each != one)


def _again(estimate: Estimate, log: LogStatistics, answer: Answer, told: Finding) -> Estimate:
    """What the data of an IMU say still holds; what its unknowns say is said anew."""
    of_data = (each for each in estimate.findings if each.code not in judge.OF_ANSWER)
    findings = sorted(
        (*of_data, told, *judge.of_answer(answer, log)),
        key=lambda each: each.severity is not Severity.UNTRUSTED,
    )
    kept = {name: getattr(estimate, name) for name in _KEPT}
    details = estimate.details
    if details is not None:
        kept["details"] = replace(details, windows=details.windows_of(answer.state))
    return replace(estimate_of(answer, log, findings=tuple(findings), **kept), statistics=log)
