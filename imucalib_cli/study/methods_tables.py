"""Tables of the comparison of methods, and the paper's claims about it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from imucalib_cli.study.claims import Claim, claims_table
from imucalib_cli.study.methods.entrants import ENTRANTS
from imucalib_cli.study.summary import (
    DEGREES,
    MILLIMETRES,
    best_setting,
    chosen,
    column,
    digits,
    mean,
    root_mean_square,
    spread,
)
from imucalib_cli.study.table import Table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.study.experiment import Row

_MEGABYTES = 1e-6
_HEADER = (
    "method",
    "data beside the IMU",
    "unknowns",
    "translation mm",
    "over bound",
    "rotation deg",
    "over bound",
    "|mean Δxyz| mm",
    "mean |rpy| deg",
    "wall s",
    "CPU s",
    "memory MB",
    "answers",
)
_CONTENDERS = {"paper": "paper", "ours, pose only": "matched, pose only", "ours": "matched"}
"""Who is held against others, and the name that other studies have for it."""
_RIVALS = {
    "B-spline batch, corners": "a B-spline batch of Kalibr's kind on corners",
    "hand-eye + RANSAC (Liang)": "Liang et al. as published",
    "hand-eye + RANSAC, tuned": "Liang et al. tuned for start-stop motion",
}
_METRICS = (("translation", MILLIMETRES, "mm"), ("rotation", DEGREES, "deg"))


@dataclass(frozen=True, kw_only=True)
class MethodsCriteria:
    """By which claims are judged, as configs/studies/methods.yaml states them."""

    conditions: tuple[str, ...]
    """Those that the paper speaks of."""
    liang_rotation_deg: float


def methods_tables(
    rows: Sequence[Row],
    conditions: Sequence[str],
    quoted: Sequence[Row],
    criteria: MethodsCriteria,
) -> list[Table]:
    """One table a condition, then the claims.

    Args:
        rows: Of the study.
        conditions: Names, in order.
        quoted: Figures of others, as text.
        criteria: By which claims are judged.
    """
    made = [_table(rows, condition, quoted) for condition in conditions]
    held = mean(rows, "held") * _MEGABYTES
    note = (
        "Errors of T_camera_imu, mean ± standard deviation over seeds, as norm and geodesic angle; "
        "|mean Δxyz| and mean |rpy| are the averages that the paper's tool reports, smaller by "
        "construction. Over bound: root mean square over the Cramér-Rao bound of the method's own "
        "unknowns on exact kinematics; with corners there is no such bound. Wall and CPU: the "
        "method alone in a fresh process, libraries loaded, one thread; runs side by side slow "
        "each other. Memory: peak resident set (VmHWM, reset before) less what interpreter, "
        f"libraries and data held, {digits(held)} MB. The published method stands in the best of "
        "its settings by the truth: for translation in the table, for each error in the claims. "
        "The B-spline batch on corners is of Kalibr's kind, not Kalibr."
    )
    first = made[0]
    made[0] = replace(first, note=f"{note} {first.note}".strip())
    claimed = [condition for condition in conditions if condition in criteria.conditions]
    claims = [
        claim for condition in claimed for claim in _claims(rows, condition, quoted, criteria)
    ]
    return [*made, claims_table("Claims of section 4.3, by mean norms and angles", claims)]


def _table(rows: Sequence[Row], condition: str, quoted: Sequence[Row]) -> Table:
    lines = []
    for method, entrant in ENTRANTS.items():
        found = best_setting(chosen(rows, condition=condition, method=method))
        setting = found[0]["setting"]
        lines.append(
            (
                method if setting is None else f"{method} ({setting})",
                entrant.data,
                entrant.unknowns,
                spread(found, "translation", MILLIMETRES),
                _over_bound(found, "translation", entrant.data),
                spread(found, "rotation", DEGREES),
                _over_bound(found, "rotation", entrant.data),
                spread(found, "averaged_translation", MILLIMETRES),
                spread(found, "averaged_rotation", DEGREES),
                digits(mean(found, "seconds")),
                digits(mean(found, "cpu_seconds")),
                digits(mean(found, "memory") * _MEGABYTES),
                f"{len(column(found, 'translation'))} of {len(found)}",
            )
        )
    lines += [
        (
            str(quote["method"]),
            "images",
            ENTRANTS["B-spline batch, corners"].unknowns,
            str(quote["translation"]),
            "-",
            str(quote["rotation"]),
            "-",
            "-",
            "-",
            str(quote["seconds"]),
            "-",
            "-",
            "-",
        )
        for quote in chosen(quoted, condition=condition)
    ]
    return Table(
        title=f"camera-IMU transform, {condition}",
        header=_HEADER,
        rows=tuple(lines),
        note=_failures(chosen(rows, condition=condition)),
    )


def _failures(rows: Sequence[Row]) -> str:
    """Why methods gave no answer, once each."""
    whys = dict.fromkeys((row["method"], row["failure"]) for row in rows if row["failure"])
    return " ".join(f"{method}: {why}." for method, why in whys)


def _over_bound(rows: Sequence[Row], key: str, data: str) -> str:
    if data != "poses":
        return "-"
    return digits(root_mean_square(rows, key) / mean(rows, f"bound_{key}"))


def _claims(
    rows: Sequence[Row], condition: str, quoted: Sequence[Row], criteria: MethodsCriteria
) -> list[Claim]:
    def error(method: str, key: str, scale: float) -> float:
        """Mean, the published method in the setting that is best for this error."""
        return scale * mean(
            best_setting(chosen(rows, condition=condition, method=method), key), key
        )

    rivals: dict[str, dict[str, float]] = {
        words: {key: error(rival, key, scale) for key, scale, _ in _METRICS}
        for rival, words in _RIVALS.items()
    }
    for quote in chosen(quoted, condition=condition):
        rivals[str(quote["method"])] = {key: _number(quote[key]) for key, _, _ in _METRICS}
    made = []
    for name, words in _CONTENDERS.items():
        for key, scale, unit in _METRICS:
            ours = error(name, key, scale)
            made += [
                Claim(
                    words=f"{words}: below {rival} in {key} ({condition})",
                    found=f"{digits(ours)} {unit} against {digits(errors[key])} {unit}",
                    met=None if math.isnan(ours - errors[key]) else ours < errors[key],
                )
                for rival, errors in rivals.items()
            ]
    angle = error("hand-eye + RANSAC (Liang)", "rotation", DEGREES)
    made.append(
        Claim(
            words=f"paper: Liang et al. over {criteria.liang_rotation_deg:g} deg ({condition})",
            found=f"{digits(angle)} deg",
            met=None if math.isnan(angle) else angle > criteria.liang_rotation_deg,
        )
    )
    return made


def _number(quoted: object) -> float:
    """A figure that is quoted; NaN where it is a range or none."""
    try:
        return float(str(quoted))
    except ValueError:
        return math.nan
