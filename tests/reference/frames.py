"""Rotation matrices with numpy, beside the kernels of `core.frames` and `core.velocity_frame`."""

from __future__ import annotations

import numpy as np

from testbed.core.frames import COURSE_FLOOR
from testbed.core.records import Array


def rotation_ned_body(euler: Array) -> Array:
    """Return R_NB (..., 3, 3) from roll, pitch, yaw (..., 3) in rad."""
    phi, theta, psi = np.moveaxis(np.asarray(euler), -1, 0)
    cf, sf = np.cos(phi), np.sin(phi)
    ct, st = np.cos(theta), np.sin(theta)
    cp, sp = np.cos(psi), np.sin(psi)
    out = np.empty((*np.shape(phi), 3, 3))
    out[..., 0, 0] = ct * cp
    out[..., 0, 1] = sf * st * cp - cf * sp
    out[..., 0, 2] = cf * st * cp + sf * sp
    out[..., 1, 0] = ct * sp
    out[..., 1, 1] = sf * st * sp + cf * cp
    out[..., 1, 2] = cf * st * sp - sf * cp
    out[..., 2, 0] = -st
    out[..., 2, 1] = sf * ct
    out[..., 2, 2] = cf * ct
    return out


def velocity_frame(velocity: Array) -> Array:
    """Return R(σ, γ) (n, 3, 3): the zero-roll velocity frame of velocities (n, 3), m/s.

    Its columns are forward along the velocity, right in the horizontal, and down.
    [HBH23] eqs. (22)-(24), with the angles' sines and cosines taken from the velocity itself.
    """
    north, east, down = velocity[:, 0], velocity[:, 1], velocity[:, 2]
    horizontal = np.hypot(north, east)
    speed = np.hypot(horizontal, down)
    upright = np.maximum(horizontal, COURSE_FLOOR)
    cs = np.where(horizontal > COURSE_FLOOR, north / upright, 1.0)
    ss = np.where(horizontal > COURSE_FLOOR, east / upright, 0.0)
    cg, sg = horizontal / speed, -down / speed
    out = np.zeros((len(velocity), 3, 3))
    out[:, 0, 0] = cg * cs
    out[:, 0, 1] = -ss
    out[:, 0, 2] = sg * cs
    out[:, 1, 0] = cg * ss
    out[:, 1, 1] = cs
    out[:, 1, 2] = sg * ss
    out[:, 2, 0] = -sg
    out[:, 2, 2] = cg
    return out
