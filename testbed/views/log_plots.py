"""The plots of the Foxglove and PlotJuggler layouts: which fields of a log share which axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from testbed.core.identifiers import identifiers
from testbed.logs.messages import COMMAND, ESTIMATE, QUANTITIES, Quantity
from testbed.views.quantities import PLOTTED, PlottedQuantity
from testbed.views.scene import fleet_colours

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


# The curves of each plot by its title, quantity and unit, and the plots of each tab by its title.
Plots = Mapping[str, Sequence[Curve]]
Tabs = Mapping[str, Plots]


def tabs(names: Sequence[str]) -> Tabs:
    """List the plots of a run of these aircraft, the leader first; empty ones are left out."""
    found: dict[str, dict[str, list[Curve]]] = {}
    for quantity in PLOTTED.values():
        for field in quantity.fields if quantity.tab else ():
            curves = _curves(names, QUANTITIES[field], quantity)
            if curves:
                found.setdefault(quantity.tab, {})[_title(quantity, field)] = curves
    return found


def numeric_topics(names: Sequence[str]) -> tuple[str, ...]:
    """List the topics of numbers: those plotted, and the estimates."""
    plots = (plot for tab in tabs(names).values() for plot in tab.values())
    found = {curve.topic for plot in plots for curve in plot}
    return tuple(sorted(found | {f"/{name}/{ESTIMATE.name}" for name in names}))


def _title(quantity: PlottedQuantity, name: str) -> str:
    """Name a plot: by the quantity, or of a vector by the component; with the log's unit."""
    field = QUANTITIES[name]
    named = replace(quantity, unit=field.unit)
    if len(quantity.fields) > 1:
        named = replace(named, words=field.field.rpartition("_")[0].replace("_", " "))
    return named.label(_desired_word(quantity))


def _desired_word(quantity: PlottedQuantity) -> str:
    """Return what the second value of a quantity is: desired or commanded."""
    commanded = quantity.desired.startswith(COMMAND.name)
    return "commanded" if commanded else "desired" if quantity.desired else ""


def _curves(names: Sequence[str], actual: Quantity, quantity: PlottedQuantity) -> list[Curve]:
    curves, desired = [], QUANTITIES.get(quantity.desired)
    colours = fleet_hex(len(names))
    for number, name in enumerate(names):
        for each in filter(None, (actual, desired)):
            if number or not each.followers_only:
                curves.append(
                    Curve(
                        topic=f"/{name}/{each.topic.name}",
                        field=each.field,
                        about=identifiers(names)[0] if each.per_aircraft else None,
                        label=f"{name}, {_desired_word(quantity)}" if each is desired else name,
                        colour=colours[number],
                        dashed=each is desired,
                    )
                )
    return curves


def fleet_hex(count: int) -> list[str]:
    """Return the colours of a leader and its followers as #rrggbb."""
    followers = fleet_colours(count)[1:]
    return [_LEADER, *("#{:02x}{:02x}{:02x}".format(*each) for each in followers)]
