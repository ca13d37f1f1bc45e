"""Loss that depends on positions and attitudes: distance, and shadowing by airframes.

An antenna below an airframe is shadowed above the plane of the wings. How far past that plane the
other aircraft is, seen from either end of a link, gives a probability of loss each; distance gives
a third. They are independent.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.frames import rotation_ned_body
from testbed.core.records import Array
from testbed.network.links import PairLinks

NEAREST = 1e-9  # m; nearer than this there is no line of sight to have an angle

Curve = tuple[tuple[float, float], ...]  # abscissa and probability, in rising order


class Curves(NamedTuple):
    """Probabilities of loss on the links between N aircraft and n followers; -1: none."""

    by_distance: tuple[Array, ...]  # (2, points) each: m, probability
    by_angle: tuple[Array, ...]  # (2, points) each: rad, probability
    distance: NDArray[np.int64]  # (n, N) index into `by_distance`
    angle: NDArray[np.int64]  # (n, N) index into `by_angle`
    side: Array  # (n, N) of the airframe the antennas are on: 1 below, -1 above


def make_curves(pairs: PairLinks) -> Curves | None:
    """Make the curves of a scenario's links; None if no link fades.

    Args:
        pairs: the links of N aircraft.
    """
    shape = pairs.numbers.shape
    distance, angle, side = np.full(shape, -1), np.full(shape, -1), np.ones(shape)
    by_distance: dict[Curve, int] = {}
    by_angle: dict[Curve, int] = {}
    for i, m, link in pairs.pairs():
        if link.range_loss:
            distance[i, m] = by_distance.setdefault(link.range_loss, len(by_distance))
        if link.shadowing is not None and link.shadowing.loss:
            angle[i, m] = by_angle.setdefault(link.shadowing.loss, len(by_angle))
            side[i, m] = 1.0 if link.shadowing.antenna == "below" else -1.0
    if not (by_distance or by_angle):
        return None
    metres = tuple(np.array(curve).T for curve in by_distance)
    radians = tuple(np.array([[np.radians(x), p] for x, p in curve]).T for curve in by_angle)
    return Curves(metres, radians, distance, angle, side)


def fading(position_ned: Array, euler: Array, curves: Curves) -> Array:
    """Return the probability (n, N) that a message is lost to distance or an airframe.

    Args:
        position_ned: (N, 3) m.
        euler: (N, 3) roll, pitch, yaw, rad.
        curves: of the links to the n followers, rows 1 to n of these.
    """
    sight = position_ned[1:, None] - position_ned  # (n, N, 3) from the sender to the receiver
    length = np.sqrt(np.sum(sight * sight, axis=-1))
    passes = 1.0 - _interpolate(curves.by_distance, curves.distance, length)
    if curves.by_angle:
        down = rotation_ned_body(euler)[..., 2]  # (N, 3) the body's z axis
        unit = sight / np.maximum(length, NEAREST)[..., None]
        for axis, sign in ((down, -1.0), (down[1:, None], 1.0)):  # from the sender; the receiver
            height = sign * curves.side * np.sum(unit * axis, axis=-1)
            past = np.arcsin(np.clip(height, -1.0, 1.0))
            passes *= 1.0 - _interpolate(curves.by_angle, curves.angle, past)
    return 1.0 - passes


def _interpolate(curves: tuple[Array, ...], index: NDArray[np.int64], abscissa: Array) -> Array:
    """Return the probability (n, N) by each link's curve; 0: no curve."""
    out = np.zeros(index.shape)
    for number, (x, probability) in enumerate(curves):
        chosen = index == number
        out[chosen] = np.interp(abscissa[chosen], x, probability)
    return out
