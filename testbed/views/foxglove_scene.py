"""Foxglove's scene of a run: aircraft, slots, links, the leader's path, trails, wind.

Aircraft and slots are drawn once and move with their frames; only lines between them and trails are
sent again, a few times per second. A topic's last message has all that the topic shows, because
that is all a viewer reads when it jumps to another time.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from operator import attrgetter
from pathlib import Path

import numpy as np

from testbed.core.frames import quaternion_xyzw
from testbed.core.records import Array, Observer
from testbed.logs import foxglove_messages as draw
from testbed.logs.proto_template import TransformsTemplate
from testbed.logs.read import RunLog, replay
from testbed.logs.recorder import Addition, McapRecorder
from testbed.views import layout
from testbed.views.airframes import draw_fleet, whole
from testbed.views.annotations import BROAD, LOST, THIN, Links
from testbed.views.cameras import hold_finite, leader_track, rotate_to_heading
from testbed.views.meshes import Mesh
from testbed.views.panels import Colour
from testbed.views.sample_columns import ViewBatch, batch_of
from testbed.views.scene import (
    BACKDROP,
    PATH_COLOUR,
    WIND_COLOUR,
    Scene,
    ground,
    mix,
    paint_colours,
    scene_of,
    secondary_colour,
)

FRAMES, AIRCRAFT, SLOTS, PATH, TRAILS, LINKS, WIND, ESTIMATES, LOSSES = TOPICS = tuple(
    f"/scene/{name}"
    for name in (
        "frames",
        "aircraft",
        "slots",
        "path",
        "trails",
        "links",
        "wind",
        "estimates",
        "losses",
    )
)
FORMATION_FRAME = "formation"
LINES_HZ = 5.0  # of links, trails, wind and estimates
TRAIL_STEP_S = 1.0
TRAIL_POINTS = 600  # at most, of all aircraft together
_FAINT: Colour = (96, 104, 118)
_WHITE: Colour = (255, 255, 255)
_GHOST_ALPHA, _DISC_ALPHA = 0.25, 0.27
_LEAST_WIND = 1e-3  # m/s, below which there is none
_LABEL_M = 12.0  # height of the labels of the grid
_ESTIMATE_SPANS = 0.12  # diameter of a dot, in wingspans


def slot_frame(name: str) -> str:
    """Name the frame of a follower's slot."""
    return f"{name}/slot"


def scene_additions(log: RunLog) -> Iterator[Addition]:
    """Make the messages that Foxglove draws, in order of time.

    Topics, in frames that the log has and `/scene/frames` adds: `/scene/aircraft` and `slots`,
    `path`, `trails`, `links`, `wind`, `estimates`, `losses`.
    """
    if not log.tick.size:
        return iter(())
    made = _SceneMessages(log)
    parts = [made.frames(), made.aircraft(), made.path(), made.slots(), made.losses()]
    parts += [made.trails(), made.lines()]
    return heapq.merge(*parts, key=attrgetter("tick"))


def write_scene_log(log: RunLog, path: Path, observers: Sequence[Observer] = ()) -> None:
    """Write a log again, with the messages that Foxglove draws.

    Args:
        log: of a run, also of one that was cut short.
        path: of the new file, which must not exist.
        observers: of the samples, such as a progress bar.

    Raises:
        LogError: the file cannot be written.
    """
    recorder = McapRecorder(path, scene_additions(log), live=False)
    recorder.end(log.metrics or {}, replay(log, [recorder, *observers]))


class _SceneMessages:
    def __init__(self, log: RunLog) -> None:
        self._scene: Scene = scene_of(log.info)
        self._batch: ViewBatch = batch_of(log, ())
        self._tick = log.tick
        self._time_ns = log.time_ns
        self._track = leader_track(self._batch)  # the frame of the formation
        stride = max(1, round(log.info.sample_rate_hz / LINES_HZ))
        self._rows = np.arange(0, log.tick.size, stride)
        self._drawings = draw_fleet(self._scene.airframes, self._scene.wingspan)
        self._lost = self._batch.lost > 0.0

    def frames(self) -> Iterator[Addition]:
        """Move the slots, and the formation's frame, with every sample."""
        scene, batch = self._scene, self._batch
        children = [FORMATION_FRAME, *(slot_frame(scene.names[k]) for k in scene.followers)]
        template = TransformsTemplate("ned", children)
        octets = np.tile(np.frombuffer(template.data, np.uint8), (len(batch), 1))
        slots = hold_finite(batch.slot)
        positions = np.concatenate([self._track.centre[:, None], slots], axis=1)
        heading = np.repeat(self._track.quaternion[:, None], len(children), axis=1)
        template.fill(octets, positions, heading, self._time_ns)
        for tick, row in zip(self._tick.tolist(), octets, strict=True):
            yield Addition(tick, FRAMES, draw.TRANSFORMS, row.tobytes())

    def aircraft(self) -> Iterator[Addition]:
        """Draw each aircraft in its own frame."""
        scene, time_ns = self._scene, int(self._time_ns[0])
        entities = []
        for name, drawing, paint in zip(scene.names, self._drawings, scene.colours, strict=True):
            surfaces = _painted(whole(drawing), paint, secondary_colour(paint), 1.0)
            if drawing.disc is not None:
                surfaces += _painted(drawing.disc, paint, secondary_colour(paint), _DISC_ALPHA)
            entities.append(draw.entity(name, name, time_ns, triangles=surfaces))
        yield self._update(0, AIRCRAFT, entities)

    def slots(self) -> Iterator[Addition]:
        """Draw a transparent aircraft in each slot, without those of lost aircraft."""
        scene = self._scene
        if not scene.followers:
            return
        for row in self._changes():
            entities = []
            for k in scene.followers:
                if not self._lost[row, k]:
                    faded = mix(scene.colours[k], BACKDROP, 0.5)
                    ghost = _painted(whole(self._drawings[k]), faded, faded, _GHOST_ALPHA)
                    frame = slot_frame(scene.names[k])
                    time_ns = int(self._time_ns[row])
                    entities.append(draw.entity(frame, frame, time_ns, triangles=ghost))
            yield self._update(row, SLOTS, entities, alone=True)

    def losses(self) -> Iterator[Addition]:
        """Mark where aircraft were lost."""
        scene = self._scene
        for row in self._changes():
            spheres, texts = [], []
            for k in np.flatnonzero(self._lost[row]):
                where = self._batch.position[int(self._lost[:, k].argmax()), k]
                if np.isfinite(where).all():
                    span = scene.wingspan[k]
                    spheres.append(draw.sphere(where, span, LOST))
                    above = where - [0.0, 0.0, 2.0 * span]
                    texts.append(draw.text(f"{scene.names[k]} lost", above, LOST, span))
            if row:
                time_ns = int(self._time_ns[row])
                marks = draw.entity("losses", "ned", time_ns, spheres=spheres, texts=texts)
                yield self._update(row, LOSSES, [marks])

    def path(self) -> Iterator[Addition]:
        """Draw the leader's path, its shadow on the ground, and a scale."""
        area, lines = ground(self._scene.paths), []
        for path in area.paths:
            lines.append(draw.line_strip(draw.points(path), PATH_COLOUR, 2.0))
            lines.append(draw.line_strip(draw.points(path * [1.0, 1.0, 0.0]), _FAINT, 1.0))
        if area.paths:
            lines.append(draw.line_list(area.posts, _FAINT, 1.0))
        labels = zip(area.labels, area.label_positions, strict=True)
        texts = [draw.text(words, where, _FAINT, _LABEL_M) for words, where in labels]
        time_ns = int(self._time_ns[0])
        yield self._update(0, PATH, [draw.entity("path", "ned", time_ns, lines=lines, texts=texts)])

    def trails(self) -> Iterator[Addition]:
        """Draw where the aircraft were in the last minute; of many aircraft, in less."""
        scene, time = self._scene, self._batch.time
        longest = TRAIL_STEP_S * TRAIL_POINTS / len(scene.names)
        trail_s = min(layout.OVERVIEW_TRAIL_S, max(layout.CHASE_TRAIL_S, longest))
        knots = np.searchsorted(time, np.arange(time[0], time[-1] + TRAIL_STEP_S, TRAIL_STEP_S))
        knots = np.unique(np.minimum(knots, len(time) - 1))
        position = hold_finite(self._batch.position)
        fixed = [draw.points(position[knots, k]) for k in range(len(scene.names))]
        first = np.searchsorted(time[knots], time[self._rows] - trail_s)
        last = np.searchsorted(knots, self._rows)
        for row, begin, end in zip(self._rows.tolist(), first, last, strict=True):
            now = draw.points(position[row])
            lines = [
                draw.line_strip([*along[begin:end], here], colour, 1.5)
                for along, here, colour in zip(fixed, now, scene.colours, strict=True)
            ]
            trails = draw.entity("trails", "ned", int(self._time_ns[row]), lines=lines)
            yield self._update(row, TRAILS, [trails])

    def lines(self) -> Iterator[Addition]:
        """Draw links, wind and estimates, in the frame of the formation."""
        scene, shown = self._scene, self._batch.rows(self._rows)
        flying = ~self._lost[self._rows]
        track = self._track.rows(self._rows)
        position, estimate = map(track.to_frame, (shown.position, shown.estimated_position))
        wind = rotate_to_heading(shown.wind, track.heading)
        windy = bool(np.any(np.linalg.norm(wind, axis=-1) > _LEAST_WIND))
        scale = layout.fit_formation(scene, shown.rows(slice(0, 1))).wind
        links = Links(scene).lines(shown, position) if scene.followers else None
        ends = np.cumsum(links.counts) if links else np.zeros(len(shown), int)
        differ = bool(np.any(shown.estimated_position != shown.position))
        for i, row in enumerate(self._rows.tolist()):
            time_ns = int(self._time_ns[row])
            if links:
                of = slice(ends[i] - links.counts[i], ends[i])
                lines = [
                    draw.line_list(links.strips[of][width], links.colours[of][width], 2.0 * pixels)
                    for pixels in (THIN, BROAD)
                    if (width := links.radii[of] == pixels).any()
                ]
                drawn = draw.entity("links", FORMATION_FRAME, time_ns, lines=lines)
                yield self._update(row, LINKS, [drawn])
            if windy:
                pairs = zip(position[i, flying[i]], wind[i, flying[i]], strict=True)
                arrows = [
                    draw.arrow(
                        where, _along(vector), scale * float(np.linalg.norm(vector)), WIND_COLOUR
                    )
                    for where, vector in pairs
                    if np.linalg.norm(vector) > _LEAST_WIND
                ]
                drawn = draw.entity("wind", FORMATION_FRAME, time_ns, arrows=arrows)
                yield self._update(row, WIND, [drawn])
            if differ:
                size = _ESTIMATE_SPANS * max(scene.wingspan)
                dots = [draw.sphere(where, size, _WHITE) for where in estimate[i, flying[i]]]
                drawn = draw.entity("estimates", FORMATION_FRAME, time_ns, spheres=dots)
                yield self._update(row, ESTIMATES, [drawn])

    def _changes(self) -> list[int]:
        """List the first row, and those in which more aircraft are lost."""
        more = np.flatnonzero(np.diff(self._lost.sum(axis=1)) > 0) + 1
        return [0, *more.tolist()]

    def _update(
        self, row: int, topic: str, entities: Sequence[draw.Entity], *, alone: bool = False
    ) -> Addition:
        """Make the message of a sample; `alone`: earlier entities of the topic disappear."""
        from_ns = int(self._time_ns[row]) if alone and row else None
        data = draw.scene_update(entities, alone_from_ns=from_ns)
        return Addition(int(self._tick[row]), topic, draw.SCENE, data)


def _painted(mesh: Mesh, paint: Colour, trim: Colour, alpha: float) -> list[draw.Triangles]:
    """Draw a mesh as one surface of each paint."""
    colours = paint_colours(paint, trim).tolist()
    of_triangle = mesh.paint[mesh.triangles[:, 0]]
    surfaces = []
    for number in np.unique(of_triangle).tolist():
        used, triangles = np.unique(mesh.triangles[of_triangle == number], return_inverse=True)
        surfaces.append(
            draw.triangle_list(
                mesh.vertices[used], triangles.astype(np.uint32), colours[number], alpha
            )
        )
    return surfaces


def _along(vector: Array) -> Array:
    """Rotate the x axis to a vector (3,), which is not zero: x, y, z, w."""
    pitch = np.arctan2(-vector[2], np.hypot(vector[0], vector[1]))
    return quaternion_xyzw(np.array([0.0, pitch, np.arctan2(vector[1], vector[0])]))
