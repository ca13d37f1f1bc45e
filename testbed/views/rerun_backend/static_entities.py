"""Entities that do not move, and the constant parts of those that do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr

from testbed.core.records import Array
from testbed.views import layout, plots
from testbed.views.airframes import AirframeDrawing
from testbed.views.meshes import Mesh, vertex_normals
from testbed.views.panels import Colour
from testbed.views.scene import (
    BACKDROP,
    GRID_COLOUR,
    HAZE,
    PATH_COLOUR,
    SOIL,
    TEXT_COLOUR,
    WIND_COLOUR,
    Ground,
    Scene,
    ground,
    mix,
    paint_colours,
    secondary_colour,
)

ESTIMATE: Colour = (255, 255, 255)
RINGS = ((400.0, 0.0), (1500.0, 0.35), (5000.0, 0.8), (40000.0, 1.0))  # radius, m, and haze
RING_POINTS = 48
BELOW_GRID = 1.0  # m, of the ground: lines in its plane would flicker
GHOST_ALPHA, DISC_ALPHA = 60, 70  # of 255
REAL_ALPHA = 130  # of real aircraft beside simulated ones

Entity = tuple[str, tuple[rr.AsComponents, ...]]  # path and components


def static_entities(
    scene: Scene,
    drawings: Sequence[AirframeDrawing],
    framing: layout.Framing,
    tabs: Sequence[Sequence[plots.TimePlot]],
) -> Iterator[Entity]:
    """List the entities that are sent once.

    Args:
        scene: of N aircraft.
        drawings: N
        framing: how large they are drawn.
        tabs: rows of plots.
    """
    yield "world", (rr.ViewCoordinates.FRD,)
    for row, (name, drawing, paint) in enumerate(
        zip(scene.names, drawings, scene.colours, strict=True)
    ):
        alpha = REAL_ALPHA if row in scene.ghosts else 255
        yield from _aircraft(name, drawing, paint, framing.size, alpha)
    for row in (row for row in scene.followers if row not in scene.ghosts):
        faded = mix(scene.colours[row], BACKDROP, 0.5)
        ghost = painted(drawings[row].body, faded, faded, GHOST_ALPHA)
        drawn = f"world/slots/{scene.names[row]}/drawn"
        yield drawn, (rr.Transform3D(scale=framing.size), ghost)
    arrows = rr.Arrows3D.from_fields(colors=WIND_COLOUR, radii=rr.Radius.ui_points(1.2))
    yield "world/chase/wind", (arrows,)
    points = rr.Points3D.from_fields(colors=ESTIMATE, radii=rr.Radius.ui_points(3.0))
    yield "world/chase/estimates", (points,)
    for camera in ("world/behind", "world/above"):
        small, thin = rr.Radius.ui_points(0.1), rr.Radius.ui_points(0.5)
        yield f"{camera}/names", (rr.Points3D.from_fields(radii=small, show_labels=True),)
        yield f"{camera}/ties", (rr.LineStrips3D.from_fields(radii=thin),)
        yield f"{camera}/grid", (rr.LineStrips3D.from_fields(radii=thin, colors=GRID_COLOUR),)
        bar = rr.LineStrips3D.from_fields(
            radii=rr.Radius.ui_points(1.5), colors=TEXT_COLOUR, show_labels=True
        )
        yield f"{camera}/scale", (bar,)
        arrows = rr.Arrows3D.from_fields(radii=rr.Radius.ui_points(2.0))
        yield f"{camera}/out_of_view", (arrows,)
    yield from _ground(ground(scene.paths))
    for plot in (plot for row in tabs for plot in row):
        yield from _axes(plot)


def _aircraft(
    name: str, drawing: AirframeDrawing, paint: Colour, size: float, alpha: int
) -> Iterator[Entity]:
    at, trim = f"world/aircraft/{name}", secondary_colour(paint)
    yield f"{at}/drawn", (rr.Transform3D(scale=size),)
    yield f"{at}/drawn/body", (painted(drawing.body, paint, trim, alpha),)
    if drawing.disc is not None:
        yield f"{at}/drawn/disc", (painted(drawing.disc, paint, trim, min(alpha, DISC_ALPHA)),)
    for surface in drawing.control_surfaces:
        hinge = rr.Transform3D(translation=surface.hinge)
        yield f"{at}/drawn/{surface.name}", (painted(surface.mesh, paint, trim, alpha), hinge)
    marker = rr.Points3D([0.0, 0.0, 0.0], radii=rr.Radius.ui_points(3.5), colors=paint)
    yield f"{at}/marker", (marker,)
    # the points of a trail come later
    line = rr.LineStrips3D.from_fields(colors=paint, radii=rr.Radius.ui_points(1.0))
    yield f"world/trails/{name}", (line,)


def _ground(area: Ground) -> Iterator[Entity]:
    def lines(
        strips: Sequence[Array], colour: Colour, points: float = 0.5
    ) -> tuple[rr.LineStrips3D]:
        return (rr.LineStrips3D(strips, radii=rr.Radius.ui_points(points), colors=colour),)

    yield "world/ground/soil", (_soil(0.5 * (area.low + area.high)),)
    yield "world/ground/grid", lines(area.lines, GRID_COLOUR)
    if area.fine:
        yield "world/ground/fine", lines(area.fine, mix(GRID_COLOUR, SOIL, 0.6), 0.4)
    if area.paths:
        shadows = [path * [1.0, 1.0, 0.0] for path in area.paths]
        yield "world/paths/line", lines(area.paths, PATH_COLOUR, 0.8)
        yield "world/paths/shadow", lines(shadows, GRID_COLOUR)
        yield "world/paths/posts", lines(tuple(area.posts), GRID_COLOUR)
    small = rr.Radius.ui_points(0.1)
    scale = rr.Points3D(area.label_positions, labels=area.labels, radii=small, colors=GRID_COLOUR)
    yield "world/ground/scale", (scale,)


def _soil(middle: Array) -> rr.Mesh3D:
    """Draw the ground as rings around the middle (2,) of a flight, in haze far away."""
    angle = np.linspace(0.0, 2.0 * np.pi, RING_POINTS, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
    vertices = [np.array([[*middle, BELOW_GRID]])]
    vertices += [vertices[0] + radius * ring for radius, _ in RINGS]
    colours = [SOIL, *(mix(SOIL, HAZE, share) for _, share in RINGS for _ in angle)]
    k, following = np.arange(RING_POINTS), np.roll(np.arange(RING_POINTS), -1)
    triangles = [np.stack([np.zeros_like(k), 1 + k, 1 + following], axis=-1)]
    for inner in range(len(RINGS) - 1):
        a, b = 1 + RING_POINTS * inner + k, 1 + RING_POINTS * inner + following
        triangles += [np.stack([a, a + RING_POINTS, b], axis=-1)]
        triangles += [np.stack([b, a + RING_POINTS, b + RING_POINTS], axis=-1)]
    return rr.Mesh3D(
        vertex_positions=np.concatenate(vertices),
        triangle_indices=np.concatenate(triangles),
        vertex_colors=colours,
    )


def _axes(plot: plots.TimePlot) -> Iterator[Entity]:
    for series in plot.series:
        lines = rr.SeriesLines(colors=series.colours, names=series.labels, widths=series.width)
        yield f"plots/{plot.name}/{series.name}", (lines,)
    if plot.constants:
        # Transparent lines at the ends of the minimum range extend the axis. They have the name of
        # a series, so that the legend, which merges equal names, does not list them.
        unseen = len(plot.constants) - len(plot.limits)
        names = [name for name, _ in plot.limits] + [plot.series[0].labels[0]] * unseen
        colours = [(*plots.LIMIT, 255)] * len(plot.limits) + [(0, 0, 0, 0)] * unseen
        yield (
            f"plots/{plot.name}/limits",
            (rr.SeriesLines(colors=colours, names=names, widths=1.0),),
        )


def painted(mesh: Mesh, paint: Colour, trim: Colour, alpha: int = 255) -> rr.Mesh3D:
    """Colour a mesh for an aircraft."""
    return rr.Mesh3D(
        vertex_positions=mesh.vertices,
        triangle_indices=mesh.triangles,
        vertex_normals=vertex_normals(mesh),
        vertex_colors=paint_colours(paint, trim)[mesh.paint],
        albedo_factor=(255, 255, 255, alpha),
    )
