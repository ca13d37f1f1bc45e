"""Make triangle meshes: lofted bodies, lifting surfaces, wheels, discs.

Body axes (x forward, y right, z down), metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array

Triangles = NDArray[np.uint32]

MAIN, LIGHT, DARK = range(3)  # paints: the aircraft's colour, nearly white, nearly black


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles with a paint number per vertex."""

    vertices: Array  # (v, 3) m
    triangles: Triangles  # (t, 3)
    paint: NDArray[np.uint8]  # (v,)


def join(*parts: Mesh) -> Mesh:
    """Join meshes into one."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate(
            [part.triangles + np.uint32(k) for part, k in zip(parts, starts, strict=True)]
        ),
        np.concatenate([part.paint for part in parts]),
    )


def move(mesh: Mesh, by: Array) -> Mesh:
    """Move a mesh by a vector (3,), m."""
    return Mesh(mesh.vertices + by, mesh.triangles, mesh.paint)


def loft(rings: Array, paint: int) -> Mesh:
    """Loft a closed skin through rings (m, k, 3) of points, with flat caps at both ends.

    Faces point outward. The caps have their own vertices, so that their edges stay sharp.
    """
    count, around = rings.shape[:2]
    index = np.arange(count * around).reshape(count, around)
    a, b = index[:-1], index[1:]
    a_next, b_next = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    skin = np.stack([np.stack([a, b, b_next], -1), np.stack([a, b_next, a_next], -1)], axis=2)
    first, last = index[-1, -1] + 1, index[-1, -1] + 1 + around
    fan = np.stack([np.zeros(around - 2, int), np.arange(1, around - 1), np.arange(2, around)], -1)
    vertices = np.concatenate([rings.reshape(-1, 3), rings[0], rings[-1]])
    triangles = np.concatenate([skin.reshape(-1, 3), fan + first, fan[:, ::-1] + last])
    p, q, r = np.moveaxis(vertices[triangles] - vertices.mean(axis=0), 1, 0)
    if np.einsum("ij,ij->", p, np.cross(q, r)) < 0.0:  # the rings run the other way: inside out
        triangles = triangles[:, ::-1]
    paints = np.full(len(vertices), paint, np.uint8)
    return Mesh(vertices, triangles.astype(np.uint32), paints)


def fuselage(stations: Array, paint: int, around: int = 20) -> Mesh:
    """Loft a body along x through stations (m, 5): x, half width, half height, centre z, exponent.

    Cross-sections are superellipses: exponent 2 is an ellipse, larger ones are rounded boxes.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    x, width, height, centre, exponent = stations.T[..., None]
    c, s = np.cos(angle), np.sin(angle)
    y = width * np.sign(c) * np.abs(c) ** (2.0 / exponent)
    z = centre + height * np.sign(s) * np.abs(s) ** (2.0 / exponent)
    return loft(np.stack([np.broadcast_to(x, y.shape), y, z], axis=-1), paint)


def surface(sections: Array, paint: int, thickness: float = 0.11) -> Mesh:
    """Loft a lifting surface through sections (m, 4): leading edge x, y, z and chord.

    Its thickness, relative to the chord, is along z for a wing and along y for a fin, which is
    a surface with more extent in z than in y.
    """
    u = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, 9)))  # chordwise, dense at the leading edge
    half = (
        5.0
        * thickness
        * (0.2969 * np.sqrt(u) - 0.1260 * u - 0.3516 * u**2 + 0.2843 * u**3 - 0.1036 * u**4)
    )
    along = np.concatenate([u, u[-2:0:-1]])
    across = np.concatenate([half, -half[-2:0:-1]])
    spread = np.ptp(sections[:, 1]) >= np.ptp(sections[:, 2])
    edge, chord = sections[:, None, :3], sections[:, None, 3]
    rings = np.repeat(edge, len(along), axis=1)
    rings[..., 0] -= along * chord
    rings[..., 2 if spread else 1] -= across * chord
    return loft(rings, paint)


def disc(centre: tuple[float, float, float], radius: float, around: int = 32) -> Mesh:
    """Make a flat disc perpendicular to x."""
    angle = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    rim = np.stack([np.zeros(around), np.cos(angle), np.sin(angle)], axis=-1) * radius
    k = np.arange(around)
    return Mesh(
        np.concatenate([[centre], rim + centre]),
        np.stack([np.zeros(around, int), 1 + k, 1 + (k + 1) % around], -1).astype(np.uint32),
        np.full(around + 1, LIGHT, np.uint8),
    )


def rod(start: tuple[float, float, float], end: tuple[float, float, float], radius: float) -> Mesh:
    """Make a strut between two points that differ in z."""
    angle = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    ring = radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(8)], axis=-1)
    return loft(np.stack([ring + start, ring + end]), DARK)


def wheel(centre: tuple[float, float, float], radius: float, width: float) -> Mesh:
    """Make a wheel that rolls along x."""
    angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    rim = radius * np.stack([np.cos(angle), np.zeros(16), np.sin(angle)], axis=-1) + centre
    side = np.array([0.0, width / 2.0, 0.0])
    return loft(np.stack([rim - side, rim + side]), DARK)


def wing(half: Array, paint: int) -> Mesh:
    """Make a whole wing from the sections (m, 4) of its right half, root first."""
    left = mirror(half[::-1])
    root_shared = half[1:] if half[0, 1] == 0.0 else half
    return surface(np.concatenate([left, root_shared]), paint)


def mirror(sections: Array) -> Array:
    """Mirror sections (m, 4) to the other side of the aircraft."""
    return sections * [1.0, -1.0, 1.0, 1.0]


def cut_control_surface(
    sections: Array, inner: float, outer: float, share: float
) -> tuple[Array, Array]:
    """Cut a control surface out of the trailing edge of a lifting surface.

    Args:
        sections: (m, 4) as in `surface`, ordered by distance from the first.
        inner: start of the control surface, as a fraction of the span of the sections.
        outer: end of the control surface, likewise.
        share: fraction of the chord that moves.

    Returns:
        The sections of the fixed part, and those (k, 4) of the control surface, whose first and
        last leading edges are the ends of the hinge.
    """
    along = np.linalg.norm(sections[:, 1:3] - sections[0, 1:3], axis=-1)
    along = along / along[-1]

    def at(where: Array) -> Array:
        return np.stack([np.interp(where, along, sections[:, k]) for k in range(4)], axis=-1)

    between = along[(along > inner) & (along < outer)]
    moving = at(np.array([inner, *between, outer]))
    shortened = moving * [1.0, 1.0, 1.0, 1.0 - share]
    edges = at(np.array([inner, outer]))
    fixed = [sections[along < inner], edges[:1], shortened, edges[1:], sections[along > outer]]
    moving[:, 0] -= (1.0 - share) * moving[:, 3]
    moving[:, 3] *= share
    return np.concatenate(fixed), moving


def vertex_normals(mesh: Mesh) -> Array:
    """Compute unit normals (v, 3) at the vertices, averaged over the faces by area."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    face = np.cross(b - a, c - a)
    out = np.zeros_like(mesh.vertices)
    for corner in range(3):
        np.add.at(out, mesh.triangles[:, corner], face)
    length = np.linalg.norm(out, axis=-1, keepdims=True)
    return out / np.where(length > 0.0, length, 1.0)
