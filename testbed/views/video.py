"""Draw frames of a flight for a video: the formation from behind and from above, and all of it.

The cameras, names and colours are those of the viewer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from testbed.core.frames import rotation_ned_body
from testbed.core.records import Array
from testbed.views import layout
from testbed.views.airframes import draw_airframe
from testbed.views.annotations import (
    FLASH_S,
    LOST,
    Canvas,
    Links,
    name_aircraft,
    place,
    scale_bar,
    text_boxes,
)
from testbed.views.cameras import (
    ABOVE,
    BEHIND,
    HALF_HEIGHT,
    FormationCameras,
    flying_aircraft,
)
from testbed.views.flight_map import FlightMap
from testbed.views.landscape import landscape_palette
from testbed.views.meshes import LIGHT, join
from testbed.views.panels import Colour
from testbed.views.pillow_backend import Drawing, text_width
from testbed.views.sample_columns import ViewBatch
from testbed.views.scene import (
    BACKDROP,
    GRID_COLOUR,
    PATH_COLOUR,
    TEXT_COLOUR,
    TYRE,
    Scene,
    mix,
    paint_colours,
    secondary_colour,
    subdivide,
)
from testbed.views.video_view import NEAR, VideoView

TRAIL_S = 6.0
TRAIL_POINTS = 40
BESIDE = 0.32  # share of the width that the small pictures have
UPPER = 0.56  # share of their height that the view from above has
MARGIN = 12  # pixels around texts
DETAILED_PX = 16.0  # wingspan from which an aircraft is drawn as a mesh, otherwise as a dot
LIGHT_FROM = np.array([-0.35, -0.25, -0.90])  # forward, right, down of north
SHADE = 0.45  # of a colour, turned away from the light
LOST_PX = 4.0  # pixels, radius of the mark of a lost aircraft
HEAD = 30  # pixels, height of the line above the pictures
GAP = 18  # pixels between two texts in that line
TITLE_PX = 17.0  # size of its first text
ARROW = 18.0, 5.0  # pixels, length and half the width of an arrow at the edge
RED: Colour = (255, 96, 88)  # of texts about lost aircraft


@dataclass(frozen=True, slots=True)
class Painted:
    """The mesh of an aircraft of v vertices and t triangles, at its drawn size."""

    vertices: Array  # (v, 3) m, body axes
    triangles: NDArray[np.uint32]  # (t, 3)
    normals: Array  # (t, 3) unit, outward
    colours: Array  # (t, 3) 0..255
    raised: Array  # (t,) m, towards the camera where triangles are sorted by depth


class FlightVideo:
    """Frames of one flight at some of its samples."""

    def __init__(
        self, scene: Scene, batch: ViewBatch, frames: NDArray[np.intp], size: tuple[int, int]
    ) -> None:
        """Prepare the cameras.

        Args:
            scene: of N aircraft.
            batch: all samples, so that the cameras are where the viewer has them.
            frames: rows of the samples that are drawn, ascending.
            size: width and height, pixels.
        """
        self._scene, self._batch, self._frames = scene, batch, frames
        self._shown = batch.rows(frames)
        self._flying = flying_aircraft(self._shown)
        framing = layout.fit_formation(scene, batch)
        self._size = framing.size
        width, height = size
        small, height = round(BESIDE * width), height - HEAD
        upper = round(UPPER * height)
        frames_px = (width - small, height), (small, upper)
        lenses = [
            replace(lens, aspect=wide / high)
            for lens, (wide, high) in zip((BEHIND, ABOVE), frames_px, strict=True)
        ]
        tracks = FormationCameras(scene, lenses, self._size).track(batch)
        self._views = tuple(
            VideoView.of(track.rows(frames), Canvas(*each, letter=7.4, line=19.0))
            for track, each in zip(tracks, frames_px, strict=True)
        )
        self._map = FlightMap(scene, batch, frames, Canvas(small, height - upper))
        self._lines = self._links().lines(self._shown, self._shown.position)
        self._first_line = np.concatenate([[0], np.cumsum(self._lines.counts)])
        self._rotation = rotation_ned_body(self._shown.euler)
        level = np.zeros_like(self._shown.euler)
        level[..., 2] = self._views[0].track.heading[:, None]
        self._level = rotation_ned_body(level)
        self._prepare_meshes()
        paths = [subdivide(each) for each in scene.paths]
        self._paths = [(path * [1.0, 1.0, 0.0], GRID_COLOUR) for path in paths]
        self._paths += [(path, PATH_COLOUR) for path in paths]

    @property
    def colours(self) -> list[Colour]:
        """Colours that a picture with few colours needs, at most 256."""
        greys = [mix(BACKDROP, (255, 255, 255), share) for share in np.linspace(0.0, 1.0, 24)]
        used = list(dict.fromkeys(self._scene.colours))[:21]
        tones = [mix(BACKDROP, each, s) for each in used for s in (0.25, 0.4, 0.55, 0.7, 0.85, 1)]
        pale = [mix(each, (255, 255, 255), 0.4) for each in used]
        fixed = [(30, 34, 42), TYRE, LOST, GRID_COLOUR, PATH_COLOUR]
        return [*greys, *fixed, *landscape_palette(), *tones, *pale]

    def frame(self, number: int) -> Drawing:
        """Draw a frame by its number."""
        behind, above = self._views
        left, right = self._view(behind, number), self._view(above, number)
        self._texts(left, behind, number)
        self._texts(right, above, number)
        flight = self._map.draw(number)
        for part, title in ((right, "from above"), (flight, "the flight")):
            part.text(np.array([MARGIN, MARGIN]), title, TEXT_COLOUR, anchor="lt")
        edge, height, upper = (
            int(each) for each in (behind.canvas.width, behind.canvas.height, above.canvas.height)
        )
        width = edge + int(above.canvas.width)
        parts = [(left, 0, HEAD), (right, edge, HEAD), (flight, edge, HEAD + upper)]
        whole = Drawing.joined(width, HEAD + height, parts)
        whole.line(np.array([[edge, HEAD], [edge, HEAD + height]]), GRID_COLOUR)
        whole.line(np.array([[edge, HEAD + upper], [width, HEAD + upper]]), GRID_COLOUR)
        self._head(whole, width, number)
        return whole

    def _links(self) -> Links:
        """Return what selects lines, after the samples before the first frame: losses last."""
        links, first = Links(self._scene), int(self._frames[0])
        begin = np.searchsorted(self._batch.time, self._batch.time[first] - FLASH_S) - 2
        before = self._batch.rows(slice(max(int(begin), 0), first))
        if len(before):
            links.lines(before, before.position)
        return links

    def _prepare_meshes(self) -> None:
        """Join the parts of each drawn airframe, with a colour and a normal per triangle."""
        scene = self._scene
        self._meshes: list[Painted] = []
        for name, span, paint in zip(scene.airframes, scene.wingspan, scene.colours, strict=True):
            drawn = draw_airframe(name, span)
            moved = [
                replace(each.mesh, vertices=each.mesh.vertices + each.hinge)
                for each in drawn.control_surfaces
            ]
            mesh = join(drawn.body, *moved)
            vertices = self._size * mesh.vertices
            corners = vertices[mesh.triangles]
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            area = np.linalg.norm(normal, axis=-1, keepdims=True)
            keep = area[:, 0] > 0.0
            colours = paint_colours(paint, secondary_colour(paint)).astype(np.float64)
            paint_of = mesh.paint[mesh.triangles[:, 0]]
            self._meshes.append(
                Painted(
                    vertices,
                    mesh.triangles[keep],
                    (normal / np.maximum(area, 1e-12))[keep],
                    colours[paint_of[keep]],
                    # light stripes lie on surfaces of the main colour
                    np.where(paint_of[keep] == LIGHT, 0.012 * self._size * span, 0.0),
                )
            )

    def _view(self, view: VideoView, number: int) -> Drawing:
        """Draw everything but the texts."""
        shown, drawing = self._shown, view.begin(number)
        for points, colour in self._paths:
            view.polyline(drawing, number, points, colour)
        row = int(self._frames[number])
        first = int(np.searchsorted(self._batch.time, self._batch.time[row] - TRAIL_S))
        step = max(1, (row - first) // TRAIL_POINTS)
        rows = np.union1d(np.arange(row - (row - first) // step * step, row + 1, step), [row])
        for k in range(len(self._scene.names)):
            if self._flying[number, k]:
                trail = self._batch.position[rows, k]
                view.polyline(drawing, number, trail, self._scene.colours[k], 1.6)
        lines, begin = self._lines, self._first_line
        for s in range(begin[number], begin[number + 1]):
            colour = tuple(lines.colours[s].tolist())
            width = 0.5 + float(lines.radii[s])
            view.polyline(drawing, number, lines.strips[s], colour, width)
        for lost in np.flatnonzero(shown.lost[number]).tolist():
            at, depth = view.pixels(number, shown.position[number, lost : lost + 1])
            if depth[0] > NEAR:
                drawing.dot(at[0], LOST, LOST_PX)
        self._aircraft(drawing, view, number)
        return drawing

    def _aircraft(self, drawing: Drawing, view: VideoView, number: int) -> None:
        """Draw slots, and then aircraft over them, each the farthest first."""
        shown, scene = self._shown, self._scene
        things = [
            (k, shown.position[number, k], self._rotation[number, k], False)
            for k in np.flatnonzero(self._flying[number]).tolist()
        ]
        things += [
            (k, shown.slot[number, i], self._level[number, k], True)
            for i, k in enumerate(scene.followers)
            if self._flying[number, k] and np.isfinite(shown.slot[number, i]).all()
        ]
        if not things:
            return
        middle, depth = view.pixels(number, np.array([each[1] for each in things]))
        axes = view.track.lens.axes
        course = view.track.heading[number]
        c, s = np.cos(course), np.sin(course)
        to_view = axes @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        slots_first = np.array([not ghost for *_, ghost in things])
        for each in np.lexsort((-depth, slots_first)):
            k, position, rotation, ghost = things[each]
            if depth[each] <= NEAR:
                continue
            metre = 0.5 * view.canvas.height / (HALF_HEIGHT * depth[each])
            colour = scene.colours[k]
            if self._size * scene.wingspan[k] * metre < DETAILED_PX:
                if not ghost:
                    drawing.dot(middle[each], colour, 3.0)
                continue
            mesh = self._meshes[k]
            pixels, deep = view.pixels(number, position + mesh.vertices @ rotation.T)
            pixels, deep = pixels[mesh.triangles], deep[mesh.triangles]
            normals = mesh.normals @ rotation.T
            a, b = pixels[:, 1] - pixels[:, 0], pixels[:, 2] - pixels[:, 0]
            turning = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]  # by the side that is seen
            outward = turning * -(normals @ to_view[2])
            front = turning * np.sign(outward.sum()) > 0.0
            front &= deep.min(axis=1) > NEAR
            if ghost:
                faded = np.array(mix(colour, BACKDROP, 0.72), np.uint8)
                drawing.polygons(pixels[front], np.broadcast_to(faded, (int(front.sum()), 3)))
                continue
            light = np.clip(normals @ LIGHT_FROM, 0.0, 1.0)
            tone = (SHADE + (1.0 - SHADE) * light)[:, None] * mesh.colours
            far = deep.mean(axis=1) - mesh.raised
            order = np.flatnonzero(front)[np.argsort(-far[front])]
            drawing.polygons(pixels[order], tone[order].astype(np.uint8))

    def _texts(self, drawing: Drawing, view: VideoView, number: int) -> None:
        """Write names, arrows towards aircraft out of view, losses, and the scale bar."""
        one = self._shown.rows(slice(number, number + 1))
        at = view.track.rows(slice(number, number + 1))
        names, arrows = name_aircraft(self._scene, one, at, view.canvas, self._size)
        bar = scale_bar(at, view.canvas)
        left, low = MARGIN, view.canvas.height - MARGIN
        drawing.line(np.array([[left, low], [left + bar.pixels, low]]), TEXT_COLOUR, 2.0)
        length, half = ARROW
        for tip, direction, row in zip(arrows.tip, arrows.direction, arrows.rows, strict=True):
            tail = tip - length * direction
            aside = half * np.array([-direction[1], direction[0]])
            head = np.stack([tip, tail + aside, tail - aside])
            drawing.polygons(head[None], np.array([self._scene.colours[row]], np.uint8))
        for ends, row in zip(names.ties, names.tied, strict=True):
            drawing.line(ends, mix(self._scene.colours[row], BACKDROP, 0.4))
        taken = [text_boxes(each.middle, view.canvas.text_size(each.texts))
                 for each in (names, arrows)]  # fmt: skip
        for each in (names, arrows):
            for middle, text, row in zip(each.middle, each.texts, each.rows, strict=True):
                drawing.text(middle, text, self._scene.colours[row])
        self._losses(drawing, view, number, np.concatenate(taken))
        drawing.text(np.array([left + 2, low - 6]), f"{bar.length:g} m", TEXT_COLOUR, anchor="ls")
        if view is self._views[0]:
            corner = np.array([view.canvas.width - MARGIN, low])
            drawing.text(corner, self._height_and_speed(view, number), TEXT_COLOUR, anchor="rs")

    def _height_and_speed(self, view: VideoView, number: int) -> str:
        """Describe the flight of the first aircraft that is not lost, and the lines below it."""
        grid = f"ground grid {view.step:g} m"
        flying = np.flatnonzero(self._flying[number])
        if not len(flying):
            return grid
        height = -self._shown.position[number, flying[0], 2]
        speed = float(np.linalg.norm(self._shown.velocity[number, flying[0]]))
        return f"height {height:.0f} m · {speed:.1f} m/s · {grid}"

    def _losses(self, drawing: Drawing, view: VideoView, number: int, taken: Array) -> None:
        """Name the marks of lost aircraft where boxes (b, 4) of other texts leave room."""
        lost = np.flatnonzero(self._shown.lost[number])
        pixels, depth = view.pixels(number, self._shown.position[number, lost])
        frame = view.canvas.width, view.canvas.height
        near = (depth > NEAR) & (pixels >= 0.0).all(axis=-1) & (pixels <= frame).all(axis=-1)
        lost, pixels = lost[near], pixels[near]
        texts = [f"{self._scene.names[k]} lost" for k in lost]
        gaps = np.full((len(texts), 2), LOST_PX + 2.0)
        middles = place(pixels, view.canvas.text_size(texts), gaps, taken, pixels, frame)
        for middle, text in zip(middles, texts, strict=True):
            if np.isfinite(middle[0]):
                drawing.text(middle, text, RED)

    def _head(self, drawing: Drawing, width: float, number: int) -> None:
        """Write scenario, time and scale, and losses and the largest errors that fit, in a line."""
        scene, time = self._scene, float(self._shown.time[number])
        at = np.array([MARGIN, 0.5 * HEAD])
        title = f"{scene.scenario}   {time:.1f} s"
        drawing.text(at, title, (240, 240, 240), anchor="lm", size=TITLE_PX, boxed=False)
        at[0] += text_width(f"{scene.scenario}   8888.8 s", TITLE_PX) + GAP
        if self._size > 1.0:
            scale = f"aircraft {self._size:g} x as large"
            drawing.text(at, scale, TEXT_COLOUR, anchor="lm", boxed=False)
            at[0] += text_width(scale) + GAP
        error = np.linalg.norm(self._shown.error[number], axis=-1)
        entries: dict[int, tuple[str, Colour]] = {}  # the most important ones first
        for i in sorted(range(len(error)), key=lambda i: -np.nan_to_num(error[i])):
            k = scene.followers[i]
            if self._flying[number, k] and np.isfinite(error[i]):
                entries[k] = f"{scene.names[k]} {short_length(error[i])} m", scene.colours[k]
        lost_rows = np.flatnonzero(self._shown.lost[number]).tolist()
        lost = {k: (f"{scene.names[k]} lost", RED) for k in lost_rows}
        entries = lost | entries
        # of the longest text, so that the line stands still
        widths = {k: text_width(f"{scene.names[k]} 88.88 m") + GAP for k in entries}
        label = "from slots" if len(entries) > len(lost) else ""
        free_width = width - at[0] - text_width(f"largest {label}:") - GAP
        fits = [k for k, end in zip(entries, np.cumsum(list(widths.values())), strict=True)
                if end <= free_width]  # fmt: skip
        if not fits:
            return
        label = label if len(fits) == len(entries) else f"largest {label}"
        at[0] = width - sum(widths[k] for k in fits)
        drawing.text(at - [8, 0], f"{label}:", TEXT_COLOUR, anchor="rm", boxed=False)
        for k in sorted(fits):
            text, colour = entries[k]
            drawing.text(at, text, colour, anchor="lm", boxed=False)
            at = at + [widths[k], 0]


def short_length(value: float) -> str:
    """Write a length with three or four digits."""
    return f"{value:.{2 if value < 10.0 else 1 if value < 100.0 else 0}f}"
