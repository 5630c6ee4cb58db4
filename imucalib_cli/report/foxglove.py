"""The layout in which Foxglove shows a debug MCAP: the robot in 3D, and plots of each IMU.

The fixed part is assets/foxglove.json, with the keys that Foxglove exports (its SDK's examples and
``foxglove.layouts``).
"""

from __future__ import annotations

import json
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from imucalib_cli.report.debug_mcap import DESCRIPTION, topics_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.results.result import Result

_MEASURED, _PREDICTED = "#0072b2", "#d55e00"
_AXES = {"x": "#0072b2", "y": "#d55e00", "z": "#009e73"}
"""Okabe and Ito's colours, which colour-blind readers can tell apart."""
_SENSORS = {
    "accel": ("linear_acceleration", "acceleration, m/s²"),
    "gyro": ("angular_velocity", "rate, rad/s"),
}
_SHOWN: dict[str, Any] = {
    "showXAxisLabels": True,
    "showYAxisLabels": True,
    "showLegend": True,
    "legendDisplay": "floating",
    "showPlotValuesInLegend": False,
    "isSynced": True,
    "xAxisVal": "timestamp",
    "sidebarDimension": 240,
}

Layout = Any
"""A panel's id, or two layouts side by side or one above the other."""


def foxglove_layout(results: Sequence[Result], *, with_urdf: bool) -> str:
    """The layout of a debug MCAP with these IMUs in their order, JSON."""
    asset = files("imucalib_cli.report") / "assets/foxglove.json"
    layout: dict[str, Any] = json.loads(asset.read_text(encoding="utf-8"))
    panels = layout["configById"]
    scene, layers = panels["3D!robot"], panels["3D!robot"]["layers"]
    scene["followTf"] = layers["grid"]["frameId"] = results[0].provenance.world
    layers["urdf"]["topic"] = DESCRIPTION
    if not with_urdf:
        del layers["urdf"]
    tabs = [
        {"title": result.child, "layout": _plots(panels, topic)}
        for result, topic in zip(results, topics_of(results), strict=True)
    ]
    if len(tabs) > 1:
        panels["Tab!imus"] = {"activeTabIdx": 0, "tabs": tabs}
    plots = "Tab!imus" if len(tabs) > 1 else tabs[0]["layout"]
    layout["layout"] = _split("row", "3D!robot", plots, share=30)
    return json.dumps(layout, indent=2, ensure_ascii=False) + "\n"


def _plots(panels: dict[str, Any], topic: str) -> Layout:
    """Add the plots of one IMU to the panels, and return their layout."""
    name = topic.rsplit("/", 1)[-1]
    columns = []
    for sensor, (field, quantity) in _SENSORS.items():
        column = [f"Plot!{name}-{sensor}-{what}" for what in (*_AXES, "residual")]
        for panel, axis in zip(column, _AXES, strict=False):
            lines = [
                (what, f"{topic}/{what}.{field}.{axis}", colour)
                for what, colour in (("measured", _MEASURED), ("predicted", _PREDICTED))
            ]
            panels[panel] = _plot(f"{name}: {quantity}, {axis}", lines)
        lines = [
            (axis, f"{topic}/residual.{field}.{axis}", colour) for axis, colour in _AXES.items()
        ]
        panels[column[-1]] = _plot(f"{name}: residual of {quantity}", lines)
        columns.append(_stack("column", column))
    panel = f"Plot!{name}-weight"
    lines = [("weight", f"{topic}/weight.data[0]", "#444444")]
    weight = _plot(f"{name}: weight, 0 is left out", lines)
    panels[panel] = {**weight, "minYValue": 0, "maxYValue": 1.05}
    return _split("column", _stack("row", columns), panel, share=85)


def _plot(title: str, lines: Sequence[tuple[str, str, str]]) -> dict[str, Any]:
    paths = [
        {
            "value": value,
            "enabled": True,
            "timestampMethod": "receiveTime",
            "label": label,
            "color": colour,
            "id": value,
        }
        for label, value, colour in lines
    ]
    return {**_SHOWN, "paths": paths, "foxglovePanelTitle": title}


def _stack(direction: str, layouts: Sequence[Layout]) -> Layout:
    """Layouts of equal size in a row or a column."""
    if len(layouts) == 1:
        return layouts[0]
    return _split(direction, layouts[0], _stack(direction, layouts[1:]), share=100 / len(layouts))


def _split(direction: str, first: Layout, second: Layout, *, share: float) -> Layout:
    return {
        "first": first,
        "second": second,
        "direction": direction,
        "splitPercentage": round(share, 1),
    }
