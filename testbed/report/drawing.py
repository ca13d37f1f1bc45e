"""What the figures share: the time axis with its portions and events, and limits of axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from testbed.report.cast import Cast
from testbed.report.flight import Flight
from testbed.state import Array, Truths
from testbed.views.panels import BLACK, GREY, ORANGE, Band, Line, Panel, Space, Span, each_once

WIDTH = 11.0  # inches
AXIS_IN = 10.0  # of them, about what the time axis has
LETTER_IN, GAP_IN = 0.085, 0.1  # of a portion's name, and after it
LEVELS = 4  # lines for the names of portions
MOST_MARKS = 40
TIME = "time, s"
MARK_COLOURS = {"info": GREY, "warning": ORANGE, "error": ORANGE}
MARKED = " Dotted upright lines: events, grey, and warnings and errors, orange."


@dataclass(frozen=True, slots=True)
class Drawing:
    """Panels with what is to be said of them."""

    title: str
    caption: str
    rows: Sequence[Sequence[Panel | Space]]
    height: float  # inches
    widths: Sequence[float] = (1.0,)
    of_all: bool = True  # the followers are drawn as their cast says

    @property
    def inches(self) -> tuple[float, float]:
        """Width and height of the sheet."""
        return WIDTH, self.height

    def whom(self, cast: Cast) -> str:
        """Who of many is shown."""
        return cast.said if self.of_all else ""


class TimeAxis:
    """Panels over the time of one run, all shaded and marked alike."""

    def __init__(self, flight: Flight) -> None:
        """Of this flight."""
        time = flight.log.time_s
        self._limits = (float(time[0]), float(time[-1])) if time[-1] > time[0] else None
        self._spans = placed(
            [
                Span(start, end, name)
                for name, (start, end) in flight.log.info.portions.items()
                if start < time[-1]
            ],
            float(time[-1] - time[0]),
        )
        # what happens before the start is of the page, not of the flight
        events = [each for each in flight.log.events if each.time_s > 0.0]
        order = sorted(events, key=lambda each: each.level == "info")[:MOST_MARKS]
        self._named = False
        self._marks = [(e.time_s, MARK_COLOURS[e.level]) for e in order]
        self.said = MARKED if order else ""

    def panel(
        self,
        title: str,
        y_label: str,
        lines: Sequence[Line],
        bands: Sequence[Band] = (),
        *,
        last: bool = False,
        **more: Any,  # noqa: ANN401 - fields of Panel
    ) -> Panel:
        """A panel; the last of a figure names the axis."""
        spans = [replace(span, name="") for span in self._spans] if self._named else self._spans
        self._named = True  # the panels below need no names again
        return Panel(
            title,
            TIME if last else "",
            y_label,
            lines,
            bands,
            x_limits=self._limits,
            spans=spans,
            marks=self._marks,
            **more,
        )


def placed(spans: Sequence[Span], length: float) -> list[Span]:
    """The spans of an axis of this length, their names below one another where they would meet.

    A name that finds no room on `LEVELS` lines is left out.
    """
    free = [-np.inf] * LEVELS  # from where on each line is
    out = []
    for span in sorted(spans, key=lambda each: each.start):
        end = span.start + (len(span.name) * LETTER_IN + GAP_IN) / AXIS_IN * length
        level = next((k for k, begin in enumerate(free) if begin <= span.start), None)
        if level is None:
            out.append(replace(span, name=""))
        else:
            free[level] = end
            out.append(replace(span, level=level))
    return out


def limits_at(time: Array, values: ArrayLike, name: str) -> list[Line]:
    """Thin lines across times (K,), one at each value that differs; the first has the name."""
    return [
        Line(time[[0, -1]], np.full(2, value), BLACK, "" if k else name, 0.8)
        for k, value in enumerate(each_once(values))
    ]


def settled(flight: Flight) -> tuple[Truths, str]:
    """Frames and followers (K, n) that linear axes are to hold, and what is to be said of it.

    Not the approach, if all engaged in the first quarter of the run, nor who was lost.
    """
    log = flight.log
    held = np.ones(flight.gone.shape, dtype=np.bool_)
    said = []
    engaged = list(flight.metrics["engaged_at_s"].values())
    if engaged and None not in engaged and max(engaged) <= 0.25 * log.time_s[-1]:
        held[log.time_s < max(engaged)] = False
        said.append(f"the approach, until all had engaged at {max(engaged):.1f} s")
    gone = log.lost[:, 1:].any(axis=0)
    if gone.any() and not gone.all():
        held[:, gone] = False
        said.append("aircraft that were lost in the run")
    return held, f" Linear axes need not hold {', nor '.join(said)}." if said else ""


def masked(flight: Flight, values: Array) -> Array:
    """Values (K, n), not a number where a follower or its leader is lost."""
    return np.where(flight.gone, np.nan, values)


def span_of(values: Sequence[Array], *, least: float = 1e-3) -> tuple[float, float] | None:
    """Limits that hold all numbers with a margin, never closer than `least`; None of none."""
    some = [each[np.isfinite(each)] for each in values]
    known = np.concatenate(some) if some else np.empty(0)
    if not known.size:
        return None
    low, high = float(known.min()), float(known.max())
    margin = max(0.06 * (high - low), 0.5 * least)
    return low - margin, high + margin
