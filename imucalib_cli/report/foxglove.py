"""The layout in which Foxglove shows a debug MCAP: the robot in 3D, and plots of each IMU.

Keys are those that Foxglove exports (its SDK's examples and ``foxglove.layouts``).
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from imucalib_cli.report.debug_mcap import DESCRIPTION, topics_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.results.result import Result

_MEASURED, _PREDICTED = "#0072b2", "#d55e00"
_AXES = {"x": "#0072b2", "y": "#d55e00", "z": "#009e73"}
"""Okabe and Ito's, told apart by colour-blind readers too."""
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
"""A panel's id, or two layouts beside or above each other."""


def foxglove_layout(results: Sequence[Result], *, with_urdf: bool) -> str:
    """The layout of a debug MCAP with these IMUs in their order, JSON."""
    panels: dict[str, Any] = {"3D!robot": _scene(results, with_urdf=with_urdf)}
    tabs = []
    for result, topic in zip(results, topics_of(results), strict=True):
        tabs.append({"title": result.child, "layout": _plots(panels, topic)})
    if len(tabs) > 1:
        panels["Tab!imus"] = {"activeTabIdx": 0, "tabs": tabs}
    layout = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split(
            "row", "3D!robot", "Tab!imus" if len(tabs) > 1 else tabs[0]["layout"], share=30
        ),
    }
    return json.dumps(layout, indent=2, ensure_ascii=False) + "\n"


def _plots(panels: dict[str, Any], topic: str) -> Layout:
    """Put the plots of one IMU among the panels; how they stand."""
    name = topic.rsplit("/", 1)[-1]
    columns = []
    for sensor, (field, quantity) in _SENSORS.items():
        column = []
        for axis in _AXES:
            panel = f"Plot!{name}-{sensor}-{axis}"
            lines = {"measured": _MEASURED, "predicted": _PREDICTED}
            panels[panel] = _plot(
                f"{name}: {quantity}, {axis}",
                [(what, f"{topic}/{what}.{field}.{axis}", lines[what]) for what in lines],
            )
            column.append(panel)
        panel = f"Plot!{name}-{sensor}-residual"
        panels[panel] = _plot(
            f"{name}: residual of {quantity}",
            [(axis, f"{topic}/residual.{field}.{axis}", _AXES[axis]) for axis in _AXES],
        )
        columns.append(_stack("column", [*column, panel]))
    panel = f"Plot!{name}-weight"
    weight = _plot(
        f"{name}: weight, 0 is left out", [("weight", f"{topic}/weight.data[0]", "#444444")]
    )
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


def _scene(results: Sequence[Result], *, with_urdf: bool) -> dict[str, Any]:
    first = results[0]
    layers: dict[str, Any] = {
        "grid": {
            "visible": True,
            "frameLocked": True,
            "label": "Grid",
            "instanceId": "grid",
            "layerId": "foxglove.Grid",
            "size": 4,
            "divisions": 8,
            "lineWidth": 1,
            "color": "#8080807f",
            "position": [0, 0, 0],
            "rotation": [0, 0, 0],
            "frameId": first.provenance.world,
            "order": 1,
        }
    }
    if with_urdf:
        layers["urdf"] = {
            "visible": True,
            "frameLocked": True,
            "label": "URDF",
            "instanceId": "urdf",
            "layerId": "foxglove.Urdf",
            "sourceType": "topic",
            "topic": DESCRIPTION,
            "url": "",
            "filePath": "",
            "parameter": "",
            "framePrefix": "",
            "controlMode": "transforms",
            "displayMode": "auto",
            "fallbackColor": "#ffffff",
            "opacity": 0.7,
            "order": 2,
        }
    return {
        "cameraState": {
            "perspective": True,
            "distance": 3,
            "phi": 65,
            "thetaOffset": 45,
            "targetOffset": [0, 0, 0],
            "target": [0, 0, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": 0.01,
            "far": 5000,
        },
        "followMode": "follow-none",
        "followTf": first.provenance.world,
        "scene": {"transforms": {"showLabel": True, "labelSize": 0.05, "axisSize": 0.15}},
        "transforms": {},
        "topics": {},
        "layers": layers,
        "publish": {},
        "imageMode": {},
        "foxglovePanelTitle": "robot, and the IMU where it was found and where it was said to be",
    }


def _stack(direction: str, layouts: Sequence[Layout]) -> Layout:
    """Layouts of one size in a row or a column."""
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
