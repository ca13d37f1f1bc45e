"""Resolve vectors in the zero-roll velocity frame, [HBH23] eqs. (22)-(26)."""

from __future__ import annotations

from math import cos, hypot, sin, sqrt

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.frames import COURSE_FLOOR
from testbed.core.records import Array, Record, Values, Vector


@kernel
def frame_angles(x: float, y: float, z: float) -> Values:
    """Return cos σ, sin σ, cos γ, sin γ of a velocity in NED, (22)-(24)."""
    horizontal = hypot(x, y)
    speed = hypot(horizontal, z)
    cs, ss = (x / horizontal, y / horizontal) if horizontal > COURSE_FLOOR else (1.0, 0.0)
    return cs, ss, horizontal / speed, -z / speed


@kernel
def to_ned(frame: Vector, x: float, y: float, z: float) -> Values:
    """Resolve a vector of the velocity frame in NED: R(σ, γ) (x, y, z)."""
    cs, ss, cg, sg = frame
    return cg * cs * x - ss * y + sg * cs * z, cg * ss * x + cs * y + sg * ss * z, -sg * x + cg * z


@kernel
def from_ned(frame: Vector, x: float, y: float, z: float) -> Values:
    """Resolve a vector of NED in the velocity frame: R(σ, γ)ᵀ (x, y, z)."""
    cs, ss, cg, sg = frame
    return cg * cs * x + cg * ss * y - sg * z, cs * y - ss * x, sg * cs * x + sg * ss * y + cg * z


def velocity_frame(velocity: Array) -> Array:
    """Return R(σ, γ) (n, 3, 3), (24), of velocities (n, 3), m/s.

    Its columns are forward along the velocity, right in the horizontal, and down.
    """
    out = np.empty((len(velocity), 3, 3))
    write_frames(np.ascontiguousarray(velocity, dtype=np.float64), out)
    return out


@entry
def write_frames(velocity: Array, out: Array) -> None:
    """Write R(σ, γ) (n, 3, 3) of velocities (n, 3), m/s; see `velocity_frame`."""
    for i in range(len(out)):
        cs, ss, cg, sg = frame_angles(velocity[i, 0], velocity[i, 1], velocity[i, 2])
        out[i, 0, 0], out[i, 0, 1], out[i, 0, 2] = cg * cs, -ss, sg * cs
        out[i, 1, 0], out[i, 1, 1], out[i, 1, 2] = cg * ss, cs, sg * ss
        out[i, 2, 0], out[i, 2, 1], out[i, 2, 2] = -sg, 0.0, cg


@kernel
def cross(a: Record, b: float, c: float, x: float, y: float, z: float) -> Values:
    """Return (a, b, c) × (x, y, z)."""
    return b * z - c * y, c * x - a * z, a * y - b * x


@kernel
def frame_angular_velocity(gamma: float, chi_dot: float, gamma_dot: float) -> Values:
    """Return ω_g, rad/s, in the velocity frame, (26), of γ (rad), σ̇ and γ̇ (rad/s)."""
    return -chi_dot * sin(gamma), gamma_dot, chi_dot * cos(gamma)


@kernel
def frame_angular_acceleration(
    gamma: float, chi_dot: float, gamma_dot: float, chi_ddot: float
) -> Values:
    """Return ω̇_g, rad/s², the derivative of (26) where γ̈ is zero."""
    sine, cosine = sin(gamma), cos(gamma)
    return (
        -chi_ddot * sine - chi_dot * gamma_dot * cosine,
        0.0,
        chi_ddot * cosine - chi_dot * gamma_dot * sine,
    )


@kernel
def velocity_rates(v: Vector, a: Record) -> Values:
    """Return σ̇ and γ̇, rad/s, of a velocity (m/s) that changes at an acceleration (m/s²)."""
    along, across = v[0] * a[0] + v[1] * a[1], v[0] * a[1] - v[1] * a[0]
    square = max(v[0] * v[0] + v[1] * v[1], COURSE_FLOOR)
    horizontal = sqrt(square)
    gamma_dot = (v[2] * along / horizontal - horizontal * a[2]) / (square + v[2] * v[2])
    return across / square, gamma_dot
