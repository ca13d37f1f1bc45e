"""Foxglove's messages: their schemas, events, and what a 3D panel draws.

The only module that imports foxglove. Messages and their fields:
https://docs.foxglove.dev/docs/visualization/message-schemas.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from foxglove import messages
from numpy.typing import NDArray

from testbed.core.records import Array, Event
from testbed.logs.message_batch import Schema

_NS = 10**9
Colour = tuple[int, int, int]  # red, green, blue, 0..255
Entity: TypeAlias = messages.SceneEntity
Point: TypeAlias = messages.Point3
Triangles: TypeAlias = messages.TriangleListPrimitive


def _schema(message_type: Any) -> Schema:  # noqa: ANN401 - a class of foxglove.messages
    schema = message_type.get_schema()
    return Schema(schema.name, schema.data)


TRANSFORMS = _schema(messages.FrameTransforms)
FIX = _schema(messages.LocationFix)
LOG = _schema(messages.Log)
SCENE = _schema(messages.SceneUpdate)


def encode_event(event: Event, time_ns: int) -> bytes:
    """Encode an event as foxglove.Log of a time."""
    line = messages.Log(
        timestamp=_timestamp(time_ns),
        level=getattr(messages.LogLevel, event.level.title(), messages.LogLevel.Unknown),
        message=event.text,
        name=event.source,
    )
    return line.encode()


def scene_update(entities: Sequence[Entity], *, alone_from_ns: int | None = None) -> bytes:
    """Encode entities that replace those of the same ids.

    Args:
        entities: to draw.
        alone_from_ns: a time from which the topic has no other entities; None: it keeps them.
    """
    deletions = []
    if alone_from_ns is not None:
        everything = messages.SceneEntityDeletionType.All
        deletions.append(
            messages.SceneEntityDeletion(timestamp=_timestamp(alone_from_ns), type=everything)
        )
    return messages.SceneUpdate(deletions=deletions, entities=list(entities)).encode()


def entity(
    name: str,
    frame: str,
    time_ns: int,
    *,
    lines: Sequence[messages.LinePrimitive] = (),
    triangles: Sequence[messages.TriangleListPrimitive] = (),
    texts: Sequence[messages.TextPrimitive] = (),
    arrows: Sequence[messages.ArrowPrimitive] = (),
    spheres: Sequence[messages.SpherePrimitive] = (),
) -> Entity:
    """Make an entity that moves with its frame and is drawn until it is replaced."""
    return messages.SceneEntity(
        timestamp=_timestamp(time_ns),
        frame_id=frame,
        id=name,
        frame_locked=True,
        lines=list(lines),
        triangles=list(triangles),
        texts=list(texts),
        arrows=list(arrows),
        spheres=list(spheres),
    )


def points(positions: Array) -> list[Point]:
    """Make points of positions (k, 3), m."""
    return [messages.Point3(x=x, y=y, z=z) for x, y, z in positions.tolist()]


def line_strip(along: Sequence[Point], colour: Colour, pixels: float) -> messages.LinePrimitive:
    """Make a line through points, some pixels wide."""
    return messages.LinePrimitive(
        type=messages.LinePrimitiveLineType.LineStrip,
        pose=_pose(np.zeros(3)),
        thickness=pixels,
        scale_invariant=True,
        points=list(along),
        color=_colour(colour),
    )


def line_list(
    strips: Array, colours: NDArray[np.uint8] | Colour, pixels: float
) -> messages.LinePrimitive:
    """Make S separate lines.

    Args:
        strips: (S, 2, 3) m, their ends.
        colours: (S, 3), or one of all.
        pixels: their width.
    """
    each = np.broadcast_to(np.asarray(colours), (len(strips), 3)).tolist()
    return messages.LinePrimitive(
        type=messages.LinePrimitiveLineType.LineList,
        pose=_pose(np.zeros(3)),
        thickness=pixels,
        scale_invariant=True,
        points=points(strips.reshape(-1, 3)),
        colors=[shade for colour in each for shade in 2 * [_colour(colour)]],
    )


def triangle_list(
    vertices: Array, triangles: NDArray[np.uint32], colour: Colour, alpha: float = 1.0
) -> messages.TriangleListPrimitive:
    """Make a surface of triangles (t, 3) of vertices (v, 3), m."""
    return messages.TriangleListPrimitive(
        pose=_pose(np.zeros(3)),
        points=points(vertices),
        color=_colour(colour, alpha),
        indices=triangles.ravel().tolist(),
    )


def text(words: str, position: Array, colour: Colour, height_m: float) -> messages.TextPrimitive:
    """Make a text that faces the camera."""
    return messages.TextPrimitive(
        pose=_pose(position),
        billboard=True,
        font_size=height_m,
        color=_colour(colour),
        text=words,
    )


def arrow(
    position: Array, quaternion: Array, length: float, colour: Colour
) -> messages.ArrowPrimitive:
    """Make an arrow along the x axis of a rotation."""
    return messages.ArrowPrimitive(
        pose=_pose(position, quaternion),
        shaft_length=0.75 * length,
        shaft_diameter=0.05 * length,
        head_length=0.25 * length,
        head_diameter=0.15 * length,
        color=_colour(colour),
    )


def sphere(position: Array, diameter: float, colour: Colour) -> messages.SpherePrimitive:
    """Make a sphere."""
    return messages.SpherePrimitive(
        pose=_pose(position),
        size=messages.Vector3(x=diameter, y=diameter, z=diameter),
        color=_colour(colour),
    )


def _timestamp(time_ns: int) -> messages.Timestamp:
    return messages.Timestamp(sec=time_ns // _NS, nsec=time_ns % _NS)


def _pose(position: Array, quaternion: Array | None = None) -> messages.Pose:
    x, y, z = (float(each) for each in position)
    turned = (0.0, 0.0, 0.0, 1.0) if quaternion is None else (float(each) for each in quaternion)
    rotation = dict(zip("xyzw", turned, strict=True))
    return messages.Pose(
        position=messages.Vector3(x=x, y=y, z=z), orientation=messages.Quaternion(**rotation)
    )


def _colour(colour: Sequence[int], alpha: float = 1.0) -> messages.Color:
    red, green, blue = (each / 255.0 for each in colour)
    return messages.Color(r=red, g=green, b=blue, a=alpha)
