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
    span: layout.Span | None = None,
) -> rrb.Blueprint:
    """The layout of the viewer: pictures on the left, plots in tabs and events on the right.

    Args:
        still: what is shown.
        frame: where the cameras stand.
        tabs: what is plotted.
        live: whether the viewer follows a flight that goes on.
        span: what the plots show, s; None: the last minute, wherever the cursor is.
    """
    named = len(still.names) <= layout.MOST_NAMED
    latest_s = layout.stride(still, layout.PLOT_ROWS_PER_S) / still.frame_rate_hz
    shown = layout.pictures(still, frame)
    behind, above, flight = (picture(each, still.names, latest_s) for each in shown)
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
                        *(axes(plot, named=named, live=live, span=span) for plot in row),
                        active_tab=0,
                    )
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


def picture(shown: layout.Picture, names: Sequence[str], latest_s: float) -> rrb.Spatial3DView:
    """A view of the world.

    Args:
        shown: what of it, and from where.
        names: of the aircraft.
        latest_s: between two rows of what has no trail.
    """
    # Just less than that: neither none of the rows nor two of them.
    now: dict[rr.encodings.EntityPathLike, rrb.VisibleTimeRanges] = {
        f"world/chase/{sign}": trailing(0.99 * latest_s) for sign in SIGNS
    }
    # Where somebody was lost stays marked.
    now |= {f"world/losses/{name}": trailing(None) for name in names}
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


def axes(
    plot: plots.Plot, *, named: bool, live: bool, span: layout.Span | None
) -> rrb.TimeSeriesView:
    """A view of a plot: of the last minute before the cursor, or of a stretch, s."""
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
        axis_y=rrb.ScalarAxis(range=plot.least) if plot.whole else None,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=named and plot.name == "error"),
        background=rrb.archetypes.PlotBackground(color=BACKDROP, show_grid=True),
        # of a flight that goes on no more is drawn than is looked at
        time_ranges=trailing(2.0 * layout.PLOT_WINDOW_S) if live else None,
    )


def trailing(seconds: float | None) -> rrb.VisibleTimeRanges:
    """The last seconds before the time cursor, or all of them."""
    return rrb.VisibleTimeRanges(
        timeline=TIMELINE,
        start=rr.TimeRangeBoundary.infinite()
        if seconds is None
        else rr.TimeRangeBoundary.cursor_relative(seconds=-seconds),
        end=rr.TimeRangeBoundary.cursor_relative(),
    )
