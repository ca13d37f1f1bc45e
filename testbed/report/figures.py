"""The figures of the report in their order, each a sheet of panels with a caption."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from testbed.report import motion, surroundings
from testbed.report.cast import Cast, cast_of
from testbed.report.drawing import Drawing
from testbed.report.flight import Flight
from testbed.report.shell import Figure
from testbed.views.panels import Sheet

Maker = Callable[[Flight, Cast], Drawing | None]
MAKERS: Sequence[tuple[str, Maker]] = (
    ("trajectory", motion.trajectory),
    ("corner", motion.corner),
    ("altitude", motion.altitude),
    ("relative", motion.relative),
    ("relative-ned", motion.relative_ned),
    ("error", motion.error),
    ("speed", motion.speed),
    ("barrier", motion.barrier),
    ("commands", surroundings.commands),
    ("network", surroundings.network),
    ("wind", surroundings.wind),
    ("estimates", surroundings.estimates),
)


def figures_of(flight: Flight) -> Iterator[Figure]:
    """All figures for which the run has something to show."""
    cast = cast_of(flight)
    info = flight.log.info
    for name, make in MAKERS:
        # an aircraft that left its model's range has numbers without end
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            drawing = make(flight, cast)
        if drawing is None:
            continue
        subtitle = f"{info.scenario_name} · {flight.outcome} · seed {info.seed}"
        sheet = Sheet(drawing.title, subtitle, drawing.rows, drawing.widths, drawing.inches)
        yield Figure(name, drawing.title, drawing.caption + drawing.whom(cast), sheet)
