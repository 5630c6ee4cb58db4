"""What the paper says about noise (section 4.4), judged by the rows of the noise study."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucalib_cli.study.claims import Claim, claims_table
from imucalib_cli.study.summary import DEGREES, MILLIMETRES, chosen, column, digits, mean

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.study.experiment import Row
    from imucalib_cli.study.table import Table

ROTATION_DEG = 0.0066
"""The one figure of section 4.4 that is known to us."""
SAME = 0.1
"""Share by which two means may differ and still be called the same."""
ARM, BAR = "rihibot", "barbot"


def noise_claims(rows: Sequence[Row], accel: Sequence[float], gyro: Sequence[float]) -> Table:
    """Each claim for each method, on rows without an offset."""
    rows = chosen(rows, offset=0.0)
    made = []
    for method in dict.fromkeys(str(row["method"]) for row in rows):
        mine = chosen(rows, method=method)
        made += _of_the_arm(method, mine, accel, gyro)
        made += _of_the_bar(method, mine, accel, gyro)
    return claims_table("Claims of section 4.4", made)


def _of_the_arm(
    method: str, rows: list[Row], accel: Sequence[float], gyro: Sequence[float]
) -> list[Claim]:
    arm = chosen(rows, system=ARM)
    if not arm:
        return []
    quiet = [row for row in arm if row["accel"] == 0.0]
    angles = column(quiet, "rotation"), column(quiet, "averaged_rotation")
    worst, worst_averaged = (max(values, default=float("nan")) * DEGREES for values in angles)
    still, turned = (
        mean(chosen(arm, accel=0.0, gyro=level), "translation") * MILLIMETRES
        for level in (gyro[0], gyro[-1])
    )
    grown = mean(chosen(arm, accel=accel[-1], gyro=gyro[0]), "translation") * MILLIMETRES
    together = mean(chosen(arm, accel=accel[-1], gyro=gyro[-1]), "translation") * MILLIMETRES
    return [
        Claim(
            words=f"{method}: RiHIBot, σ_a = 0: rotation below {ROTATION_DEG} deg at every σ_ω, in "
            "every calibration",
            found=f"at most {digits(worst)} deg (mean |rpy| {digits(worst_averaged)} deg)",
            met=worst < ROTATION_DEG,
        ),
        Claim(
            words=f"{method}: RiHIBot, σ_a = 0: gyroscope noise has no effect on translation "
            f"(means within {SAME:.0%})",
            found=f"{digits(still)} mm at σ_ω = {gyro[0]:g}, {digits(turned)} mm at {gyro[-1]:g}",
            met=abs(turned - still) <= SAME * still,
        ),
        Claim(
            words=f"{method}: RiHIBot: translation errors grow with σ_a (more than {SAME:.0%})",
            found=f"{digits(still)} mm at σ_a = {accel[0]:g}, {digits(grown)} mm at {accel[-1]:g}",
            met=grown > (1.0 + SAME) * still,
        ),
        Claim(
            words=f"{method}: RiHIBot: both noises together are as accelerometer noise alone "
            f"(means within {SAME:.0%})",
            found=f"{digits(together)} mm together, {digits(grown)} mm alone",
            met=abs(together - grown) <= SAME * grown,
        ),
    ]


def _of_the_bar(
    method: str, rows: list[Row], accel: Sequence[float], gyro: Sequence[float]
) -> list[Claim]:
    bar, arm = chosen(rows, system=BAR), chosen(rows, system=ARM)
    if not bar or not arm:
        return []
    still, grown = (
        mean(chosen(bar, accel=level, gyro=gyro[0]), "translation") * MILLIMETRES
        for level in (accel[0], accel[-1])
    )
    arm_still, arm_grown = (
        mean(chosen(arm, accel=level, gyro=gyro[0]), "translation") * MILLIMETRES
        for level in (accel[0], accel[-1])
    )
    return [
        Claim(
            words=f"{method}: BarBot: translation errors grow little with σ_a (less than half of "
            "RiHIBot's growth)",
            found=f"{digits(still)} to {digits(grown)} mm; RiHIBot {digits(arm_still)} to "
            f"{digits(arm_grown)} mm",
            met=grown - still < 0.5 * (arm_grown - arm_still),
        )
    ]
