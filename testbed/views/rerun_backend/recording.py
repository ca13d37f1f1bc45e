"""Send a scene and its batches to Rerun as entities and columns.

Entities of a run, in the north-east-down world:

    world/aircraft/<name>         pose of an aircraft; below it its marker, its name, and `drawn`:
                                  body, propeller disc and control surfaces
    world/trails/<name>           short lines along the path flown, by time
    world/slots/<name>            desired position of a follower, as a transparent aircraft
    world/losses/<name>           position where an aircraft was lost
    world/paths, world/ground     static
    world/chase                   a frame that moves with the formation and turns with its course;
                                  in it `links`, `wind` and `estimates`
    world/behind, world/above     frames of the cameras; in them `names`, arrows to aircraft
                                  `out_of_view`, the `scale` bar and the `grid`
    plots/<quantity>/<series>     one line per aircraft; in plots/<quantity>/limits the bounds and,
                                  transparent, the ends of the axis's minimum range
    events                        text

A batch costs a fixed number of calls plus a few per aircraft, for any number of samples.
"""

from __future__ import annotations

import math

import numpy as np
import rerun as rr

from testbed.core.frames import quaternion_xyzw
from testbed.core.records import Array, Event
from testbed.views import layout, plots
from testbed.views.airframes import AirframeDrawing, draw_fleet
from testbed.views.annotations import LOST, Links
from testbed.views.cameras import (
    ABOVE,
    BEHIND,
    CameraTrack,
    FormationCameras,
    rotate_to_heading,
)
from testbed.views.rerun_backend.blueprint import TIMELINE, blueprint
from testbed.views.rerun_backend.overlays import (
    ABOVE_CANVAS,
    BEHIND_CANVAS,
    camera_frame,
    overlay,
)
from testbed.views.rerun_backend.static_entities import static_entities
from testbed.views.sample_columns import ViewBatch, concat
from testbed.views.scene import Scene

LEVELS = {"info": "INFO", "warning": "WARN", "error": "ERROR"}


def address(port: int) -> str:
    """Return Rerun's address of the viewer on a port of this machine."""
    return f"rerun+http://127.0.0.1:{port}/proxy"


class RerunRecording:
    """Send one run to a viewer or to memory."""

    def __init__(
        self,
        scene: Scene,
        *,
        live: bool,
        at_s: float | None = None,
        framing: layout.Framing | None = None,
    ) -> None:
        """Prepare the recording; call `open` before `send`.

        Args:
            scene: the static part of the view.
            live: whether a viewer follows the running flight, or opens it afterwards.
            at_s: the only time that will be shown, s; None: plots follow the cursor.
            framing: scales; None: those that suit the first sample that is sent.
        """
        self._scene = scene
        self._live = live
        self._at_s = at_s
        self._drawings = draw_fleet(scene.airframes, scene.wingspan)
        self._links = Links(scene)
        self._trail_stride = layout.stride(scene, layout.TRAIL_ROWS_PER_S, 12.5)
        self._pending_points = np.empty((0, len(scene.names), 3))  # of trails
        self._pending_time = np.empty(0)
        self._lost = np.zeros(len(scene.names), dtype=bool)
        self._sent = 0  # samples
        self._last_plotted: ViewBatch | None = None  # one sample
        self._framing = framing
        self.calls = 0
        self._memory: rr.MemoryRecording | None = None
        self._stream = rr.RecordingStream("testbed", recording_id=scene.recording_id)
        self._stream.send_recording_name(scene.title)

    def open(self, port: int | None) -> None:
        """Send to the viewer on a port of this machine, or to memory."""
        if port is None:
            self._memory = self._stream.memory_recording()
        else:
            self._stream.connect_grpc(address(port))

    def drain(self) -> bytes:
        """Return what is in memory as the content of an .rrd file; memory is empty then."""
        assert self._memory is not None
        return self._memory.drain_as_bytes()

    def flush(self, timeout_s: float) -> None:
        """Wait until everything sent was received.

        Raises:
            RuntimeError: The viewer was closed or did not receive it in time.
        """
        self._stream.flush(timeout_sec=timeout_s)

    def close(self) -> None:
        """Flush and disconnect."""
        self._stream.disconnect()

    def send(self, batch: ViewBatch) -> None:
        """Send consecutive samples; the first batch also sends the static part and the layout."""
        if len(batch):
            if not self._sent:
                self._begin(batch)
            behind, above = self._cameras.track(batch)
            self._send_motion(batch, behind, above)
            self._send_overlays(batch, behind, above)
            self._send_annotations(batch, above)
            self._send_plots(batch)
            self._sent += len(batch)
        for event in batch.events:
            self._send_event(event)

    def _every(self, rows_per_s: float, max_hz: float = math.inf) -> slice:
        """Select the samples drawn at a rate, counted from the first of the run."""
        step = layout.stride(self._scene, rows_per_s, max_hz)
        return slice(-self._sent % step, None, step)

    def _columns(self, entity: str, time: Array, columns: rr.ComponentColumnList) -> None:
        self.calls += 1
        self._stream.send_columns(
            entity, indexes=[rr.TimeColumn(TIMELINE, duration=time)], columns=columns
        )

    def _begin(self, first: ViewBatch) -> None:
        scene = self._scene
        framing = self._framing = self._framing or layout.fit_formation(scene, first)
        self._cameras = FormationCameras(scene, (BEHIND, ABOVE), framing.size)
        self._tabs = plots.tabs(scene)
        entities = static_entities(scene, self._drawings, framing, self._tabs)
        for entity, components in entities:
            self.calls += 1
            self._stream.log(entity, *components, static=True)
        at_s, begin = self._at_s, float(first.time[0])
        span = None if at_s is None else layout.plot_span(at_s, begin)
        self._stream.send_blueprint(
            blueprint(scene, framing, self._tabs, live=self._live, span=span)
        )

    def _send_motion(self, batch: ViewBatch, behind: CameraTrack, above: CameraTrack) -> None:
        rows = self._every(layout.POSE_ROWS_PER_S)
        shown = batch.rows(rows)
        attitude = quaternion_xyzw(shown.euler)
        heading = above.rows(rows).quaternion
        deflection = np.stack([shown.aileron, shown.elevator, shown.rudder], axis=-1)
        for k, name in enumerate(self._scene.names):
            self._poses(f"world/aircraft/{name}", shown.time, shown.position[:, k], attitude[:, k])
            if len(self._scene.names) <= layout.MAX_MOVING_SURFACES:
                self._send_control_surfaces(name, self._drawings[k], shown.time, deflection[:, k])
        for i, k in enumerate(self._scene.followers):
            entity, flying = f"world/slots/{self._scene.names[k]}", shown.lost[:, k] == 0.0
            if flying.any():
                self._poses(entity, shown.time[flying], shown.slot[flying, i], heading[flying])
        self._poses("world/chase", shown.time, above.centre[rows], heading)
        for entity, track in (("world/behind", behind), ("world/above", above)):
            self._columns(entity, shown.time, camera_frame(track.rows(rows)))
        self._send_trails(batch)
        for row in np.flatnonzero(batch.lost.any(axis=0) & ~self._lost):
            self._send_loss(batch, int(row))
        self._lost |= batch.lost.any(axis=0)

    def _send_loss(self, batch: ViewBatch, k: int) -> None:
        """Mark where an aircraft was lost, and hide its slot."""
        first, name = int(batch.lost[:, k].argmax()), self._scene.names[k]
        time, size = batch.time[first : first + 1], rr.Radius.ui_points([4.0])
        mark = rr.Points3D.columns(
            positions=batch.position[first : first + 1, k],
            labels=[f"{name} lost"],
            colors=[LOST],
            radii=size,
        )
        self._columns(f"world/losses/{name}", time, mark)
        if k in self._scene.followers:
            hidden = rr.Transform3D.columns(scale=np.zeros((1, 3)))
            self._columns(f"world/slots/{name}", time, hidden)

    def _send_control_surfaces(
        self, name: str, drawing: AirframeDrawing, time: Array, deflection: Array
    ) -> None:
        for surface in drawing.control_surfaces:
            entity = f"world/aircraft/{name}/drawn/{surface.name}"
            hinge = np.tile(surface.hinge, (time.size, 1))
            self._poses(entity, time, hinge, surface.quaternion(deflection))

    def _poses(self, entity: str, time: Array, position: Array, quaternion: Array) -> None:
        self._columns(
            entity, time, rr.Transform3D.columns(translation=position, quaternion=quaternion)
        )

    def _send_trails(self, batch: ViewBatch) -> None:
        """Send complete pieces of the trails; the rest waits for the next batch."""
        points = np.concatenate([self._pending_points, batch.position])
        time = np.concatenate([self._pending_time, batch.time])
        step = self._trail_stride
        count = (len(points) - 1) // step
        self._pending_points, self._pending_time = points[count * step :], time[count * step :]
        if not count:
            return
        rows = step * np.arange(count)[:, None] + np.arange(step + 1)
        strips = points[rows].astype(np.float32)
        for k, name in enumerate(self._scene.names):
            self._columns(
                f"world/trails/{name}",
                time[rows[:, -1]],
                rr.LineStrips3D.columns(strips=np.ascontiguousarray(strips[:, :, k])),
            )

    def _send_overlays(self, batch: ViewBatch, behind: CameraTrack, above: CameraTrack) -> None:
        assert self._framing is not None
        rows = self._every(math.inf, layout.LABEL_ROWS_PER_S)
        shown = batch.rows(rows)
        if not len(shown):
            return
        for camera, track, canvas in (
            ("behind", behind, BEHIND_CANVAS),
            ("above", above, ABOVE_CANVAS),
        ):
            parts = overlay(
                self._scene,
                shown,
                track.rows(rows),
                canvas,
                self._framing.size,
                grid=camera == "above",
            )
            for name, columns in parts:
                self._columns(f"world/{camera}/{name}", shown.time, columns)

    def _send_annotations(self, batch: ViewBatch, above: CameraTrack) -> None:
        assert self._framing is not None
        rows = self._every(layout.PLOT_ROWS_PER_S)
        shown, track = batch.rows(rows), above.rows(rows)
        if not len(shown):
            return
        flying = shown.lost == 0.0
        count = flying.sum(axis=1)
        wind = rotate_to_heading(shown.wind, track.heading)
        arrows = rr.Arrows3D.columns(
            origins=track.to_frame(shown.position)[flying],
            vectors=self._framing.wind * wind[flying],
        )
        self._columns("world/chase/wind", shown.time, arrows.partition(count))
        if self._scene.estimated:
            position = track.to_frame(shown.estimated_position)
            points = rr.Points3D.columns(positions=position[flying])
            self._columns("world/chase/estimates", shown.time, points.partition(count))
        if self._scene.followers:
            lines = self._links.lines(shown, track.to_frame(shown.position))
            strips = rr.LineStrips3D.columns(
                strips=lines.strips.astype(np.float32),
                colors=lines.colours,
                radii=rr.Radius.ui_points(lines.radii),
            )
            self._columns("world/chase/links", lines.time, strips.partition(lines.counts))

    def _send_plots(self, batch: ViewBatch) -> None:
        shown = batch.rows(self._every(layout.PLOT_ROWS_PER_S))
        if not len(shown):
            return
        # with the sample before, on which some series depend; it is not sent again
        last = self._last_plotted
        known = shown if last is None else concat(last, shown)
        self._last_plotted = shown.rows(slice(-1, None))
        ends = shown.time[[0, -1]]
        for plot in (plot for row in self._tabs for plot in row):
            for series in plot.series:
                values = series.values(known)[-len(shown) :]
                self._scalars(f"plots/{plot.name}/{series.name}", shown.time, values)
            if plot.constants:
                constants = np.tile(plot.constants, (2, 1))
                self._scalars(f"plots/{plot.name}/limits", ends, constants)

    def _scalars(self, entity: str, time: Array, values: Array) -> None:
        column = rr.Scalars.columns(scalars=values.ravel())
        self._columns(entity, time, column.partition([values.shape[1]] * len(values)))

    def _send_event(self, event: Event) -> None:
        self.calls += 1
        self._stream.set_time(TIMELINE, duration=event.time_s)
        text = rr.TextLog(f"{event.source}: {event.text}", level=LEVELS.get(event.level, "INFO"))
        self._stream.log("events", text)
