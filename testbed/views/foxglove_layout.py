"""A layout of Foxglove for the log of a run.

The form is the one that Foxglove, from its days as Studio on, and Lichtblick import: panels by
`<type>!<id>`, and the tree of how they share the window. Settings of panels have the names that
Foxglove's SDK gives them (https://docs.foxglove.dev/docs/sdk, `foxglove.layouts`), paths the
message path syntax (https://docs.foxglove.dev/docs/visualization/message-path-syntax).
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from testbed.state import RunInfo
from testbed.views.log_plots import Curve, Page, pages

_SQUARE = 100.0  # m, of the grid on the ground
_WINGSPANS_AWAY = 30.0
_PLAIN = re.compile(r"[\w/-]+", re.ASCII)


def foxglove_layout(info: RunInfo) -> str:
    """The text of the layout: the aircraft in their world, events, and plots in tabs."""
    leader = info.names[0]
    panels: dict[str, Any] = {
        "3D!world": {
            "followTf": leader,
            "followMode": "follow-position",
            "fixedFrame": "enu",
            "enuFrameId": "enu",
            "cameraState": {
                "distance": _WINGSPANS_AWAY * max(info.wingspan_m),
                "perspective": True,
                "phi": 65,
                "thetaOffset": 45,
                "targetOffset": [0, 0, 0],
                "target": [0, 0, 0],
                "targetOrientation": [0, 0, 0, 1],
                "fovy": 45,
                "near": 0.5,
                "far": 50_000,
            },
            # a frame's axes as long as its aircraft is wide; older programs know the second name
            "scene": {
                "transforms": {
                    "showLabel": True,
                    "axisSize": max(info.wingspan_m),
                    "axisScale": max(info.wingspan_m),
                }
            },
            "transforms": {},
            "topics": {},
            "layers": {"ground": _ground(info)},
        },
        "RosOut!events": {"topicToRender": "/events", "searchTerms": [], "minLogLevel": 1},
    }
    tabs = []
    for page in pages(info.names):
        ids = [f"Plot!{page.title}{k}" for k in range(len(page.plots))]
        panels |= dict(zip(ids, _plots(page), strict=True))
        tabs.append({"title": page.title, "layout": _stack(ids)})
    panels["map!fixes"] = {
        "layer": "map",
        "topicColors": {f"/{name}/fix": hue for name, hue in _hues(info.names).items()},
        "followTopic": f"/{leader}/fix",
    }
    tabs.append({"title": "map", "layout": "map!fixes"})
    panels["Tab!plots"] = {"activeTabIdx": 0, "tabs": tabs}
    layout = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "row",
            "first": _stack(["3D!world", "RosOut!events"], 75),
            "second": "Tab!plots",
            "splitPercentage": 50,
        },
    }
    return json.dumps(layout, indent=2, ensure_ascii=False) + "\n"


def message_path(curve: Curve) -> str:
    """Where Foxglove finds a curve's numbers: /uav1/formation.age_s[0]."""
    topic = curve.topic if _PLAIN.fullmatch(curve.topic) else f'"{curve.topic}"'
    place = "" if curve.index is None else f"[{curve.index}]"
    return f"{topic}.{curve.field}{place}"


def _plots(page: Page) -> list[dict[str, Any]]:
    return [
        {
            # what Foxglove and Lichtblick call the heading of a panel
            "foxglovePanelTitle": plot.title,
            "lichtblickPanelTitle": plot.title,
            "paths": [
                {
                    "value": message_path(curve),
                    "label": curve.label,
                    "color": curve.colour,
                    "lineStyle": "dashed" if curve.dashed else "solid",
                    "enabled": True,
                    "timestampMethod": "receiveTime",
                }
                for curve in plot.curves
            ],
            "isSynced": True,
            "xAxisVal": "timestamp",
            "showXAxisLabels": True,
            "showYAxisLabels": True,
            "showLegend": True,
            "legendDisplay": "floating",
            "showPlotValuesInLegend": True,
        }
        for plot in page.plots
    ]


def _hues(names: Sequence[str]) -> dict[str, str]:
    """The colour of each aircraft, as in the plots of airspeed, which show all."""
    air = next(page for page in pages(names) if page.title == "air")
    return {name: curve.colour for name, curve in zip(names, air.plots[0].curves, strict=True)}


def _stack(ids: Sequence[str], first: float | None = None) -> Any:  # noqa: ANN401 - a tree
    """Panels one below the other, the first with so many percent of the height."""
    if len(ids) == 1:
        return ids[0]
    return {
        "direction": "column",
        "first": ids[0],
        "second": _stack(ids[1:]),
        "splitPercentage": 100 / len(ids) if first is None else first,
    }


def _ground(info: RunInfo) -> dict[str, Any]:
    """A grid at the height of the origin, of squares of 100 m, over the whole path."""
    east_north = np.vstack([np.zeros((1, 2)), info.leader_path_ned[:, 1::-1]])
    low, high = east_north.min(axis=0), east_north.max(axis=0)
    half = math.ceil(max(high - low) / 2 / _SQUARE + 1)  # squares, one more than needed
    middle = np.round((low + high) / 2 / _SQUARE) * _SQUARE
    return {
        "layerId": "foxglove.Grid",
        "instanceId": "ground",
        "label": "Ground: squares of 100 m",
        "visible": True,
        "frameId": "enu",
        "size": 2 * half * _SQUARE,
        "divisions": 2 * half,
        "lineWidth": 1,
        "color": "#80808080",
        "position": [*middle.tolist(), 0],
        "rotation": [0, 0, 0],
    }
