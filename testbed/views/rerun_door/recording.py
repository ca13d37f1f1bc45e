"""A scene and its batches become Rerun's entities and columns.

Entities of a run, in the north-east-down world:

    world/aircraft/<name>         pose of an aircraft, below it its marker, its name, and `drawn`:
                                  body, disc and control surfaces
    world/trails/<name>           one short line per stretch flown, by time
    world/slots/<name>            ghost of where a follower should be
    world/losses/<name>           where an aircraft was lost
    world/paths, world/ground     still
    world/chase                   a frame that goes with the formation and turns with its course;
                                  in it `links`, `wind`, `believed` and, of many, the names of the
                                  `worst`
    plots/<quantity>/<series>     one line per aircraft; in plots/<quantity>/limits bounds, and,
                                  unseen, what the axis shows at the least
    events                        text

A batch costs a fixed number of calls plus a few per aircraft, whatever number of frames it holds.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr

from testbed.frames import course, quaternion_xyzw
from testbed.state import Array, Event
from testbed.views import layout, plots, signs
from testbed.views.airframes import Airframe, airframe
from testbed.views.batch import Batch, joined
from testbed.views.rerun_door.blueprint import TIMELINE, blueprint
from testbed.views.rerun_door.still import stills
from testbed.views.scene import Scene

LEVELS = {"info": "INFO", "warning": "WARN", "error": "ERROR"}


def address(port: int) -> str:
    """Where Rerun finds the viewer on a port of this machine."""
    return f"rerun+http://127.0.0.1:{port}/proxy"


class Recording:
    """One run on its way to a viewer, a file or memory."""

    def __init__(self, still: Scene, *, live: bool, at_s: float | None = None) -> None:
        """Name the run; `open` it before `send`.

        Args:
            still: the part of the view that does not move.
            live: whether a viewer follows the flight as it happens, or opens it afterwards.
            at_s: the only time that will be looked at, s; None: the plots go with the cursor.
        """
        self._scene = still
        self._live = live
        self._at_s = at_s
        self._drawings = [
            airframe(*each) for each in zip(still.airframes, still.wingspan, strict=True)
        ]
        self._links = signs.Links(still)
        self._trail_stride = layout.stride(still, layout.TRAIL_ROWS_PER_S, 12.5)
        self._undrawn_points = np.empty((0, len(still.names), 3))
        self._undrawn_time = np.empty(0)
        self._lost = np.zeros(len(still.names), dtype=bool)
        self._seen = 0  # frames
        self._plotted: Batch | None = None  # the last row of it
        self._frame: layout.Framing | None = None
        self.calls = 0
        self._stream = rr.RecordingStream("testbed", recording_id=still.recording_id)
        self._stream.send_recording_name(still.title)

    def open(self, to: Path | int | None) -> None:
        """Send to an .rrd file, to the viewer on a port of this machine, or keep all in memory.

        Raises:
            OSError: the file cannot be written.
        """
        if isinstance(to, Path):
            with to.open("wb"):  # Rerun would only log the failure
                pass
            self._stream.save(to)
        elif to is None:
            self._stream.memory_recording()
        else:
            self._stream.connect_grpc(address(to))

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
            if self._frame is None:
                self._begin(batch)
            self._send_motion(batch)
            self._send_signs(batch)
            self._send_plots(batch)
            self._seen += len(batch)
        for event in batch.events:
            self._send_event(event)

    def _every(self, batch: Batch, rows_per_s: float) -> Batch:
        """The frames of a batch that are drawn at a rate, counted from the first of the run."""
        step = layout.stride(self._scene, rows_per_s)
        return batch if step == 1 else batch.rows(slice(-self._seen % step, None, step))

    def _columns(self, entity: str, time: Array, columns: rr.ComponentColumnList) -> None:
        self.calls += 1
        self._stream.send_columns(
            entity, indexes=[rr.TimeColumn(TIMELINE, duration=time)], columns=columns
        )

    def _begin(self, first: Batch) -> None:
        still = self._scene
        self._frame = layout.framing(still, first)
        self._tabs = plots.tabs(still)
        for entity, what in stills(still, self._drawings, self._frame, self._tabs):
            self.calls += 1
            self._stream.log(entity, *what, static=True)
        at_s, begin = self._at_s, float(first.time[0])
        span = None if at_s is None else layout.span_of(at_s, begin)
        self._stream.send_blueprint(
            blueprint(still, self._frame, self._tabs, live=self._live, span=span)
        )

    def _send_motion(self, batch: Batch) -> None:
        shown = self._every(batch, layout.POSE_ROWS_PER_S)
        attitude = quaternion_xyzw(shown.euler)
        level = np.zeros((len(shown), 3))
        level[:, 2] = course(shown.velocity[:, 0])
        heading = quaternion_xyzw(level)
        deflection = np.stack([shown.aileron, shown.elevator, shown.rudder], axis=-1)
        for k, name in enumerate(self._scene.names):
            self._poses(f"world/aircraft/{name}", shown.time, shown.position[:, k], attitude[:, k])
            if len(self._scene.names) <= layout.MOST_MOVING:
                self._send_flaps(name, self._drawings[k], shown.time, deflection[:, k])
        for i, k in enumerate(self._scene.followers):
            at, has = f"world/slots/{self._scene.names[k]}", shown.lost[:, k] == 0.0
            if has.any():
                self._poses(at, shown.time[has], shown.slot[has, i], heading[has])
        self._poses("world/chase", shown.time, signs.centre(self._scene, shown), heading)
        self._send_trails(batch)
        for row in np.flatnonzero(batch.lost.any(axis=0) & ~self._lost):
            self._send_loss(batch, int(row))
        self._lost |= batch.lost.any(axis=0)

    def _send_loss(self, batch: Batch, k: int) -> None:
        """A mark where an aircraft was lost, and the end of its slot."""
        first, name = int(batch.lost[:, k].argmax()), self._scene.names[k]
        when, size = batch.time[first : first + 1], rr.Radius.ui_points([4.0])
        said = rr.Points3D.columns(
            positions=batch.position[first : first + 1, k],
            labels=[f"{name} lost"],
            colors=[signs.LOST],
            radii=size,
        )
        self._columns(f"world/losses/{name}", when, said)
        if k in self._scene.followers:
            nowhere = rr.Transform3D.columns(scale=np.zeros((1, 3)))
            self._columns(f"world/slots/{name}", when, nowhere)

    def _send_flaps(self, name: str, drawing: Airframe, time: Array, deflection: Array) -> None:
        for flap in drawing.flaps:
            at = f"world/aircraft/{name}/drawn/{flap.name}"
            hinge = np.tile(flap.hinge, (time.size, 1))
            self._poses(at, time, hinge, flap.turn(deflection))

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

    def _send_signs(self, batch: Batch) -> None:
        assert self._frame is not None
        shown = self._every(batch, layout.PLOT_ROWS_PER_S)
        if not len(shown):
            return
        still, flown = self._scene, shown.lost == 0.0
        count = flown.sum(axis=1)
        place = signs.to_chase(still, shown, shown.position)
        wind = self._frame.wind * signs.turned(shown.wind, course(shown.velocity[:, 0]))
        arrows = rr.Arrows3D.columns(origins=place[flown], vectors=wind[flown])
        self._columns("world/chase/wind", shown.time, arrows.partition(count))
        if still.estimated:
            place = signs.to_chase(still, shown, shown.believed)
            points = rr.Points3D.columns(positions=place[flown])
            self._columns("world/chase/believed", shown.time, points.partition(count))
        if len(still.names) > layout.MOST_NAMED:
            told = signs.worst(still, shown)
            points = rr.Points3D.columns(
                positions=told.places,
                labels=told.texts,
                colors=np.array(still.colours, np.uint8)[told.rows],
            )
            self._columns("world/chase/worst", shown.time, points.partition(told.counts))
        if still.followers:
            lines = self._links.lines(shown)
            strips = rr.LineStrips3D.columns(
                strips=lines.strips.astype(np.float32),
                colors=lines.colours,
                radii=rr.Radius.ui_points(lines.radii),
            )
            self._columns("world/chase/links", lines.time, strips.partition(lines.counts))

    def _send_plots(self, batch: Batch) -> None:
        shown = self._every(batch, layout.PLOT_ROWS_PER_S)
        if not len(shown):
            return
        # The row before comes along, for what depends on it, and is not sent again.
        known = shown if self._plotted is None else joined(self._plotted, shown)
        self._plotted = shown.rows(slice(-1, None))
        ends = shown.time[[0, -1]]
        for plot in (plot for row in self._tabs for plot in row):
            for series in plot.series:
                values = series.values(known)[-len(shown) :]
                self._scalars(f"plots/{plot.name}/{series.name}", shown.time, values)
            if plot.still:
                self._scalars(f"plots/{plot.name}/limits", ends, np.tile(plot.still, (2, 1)))

    def _scalars(self, entity: str, time: Array, values: Array) -> None:
        column = rr.Scalars.columns(scalars=values.ravel())
        self._columns(entity, time, column.partition([values.shape[1]] * len(values)))

    def _send_event(self, event: Event) -> None:
        self.calls += 1
        self._stream.set_time(TIMELINE, duration=event.time_s)
        text = rr.TextLog(f"{event.source}: {event.text}", level=LEVELS.get(event.level, "INFO"))
        self._stream.log("events", text)
