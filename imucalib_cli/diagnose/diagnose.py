"""Find out why a fit is poor, and put it before everything else that is said of the result."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.diagnose.bench import make_bench
from imucalib_cli.diagnose.parameters import explain_by_parameters
from imucalib_cli.diagnose.rest import find_motion_at_rest
from imucalib_cli.diagnose.ringing import find_ringing
from imucalib_cli.diagnose.rivals import find_rival_publishers
from imucalib_cli.diagnose.search import explain_grossly, falls, is_poor
from imucalib_cli.diagnose.words import of_given_offset, of_hypotheses, of_parameters
from imucalib_cli.estimate.sentence import Says, says_any, without
from imucalib_cli.findings import Severity, texts

if TYPE_CHECKING:
    from imucalib_cli.diagnose.bench import Bench, Trial
    from imucalib_cli.diagnose.case import Case, Finding, FindingKind
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.findings import Finding as Told

_OFFSET_FALL = 2.0
"""Fall of a residual for which a time offset that was given is contradicted."""
_SMALL_GYRO = 0.1
"""Share of the rotation left unexplained up to which small errors are looked for first."""
_GENERIC = frozenset({Says.POOR, Says.PARTS_DIFFER})
"""What a cause explains, and what need not be said beside it. A small error of the chain explains
away that parts of the log differ too: it pulls unlike moves apart."""
_ASIDE: frozenset[FindingKind] = frozenset({"ringing", "publishers"})
"""Findings that say why residuals are large, but not that the answer is another."""
_SIGMAS = 2.0
_MOST_MOVED = (2e-3, math.radians(0.2))
"""m and rad by which a pose may move once a known cause is mended, and still be given as it is."""
_AFTER = "not to be judged before the cause of the misfit is mended"


def diagnose(case: Case) -> tuple[Finding, ...]:
    """Try what may be wrong with robot and log; name what explains decisively.

    Args:
        case: The fit and what else could be true.

    Returns:
        Findings, the first the most likely; empty where nothing tried explains.
    """
    notes = case.estimate.notes
    samples = case.samples
    if notes.get("accel_sign") == "down":
        samples = replace(samples, accel=-samples.accel)
    bench = make_bench(
        samples,
        case.options,
        seconds=case.estimate.window.seconds,
        imu_ticks=notes.get("imu_stamps") == "ticks",
        robot_ticks=notes.get("robot_stamps") == "ticks",
        corrections=case.estimate.corrections,
    )
    rivals = find_rival_publishers(case.path)
    if rivals is not None:
        return (rivals,)
    told = bench.trial(case.path)
    if told is None:
        return ()
    small = told.shares[1] < _SMALL_GYRO
    for attempt in (_given_offset, _small, _gross) if small else (_gross, _small):
        found = attempt(bench, case, told)
        if found:
            return found
    other = find_ringing(told) or find_motion_at_rest(told)
    return () if other is None else (other,)


def _given_offset(bench: Bench, case: Case, told: Trial) -> tuple[Finding, ...]:
    """A time offset that was given, and that the log contradicts."""
    if case.options.time_offset is None:
        return ()
    free = replace(bench, options=replace(bench.options, time_offset=None))
    trial = free.trial(case.path, offset=told.time_offset)
    if trial is None or not falls(trial, told, _OFFSET_FALL):
        return ()
    return (of_given_offset(trial, told, case),)


def _gross(bench: Bench, case: Case, told: Trial) -> tuple[Finding, ...]:
    if not is_poor(told):
        return ()
    found = explain_grossly(bench, case, told)
    return (of_hypotheses(found, told, case),) if found else ()


def _small(bench: Bench, case: Case, told: Trial) -> tuple[Finding, ...]:
    explanation = explain_by_parameters(bench, told)
    if explanation is None:
        return ()
    finding = of_parameters(explanation, told, case)
    return () if finding is None else (finding,)


def explained(estimate: Estimate, findings: tuple[Finding, ...]) -> Estimate:
    """The estimate with its findings said first, and what they explain no longer said."""
    if not findings:
        return _without_advice(estimate) if _misfits(estimate) else estimate
    aside = all(finding.kind in _ASIDE for finding in findings)
    stands = _stands(estimate, findings, aside=aside)
    severity = Severity.WARNING if stands else Severity.UNTRUSTED
    told = tuple(
        replace(finding.seen, severity=severity)
        if finding.seen is not None
        else texts(severity, [finding.sentence])[0]
        for finding in findings
    )
    reasons, warnings = _parted(estimate)
    warnings = without(warnings, {Says.POOR})
    if stands:
        return replace(estimate, findings=(*told, *warnings))
    reasons = without(reasons, () if aside else _GENERIC)
    return replace(_without_advice(estimate), findings=(*told, *reasons, *warnings))


def _parted(estimate: Estimate) -> tuple[tuple[Told, ...], tuple[Told, ...]]:
    """Findings that forbid to use the result, and the others."""
    reasons = tuple(each for each in estimate.findings if each.severity is Severity.UNTRUSTED)
    others = tuple(each for each in estimate.findings if each.severity is not Severity.UNTRUSTED)
    return reasons, others


def _stands(estimate: Estimate, findings: tuple[Finding, ...], *, aside: bool) -> bool:
    """Whether the result may be used as it is, with the findings as warnings."""
    if aside:
        return estimate.trusted
    left = without(_parted(estimate)[0], {Says.PARTS_DIFFER})
    return not left and not estimate.unobservable and not _undoes(estimate, findings)


def _undoes(estimate: Estimate, findings: tuple[Finding, ...]) -> bool:
    """Whether mending a finding would move the pose by more than is stated, or by plainly much."""
    std = np.zeros(6) if estimate.covariance is None else np.sqrt(np.diag(estimate.covariance))
    stated = float(np.linalg.norm(std[:3])), float(np.linalg.norm(std[3:]))
    return any(
        move > min(_SIGMAS * sigma, most)
        for finding in findings
        for move, sigma, most in zip(
            finding.moves or (np.inf,) * 2, stated, _MOST_MOVED, strict=True
        )
    )


def stepped_back(estimate: Estimate) -> Estimate:
    """The estimate without advice on motion, which is no use while the fit is wrong otherwise."""
    reasons, warnings = _parted(estimate)
    findings = (*reasons, *without(warnings, {Says.POOR}))
    return replace(_without_advice(estimate), findings=findings)


def _misfits(estimate: Estimate) -> bool:
    """Whether a result is distrusted for what the model leaves over, whatever the cause."""
    return any(says_any(reason, {Says.POOR}) for reason in estimate.distrust)


def _without_advice(estimate: Estimate) -> Estimate:
    return replace(
        estimate,
        unobservable=tuple(replace(each, motion=_AFTER) for each in estimate.unobservable),
    )
