"""The middle loop, [HBH23] eqs. (19)-(21): from (u, ω) to a fly-by-wire-A command."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from reference.formation_arrays import norm
from reference.formation_geometry import velocity_rates
from testbed.core.flags import LimiterFlag, Saturation
from testbed.core.frames import PAPER_GRAVITY, course, flight_path_angle, wrap_pi
from testbed.core.records import (
    Array,
    BoolArray,
    ByteArray,
    FbwaCommand,
    UnicycleCommand,
    VehicleState,
)

PITCH, ROLL, THROTTLE = map(int, (Saturation.PITCH, Saturation.ROLL, Saturation.THROTTLE))
CLIPPED = int(LimiterFlag.SPEED_COMMAND_CLIPPED)


class ControlDiagnostics(NamedTuple):
    """What the control desires, limits and saturates; every array (n,)."""

    speed_desired: Array  # m/s
    airspeed_command: Array  # m/s
    course_desired: Array  # rad
    flight_path_angle_desired: Array  # rad
    limiter_flags: ByteArray
    saturations: ByteArray


class MiddleLoopGains(NamedTuple):
    """Gains of n agents, every array (n,); angles in rad, throttle as a fraction of full.

    The last seven are not in the paper; at zero they change nothing.
    """

    gamma_p: Array  # k_γp, rad per rad
    gamma_i: Array  # k_γi, 1/s
    gamma_d: Array  # k_γd, s
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
    altitude_p: Array  # rad per m, of the horizontal variant's altitude hold
    altitude_i: Array  # rad per m s
    altitude_d: Array  # rad per m/s
    incidence: Array  # 0 or 1: share of θ − γ fed forward to the pitch command
    turn_incidence: Array  # rad, extra incidence per extra load factor, by the bank
    roll_lead: Array  # s, by how much the coordinated turn's bank is commanded early
    lead_filter: Array  # s, of the derivative that this takes
    eta_climb: Array  # throttle per sin γ_d
    rate_filter: Array  # s, of the filters on σ̇ and γ̇
    course_inside: Array  # 0 or 1: the feedback of (20) acts inside its arctangent


class MiddleLoopMemory(NamedTuple):
    """The integrals of (19)-(21) and what is filtered, (n,) each; nan: not begun."""

    gamma: Array  # rad s
    course: Array  # rad s
    speed: Array  # m
    altitude: Array  # m s
    chi_dot: Array  # rad/s
    gamma_dot: Array  # rad/s
    turn_bank: Array  # rad, of the coordinated turn
    turn_bank_rate: Array  # rad/s


@dataclass(frozen=True, eq=False, kw_only=True)
class MiddleLoop:
    """The middle loops of n agents."""

    gains: MiddleLoopGains
    speed_min: Array  # (n,) m/s, the commanded airspeed is clipped to these
    speed_max: Array  # (n,) m/s
    altitude: Array  # (n,) m above the origin to hold by pitch; nan: (19) flies the pitch
    # Take the (·) of (21) as s_a − u, as printed, which fights the feed-forward in wind; the
    # default is s_a less the commanded airspeed, equal where there is no wind.
    airspeed_error_as_printed: bool
    dt: float  # s, control period

    def start(self) -> MiddleLoopMemory:
        """Integrals at rest, nothing filtered yet."""
        n = len(self.altitude)
        rest, never = np.zeros(n), np.full(n, np.nan)
        return MiddleLoopMemory(rest, rest, rest, rest, never, never, never, rest)

    def step(
        self, own: VehicleState, inputs: UnicycleCommand, memory: MiddleLoopMemory
    ) -> tuple[FbwaCommand, MiddleLoopMemory, ControlDiagnostics]:
        """One step: the command, the memory for the next, and what was after what."""
        return middle_step(self, own, inputs, memory)


def middle_step(
    loop: MiddleLoop, own: VehicleState, inputs: UnicycleCommand, memory: MiddleLoopMemory
) -> tuple[FbwaCommand, MiddleLoopMemory, ControlDiagnostics]:
    """(19)-(21) for n agents; see `MiddleLoop.step`.

    Args:
        loop: gains and options.
        own: estimates of the agents.
        inputs: u, ω and y_d; γ̇_d ≈ e2ᵀω and σ̇_d ≈ e3ᵀω / cos γ.
        memory: of the step before.
    """
    gains, dt = loop.gains, loop.dt
    holding = ~np.isnan(loop.altitude)
    # in the horizontal variant u and ω are motions in the plane, and so is what they are held to
    velocity = own.velocity_ned.copy()
    velocity[:, 2] = np.where(holding, 0.0, velocity[:, 2])
    speed = norm(velocity)
    unguarded = inputs.speed + own.airspeed - speed
    airspeed_command = np.minimum(np.maximum(unguarded, loop.speed_min), loop.speed_max)
    measured = velocity_rates(velocity, own.acceleration_ned)
    share = dt / (dt + gains.rate_filter)
    chi_dot = _average(memory.chi_dot, measured[0], share)
    gamma_dot = _average(memory.gamma_dot, measured[1], share)
    gamma, gamma_desired = flight_path_angle(velocity), flight_path_angle(inputs.direction)
    course_desired = course(inputs.direction)
    bank, attitude = own.euler[:, 0], own.euler[:, 1]

    gamma_error = gamma - gamma_desired
    pitch = (
        gamma_desired
        - gains.gamma_p * gamma_error
        - gains.gamma_i * memory.gamma
        - gains.gamma_d * (gamma_dot - inputs.omega[:, 1])
        + gains.incidence * (attitude - gamma)
        + gains.turn_incidence * (1.0 / np.cos(bank) - 1.0)
    )
    height_error = np.where(holding, -own.position_ned[:, 2] - loop.altitude, 0.0)
    hold = (
        -gains.altitude_p * height_error
        - gains.altitude_i * memory.altitude
        + gains.altitude_d * own.velocity_ned[:, 2]
    )

    chi_dot_desired = inputs.omega[:, 2] / np.cos(gamma)
    turn_bank = np.arctan(chi_dot_desired * speed * np.cos(gamma) / PAPER_GRAVITY)
    last = np.where(np.isnan(memory.turn_bank), turn_bank, memory.turn_bank)
    turn_bank_rate = memory.turn_bank_rate + dt / (dt + gains.lead_filter) * (
        (turn_bank - last) / dt - memory.turn_bank_rate
    )
    course_error = wrap_pi(course(velocity) - course_desired)
    correction = (
        -gains.course_p * course_error
        - gains.course_i * memory.course
        - gains.course_d * (chi_dot - chi_dot_desired)
    )
    inside, outside = np.arctan(np.tan(turn_bank) + correction), turn_bank + correction
    roll = np.where(gains.course_inside > 0.0, inside, outside) + gains.roll_lead * turn_bank_rate

    reference = inputs.speed if loop.airspeed_error_as_printed else airspeed_command
    airspeed_error = own.airspeed - reference
    throttle = (
        gains.trim_throttle
        + gains.eta_bank * (np.cos(bank) ** -2 - 1.0)
        + gains.eta_speed * (airspeed_command - gains.trim_airspeed)
        + gains.eta_climb * np.sin(gamma_desired)
        - gains.speed_p * airspeed_error
        - gains.speed_i * memory.speed
    )

    limit = gains.pitch_limit
    gamma_pitch, gamma_integral, _ = _integrate(memory.gamma, gamma_error, dt, pitch, -limit, limit)
    hold_pitch, altitude_integral, _ = _integrate(
        memory.altitude, height_error, dt, hold, -limit, limit
    )
    wanted = np.where(holding, hold, pitch)
    pitch = np.where(holding, hold_pitch, gamma_pitch)
    roll, course_integral, roll_flag = _integrate(
        memory.course, course_error, dt, roll, -gains.roll_limit, gains.roll_limit
    )
    throttle, speed_integral, throttle_flag = _integrate(
        memory.speed, airspeed_error, dt, throttle, 0.0 * speed, 1.0 + 0.0 * speed
    )
    saturations = (pitch != wanted) * PITCH + roll_flag * ROLL + throttle_flag * THROTTLE
    limiter_flags = inputs.limiter_flags | ((airspeed_command != unguarded) * CLIPPED).astype(
        np.uint8
    )
    return (
        FbwaCommand(pitch, roll, throttle),
        MiddleLoopMemory(
            np.where(holding, 0.0, gamma_integral),
            course_integral,
            speed_integral,
            altitude_integral,
            chi_dot,
            gamma_dot,
            turn_bank,
            turn_bank_rate,
        ),
        ControlDiagnostics(
            inputs.speed_desired,
            airspeed_command,
            course_desired,
            gamma_desired,
            limiter_flags,
            saturations.astype(np.uint8),
        ),
    )


def _average(last: Array, sample: Array, share: Array) -> Array:
    """The exponential average, begun at the first sample."""
    return np.where(np.isnan(last), sample, last + share * (sample - last))


def _integrate(
    integral: Array, error: Array, dt: float, command: Array, limit_lo: Array, limit_hi: Array
) -> tuple[Array, Array, BoolArray]:
    """Saturate a command that falls with its error's integral; hold the integral if that hurts."""
    limited = np.minimum(np.maximum(command, limit_lo), limit_hi)
    saturated = limited != command
    grows = saturated & ((command > limited) == (error < 0.0))
    return limited, np.where(grows, integral, integral + dt * error), saturated
