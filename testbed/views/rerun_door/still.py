"""The entities that stand still, or whose looks are said once and whose places come later."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr

from testbed.state import Array
from testbed.views import layout, plots, scene
from testbed.views.airframes import Airframe
from testbed.views.meshes import DARK, LIGHT, MAIN, Mesh, normals
from testbed.views.rerun_door.blueprint import GRID
from testbed.views.scene import BACKDROP, Scene

PATH = (165, 165, 170)
WIND, BELIEF = (255, 150, 190), (255, 255, 255)  # no colour of an aircraft
GHOST_ALPHA, DISC_ALPHA = 60, 70  # of 255

Entity = tuple[str, tuple[rr.AsComponents, ...]]  # its path, and what it is


def stills(
    still: Scene,
    drawings: Sequence[Airframe],
    frame: layout.Framing,
    tabs: Sequence[Sequence[plots.Plot]],
) -> Iterator[Entity]:
    """Everything that is said once of a run.

    Args:
        still: of N aircraft.
        drawings: N
        frame: how large they are drawn.
        tabs: what is plotted.
    """
    yield "world", (rr.ViewCoordinates.FRD,)
    for name, drawing, paint in zip(still.names, drawings, still.colours, strict=True):
        yield from _aircraft(name, drawing, paint, frame.size)
    for row in still.followers:
        faded = scene.mixed(still.colours[row], BACKDROP, 0.5)
        ghost = painted(drawings[row].body, faded, faded, GHOST_ALPHA)
        drawn = f"world/slots/{still.names[row]}/drawn"
        yield drawn, (rr.Transform3D(scale=frame.size), ghost)
    arrows = rr.Arrows3D.from_fields(colors=WIND, radii=rr.Radius.ui_points(1.2))
    yield "world/chase/wind", (arrows,)
    points = rr.Points3D.from_fields(colors=BELIEF, radii=rr.Radius.ui_points(3.0))
    yield "world/chase/believed", (points,)
    if len(still.names) > layout.MOST_NAMED:
        above = rr.Points3D.from_fields(radii=rr.Radius.ui_points(0.1), show_labels=True)
        yield "world/chase/worst", (above,)
    yield from _ground(scene.ground(still.paths))
    for plot in (plot for row in tabs for plot in row):
        yield from _axes(plot)


def _aircraft(name: str, drawing: Airframe, paint: scene.Colour, size: float) -> Iterator[Entity]:
    at, trim = f"world/aircraft/{name}", scene.trim(paint)
    yield f"{at}/drawn", (rr.Transform3D(scale=size),)
    yield f"{at}/drawn/body", (painted(drawing.body, paint, trim),)
    if drawing.disc is not None:
        yield f"{at}/drawn/disc", (painted(drawing.disc, paint, trim, DISC_ALPHA),)
    for flap in drawing.flaps:
        place = rr.Transform3D(translation=flap.hinge)
        yield f"{at}/drawn/{flap.name}", (painted(flap.mesh, paint, trim), place)
    marker = rr.Points3D([0.0, 0.0, 0.0], radii=rr.Radius.ui_points(3.5), colors=paint)
    yield f"{at}/marker", (marker,)
    above = [0.0, 0.0, -0.3 * size * np.ptp(drawing.body.vertices[:, 1])]
    small = rr.Radius.ui_points(0.1)
    yield f"{at}/name", (rr.Points3D(above, radii=small, colors=paint, labels=name),)
    # Only the points of a trail come with every stretch.
    line = rr.LineStrips3D.from_fields(colors=paint, radii=rr.Radius.ui_points(1.0))
    yield f"world/trails/{name}", (line,)


def _ground(area: scene.Ground) -> Iterator[Entity]:
    def lines(
        strips: Sequence[Array], colour: scene.Colour, points: float = 0.5
    ) -> tuple[rr.LineStrips3D]:
        return (rr.LineStrips3D(strips, radii=rr.Radius.ui_points(points), colors=colour),)

    yield "world/ground/grid", lines(area.lines, GRID)
    if area.paths:
        shadows = [path * [1.0, 1.0, 0.0] for path in area.paths]
        yield "world/paths/line", lines(area.paths, PATH, 0.8)
        yield "world/paths/shadow", lines(shadows, GRID)
        yield "world/paths/posts", lines(tuple(area.posts), GRID)
    small = rr.Radius.ui_points(0.1)
    scale = rr.Points3D(area.label_positions, labels=area.labels, radii=small, colors=GRID)
    yield "world/ground/scale", (scale,)


def _axes(plot: plots.Plot) -> Iterator[Entity]:
    for series in plot.series:
        lines = rr.SeriesLines(colors=series.colours, names=series.labels, widths=series.width)
        yield f"plots/{plot.name}/{series.name}", (lines,)
    if plot.still:
        # Two lines that nobody sees make the axis show what lies between them. A legend, in which
        # equal names are one, has nothing to add for them.
        unseen = len(plot.still) - len(plot.limits)
        names = [name for name, _ in plot.limits] + [plot.series[0].labels[0]] * unseen
        colours = [(*plots.LIMIT, 255)] * len(plot.limits) + [(0, 0, 0, 0)] * unseen
        yield (
            f"plots/{plot.name}/limits",
            (rr.SeriesLines(colors=colours, names=names, widths=1.0),),
        )


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
