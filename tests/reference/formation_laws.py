"""The formation control itself, [HBH23] eqs. (6)-(15), over agents on the leading axis."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from reference.formation_arrays import dot, norm, scale
from reference.formation_barrier import h
from reference.formation_control_function import rho_and_rate
from reference.frames import velocity_frame
from testbed.core.records import Array, BoolArray
from testbed.formation.barrier import NO_BARRIER, SpeedBarrier
from testbed.formation.control_function import ControlFunction

# (14) divides by the slope of h outside the speed set. Where tanh has saturated that slope
# underflows to nothing; the guard on the commanded airspeed bounds what this floor lets through.
SLOPE_FLOOR = 1e-12


class SpeedSet(NamedTuple):
    """The speeds an agent may fly at: S = (min, max), and S_d, where its desired speed may lie."""

    min: Array  # s_lo (n,), m/s
    max: Array  # s_hi (n,), m/s
    desired_min: Array  # s_lo + ε (n,), m/s, with ε = κ − k ρ̄ by fact 1
    desired_max: Array  # s_hi − ε (n,), m/s


class Desired(NamedTuple):
    """The velocity an agent wants, and how it changes; speeds (n,), vectors (n, 3)."""

    speed: Array  # s_d, m/s
    speed_rate: Array  # ṡ_d, m/s²
    direction: Array  # y_d, unit vector
    direction_rate: Array  # ẏ_d, 1/s
    clamped: BoolArray  # (n,) s_d had to be put back into S_d


def formation_error(
    own: Array, own_slot: Array, others: Array, other_slots: Array, gains: Array
) -> Array:
    """ξ (n, 3), [HBH23] eq. (6); with velocities for positions, its time derivative.

    Args:
        own: q_i (n, 3).
        own_slot: χ_i (n, 3).
        others: (n, N, 3) estimates by agent i of aircraft m; aircraft 0 is the leader.
        other_slots: (n, N, 3) χ_m as agent i computes it; zero for the leader.
        gains: (n, N, 3) β_i for m = 0, β_ij for the others, diagonal per axis of NED.
    """
    relative = (others - other_slots) - np.expand_dims(own - own_slot, 1)
    error: Array = (gains * relative).sum(axis=1)
    return error


def desired_velocity(
    leader_velocity: Array,
    leader_acceleration: Array,
    slot_velocity: Array,
    slot_acceleration: Array,
    error: Array,
    error_rate: Array,
    k: Array,
    control_function: ControlFunction,
    speeds: SpeedSet,
) -> Desired:
    """p_d, its magnitude, direction and rates, [HBH23] eqs. (7)-(12); vectors (n, 3).

    The desired speed is clamped into S_d with its rate set to zero, which the proof assumes and
    an unreachable leader breaks; without it the denominator of (14) can change sign.
    """
    push, push_rate = rho_and_rate(control_function, error, error_rate)
    velocity = leader_velocity + slot_velocity + scale(k, push)
    acceleration = leader_acceleration + slot_acceleration + scale(k, push_rate)
    speed = norm(velocity)
    direction = scale(1.0 / speed, velocity)
    speed_rate = dot(direction, acceleration)
    direction_rate = scale(1.0 / speed, acceleration - scale(speed_rate, direction))
    inside = np.minimum(np.maximum(speed, speeds.desired_min), speeds.desired_max)
    clamped = inside != speed
    return Desired(inside, np.where(clamped, 0.0, speed_rate), direction, direction_rate, clamped)


def speed_control(
    speed: Array,
    desired: Desired,
    a: Array,
    b: Array,
    pole: Array,
    barrier: SpeedBarrier,
    speeds: SpeedSet,
) -> tuple[Array, BoolArray]:
    """The control u (n,) m/s, [HBH23] eq. (14), for f = −p s, g = p; and whether s is in S.

    Args:
        speed: s (n,), ground speed, m/s.
        desired: the desired speed and its rate.
        a: (n,) 1/s.
        b: (n,) s/m² inside S, dimensionless outside, as (14) has it.
        pole: p (n,), 1/s.
        barrier: h.
        speeds: S.

    Returns:
        u and a boolean array, true where s lies inside S.
    """
    height, slope = h(barrier, speed, speeds.min, speeds.max)
    gap = desired.speed - speed
    inside = (speed > speeds.min) & (speed < speeds.max)
    first_branch = inside | (barrier.example == NO_BARRIER)
    divisor = np.where(first_branch, height + gap * slope, 1.0)
    within = (b * gap**3 + desired.speed_rate * height + a * gap * height) / divisor
    outside = b * gap**2 / np.copysign(np.maximum(np.abs(slope), SLOPE_FLOOR), slope)
    return np.where(first_branch, within, outside) / pole + speed, inside


def turn_control(velocity: Array, desired: Desired, c: Array) -> tuple[Array, Array]:
    """e2ᵀω and e3ᵀω (n,) rad/s, [HBH23] eq. (15), in the zero-roll velocity frame.

    With y = R e1 the product Rᵀ [y]x w is e1 × Rᵀ w, so the first component is zero and the other
    two are components of w across the velocity.

    Args:
        velocity: q̇_i (n, 3), m/s.
        desired: the desired direction and its rate.
        c: (n,) 1/s.
    """
    frame = velocity_frame(velocity)
    pointing = frame[:, :, 0]
    w = scale(c - dot(pointing, desired.direction_rate), desired.direction) + scale(
        dot(pointing, desired.direction), desired.direction_rate
    )
    return -dot(frame[:, :, 2], w), dot(frame[:, :, 1], w)
