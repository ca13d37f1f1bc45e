"""What a follower makes of its leader's messages: q̈_g and ω̇_g, [HBH23] sections 8 and 10."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from reference.formation_arrays import norm, scale
from testbed.core.frames import PAPER_GRAVITY, flight_path_angle
from testbed.core.records import Array

# Where q̈_g comes from.
NOTHING, BROADCAST, TURN = 0, 1, 2
# Where ω̇_g comes from, beside NOTHING.
ROLL_RATE, DIFFERENCE = 1, 2


class Memory(NamedTuple):
    """Memory of n followers for their leader and neighbours; nan: no message yet."""

    acceleration: Array  # (n, 3) m/s², averaged estimate of q̈_g
    time_s: Array  # (n,) of the newest message used, as the law takes it: of its stamp or receipt
    speed: Array  # (n,) m/s, then
    gamma: Array  # (n,) rad, then
    speed_rate: Array  # (n,) m/s², averaged
    gamma_dot: Array  # (n,) rad/s, averaged
    omega: Array  # (n, 3) rad/s, then
    omega_dot: Array  # (n, 3) rad/s², averaged
    # Start and own course of a leader timeout; nan: the leader has not timed out.
    timeout_since: Array  # (n,) s
    timeout_course: Array  # (n,) rad
    # Where each was in the leader's velocity frame when its last message was new, if the law holds
    # it there, and the time of that message; nan: never, and for the leader.
    held_position: Array  # (n, N, 3) m: forward, right, down
    held_time_s: Array  # (n, N)


def no_messages(n: int, aircraft: int) -> Memory:
    """The memory of n followers among so many aircraft before the first message."""
    never = np.full(n, np.nan)
    zero = np.zeros(n)
    nowhere, unsaid = np.full((n, aircraft, 3), np.nan), np.full((n, aircraft), np.nan)
    still, unknown = np.zeros((n, 3)), np.full((n, 3), np.nan)
    return Memory(
        still, never, never, never, zero, zero, unknown, still, never, never, nowhere, unsaid
    )


def differentiate(
    memory: Memory, time_s: Array, velocity: Array, blend: Array
) -> tuple[Array, Array, Array, Array]:
    """Speed and flight-path angle in the leader's message, and their averaged differences.

    Args:
        memory: of the step before.
        time_s: (n,) s, of the newest message.
        velocity: (n, 3) in it.
        blend: (n, 2) share of a new difference in the averages of ṡ_g and γ̇_g.

    Returns:
        s_g (n,) m/s, γ_g (n,) rad, ṡ_g (n,) m/s², γ̇_g (n,) rad/s.
    """
    speed, gamma = norm(velocity), flight_path_angle(velocity)
    since = time_s - memory.time_s
    fresh = since > 0.0  # false for the first message too: nan
    span = np.where(fresh, since, 1.0)
    speed_rate = memory.speed_rate + blend[:, 0] * (
        (speed - memory.speed) / span - memory.speed_rate
    )
    gamma_dot = memory.gamma_dot + blend[:, 1] * ((gamma - memory.gamma) / span - memory.gamma_dot)
    return (
        speed,
        gamma,
        np.where(fresh, speed_rate, memory.speed_rate),
        np.where(fresh, gamma_dot, memory.gamma_dot),
    )


def differentiate_rate(
    memory: Memory, time_s: Array, omega: Array, blend: Array
) -> tuple[Array, Array]:
    """ω_g (n, 3) rad/s to store and its averaged differences, ω̇_g (n, 3) rad/s².

    Args:
        memory: of the step before.
        time_s: (n,) s, of the newest message.
        omega: ω_g (n, 3) by that message.
        blend: (n,) share of a new difference in the average.
    """
    since = np.expand_dims(time_s - memory.time_s, 1)
    slope = (omega - memory.omega) / np.where(since > 0.0, since, 1.0)
    moved = memory.omega_dot + np.expand_dims(blend, 1) * (slope - memory.omega_dot)
    return (
        np.where(since <= 0.0, memory.omega, omega),
        np.where(since > 0.0, moved, memory.omega_dot),
    )


def turn_acceleration(
    frame: Array, speed: Array, gamma: Array, speed_rate: Array, gamma_dot: Array, euler: Array
) -> Array:
    """q̈_g (n, 3) m/s² of a coordinated turn: s_g Ṙ_g e1 + ṡ_g R_g e1, [HBH23] section 10.

    With σ̇_g ≈ g tan φ_g / (s_g cos θ_g), because the leader's rates are not broadcast there.

    Args:
        frame: R_g (n, 3, 3).
        speed: s_g (n,).
        gamma: γ_g (n,).
        speed_rate: ṡ_g (n,).
        gamma_dot: γ̇_g (n,).
        euler: the leader's roll, pitch, yaw (n, 3).
    """
    chi_dot = PAPER_GRAVITY * np.tan(euler[:, 0]) / (speed * np.cos(euler[:, 1]))
    return (
        scale(speed_rate, frame[:, :, 0])
        + scale(speed * chi_dot * np.cos(gamma), frame[:, :, 1])
        - scale(speed * gamma_dot, frame[:, :, 2])
    )


def course_acceleration(speed: Array, euler: Array, roll_rate: Array) -> Array:
    """σ̈_g (n,) rad/s² of a coordinated turn whose bank changes at `roll_rate` (n,).

    The derivative of σ̇_g ≈ g tan φ_g / (s_g cos θ_g) by the bank alone.
    """
    cosine = np.cos(euler[:, 0])
    rate: Array = PAPER_GRAVITY * roll_rate / (speed * np.cos(euler[:, 1]) * cosine * cosine)
    return rate
