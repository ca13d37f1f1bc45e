"""The layout of the viewer for a run."""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from testbed.views import layout, plots
from testbed.views.scene import BACKDROP, Scene
from testbed.views.signs import SIGNS

TIMELINE = "sim_time"
GRID = (84, 94, 110)


def blueprint(
    still: Scene,
    frame: layout.Framing,
    tabs: Sequence[Sequence[plots.Plot]],
    *,
    live: bool,
) -> rrb.Blueprint:
    """The layout of the viewer: pictures on the left, plots in tabs and events on the right."""
    named = len(still.names) <= layout.MOST_NAMED
    latest_s = layout.stride(still, layout.PLOT_ROWS_PER_S) / still.frame_rate_hz
    shown = layout.pictures(still, frame)
    behind, above, flight = (picture(each, latest_s) for each in shown)
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
                    rrb.Tabs(*(axes(plot, named=named, live=live) for plot in row), active_tab=0)
                    for row in tabs
                ),
                events,
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


def picture(shown: layout.Picture, latest_s: float) -> rrb.Spatial3DView:
    """A view of the world.

    Args:
        shown: what of it, and from where.
        latest_s: between two rows of what has no trail.
    """
    # Just less than that: neither none of the rows nor two of them.
    now: dict[rr.encodings.EntityPathLike, rrb.VisibleTimeRanges] = {
        f"world/chase/{sign}": trailing(0.99 * latest_s) for sign in SIGNS
    }
    return rrb.Spatial3DView(
        origin=shown.origin,
        name=shown.name,
        contents=["+ /world/**", *(f"- /{entity}" for entity in shown.without)],
        background=rrb.Background(color=BACKDROP, kind=rrb.BackgroundKind.SolidColor),
        line_grid=rrb.LineGrid3D(spacing=shown.grid, color=(*GRID, 90), stroke_width=0.5)
        if shown.grid
        else False,
        eye_controls=rrb.EyeControls3D(
            position=shown.eye.position, look_target=shown.eye.target, eye_up=shown.eye.up
        ),
        time_ranges=trailing(shown.trail_s),
        overrides=now,
    )


def axes(plot: plots.Plot, *, named: bool, live: bool) -> rrb.TimeSeriesView:
    """A view of a plot; a flight that goes on shows its last minutes."""
    return rrb.TimeSeriesView(
        origin=f"/plots/{plot.name}",
        name=plot.title,
        axis_y=rrb.ScalarAxis(range=plot.range),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop, visible=named and plot.name == "error"),
        background=rrb.archetypes.PlotBackground(color=BACKDROP, show_grid=True),
        time_ranges=trailing(layout.PLOT_WINDOW_S) if live else None,
    )


def trailing(seconds: float) -> rrb.VisibleTimeRanges:
    """The last seconds before the time cursor."""
    return rrb.VisibleTimeRanges(
        timeline=TIMELINE,
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-seconds),
        end=rr.TimeRangeBoundary.cursor_relative(),
    )
