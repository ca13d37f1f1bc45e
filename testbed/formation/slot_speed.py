"""How fast the slots move over the ground: the ‖q̇_g + χ̇_i‖ of [HBH23] Assumption 1."""

from __future__ import annotations

import numpy as np

from testbed.formation.arrays import cross, dot, norm
from testbed.formation.geometry import frame_rate
from testbed.state import Array

ANGLES = 61  # flight-path angles tried, level among them
FORWARD = np.array([1.0, 0.0, 0.0])


def slot_speed(velocity: Array, rate: Array, offsets: Array) -> Array:
    """‖q̇_g + χ̇_i‖ (K, n) m/s along a leader's path, [HBH23] eqs. (26)-(28).

    Args:
        velocity: q̇_g (K, 3) m/s, NED.
        rate: ω_g (K, 3) rad/s in the leader's velocity frame, as `geometry.frame_rate` has it.
        offsets: υ (n, 3) m in the leader's velocity frame.
    """
    turning = cross(rate, np.broadcast_to(offsets, (len(rate), *offsets.shape)))
    return norm(norm(velocity)[:, None, None] * FORWARD + turning)


def slot_speed_range(
    offsets: Array,
    *,
    speed_min: float,
    speed_max: float,
    turn_rate: float,
    climb_angle: float = 0.0,
    climb_rate: float = 0.0,
) -> tuple[Array, Array]:
    """Smallest and largest ‖q̇_g + χ̇_i‖ (n,) m/s that a leader within these limits can ask for.

    In the leader's frame the slot moves at w = v e1 + ω_g × υ with
    ω_g = (−σ̇ sin γ, γ̇, σ̇ cos γ), (26). For one γ the second part runs over a parallelogram
    around zero as σ̇ and γ̇ run over their ranges, so both the least and the largest ‖w‖ grow with
    v. ‖w‖ is convex: it is largest in a corner, and smallest in a corner, on an edge or where its
    gradient vanishes. γ is tried on a grid. In a level turn this is
    v ± |σ̇ υ_2| forward and |σ̇ υ_1| across.

    Args:
        offsets: υ (n, 3) m: forward, right, down in the leader's velocity frame.
        speed_min: smallest ‖q̇_g‖, m/s over the ground.
        speed_max: largest ‖q̇_g‖, m/s over the ground.
        turn_rate: largest |σ̇_g|, rad/s.
        climb_angle: largest |γ_g|, rad.
        climb_rate: largest |γ̇_g|, rad/s.
    """
    gamma = np.linspace(-climb_angle, climb_angle, ANGLES)
    ones, zeros = np.ones(ANGLES), np.zeros(ANGLES)
    upsilon = np.broadcast_to(offsets, (ANGLES, *offsets.shape))
    a = turn_rate * cross(frame_rate(gamma, ones, zeros), upsilon)
    b = climb_rate * cross(frame_rate(gamma, zeros, ones), upsilon)
    fastest = np.maximum(norm(speed_max * FORWARD + a + b), norm(speed_max * FORWARD + a - b))
    fastest = np.maximum(fastest, norm(speed_max * FORWARD - a + b))
    fastest = np.maximum(fastest, norm(speed_max * FORWARD - a - b))
    return _shortest(speed_min * FORWARD, a, b).min(axis=0), fastest.max(axis=0)


def _shortest(base: Array, a: Array, b: Array) -> Array:
    """The smallest ‖base + x a + y b‖ (...) over x and y in [−1, 1], of vectors (..., 3)."""
    edges = [
        norm(start + _along(start, side)[..., None] * side)
        for start, side in ((base + b, a), (base - b, a), (base + a, b), (base - a, b))
    ]
    # Where both slopes vanish, if that is within reach; parallel a and b leave it to the edges.
    aa, ab, bb = dot(a, a), dot(a, b), dot(b, b)
    determinant = aa * bb - ab * ab
    regular = determinant > 1e-12 * aa * bb
    divisor = np.where(regular, determinant, 1.0)
    x = (ab * dot(b, base) - bb * dot(a, base)) / divisor
    y = (ab * dot(a, base) - aa * dot(b, base)) / divisor
    within = regular & (np.abs(x) <= 1.0) & (np.abs(y) <= 1.0)
    inner = np.where(within, norm(base + x[..., None] * a + y[..., None] * b), np.inf)
    shortest: Array = np.minimum(inner, np.min(edges, axis=0))
    return shortest


def _along(start: Array, side: Array) -> Array:
    """The t (...) in [−1, 1] that makes ‖start + t side‖ smallest, of vectors (..., 3)."""
    square = dot(side, side)
    t = -dot(start, side) / np.where(square > 0.0, square, 1.0)
    return np.clip(t, -1.0, 1.0)
