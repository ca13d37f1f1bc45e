"""The middle loop, [HBH23] eqs. (19)-(21): from (u, ω) to a fly-by-wire-A command."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from testbed.formation.flags import Saturation
from testbed.frames import wrap_pi
from testbed.state import Array, FbwaCommand, Flags

PITCH, ROLL, THROTTLE = map(int, (Saturation.PITCH, Saturation.ROLL, Saturation.THROTTLE))
GRAVITY = 9.81  # m/s², as printed beside (20)


class MiddleLoopGains(NamedTuple):
    """Gains of n agents, every array (n,); angles in rad, throttle as a fraction of full."""

    climb_p: Array  # k_γp, rad per rad
    climb_i: Array  # k_γi, 1/s
    climb_d: Array  # k_γd, s
    course_p: Array  # k_σp, rad per rad
    course_i: Array  # k_σi, 1/s
    course_d: Array  # k_σd, s
    speed_p: Array  # k_sp, throttle per m/s
    speed_i: Array  # k_si, throttle per m
    eta_speed: Array  # η_s, throttle per m/s
    eta_bank: Array  # η_φ, throttle
    trim_throttle: Array  # η_0, throttle
    trim_airspeed: Array  # s_a0, m/s
    pitch_limit: Array  # rad
    roll_limit: Array  # rad


class MiddleLoopMemory(NamedTuple):
    """The three integrals of (19)-(21), (n,) each."""

    climb: Array  # rad s
    course: Array  # rad s
    speed: Array  # m


def zero_memory(n: int) -> MiddleLoopMemory:
    """Integrals at rest for n agents."""
    return MiddleLoopMemory(np.zeros(n), np.zeros(n), np.zeros(n))


def _integrate(
    integral: Array, error: Array, dt: float, command: Array, limit_lo: Array, limit_hi: Array
) -> tuple[Array, Array, Array]:
    """Saturate a command that falls with its error's integral; hold the integral if that hurts."""
    limited = np.minimum(np.maximum(command, limit_lo), limit_hi)
    saturated = limited != command
    grows = saturated & ((command > limited) == (error < 0.0))
    return limited, np.where(grows, integral, integral + dt * error), saturated


def middle_loop(
    memory: MiddleLoopMemory,
    gains: MiddleLoopGains,
    dt: float,
    climb: Array,
    climb_rate: Array,
    climb_desired: Array,
    climb_rate_desired: Array,
    course: Array,
    course_rate: Array,
    course_desired: Array,
    course_rate_desired: Array,
    speed: Array,
    bank: Array,
    airspeed: Array,
    airspeed_command: Array,
    airspeed_error: Array,
) -> tuple[FbwaCommand, MiddleLoopMemory, Flags]:
    """One step of (19)-(21) for n agents; every array (n,), rad, rad/s, m/s.

    Args:
        memory: the integrals.
        gains: k and η.
        dt: control period, s.
        climb: γ, flight-path angle.
        climb_rate: γ̇.
        climb_desired: γ_d.
        climb_rate_desired: γ̇_d ≈ e2ᵀω.
        course: σ.
        course_rate: σ̇.
        course_desired: σ_d.
        course_rate_desired: σ̇_d ≈ e3ᵀω / cos γ.
        speed: s, ground speed.
        bank: φ.
        airspeed: s_a.
        airspeed_command: u + s_a − s, after its guard.
        airspeed_error: the (·) of (21): s_a less the commanded airspeed (right in wind), or
            s_a − u as printed.

    Returns:
        The command, the new integrals, and per agent which limits were reached (`Saturation`).
    """
    climb_error = climb - climb_desired
    pitch = (
        climb_desired
        - gains.climb_p * climb_error
        - gains.climb_i * memory.climb
        - gains.climb_d * (climb_rate - climb_rate_desired)
    )
    course_error = wrap_pi(course - course_desired)
    roll = (
        np.arctan(course_rate_desired * speed * np.cos(climb) / GRAVITY)
        - gains.course_p * course_error
        - gains.course_i * memory.course
        - gains.course_d * (course_rate - course_rate_desired)
    )
    throttle = (
        gains.trim_throttle
        + gains.eta_bank * (np.cos(bank) ** -2 - 1.0)
        + gains.eta_speed * (airspeed_command - gains.trim_airspeed)
        - gains.speed_p * airspeed_error
        - gains.speed_i * memory.speed
    )
    pitch, climb_integral, pitch_flag = _integrate(
        memory.climb, climb_error, dt, pitch, -gains.pitch_limit, gains.pitch_limit
    )
    roll, course_integral, roll_flag = _integrate(
        memory.course, course_error, dt, roll, -gains.roll_limit, gains.roll_limit
    )
    throttle, speed_integral, throttle_flag = _integrate(
        memory.speed, airspeed_error, dt, throttle, 0.0 * speed, 1.0 + 0.0 * speed
    )
    flags = pitch_flag * PITCH + roll_flag * ROLL + throttle_flag * THROTTLE
    return (
        FbwaCommand(pitch, roll, throttle),
        MiddleLoopMemory(climb_integral, course_integral, speed_integral),
        flags.astype(np.uint8),
    )
