"""The IMUs of one log: what each says by itself, and what they say together."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.estimate.answer import estimate_of
from imucalib_cli.estimate.checks import judge
from imucalib_cli.findings import Severity, note, warning

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.solution.normal_equations import Answer
    from imucalib_cli.estimate.statistics import LogStatistics
    from imucalib_cli.findings import Finding
    from imucalib_cli.robot.path import KinematicPath

SOLVED_TOGETHER = "imus.together"
"""Code of the finding that other IMUs of the log had a part in a result."""


def together(imus: Sequence[tuple[str, Estimate, KinematicPath]]) -> list[Estimate]:
    """Solve IMUs again with what is the robot's in common, where their chains share any of it.

    Those that cannot be trusted, or hang on something that no unknown explains, stay as they are,
    and so do those that do not agree with the others, which is told.

    Args:
        imus: Name, what it says by itself, and what carries it.
    """
    found = [estimate for _, estimate, _ in imus]
    sound = {
        name: (place, estimate.statistics, path)
        for place, (name, estimate, path) in enumerate(imus)
        if estimate.statistics is not None
        and estimate.trusted
        and not estimate.statistics.widened.any()
    }
    if len(sound) < 2:
        return found
    from imucalib_cli.estimate.several_imus import OnRobot, groups, solve_agreeing

    # In an order of their own, whatever that of the log.
    names = sorted(sound)
    places, logs, paths = zip(*(sound[name] for name in names), strict=True)
    for group in groups([OnRobot.of(*each) for each in zip(logs, paths, strict=True)]):
        own = [logs[each].equations.solve(logs[each].options) for each in group]
        solved = solve_agreeing([logs[each] for each in group], own)
        agreeing = [names[group[each]] for each in solved.answers]
        for each, answer in solved.answers.items():
            index = group[each]
            others = tuple(name for name in agreeing if name != names[index])
            found[places[index]] = _again(
                found[places[index]], logs[index], answer, note(SOLVED_TOGETHER, others=others)
            )
        for each, change in solved.strangers.items():
            index = group[each]
            others = tuple(names[other] for other in group if other != index)
            told = warning("imus.disagree", imu=names[index], others=others, **vars(change))
            place = places[index]
            found[place] = replace(found[place], findings=(*found[place].findings, told))
    return found


def _again(estimate: Estimate, log: LogStatistics, answer: Answer, told: Finding) -> Estimate:
    """What the data of an IMU say still holds; what its unknowns say is said anew."""
    of_data = (each for each in estimate.findings if each.code not in judge.OF_ANSWER)
    anew = judge.of_answer(
        answer,
        log.windows,
        seconds=log.seconds,
        clock_stepped=log.clock_stepped,
        contradicted=False,
        unknown=bool(judge.unobservable(answer)),
    )
    findings = sorted((*of_data, told, *anew), key=lambda each: each.severity is not Severity.UNTRUSTED)
    kept = {
        name: getattr(estimate, name)
        for name in ("window", "residuals", "consistency", "sigma_source", "imu_check", "details", "notes")
    }
    return replace(estimate_of(answer, log, findings=tuple(findings), **kept), statistics=log)
