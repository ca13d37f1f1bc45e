"""The figure of `testbed respond`: recorded and modelled quantities over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.core.records import Array
from testbed.views.panels import BLACK, DASHED, ORANGE, Line, Panel, PanelGrid

COLUMNS = 2
PANEL_INCHES = (7.5, 2.5)  # width and height
HEADER_INCHES = 1.2


@dataclass(frozen=True, slots=True)
class RecordedAndModelled:
    """One quantity over time (K,)."""

    name: str
    unit: str
    recorded: Array  # (K,)
    model: Array  # (K,)
    rms: float  # of their difference


@dataclass(frozen=True, slots=True)
class ResponseFigureData:
    """What is drawn."""

    title: str
    subtitle: str
    time_s: Array  # (K,)
    quantities: Sequence[RecordedAndModelled]


def response_figure(data: ResponseFigureData) -> PanelGrid:
    """Lay out a panel for each quantity, two beside each other."""
    count = len(data.quantities)
    panels = [_panel(data, each) for each in data.quantities]
    rows = [panels[k : k + COLUMNS] for k in range(0, count, COLUMNS)]
    width, height = PANEL_INCHES
    columns = min(COLUMNS, count)
    size = columns * width, HEADER_INCHES + len(rows) * height
    return PanelGrid(data.title, data.subtitle, rows, (1.0,) * columns, size)


def _panel(data: ResponseFigureData, each: RecordedAndModelled) -> Panel:
    recorded, model = (
        np.unwrap(values, period=360.0) if each.name == "heading" else values
        for values in (each.recorded, each.model)
    )
    return Panel(
        f"difference {each.rms:.3g} {each.unit} RMS",
        "time, s",
        ", ".join(filter(None, [each.name, each.unit])),
        [
            Line(data.time_s, recorded, BLACK, "recorded", 1.6),
            Line(data.time_s, model, ORANGE, "model", 1.2, dashes=DASHED),
        ],
        x_limits=(float(data.time_s[0]), float(data.time_s[-1])),
    )
