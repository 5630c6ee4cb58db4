"""Find the cause of a poor fit, and put it before all other findings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from imucalib_cli.diagnose.publishers import find_rival_publishers
from imucalib_cli.errors import InputError
from imucalib_cli.findings import Finding, Severity, untrusted
from imucalib_cli.messages import FOLLOWING, UNSPECIFIC

if TYPE_CHECKING:
    from imucalib_cli.diagnose.alternatives import Trial
    from imucalib_cli.diagnose.hypotheses import PoorFit
    from imucalib_cli.estimate.estimate import Estimate

_AFTER: Final = "correct the cause of the poor fit first"


def needs_diagnosis(estimate: Estimate) -> bool:
    """Whether a result is poor in a way that may have a cause."""
    return estimate.method == "matched" and any(
        each.severity is Severity.UNTRUSTED or each.code == "residual.beyond_noise"
        for each in estimate.findings
        if each.code in UNSPECIFIC
    )


def diagnose(poor: PoorFit) -> tuple[Finding, ...]:
    """Name what explains a poor fit decisively, the most likely first.

    Empty where nothing tried explains, and where the fit is good; rival publishers are named even
    then.
    """
    # Their jumps look like a noisy encoder to the fit, which may be content with it.
    rivals = find_rival_publishers(poor.path)
    if rivals is not None:
        return (rivals,)
    if not needs_diagnosis(poor.estimate):
        return ()
    # late: most fits are good
    from imucalib_cli.diagnose.alternatives import explaining, given_trial
    from imucalib_cli.diagnose.base_motion import find_motion_at_rest, find_still_imu

    reversed_accel = any(each.code == "imu.accel_reversed" for each in poor.estimate.findings)
    found: tuple[Finding, ...] = ()
    # The fit may have reversed the accelerometer for another fault's sake.
    for sign in (False, True) if reversed_accel else (False,):
        try:
            fitter, given = given_trial(poor.samples, poor.path, poor.options, reversed_accel=sign)
            still = find_still_imu(given)
            ties, against = ([], given) if still else explaining(fitter, poor, given)
        except InputError:
            return found
        if still is not None:
            return (still,)
        if ties:
            return (_cause(ties, against),)
        if not found:
            other = find_motion_at_rest(given)
            found = () if other is None else (other,)
    return found


def _cause(ties: list[Trial], given: Trial) -> Finding:
    """The best alternative, and those that explain as well."""
    best, first = ties[0], ties[0].hypothesis
    tied = [trial.hypothesis for trial in ties[:4]]  # nobody reads a longer sentence
    alike = len({each.kind for each in tied}) == 1
    accel, gyro = (_shares(given, best, sensor) for sensor in (0, 1))
    return untrusted(
        f"cause.{first.kind}",
        names=[name for each in tied for name in each.names] if alike else first.names,
        sizes=first.sizes,
        ties=[(each.kind, each.names, each.sizes, each.detail) for each in tied],
        rotation=gyro,
        acceleration=accel,
        ratio=float((given.left / best.left).max()),
        evidence=best.fit.evidence_over(given.fit),
    )


def _shares(given: Trial, best: Trial, sensor: int) -> tuple[float, float] | None:
    """Share left unexplained before and after; None where it hardly falls."""
    before, after = (np.hypot(trial.left[sensor], trial.noise[sensor]) for trial in (given, best))
    if before <= 1.5 * after:
        return None
    return float(min(given.shares[sensor], 1.0)), float(min(best.shares[sensor], 1.0))


def explained(estimate: Estimate, causes: tuple[Finding, ...]) -> Estimate:
    """The estimate with its causes first, and without the findings that they explain."""
    if not causes:
        return _without_advice(estimate) if needs_diagnosis(estimate) else estimate
    said = FOLLOWING.keys() | {each.code for each in causes}
    left = tuple(each for each in estimate.findings if each.code not in said)
    # A wrong model's errors of the sensor are none.
    return _without_advice(replace(estimate, findings=(*causes, *left), corrections={}))


def _without_advice(estimate: Estimate) -> Estimate:
    """Without advice on the motion: it determines nothing while the model is wrong."""
    left = tuple(replace(each, motion=_AFTER) for each in estimate.unobservable)
    return replace(estimate, unobservable=left)
