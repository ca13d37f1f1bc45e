"""The plots of the Foxglove and PlotJuggler layouts: which fields of a log share which axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from testbed.core.identifiers import identifiers
from testbed.logs.messages import COMMAND, ESTIMATE, FORMATION, STATE, Topic
from testbed.views.scene import aircraft_colour

_LEADER = "#808080"  # grey is visible on white and on black


@dataclass(frozen=True, slots=True)
class Curve:
    """A field of one aircraft over time."""

    topic: str  # /uav1/formation
    field: str  # error_north_m
    about: str | None  # of a field by aircraft, the one of this aircraft: leader
    label: str
    colour: str
    dashed: bool = False  # a desired or commanded value


@dataclass(frozen=True, slots=True)
class LogPlot:
    """Curves on the same axes."""

    title: str  # quantity and unit
    curves: tuple[Curve, ...]


@dataclass(frozen=True, slots=True)
class Tab:
    """Plots shown together, one below the other."""

    title: str
    plots: tuple[LogPlot, ...]


_Field = tuple[Topic, str] | None
# Tabs by title; of each plot the title, the actual value and the desired or commanded one.
_TABS: tuple[tuple[str, tuple[tuple[str, _Field, _Field], ...]], ...] = (
    (
        "formation",
        (
            ("error north, m", (FORMATION, "error_north_m"), None),
            ("error east, m", (FORMATION, "error_east_m"), None),
            ("error down, m", (FORMATION, "error_down_m"), None),
        ),
    ),
    (
        "law",
        (
            (
                "ground speed and desired, m/s",
                (FORMATION, "speed_mps"),
                (FORMATION, "speed_desired_mps"),
            ),
            (
                "course and desired, rad",
                (FORMATION, "course_rad"),
                (FORMATION, "course_desired_rad"),
            ),
            (
                "flight path angle and desired, rad",
                (FORMATION, "flight_path_angle_rad"),
                (FORMATION, "flight_path_angle_desired_rad"),
            ),
        ),
    ),
    (
        "attitude",
        (
            ("roll and commanded, rad", (STATE, "roll_rad"), (COMMAND, "roll_rad")),
            ("pitch and commanded, rad", (STATE, "pitch_rad"), (COMMAND, "pitch_rad")),
            ("throttle", (STATE, "throttle"), None),
        ),
    ),
    (
        "air",
        (
            ("airspeed, m/s", (STATE, "airspeed_mps"), None),
            ("wind north, m/s", (STATE, "wind_north_mps"), None),
            ("wind east, m/s", (STATE, "wind_east_mps"), None),
            ("wind down, m/s", (STATE, "wind_down_mps"), None),
        ),
    ),
    (
        "network",
        (("age of data used of the leader, s", (FORMATION, "age_s"), None),),
    ),
)


def tabs(names: Sequence[str]) -> tuple[Tab, ...]:
    """List the plots of a run of these aircraft, the leader first; empty ones are left out."""
    out = []
    for title, plots in _TABS:
        filled = [LogPlot(heading, _curves(names, *fields)) for heading, *fields in plots]
        shown = tuple(plot for plot in filled if plot.curves)
        if shown:
            out.append(Tab(title, shown))
    return tuple(out)


def numeric_topics(names: Sequence[str]) -> tuple[str, ...]:
    """List the topics of numbers: those plotted, and the estimates."""
    found = {c.topic for tab in tabs(names) for plot in tab.plots for c in plot.curves}
    return tuple(sorted(found | {f"/{name}/{ESTIMATE.name}" for name in names}))


def _curves(names: Sequence[str], actual: _Field, desired: _Field) -> tuple[Curve, ...]:
    curves = []
    for number, name in enumerate(names):
        for field, dashed in ((actual, False), (desired, True)):
            if field is None or (number == 0 and field[0].followers_only):
                continue
            topic, key = field
            by_aircraft = dict(topic.fields)[key].per_aircraft
            curves.append(
                Curve(
                    topic=f"/{name}/{topic.name}",
                    field=key,
                    about=identifiers(names)[0] if by_aircraft else None,
                    label=f"{name}, desired" if dashed else name,
                    colour=_hex_colour(number),
                    dashed=dashed,
                )
            )
    return tuple(curves)


def _hex_colour(number: int) -> str:
    if number == 0:
        return _LEADER
    red, green, blue = aircraft_colour(number)
    return f"#{red:02x}{green:02x}{blue:02x}"
