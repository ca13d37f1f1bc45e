"""Lay out the viewer for a run."""

from __future__ import annotations

import math
from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from testbed.views import layout, plots
from testbed.views.annotations import ANNOTATIONS
from testbed.views.scene import BACKDROP, MAX_SINGLE, Scene

TIMELINE = "sim_time"
OVERLAYS = ("names", "ties", "out_of_view", "scale", "grid")  # in the frames of the cameras


def blueprint(
    scene: Scene,
    framing: layout.Framing,
    tabs: Sequence[Sequence[plots.TimePlot]],
    *,
    live: bool,
    span: layout.TimeSpan | None = None,
) -> rrb.Blueprint:
    """Lay out 3D views on the left, plots in tabs and events on the right.

    Args:
        scene: the static part of the view.
        framing: cameras and scales.
        tabs: rows of plots.
        live: whether the viewer follows a running flight.
        span: time that the plots show, s; None: the last minute before the cursor.
    """
    named = len(scene.names) <= MAX_SINGLE
    period_s = layout.stride(scene, layout.PLOT_ROWS_PER_S) / scene.sample_rate_hz
    shown = layout.views_3d(scene, framing)
    label_s = layout.stride(scene, math.inf, layout.LABEL_ROWS_PER_S) / scene.sample_rate_hz
    behind, above, flight = (spatial_view(each, scene.names, period_s, label_s) for each in shown)
    events = rrb.TextLogView(
        origin="/events",
        name="Events",
        columns=rrb.archetypes.TextLogColumns(
            timeline_columns=[TIMELINE], text_log_columns=["loglevel", "body"]
        ),
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(behind, rrb.Horizontal(above, flight), row_shares=[5, 4]),
            rrb.Vertical(
                *(
                    rrb.Tabs(
                        *(plot_view(plot, named=named, live=live, span=span) for plot in row),
                        active_tab=0,
                    )
                    for row in tabs
                ),
                events,
                # the viewer labels powers of ten that are 20 points apart: few, high plots
                row_shares=[*(3.0 for _ in tabs), 1.7],
            ),
            column_shares=[5, 3],
        ),
        rrb.TimePanel(
            state="collapsed",
            timeline=TIMELINE,
            play_state="following" if live else "playing",
        ),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
    )


def spatial_view(
    view: layout.View3D, names: Sequence[str], period_s: float, label_s: float
) -> rrb.Spatial3DView:
    """Define a view of the world.

    Args:
        view: its entities and camera.
        names: of the aircraft.
        period_s: between two rows of an annotation.
        label_s: between two rows of an overlay.
    """
    # slightly less than the period, so that exactly one row is visible
    visible: dict[rr.encodings.EntityPathLike, rrb.VisibleTimeRanges] = {
        f"world/chase/{name}": trailing(0.99 * period_s) for name in ANNOTATIONS
    }
    visible |= {
        f"{origin}/{name}": trailing(0.99 * label_s)
        for origin in ("world/behind", "world/above")
        for name in OVERLAYS
    }
    # the positions of lost aircraft stay marked
    visible |= {f"world/losses/{name}": trailing(None) for name in names}
    return rrb.Spatial3DView(
        origin=view.origin,
        name=view.name,
        contents=["+ /world/**", *(f"- /{entity}" for entity in view.excluded)],
        background=rrb.Background(color=view.background, kind=rrb.BackgroundKind.SolidColor),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            position=view.camera.position, look_target=view.camera.target, eye_up=view.camera.up
        ),
        time_ranges=trailing(view.trail_s),
        overrides=visible,
    )


def plot_view(
    plot: plots.TimePlot, *, named: bool, live: bool, span: layout.TimeSpan | None
) -> rrb.TimeSeriesView:
    """Define a view of a plot: of the last minute before the cursor, or of a time span, s."""
    begin, end = (
        (
            rr.TimeRangeBoundary.cursor_relative(seconds=-layout.PLOT_WINDOW_S),
            rr.TimeRangeBoundary.cursor_relative(seconds=layout.PLOT_AHEAD_S),
        )
        if span is None
        else (rr.TimeRangeBoundary.absolute(seconds=each) for each in span)
    )
    return rrb.TimeSeriesView(
        origin=f"/plots/{plot.name}",
        name=plot.title,
        axis_x=rrb.TimeAxis(view_range=rrb.TimeRange(begin, end)),
        axis_y=rrb.ScalarAxis(range=plot.min_range) if plot.fixed_range else None,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=named and plot.name == "error"),
        background=rrb.archetypes.PlotBackground(color=BACKDROP, show_grid=True),
        # a viewer of a running flight draws no more than it shows
        time_ranges=trailing(2.0 * layout.PLOT_WINDOW_S) if live else None,
    )


def trailing(seconds: float | None) -> rrb.VisibleTimeRanges:
    """Show the last seconds before the time cursor, or everything before it."""
    return rrb.VisibleTimeRanges(
        timeline=TIMELINE,
        start=rr.TimeRangeBoundary.infinite()
        if seconds is None
        else rr.TimeRangeBoundary.cursor_relative(seconds=-seconds),
        end=rr.TimeRangeBoundary.cursor_relative(),
    )
