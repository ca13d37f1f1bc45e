"""What the figures of a report have in common: a figure, its panels and their axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.records import Array, BoolArray
from testbed.reports.plot_selection import (
    LEADER_COLOUR,
    PlotSelection,
    decimate,
    desired_curves,
    follower_curves,
    percentile_bands,
)
from testbed.reports.run_data import RunData
from testbed.views.panels import (
    BLACK,
    DOTTED,
    GREY,
    ORANGE,
    Band,
    Line,
    Panel,
    PanelGrid,
    Span,
    unique_values,
)
from testbed.views.quantities import DEGREES, PLOTTED

WIDTH_IN = 11.0  # of all figures


@dataclass(frozen=True, slots=True)
class FigureSpec:
    """Content of a figure."""

    title: str
    caption: str
    rows: Sequence[Sequence[Panel]]
    height_in: float
    widths: Sequence[float] = ()  # of the columns, relative; empty: equal
    # whether the caption must name the followers that are drawn of many
    needs_selection_note: bool = True


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure ready to draw."""

    name: str  # of its file and its anchor, unique in a report
    title: str
    caption: str  # also its text description
    grid: PanelGrid


def make_figure(name: str, spec: FigureSpec, subtitle: str, note: str = "") -> Figure:
    """Make a figure; `note` is appended to the caption."""
    size_in = (WIDTH_IN, spec.height_in)
    widths = spec.widths or (1.0,) * max(map(len, spec.rows))
    grid = PanelGrid(spec.title, subtitle, spec.rows, widths, size_in)
    return Figure(name, spec.title, spec.caption + note, grid)


AXIS_IN = 10.0  # approximate length of the time axis, inches
LETTER_IN, GAP_IN = 0.085, 0.1  # of the name of a window, and after it, inches
NAME_LINES = 4  # for the names of windows
MAX_EVENT_MARKS = 40
MAX_JOINING_SHARE = 0.25  # of a run, up to which axes leave the approach out
TIME_LABEL = "time, s"
EVENT_COLOURS = {"info": GREY, "warning": ORANGE, "error": ORANGE}
EVENT_NOTE = " Dotted vertical lines: events, in grey; warnings and errors in orange."


class TimeAxis:
    """Make panels over the time of one run, with its windows and events.

    Attributes:
        note: sentence of the caption on the marks of events; "" without events.
    """

    def __init__(self, run: RunData, selection: PlotSelection) -> None:
        """Lay out windows and events of a run."""
        self._run, self._selection = run, selection
        time = run.log.time_s
        self._limits = (float(time[0]), float(time[-1])) if time[-1] > time[0] else None
        self._spans = stack_names(
            [
                Span(max(start, float(time[0])), end, name)
                for name, (start, end) in run.log.info.windows.items()
                if start < time[-1] and end > time[0]
            ],
            float(time[-1] - time[0]),
        )
        # events at the start are about the scenario, not the flight
        events = [each for each in run.log.events if each.time_s > 0.0]
        marked = sorted(events, key=lambda each: each.level == "info")[:MAX_EVENT_MARKS]
        self._named = False
        self._marks = [(each.time_s, EVENT_COLOURS[each.level]) for each in marked]
        self.note = EVENT_NOTE if marked else ""

    def quantity(self, name: str, *, leader: bool = True, **more: Any) -> Panel:  # noqa: ANN401
        """Make a panel of a quantity of `PLOTTED` and its desired value.

        Args:
            name: of the quantity.
            leader: draw its values of all aircraft; False: those of followers in the log.
            more: of `curves`.
        """
        quantity, run = PLOTTED[name], self._run
        log = run.log
        values = quantity.values(log) if leader else quantity.field(log, quantity.fields[0])
        if quantity.desired:
            desired = run.mask_lost(quantity.field(log, quantity.desired))
            more["desired"] = desired[:, -len(run.followers) :] if run.followers else None
        more = {"y_label": quantity.label()} | more
        return self.curves(run.mask_lost(values), y_degrees=quantity.unit == DEGREES, **more)

    def curves(
        self,
        values: Array,
        desired: Array | None = None,
        *,
        also: Sequence[Line] = (),
        with_bands: bool = True,
        **more: Any,  # noqa: ANN401 - of `panel`
    ) -> Panel:
        """Make a panel of aircraft as they are selected.

        Args:
            values: (K, N), or (K, n) of followers.
            desired: (K, n), drawn dashed; None: without.
            also: further curves.
            with_bands: summarise many followers by a band.
            more: of `panel`.
        """
        run, selection = self._run, self._selection
        time, lines = run.log.time_s, []
        if values.shape[1] == len(run.log.info.names):
            at = decimate(values[:, 0])
            name = run.log.info.names[0]
            lines.append(Line(time[at], values[at, 0], LEADER_COLOUR, name, 0.9))
            values = values[:, 1:]
        lines += follower_curves(time, values, selection)
        if desired is not None:
            lines += desired_curves(time, desired, selection)
        bands = percentile_bands(time, values, selection) if with_bands else ()
        return self.panel(lines=[*lines, *also], bands=bands, **more)

    def panel(
        self,
        y_label: str,
        lines: Sequence[Line],
        bands: Sequence[Band] = (),
        **fields: Any,  # noqa: ANN401 - of Panel
    ) -> Panel:
        """Make a panel; the first one names the windows."""
        spans = [replace(span, name="") for span in self._spans] if self._named else self._spans
        self._named = True
        return Panel(
            "",
            TIME_LABEL,
            y_label,
            lines,
            bands,
            x_limits=self._limits,
            spans=spans,
            marks=self._marks,
            **fields,
        )


def stack(panels: Sequence[Panel]) -> list[list[Panel]]:
    """Put panels over the same time one below the other."""
    return [[each] for each in panels]


def stack_names(spans: Sequence[Span], length: float) -> list[Span]:
    """Stack the names of windows where they would overlap, on up to `NAME_LINES` lines.

    Names that fit on none of the lines are left out.

    Args:
        spans: of one axis.
        length: of the axis, s.
    """
    line_ends = [-np.inf] * NAME_LINES
    out = []
    for span in sorted(spans, key=lambda each: each.start):
        end = span.start + (len(span.name) * LETTER_IN + GAP_IN) / AXIS_IN * length
        level = next((k for k, line_end in enumerate(line_ends) if line_end <= span.start), None)
        if level is None:
            out.append(replace(span, name=""))
        else:
            line_ends[level] = end
            out.append(replace(span, level=level))
    return out


def bound_lines(time: Array, values: ArrayLike, label: str) -> list[Line]:
    """Make dotted horizontal lines over times (K,) at the distinct values, the first labelled."""
    return [
        Line(time[[0, -1]], np.full(2, value), BLACK, "" if k else label, 1.2, dashes=DOTTED)
        for k, value in enumerate(unique_values(values))
    ]


def samples_on_axis(run: RunData) -> tuple[BoolArray, str]:
    """Select the samples (K, n) that linear axes must show, and describe what is left out.

    Left out are the approach, if all followers joined in the first quarter of the run, and
    followers that were lost.
    """
    log = run.log
    selected = np.ones(run.without_slot.shape, dtype=np.bool_)
    left_out = []
    joined = [at for at in run.metrics["joined_at_s"].values() if at is not None]
    begin, end = log.time_s[[0, -1]]
    latest = begin + MAX_JOINING_SHARE * (end - begin)
    all_joined = joined and len(joined) == len(run.followers)
    if all_joined and begin < max(joined) <= latest:
        selected[log.time_s < max(joined)] = False
        left_out.append(f"the approach, until all had joined at {max(joined):.1f} s")
    lost = log.lost[:, 1:].any(axis=0)
    if lost.any() and not lost.all():
        selected[:, lost] = False
        left_out.append("aircraft that were lost in the run")
    note = f" Linear axes may cut off {' and '.join(left_out)}." if left_out else ""
    return selected, note


def padded_limits(values: Sequence[Array], *, min_span: float = 1e-3) -> tuple[float, float] | None:
    """Compute limits around all finite values with a margin; None if there are none."""
    finite = [each[np.isfinite(each)] for each in values]
    known = np.concatenate(finite) if finite else np.empty(0)
    if not known.size:
        return None
    low, high = float(known.min()), float(known.max())
    margin = max(0.06 * (high - low), 0.5 * min_span)
    return low - margin, high + margin
