"""What the paper says about noise (section 4.4), judged by the rows of the noise study."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from imucalib_cli.study.claims import Claim, claims_table
from imucalib_cli.study.folded import in_steadily_best_setting
from imucalib_cli.study.summary import DEGREES, MILLIMETRES, chosen, column, digits, mean

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.study.experiment import Row
    from imucalib_cli.study.table import Table

ARM, BAR = "rihibot", "barbot"
JUDGED = "paper, components"
"""Whose figures answer the open question: its minimum is the same from every guess."""


@dataclass(frozen=True, kw_only=True)
class Criteria:
    """By which claims are judged, as configs/studies/noise.yaml states them."""

    rotation_deg: float
    same: float
    """Share by which two means may differ and still be called the same."""
    little: float
    """Share of the arm's growth below which another is called little."""


class Named(Protocol):
    """A case of the open question."""

    @property
    def name(self) -> str:
        """In the rows."""

    @property
    def offsets(self) -> tuple[float, ...]:
        """By which stamps are late, s."""


def noise_claims(
    rows: Sequence[Row],
    accel: Sequence[float],
    gyro: Sequence[float],
    adis: Sequence[float],
    criteria: Criteria,
) -> Table:
    """Each claim for each method, on rows without an offset, in one setting a system and method.

    Args:
        rows: Of the study.
        accel: Levels, m/s².
        gyro: Levels, rad/s.
        adis: Of the accelerometer's, those that the paper's IMU may have had.
        criteria: By which they are judged.
    """
    rows = in_steadily_best_setting(chosen(rows, offset=0.0), "case", "method")
    made = []
    for method in dict.fromkeys(str(row["method"]) for row in rows):
        arm = chosen(rows, method=method, case=ARM)
        bar = chosen(rows, method=method, case=BAR)
        if arm:
            made += [
                _rotation(method, arm, gyro, criteria),
                _gyro(method, arm, gyro, criteria),
                *_accel(method, arm, accel, gyro, criteria),
                *_unjudged(method, arm, accel, adis),
            ]
        if arm and bar:
            made.append(_flat(method, bar, arm, accel, criteria))
    return claims_table("Claims of section 4.4", made)


def _at(rows: Sequence[Row], accel: float, gyro: float) -> float:
    """Mean translation error, mm."""
    return MILLIMETRES * mean(chosen(rows, accel=accel, gyro=gyro), "translation")


def _rotation(method: str, arm: list[Row], gyro: Sequence[float], criteria: Criteria) -> Claim:
    worst = [
        DEGREES * max(column(chosen(arm, accel=0.0, gyro=level), "rotation"), default=math.nan)
        for level in gyro
    ]
    beyond = [
        level for level, angle in zip(gyro, worst, strict=True) if angle >= criteria.rotation_deg
    ]
    averaged = DEGREES * max(column(chosen(arm, accel=0.0), "averaged_rotation"), default=math.nan)
    found = f"at most {digits(max(worst))} deg (mean |rpy| {digits(averaged)} deg)"
    if beyond:
        found += f"; not at σ_ω = {', '.join(f'{level:g}' for level in beyond)} rad/s"
    return Claim(
        words=f"{method}: RiHIBot, σ_a = 0: rotation below {criteria.rotation_deg} deg at every "
        "σ_ω, in every calibration",
        found=found,
        met=not beyond,
    )


def _gyro(method: str, arm: list[Row], gyro: Sequence[float], criteria: Criteria) -> Claim:
    """Each run against the run without noise from the same guess on the same fold."""
    still = _at(arm, 0.0, 0.0)
    changes = []
    for level in gyro:
        pairs = [
            MILLIMETRES * (after - before)
            for row in chosen(arm, accel=0.0, gyro=level)
            for after, before in zip(
                column([row], "translation"),
                column(
                    chosen(arm, accel=0.0, gyro=0.0, fold=row["fold"], seed=row["seed"]),
                    "translation",
                ),
                strict=True,
            )
        ]
        error = float(np.std(pairs, ddof=1) / math.sqrt(len(pairs))) if len(pairs) > 1 else 0.0
        changes.append((float(np.mean(pairs)) if pairs else math.nan, error, level))
    change, error, level = max(changes[1:], key=lambda c: c[0] - 2.0 * c[1])
    return Claim(
        words=f"{method}: RiHIBot, σ_a = 0: gyroscope noise does not raise the translation error "
        f"at any σ_ω (means by {criteria.same:.0%} at most, but for two standard errors)",
        found=f"{digits(still)} mm without; at worst {'+' * (change > 0)}{digits(change)} mm, "
        f"standard error {digits(error)}, at σ_ω = {level:g}",
        met=change - 2.0 * error <= criteria.same * still,
    )


def _accel(
    method: str, arm: list[Row], accel: Sequence[float], gyro: Sequence[float], criteria: Criteria
) -> list[Claim]:
    still, grown, together = (
        _at(arm, a, g) for a, g in ((accel[0], 0.0), (accel[-1], 0.0), (accel[-1], gyro[-1]))
    )
    return [
        Claim(
            words=f"{method}: RiHIBot: translation errors grow with σ_a (more than "
            f"{criteria.same:.0%})",
            found=f"{digits(still)} mm at σ_a = {accel[0]:g}, {digits(grown)} mm at {accel[-1]:g}",
            met=grown > (1.0 + criteria.same) * still,
        ),
        Claim(
            words=f"{method}: RiHIBot: both noises together are as accelerometer noise alone "
            f"(means within {criteria.same:.0%})",
            found=f"{digits(together)} mm together, {digits(grown)} mm alone",
            met=abs(together - grown) <= criteria.same * grown,
        ),
    ]


def _unjudged(
    method: str, arm: list[Row], accel: Sequence[float], adis: Sequence[float]
) -> list[Claim]:
    """Claims whose bounds did not reach us: the figures alone."""
    angles = ", ".join(
        f"{digits(DEGREES * mean(chosen(arm, accel=level, gyro=0.0), 'rotation'))} at {level:g}"
        for level in accel
    )
    errors = ", ".join(
        f"{digits(_at(arm, level, 0.0))} mm and "
        f"{digits(DEGREES * mean(chosen(arm, accel=level, gyro=0.0), 'rotation'))} deg at {level:g}"
        for level in adis
    )
    return [
        Claim(
            words=f"{method}: RiHIBot: rotation errors rise at the largest σ_a only (which is not "
            "known to us)",
            found=f"{angles} m/s², deg",
            met=None,
        ),
        Claim(
            words=f"{method}: RiHIBot: small errors at the ADIS16495's 0.0002 (m/s², or g, which "
            "is 0.00196; the bounds are not known to us)",
            found=f"{errors} m/s²",
            met=None,
        ),
    ]


def _flat(
    method: str, bar: list[Row], arm: list[Row], accel: Sequence[float], criteria: Criteria
) -> Claim:
    still, grown, arm_still, arm_grown = (
        _at(rows, level, 0.0) for rows in (bar, arm) for level in (accel[0], accel[-1])
    )
    return Claim(
        words=f"{method}: BarBot: translation errors grow little with σ_a (less than "
        f"{criteria.little:.0%} of RiHIBot's growth)",
        found=f"{digits(still)} to {digits(grown)} mm; RiHIBot {digits(arm_still)} to "
        f"{digits(arm_grown)} mm",
        met=grown - still < criteria.little * (arm_grown - arm_still),
    )


def question_claims(
    rows: Sequence[Row],
    accel: Sequence[float],
    timing: Sequence[Named],
    bodies: Sequence[Named],
    criteria: Criteria,
) -> Table:
    """What the paper supposes behind the growth of errors, and what estimating the offset does.

    The published method is in one setting throughout, the one that is best over all of it.

    Args:
        rows: Of the study.
        accel: Levels of the accelerometer's noise, m/s²; the first and the last are compared.
        timing: Cases with stamps that are late.
        bodies: Bars.
        criteria: By which they are judged.
    """
    cases = {case.name for case in (*timing, *bodies)} | {ARM}
    asides = [
        row for row in chosen(rows, gyro=0.0) if row["case"] in cases and row["accel"] in accel
    ]
    rows = in_steadily_best_setting(asides, "method")
    mine = chosen(rows, method=JUDGED)

    def from_to(case: str, offset: float) -> tuple[float, float]:
        of_case = chosen(mine, case=case, offset=offset)
        return _at(of_case, accel[0], 0.0), _at(of_case, accel[-1], 0.0)

    in_time = from_to(ARM, 0.0)
    growth = in_time[1] - in_time[0]
    span = f"σ_a {accel[0]:g} to {accel[-1]:g} m/s²"
    made = []
    for case in timing:
        for offset in case.offsets:
            still, grown = from_to(case.name, offset)
            if (case.name, offset) == (ARM, 0.0):
                continue
            made.append(
                Claim(
                    words=f"{JUDGED}: {case.name}, stamps {offset * 1e3:g} ms late: errors grow "
                    f"more than on RiHIBot in time ({span})",
                    found=f"{digits(still)} to {digits(grown)} mm; RiHIBot in time "
                    f"{digits(in_time[0])} to {digits(in_time[1])} mm",
                    met=_judged(grown - still, (1.0 + criteria.same) * growth),
                )
            )
    for case in timing:
        late = max(case.offsets)
        ours = chosen(rows, method="matched", case=case.name, accel=accel[0], gyro=0.0)
        before, after = (
            MILLIMETRES * mean(chosen(ours, offset=offset), "translation") for offset in (0.0, late)
        )
        if late > 0.0:
            made.append(
                Claim(
                    words=f"matched: {case.name}: estimating the offset takes away what late "
                    "stamps do",
                    found=f"{digits(after)} mm at {late * 1e3:g} ms, {digits(before)} mm in time; "
                    f"{JUDGED}: {digits(from_to(case.name, late)[0])} mm",
                    met=_judged(before, 0.0) and after <= (1.0 + criteria.same) * before,
                )
            )
    for body in bodies:
        still, grown = from_to(body.name, 0.0)
        made.append(
            Claim(
                words=f"{JUDGED}: {body.name}: translation errors grow little with σ_a ({span})",
                found=f"{digits(still)} to {digits(grown)} mm; RiHIBot {digits(in_time[0])} to "
                f"{digits(in_time[1])} mm",
                met=_judged(criteria.little * growth, grown - still),
            )
        )
    return claims_table("The open question of section 4.4", made)


def _judged(more: float, less: float) -> bool | None:
    """Whether one is more than the other; None where either is missing."""
    return None if math.isnan(more) or math.isnan(less) else more > less
