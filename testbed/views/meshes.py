"""Meshes from a handful of numbers: lofted bodies, lifting surfaces, wheels, discs.

Body axes (x forward, y right, z down), metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.state import Array

Triangles = NDArray[np.uint32]

MAIN, LIGHT, DARK = range(3)  # paints: the aircraft's own colour, nearly white, nearly black


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles with a paint number per vertex."""

    vertices: Array  # (v, 3) m
    triangles: Triangles  # (t, 3)
    paint: NDArray[np.uint8]  # (v,)


def join(*parts: Mesh) -> Mesh:
    """One mesh of several."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate(
            [part.triangles + np.uint32(k) for part, k in zip(parts, starts, strict=True)]
        ),
        np.concatenate([part.paint for part in parts]),
    )


def loft(rings: Array, paint: int) -> Mesh:
    """A closed skin through rings (m, k, 3) of points, its two ends capped flat.

    Faces look outward. The caps have vertices of their own, so that their edges stay sharp.
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
    if np.einsum("ij,ij->", p, np.cross(q, r)) < 0.0:  # inside out: the rings ran the other way
        triangles = triangles[:, ::-1]
    paints = np.full(len(vertices), paint, np.uint8)
    return Mesh(vertices, triangles.astype(np.uint32), paints)


def body_of_revolution(stations: Array, paint: int, around: int = 20) -> Mesh:
    """A body along x through stations (m, 5): x, half width, half height, centre z, squareness.

    Squareness 2 is an ellipse, larger values are boxes with round corners.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    x, width, height, centre, square = stations.T[..., None]
    c, s = np.cos(angle), np.sin(angle)
    y = width * np.sign(c) * np.abs(c) ** (2.0 / square)
    z = centre + height * np.sign(s) * np.abs(s) ** (2.0 / square)
    return loft(np.stack([np.broadcast_to(x, y.shape), y, z], axis=-1), paint)


def surface(sections: Array, paint: int, thickness: float = 0.11) -> Mesh:
    """A lifting surface through sections (m, 4): leading edge x, y, z and chord.

    Its thickness, a share of the chord, stands on the surface: along z for a wing, along y for a
    fin (a surface that rises more than it spreads).
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
    """A flat disc across x."""
    angle = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    rim = np.stack([np.zeros(around), np.cos(angle), np.sin(angle)], axis=-1) * radius
    k = np.arange(around)
    return Mesh(
        np.concatenate([[centre], rim + centre]),
        np.stack([np.zeros(around, int), 1 + k, 1 + (k + 1) % around], -1).astype(np.uint32),
        np.full(around + 1, LIGHT, np.uint8),
    )


def rod(start: tuple[float, float, float], end: tuple[float, float, float], radius: float) -> Mesh:
    """A strut between two points that differ in z."""
    angle = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    ring = radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(8)], axis=-1)
    return loft(np.stack([ring + start, ring + end]), DARK)


def wheel(centre: tuple[float, float, float], radius: float, width: float) -> Mesh:
    """A wheel that rolls along x."""
    angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    rim = radius * np.stack([np.cos(angle), np.zeros(16), np.sin(angle)], axis=-1) + centre
    side = np.array([0.0, width / 2.0, 0.0])
    return loft(np.stack([rim - side, rim + side]), DARK)


def wing(half: Array, paint: int) -> Mesh:
    """Both halves of a wing from its right half's sections (m, 4), root first."""
    left = mirrored(half[::-1])
    root_shared = half[1:] if half[0, 1] == 0.0 else half
    return surface(np.concatenate([left, root_shared]), paint)


def mirrored(sections: Array) -> Array:
    """The same sections (m, 4) on the other side of the aircraft."""
    return sections * [1.0, -1.0, 1.0, 1.0]


def cut(sections: Array, inner: float, outer: float, share: float) -> tuple[Array, Array]:
    """A lifting surface without the control surface at its trailing edge, and that surface.

    Args:
        sections: (m, 4) as in `surface`, of growing distance from the first.
        inner: where the control surface begins, a share of the way from the first to the last.
        outer: where it ends.
        share: of the chord that moves.

    Returns:
        The sections that stay, and those (k, 4) of what moves; its first and last leading edges
        are the hinge.
    """
    way = np.linalg.norm(sections[:, 1:3] - sections[0, 1:3], axis=-1)
    way = way / way[-1]

    def at(where: Array) -> Array:
        return np.stack([np.interp(where, way, sections[:, k]) for k in range(4)], axis=-1)

    between = way[(way > inner) & (way < outer)]
    moving = at(np.array([inner, *between, outer]))
    shortened = moving * [1.0, 1.0, 1.0, 1.0 - share]
    edges = at(np.array([inner, outer]))
    fixed = [sections[way < inner], edges[:1], shortened, edges[1:], sections[way > outer]]
    moving[:, 0] -= (1.0 - share) * moving[:, 3]
    moving[:, 3] *= share
    return np.concatenate(fixed), moving


def normals(mesh: Mesh) -> Array:
    """Unit normals (v, 3) at the vertices: of the faces around each, weighted by area."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    face = np.cross(b - a, c - a)
    out = np.zeros_like(mesh.vertices)
    for corner in range(3):
        np.add.at(out, mesh.triangles[:, corner], face)
    length = np.linalg.norm(out, axis=-1, keepdims=True)
    return out / np.where(length > 0.0, length, 1.0)
