"""Foxglove layout for the log of a run, with or without its scene.

Foxglove and Lichtblick import this JSON: panels by `<type>!<id>`, and the tree by which they share
the window. Panel settings are those of Foxglove's SDK (https://docs.foxglove.dev/docs/sdk,
`foxglove.layouts`), paths follow
https://docs.foxglove.dev/docs/visualization/message-path-syntax.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from testbed.core.records import RunInfo
from testbed.views.foxglove_scene import FORMATION_FRAME, FRAMES, TOPICS, slot_frame
from testbed.views.log_plots import Curve, Plots, fleet_hex, tabs

_AXIS_SPANS = 0.5  # length of the axes of an aircraft, in wingspans
_SQUARE = 100.0  # m, of the ground grid
_CAMERA_WINGSPANS = 30.0  # distance of the camera
_UNQUOTED = re.compile(r"[\w/-]+", re.ASCII)


def foxglove_layout(info: RunInfo) -> str:
    """Return the layout as JSON: a 3D view, the events, tabs of plots and a map."""
    leader = info.names[0]
    panels: dict[str, Any] = {
        "3D!world": {
            "followTf": leader,
            "followMode": "follow-position",
            "fixedFrame": "enu",
            "enuFrameId": "enu",
            "cameraState": {
                "distance": _CAMERA_WINGSPANS * max(info.wingspan_m),
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
            # older versions know the last name
            "scene": {
                "transforms": {
                    "showLabel": True,
                    "axisSize": _AXIS_SPANS * max(info.wingspan_m),
                    "axisScale": _AXIS_SPANS * max(info.wingspan_m),
                }
            },
            "transforms": {
                f"frame:{frame}": {"visible": False}
                for frame in (FORMATION_FRAME, *map(slot_frame, info.names[1:]))
            },
            "topics": {
                topic: {"visible": True, "showOutlines": False, "computeVertexNormals": True}
                for topic in TOPICS
                if topic != FRAMES
            },
            "layers": {"ground": _ground(info)},
        },
        "RosOut!events": {"topicToRender": "/events", "searchTerms": [], "minLogLevel": 1},
    }
    tab_panels = []
    for title, plots in tabs(info.names).items():
        ids = [f"Plot!{title}{k}" for k in range(len(plots))]
        panels |= dict(zip(ids, _plots(plots), strict=True))
        tab_panels.append({"title": title, "layout": _stack(ids)})
    panels["map!fixes"] = {
        "layer": "map",
        "topicColors": {
            f"/{name}/fix": colour
            for name, colour in zip(info.names, fleet_hex(len(info.names)), strict=True)
        },
        "followTopic": f"/{leader}/fix",
    }
    tab_panels.append({"title": "map", "layout": "map!fixes"})
    panels["Tab!plots"] = {"activeTabIdx": 0, "tabs": tab_panels}
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
    """Return the message path of a curve: /uav1/formation.age_s.leader."""
    topic = curve.topic if _UNQUOTED.fullmatch(curve.topic) else f'"{curve.topic}"'
    return ".".join(filter(None, [topic, curve.field, curve.about]))


def _plots(plots: Plots) -> list[dict[str, Any]]:
    return [
        {
            # the panel's title in Foxglove and in Lichtblick
            "foxglovePanelTitle": title,
            "lichtblickPanelTitle": title,
            "paths": [
                {
                    "value": message_path(curve),
                    "label": curve.label,
                    "color": curve.colour,
                    "lineStyle": "dashed" if curve.dashed else "solid",
                    "enabled": True,
                    "timestampMethod": "receiveTime",
                }
                for curve in curves
            ],
            "isSynced": True,
            "xAxisVal": "timestamp",
            "showXAxisLabels": True,
            "showYAxisLabels": True,
            "showLegend": True,
            "legendDisplay": "floating",
            "showPlotValuesInLegend": True,
        }
        for title, curves in plots.items()
    ]


def _stack(ids: Sequence[str], first: float | None = None) -> Any:  # noqa: ANN401 - a tree
    """Stack panels, the first with so many percent of the height; None: equal heights."""
    if len(ids) == 1:
        return ids[0]
    return {
        "direction": "column",
        "first": ids[0],
        "second": _stack(ids[1:]),
        "splitPercentage": 100 / len(ids) if first is None else first,
    }


def _ground(info: RunInfo) -> dict[str, Any]:
    """Lay a grid of 100 m squares under the whole path, at the height of the origin."""
    east_north = np.vstack([np.zeros((1, 2)), info.leader_path_ned[:, 1::-1]])
    low, high = east_north.min(axis=0), east_north.max(axis=0)
    half = math.ceil(max(high - low) / 2 / _SQUARE + 1)  # squares, with a margin of one
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
