"""The only place that knows Rerun: a scene and its batches become entities, columns and a layout.

Entities of a run, in the north-east-down world:

    world/<name>                  pose of an aircraft, below it its body, disc and marker
    world/trails/<name>           one short line per stretch flown, by time
    world/slots/<name>            ghost of where a follower should be
    world/path, world/ground      still
    world/chase                   a frame that goes with the formation and turns with its course
    plots/<quantity>              one series per aircraft; plots/<quantity>/limits
    events                        text

A batch costs a fixed number of calls plus a few per aircraft, whatever number of frames it holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from testbed.frames import course, quaternion_xyzw
from testbed.state import Array, Event
from testbed.views import layout, scene
from testbed.views.airframes import Airframe, airframe
from testbed.views.meshes import DARK, LIGHT, MAIN, Mesh, normals
from testbed.views.scene import Batch, Scene

TIMELINE = "sim_time"
BACKDROP, GRID, PATH = (22, 26, 33), (84, 94, 110), (165, 165, 170)
LEVELS = {
    "info": rr.TextLogLevel.INFO,
    "warning": rr.TextLogLevel.WARN,
    "error": rr.TextLogLevel.ERROR,
}


class Recording:
    """One run on its way to a viewer, a file or memory."""

    def __init__(self, still: Scene, *, live: bool) -> None:
        """Name the run; connect it with `save`, `connect` or `remember` before `send`.

        Args:
            still: the part of the view that does not move.
            live: whether a viewer follows the flight as it happens, or opens it afterwards.
        """
        self._scene = still
        self._live = live
        self._trail_stride = layout.trail_stride(still)
        self._undrawn_points = np.empty((0, len(still.names), 3))
        self._undrawn_time = np.empty(0)
        self._begun = False
        self.calls = 0
        self._stream = rr.RecordingStream("testbed", recording_id=still.recording_id)
        self._stream.send_recording_name(still.title)

    def save(self, path: Path) -> None:
        """Write to an .rrd file.

        Raises:
            OSError: the file cannot be written.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb"):  # Rerun would only log the failure
            pass
        self._stream.save(path)

    def connect(self, port: int) -> None:
        """Send to the viewer that listens on this port of this machine."""
        self._stream.connect_grpc(f"rerun+http://127.0.0.1:{port}/proxy")

    def remember(self) -> None:
        """Keep everything in memory."""
        self._stream.memory_recording()

    def flush(self, timeout_s: float) -> None:
        """Wait until everything sent has been taken.

        Raises:
            RuntimeError: the viewer is gone or did not take it in time.
        """
        self._stream.flush(timeout_sec=timeout_s)

    def close(self) -> None:
        """Flush and disconnect."""
        self._stream.disconnect()

    def send(self, batch: Batch) -> None:
        """Send consecutive frames; the first batch brings the still part and the layout."""
        if len(batch):
            if not self._begun:
                self._send_still()
                self._stream.send_blueprint(blueprint(self._scene, batch, live=self._live))
                self._begun = True
            self._send_motion(batch)
            self._send_plots(batch)
        for event in batch.events:
            self._send_event(event)

    def _columns(self, entity: str, time: Array, columns: rr.ComponentColumnList) -> None:
        self.calls += 1
        self._stream.send_columns(
            entity, indexes=[rr.TimeColumn(TIMELINE, duration=time)], columns=columns
        )

    def _still(self, entity: str, *archetypes: rr.AsComponents) -> None:
        self.calls += 1
        self._stream.log(entity, *archetypes, static=True)

    def _send_still(self) -> None:
        still = self._scene
        self._still("world", rr.ViewCoordinates.FRD)
        for k, name in enumerate(still.names):
            paint, trim = scene.colour(k), scene.trim(k)
            drawing = airframe(still.airframes[k], still.wingspan[k])
            self._still(f"world/{name}/body", painted(drawing.body, paint, trim))
            if drawing.disc is not None:
                self._still(f"world/{name}/disc", painted(drawing.disc, paint, trim, alpha=70))
            marker = rr.Points3D([0.0, 0.0, 0.0], radii=rr.Radius.ui_points(3.5), colors=paint)
            self._still(f"world/{name}/marker", marker)
            # Said once: only the points of a trail come with every stretch.
            line = rr.LineStrips3D.from_fields(colors=paint, radii=rr.Radius.ui_points(1.0))
            self._still(f"world/trails/{name}", line)
            if k:
                self._still(f"world/slots/{name}", outline(drawing, paint))
        self._send_ground(scene.ground(still.path))
        for plot in layout.plots(still):
            colours = [scene.colour(k) for k in plot.aircraft]
            names = [still.names[k] for k in plot.aircraft]
            self._still(
                f"plots/{plot.name}", rr.SeriesLines(colors=colours, names=names, widths=1.5)
            )
            if plot.limits:
                self._still(
                    f"plots/{plot.name}/limits",
                    rr.SeriesLines(
                        colors=[(150, 150, 150)] * len(plot.limits),
                        names=[f"limit {value:g}" for value in plot.limits],
                        widths=1.0,
                    ),
                )

    def _send_ground(self, area: scene.Ground) -> None:
        def lines(strips: Sequence[Array], colour: scene.Colour) -> rr.LineStrips3D:
            return rr.LineStrips3D(strips, radii=rr.Radius.ui_points(0.5), colors=colour)

        self._still("world/ground/grid", lines(area.lines, GRID))
        if len(self._scene.path):
            self._still("world/path/line", lines([area.path], PATH))
            self._still("world/path/shadow", lines([area.path * [1.0, 1.0, 0.0]], GRID))
            self._still("world/path/posts", lines(tuple(area.posts), GRID))
        self._still(
            "world/ground/scale",
            rr.Points3D(
                area.label_positions,
                labels=area.labels,
                radii=rr.Radius.ui_points(0.1),
                colors=GRID,
            ),
        )

    def _send_motion(self, batch: Batch) -> None:
        attitude = quaternion_xyzw(batch.euler)
        level = np.zeros((len(batch), 3))
        level[:, 2] = course(batch.velocity[:, 0])
        heading = quaternion_xyzw(level)
        for k, name in enumerate(self._scene.names):
            self._poses(f"world/{name}", batch.time, batch.position[:, k], attitude[:, k])
            if k:
                self._poses(f"world/slots/{name}", batch.time, batch.slot[:, k - 1], heading)
        self._poses("world/chase", batch.time, layout.chase_centre(batch), heading)
        self._send_trails(batch)

    def _poses(self, entity: str, time: Array, position: Array, quaternion: Array) -> None:
        self._columns(
            entity, time, rr.Transform3D.columns(translation=position, quaternion=quaternion)
        )

    def _send_trails(self, batch: Batch) -> None:
        """Draw every stretch that is complete; what is left waits for the next batch."""
        points = np.concatenate([self._undrawn_points, batch.position])
        time = np.concatenate([self._undrawn_time, batch.time])
        step = self._trail_stride
        count = (len(points) - 1) // step
        self._undrawn_points, self._undrawn_time = points[count * step :], time[count * step :]
        if not count:
            return
        frames = step * np.arange(count)[:, None] + np.arange(step + 1)
        strips = points[frames].astype(np.float32)
        for k, name in enumerate(self._scene.names):
            self._columns(
                f"world/trails/{name}",
                time[frames[:, -1]],
                rr.LineStrips3D.columns(strips=np.ascontiguousarray(strips[:, :, k])),
            )

    def _send_plots(self, batch: Batch) -> None:
        ends = batch.time[[0, -1]]
        for plot in layout.plots(self._scene):
            values = plot.values(batch)
            series = values.shape[1]
            column = rr.Scalars.columns(scalars=values.ravel())
            self._columns(f"plots/{plot.name}", batch.time, column.partition([series] * len(batch)))
            if plot.limits:
                count = len(plot.limits)
                column = rr.Scalars.columns(scalars=np.tile(plot.limits, 2))
                self._columns(f"plots/{plot.name}/limits", ends, column.partition([count] * 2))

    def _send_event(self, event: Event) -> None:
        self.calls += 1
        self._stream.set_time(TIMELINE, duration=event.time_s)
        level = LEVELS.get(event.level, rr.TextLogLevel.INFO)
        self._stream.log("events", rr.TextLog(f"{event.source}: {event.text}", level=level))


def painted(mesh: Mesh, paint: scene.Colour, trim: scene.Colour, alpha: int = 255) -> rr.Mesh3D:
    """A mesh in an aircraft's colours."""
    colours = np.empty((3, 3), np.uint8)
    colours[MAIN], colours[LIGHT], colours[DARK] = paint, trim, (45, 50, 58)
    return rr.Mesh3D(
        vertex_positions=mesh.vertices,
        triangle_indices=mesh.triangles,
        vertex_normals=normals(mesh),
        vertex_colors=colours[mesh.paint],
        albedo_factor=(255, 255, 255, alpha),
    )


def outline(drawing: Airframe, paint: scene.Colour) -> rr.LineStrips3D:
    """The ghost of an aircraft: its outline from above, thin and faded into the backdrop."""
    faded = tuple(round(0.5 * (a + b)) for a, b in zip(paint, BACKDROP, strict=True))
    return rr.LineStrips3D(list(drawing.outline), radii=rr.Radius.ui_points(0.5), colors=faded)


def blueprint(still: Scene, first: Batch, *, live: bool) -> rrb.Blueprint:
    """The layout of the viewer: a chase view, the whole flight from above, plots, events."""
    backdrop = rrb.Background(color=BACKDROP, kind=rrb.BackgroundKind.SolidColor)
    chase, overview = layout.chase_eye(still, first), layout.overview_eye(still)
    markers = [f"- /world/{name}/marker" for name in still.names]
    fine = [f"- /world/{name}/{part}" for name in still.names for part in ("body", "disc")]
    pictures = [
        rrb.Spatial3DView(
            origin="/world/chase",
            name="Formation",
            contents=[
                "+ /world/**",
                "- /world/ground/scale",
                "- /world/path/posts",
                "- /world/path/shadow",
                *markers,
            ],
            background=backdrop,
            line_grid=False,
            eye_controls=eye(chase),
            time_ranges=trailing(layout.CHASE_TRAIL_S),
        ),
        rrb.Spatial3DView(
            origin="/world",
            name="Flight",
            contents=["+ /world/**", "- /world/slots/**", *fine],
            background=backdrop,
            line_grid=False,
            eye_controls=eye(overview),
            time_ranges=trailing(layout.OVERVIEW_TRAIL_S),
        ),
    ]
    plots: list[rrb.View] = [
        rrb.TimeSeriesView(
            origin=f"/plots/{plot.name}",
            name=plot.title,
            axis_y=rrb.ScalarAxis(range=plot.range),
            plot_legend=rrb.PlotLegend(
                rrb.Corner2D.RightTop, visible=k == 0 and len(plot.aircraft) <= 8
            ),
            background=rrb.archetypes.PlotBackground(color=BACKDROP, show_grid=True),
            time_ranges=trailing(layout.PLOT_WINDOW_S) if live else None,
        )
        for k, plot in enumerate(layout.plots(still))
    ]
    events = rrb.TextLogView(
        origin="/events",
        name="Events",
        columns=rrb.archetypes.TextLogColumns(
            timeline_columns=[TIMELINE], text_log_columns=["loglevel", "body"]
        ),
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(*pictures, row_shares=[5, 4]),
            rrb.Vertical(*plots, events),
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


def eye(view: layout.Eye) -> rrb.EyeControls3D:
    """A camera."""
    return rrb.EyeControls3D(
        position=view.position, look_target=view.target, eye_up=(0.0, 0.0, -1.0)
    )


def trailing(seconds: float) -> rrb.VisibleTimeRanges:
    """The last seconds before the time cursor."""
    return rrb.VisibleTimeRanges(
        timeline=TIMELINE,
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-seconds),
        end=rr.TimeRangeBoundary.cursor_relative(),
    )
