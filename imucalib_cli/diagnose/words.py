"""Findings in sentences: what explains, by how much, and what to do."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.diagnose.case import Finding
from imucalib_cli.diagnose.edits import origin_lengths
from imucalib_cli.robot.rotations import rotation_angle

if TYPE_CHECKING:
    from imucalib_cli.diagnose.bench import Trial
    from imucalib_cli.diagnose.case import Case
    from imucalib_cli.diagnose.parameters import Explanation, Parameter
    from imucalib_cli.diagnose.search import Explained

_MOST_RIVALS = 3


def of_hypotheses(tied: list[Explained], told: Trial, case: Case) -> Finding:
    """One sentence for the best hypothesis and those that explain as well."""
    first = tied[0]
    causes = [_cause(explained, case) for explained in tied[: _MOST_RIVALS + 1]]
    if all(e.hypothesis.kind == "link" for e in tied):
        names = [e.hypothesis.names[0] for e in tied]
        cause = f"the IMU moves as {' or '.join(names)} does, not as {told.path.parent}"
        remedy = (
            f"rerun with --parent {' or --parent '.join(names)}; if --parent was not given, "
            "correct also the frame_id or the URDF's joint that holds the IMU"
        )
    else:
        cause = "; or ".join(dict.fromkeys(causes))
        remedy = "; or ".join(dict.fromkeys(_remedy(explained, case) for explained in tied))
    unsure = ", the log cannot tell which" if len(tied) > 1 else ""
    return Finding(
        kind=first.hypothesis.kind,
        names=tuple(name for e in tied for name in e.hypothesis.names)
        if all(e.hypothesis.kind == first.hypothesis.kind for e in tied)
        else first.hypothesis.names,
        sentence=f"{cause}{unsure} (that leaves {_evidence(first.trial, told)}): {remedy}",
        size=_size(first),
    )


def of_given_offset(trial: Trial, told: Trial, case: Case) -> Finding:
    """One sentence for a time offset that was given wrongly."""
    moves = _apart(trial, told)
    return Finding(
        kind="offset",
        names=(),
        sentence=f"{_offset_cause(trial.time_offset, case)} (that leaves {_evidence(trial, told)}, "
        f"and puts the IMU {moves[0] * 1e3:.2g} mm and {math.degrees(moves[1]):.2g} deg from where "
        "it is found now): rerun without --time-offset, or give this one",
        size=(trial.time_offset,),
        moves=moves,
    )


def of_parameters(explanation: Explanation, told: Trial, case: Case) -> Finding | None:
    """One sentence for constants of the chain; None where too many others would do."""
    if len(explanation.rivals) > _MOST_RIVALS:
        return None
    values = explanation.values
    parts = [_constant(parameter, value, case) for parameter, value in values.items()]
    cause = " and ".join(parts)
    others = [
        " and ".join(_constant(p, v, case) for p, v in rival.items())
        for rival in explanation.rivals
    ]
    if others:
        cause += f", or {', or '.join(others)} (the log cannot tell which),"
    kinds = {parameter.kind for parameter in values}
    moves = _apart(explanation.trial, told)
    remedy = {
        frozenset({"zero"}): "add it to the joint's calibration, or turn the joint's origin in the "
        "URDF by it",
        frozenset({"length"}): "correct the origin in the URDF, or use the arm's own calibration",
    }.get(frozenset(kinds), "correct the URDF, or use the arm's own calibration")
    return Finding(
        kind="zero" if kinds == {"zero"} else "length" if kinds == {"length"} else "chain",
        names=tuple(parameter.joint for parameter in values),
        sentence=f"{cause} would explain what the model leaves over "
        f"({_evidence(explanation.trial, told)}) and put the IMU {moves[0] * 1e3:.2g} mm and "
        f"{math.degrees(moves[1]):.2g} deg from where it is found now: {remedy}",
        size=tuple(values.values()),
        moves=moves,
    )


def _apart(one: Trial, other: Trial) -> tuple[float, float]:
    """How far two trials put the IMU apart, m and rad."""
    a, b = one.solution.state, other.solution.state
    return float(np.linalg.norm(a.t - b.t)), float(rotation_angle(b.R.T @ a.R))


def _cause(explained: Explained, case: Case) -> str:
    hypothesis, trial = explained.hypothesis, explained.trial
    if hypothesis.kind == "offset":
        return _offset_cause(trial.time_offset, case)
    if hypothesis.kind == "zero":
        return (
            f"joint {hypothesis.names[0]} stands {math.degrees(hypothesis.size[0]):+.4g} deg from "
            "where its position says (true angle less position)"
        )
    return hypothesis.cause


def _remedy(explained: Explained, case: Case) -> str:
    hypothesis, trial = explained.hypothesis, explained.trial
    if hypothesis.kind == "offset":
        if case.options.time_offset is not None:
            return "rerun without --time-offset, or give this one"
        return f"rerun with --max-offset {math.ceil(abs(trial.time_offset) * 1.1 + 0.5)}s"
    if hypothesis.kind == "zero":
        return "turn the joint's origin in the URDF by it, or correct the encoder's zero"
    return hypothesis.remedy


def _offset_cause(offset: float, case: Case) -> str:
    late = "later" if offset > 0.0 else "earlier"
    told = case.options.time_offset
    where = (
        f"beyond the search of ±{case.options.max_offset:g} s"
        if told is None
        else f"not the {told:g} s that were given"
    )
    size = f"{abs(offset):.3g} s" if abs(offset) >= 1.0 else f"{abs(offset) * 1e3:.3g} ms"
    return f"the IMU's stamps are {size} {late} than the robot's, {where}"


def _size(explained: Explained) -> tuple[float, ...]:
    if explained.hypothesis.kind == "offset":
        return (explained.trial.time_offset,)
    return explained.hypothesis.size


def _constant(parameter: Parameter, value: float, case: Case) -> str:
    joint = parameter.joint
    step = next(s for s in case.path.steps if getattr(s, "name", None) == joint)
    if parameter.kind == "zero":
        if getattr(step, "kind", "") == "prismatic":
            return f"a zero offset of {value * 1e3:+.3g} mm of joint {joint}"
        return f"a zero offset of {math.degrees(value):+.3g} deg of joint {joint}"
    told = origin_lengths(case.path)[joint]
    link = "" if case.links is None or joint not in case.links else f" in {case.links[joint][0]}"
    size, sense = abs(value) * 1e3, "longer" if value > 0.0 else "shorter"
    return (
        f"an origin of joint {joint}{link} {size:.3g} mm {sense} than in the URDF "
        f"({(told + value) * 1e3:.4g} mm instead of {told * 1e3:.4g})"
    )


def _evidence(trial: Trial, told: Trial) -> str:
    """What is left unexplained, before and after."""
    parts = []
    for index, what in ((1, "rotation"), (0, "acceleration")):
        before, after = (min(t.shares[index], 1.0) for t in (told, trial))
        if np.hypot(told.left[index], told.noise[index]) > 1.5 * np.hypot(
            trial.left[index], trial.noise[index]
        ):
            parts.append(f"{_percent(after)} of the {what} instead of {_percent(before)}")
    if parts:
        return f"{' and '.join(parts)} unexplained"
    ratio = max(t / a for t, a in zip(told.left, trial.left, strict=True))
    return f"residuals {ratio:.2g} times smaller"


def _percent(share: float) -> str:
    """Two digits, never as a power of ten."""
    percent = 100.0 * share
    if percent < 0.1:
        return "less than 0.1 %"
    return f"{percent:.0f} %" if percent >= 10.0 else f"{percent:.2g} %"
