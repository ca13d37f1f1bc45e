"""Which numbers of a log are worth a plot, for the programs that read logs themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from testbed.record.messages import COMMAND, ESTIMATE, FORMATION, STATE, Topic
from testbed.views.scene import colour

_LEADER = "#808080"  # grey shows on white and on black


@dataclass(frozen=True, slots=True)
class Curve:
    """A number of one aircraft over time."""

    topic: str  # /uav1/formation
    field: str  # error_north_m
    index: int | None  # in a field that lists numbers
    label: str
    colour: str
    dashed: bool = False  # what is asked for, beside what is


@dataclass(frozen=True, slots=True)
class Plot:
    """Curves over one axis."""

    title: str  # what, and its unit
    curves: tuple[Curve, ...]


@dataclass(frozen=True, slots=True)
class Page:
    """Plots seen together, one below the other."""

    title: str
    plots: tuple[Plot, ...]


# of a page its title; of a plot its title, what is, and what is asked for
_Field = tuple[Topic, str] | None
_PAGES: tuple[tuple[str, tuple[tuple[str, _Field, _Field], ...]], ...] = (
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
        (("age of what followers use of the leader, s", (FORMATION, "age_s"), None),),
    ),
)


def pages(names: Sequence[str]) -> tuple[Page, ...]:
    """What to plot of a run of these aircraft, the leader first; a lone leader has less."""
    out = []
    for title, plots in _PAGES:
        made = [Plot(heading, _curves(names, *fields)) for heading, *fields in plots]
        shown = tuple(plot for plot in made if plot.curves)
        if shown:
            out.append(Page(title, shown))
    return tuple(out)


def topics(names: Sequence[str]) -> tuple[str, ...]:
    """The topics of numbers: those plotted, and the estimates beside the states."""
    found = {c.topic for page in pages(names) for plot in page.plots for c in plot.curves}
    return tuple(sorted(found | {f"/{name}/{ESTIMATE.name}" for name in names}))


def _curves(names: Sequence[str], actual: _Field, wanted: _Field) -> tuple[Curve, ...]:
    curves = []
    for number, name in enumerate(names):
        for field, dashed in ((actual, False), (wanted, True)):
            if field is None or (number == 0 and field[0].followers_only):
                continue
            topic, key = field
            listed = dict(topic.fields)[key].per_aircraft
            curves.append(
                Curve(
                    topic=f"/{name}/{topic.name}",
                    field=key,
                    index=0 if listed else None,
                    label=f"{name}, asked for" if dashed else name,
                    colour=_hex(number),
                    dashed=dashed,
                )
            )
    return tuple(curves)


def _hex(number: int) -> str:
    if number == 0:
        return _LEADER
    red, green, blue = colour(number)
    return f"#{red:02x}{green:02x}{blue:02x}"
