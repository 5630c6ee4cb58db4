"""Errors over the parameter of a sweep, drawn on logarithmic axes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucalib_cli.study.figures import Curve, draw_curves, new_figure, save_svg
from imucalib_cli.study.summary import DEGREES, MILLIMETRES, chosen
from imucalib_cli.study.sweep_tables import BOUND, Point, sweep_points

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path
    from typing import Literal

    from imucalib_cli.study.experiment import Row

_QUANTITIES: tuple[tuple[Literal["translation", "rotation"], float, str], ...] = (
    ("translation", MILLIMETRES, "translation error, mm"),
    ("rotation", DEGREES, "rotation error, deg"),
)


def draw_sweep(rows: Sequence[Row], words: str, path: Path) -> None:
    """Translation above, rotation below, a column of panels a condition.

    Args:
        rows: Of one system and part.
        words: What is swept, with its unit.
        path: The SVG.
    """
    conditions = [str(name) for name in dict.fromkeys(row["condition"] for row in rows)]
    figure, panels = new_figure(len(_QUANTITIES), len(conditions), share_x=True)
    for number, (quantity, scale, label) in enumerate(_QUANTITIES):
        for place, condition in enumerate(conditions):
            axes = panels[number * len(conditions) + place]
            points = sweep_points(chosen(rows, condition=condition))
            draw_curves(axes, _curves(points, quantity, scale))
            if number == 0:
                axes.set_title(condition)
            else:
                axes.set_xlabel(words)
            if place == 0:
                axes.set_ylabel(label)
    handles = {
        name: handle
        for axes in panels
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=3)
    save_svg(figure, path)


def _curves(
    points: list[Point], quantity: Literal["translation", "rotation"], scale: float
) -> list[Curve]:
    methods = dict.fromkeys(point.method for point in points)
    curves = []
    for method in methods:
        mine = [point for point in points if point.method == method]
        errors = [scale * getattr(point, quantity) for point in mine]
        curves.append(Curve(name=method, x=[point.value for point in mine], y=errors))
    for everything in (False, True):
        mine = [p for p in points if (p.method == "matched") == everything]
        bounds = {p.value: scale * getattr(p, f"bound_{quantity}") for p in mine}
        curves.append(
            Curve(
                name=BOUND[everything],
                x=list(bounds),
                y=list(bounds.values()),
                dashed=True,
                dotted=everything,
            )
        )
    return curves
