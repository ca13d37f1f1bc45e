"""The figure of an aircraft's level flight: controls and angle of attack over airspeed."""

from __future__ import annotations

from dataclasses import dataclass

from testbed.core.records import Array
from testbed.views.panels import BLUE, GREEN, GREY, ORANGE, Line, Panel, PanelGrid, Span


@dataclass(frozen=True, slots=True)
class EnvelopeFigureData:
    """Trims of level flight in the order of their speeds; of a glider, of its descent."""

    title: str
    subtitle: str
    airspeed: Array  # (K,) m/s, true
    throttle: Array  # (K,) 0..1
    sink: Array | None  # (K,) m/s, of an aircraft without an engine, in place of the throttle
    alpha_deg: Array  # (K,)
    elevator: Array  # (K,) -1..1, positive pitches up
    cruise: float  # m/s
    autopilot: tuple[float, float]  # m/s, lowest and highest true airspeed of the autopilot


def envelope_figure(data: EnvelopeFigureData) -> PanelGrid:
    """Lay out throttle, angle of attack and elevator over airspeed."""
    throttle = (
        _panel(data, "Throttle of level flight", "0 to 1", data.throttle, BLUE, (0.0, 1.05))
        if data.sink is None
        else _panel(data, "Sink rate", "m/s", data.sink, BLUE, None)
    )
    rows = [
        [throttle],
        [_panel(data, "Angle of attack", "degrees", data.alpha_deg, ORANGE, None)],
        [
            _panel(
                data, "Elevator, up positive", "-1 to 1", data.elevator, GREEN, (-1.05, 1.05), "m/s"
            )
        ],
    ]
    return PanelGrid(data.title, data.subtitle, rows, (1.0,), (9.0, 10.0))


def _panel(
    data: EnvelopeFigureData,
    title: str,
    unit: str,
    values: Array,
    colour: str,
    limits: tuple[float, float] | None,
    speed_unit: str = "",
) -> Panel:
    low, high = data.autopilot
    return Panel(
        title,
        f"true airspeed, {speed_unit}" if speed_unit else "",
        unit,
        [
            Line(data.airspeed, values, colour, width=1.8),
            Line(data.airspeed, values, colour, dots=True),
        ],
        y_limits=limits,
        spans=[Span(low, high, "")],
        marks=[(data.cruise, GREY)],
    )
