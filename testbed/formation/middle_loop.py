"""The middle loop, [HBH23] eqs. (19)-(21): from (u, ω) to a fly-by-wire-A command."""

from __future__ import annotations

from math import atan, atan2, cos, isnan, nan, sin

import numpy as np

from testbed.core.compile import kernel
from testbed.core.flags import LimiterFlag, Saturation
from testbed.core.frames import PAPER_GRAVITY, gamma_of, norm, wrap_pi
from testbed.core.records import Record, Records, Values, allocate
from testbed.core.velocity_frame import velocity_rates

PITCH, ROLL, THROTTLE = map(int, (Saturation.PITCH, Saturation.ROLL, Saturation.THROTTLE))
CLIPPED = int(LimiterFlag.SPEED_COMMAND_CLIPPED)

# Gains of one follower; angles in rad, throttle as a fraction of full. Those marked * are not in
# the paper; at zero they change nothing.
LOOP = np.dtype(
    [
        ("gamma_p", "f8"),  # k_γp, rad per rad
        ("gamma_i", "f8"),  # k_γi, 1/s
        ("gamma_d", "f8"),  # k_γd, s
        ("course_p", "f8"),  # k_σp, rad per rad
        ("course_i", "f8"),  # k_σi, 1/s
        ("course_d", "f8"),  # k_σd, s
        ("speed_p", "f8"),  # k_sp, throttle per m/s
        ("speed_i", "f8"),  # k_si, throttle per m
        ("eta_speed", "f8"),  # η_s, throttle per m/s
        ("eta_bank", "f8"),  # η_φ, throttle
        ("trim_throttle", "f8"),  # η_0, throttle
        ("trim_airspeed", "f8"),  # s_a0, m/s
        ("pitch_limit", "f8"),  # rad
        ("roll_limit", "f8"),  # rad
        ("altitude_p", "f8"),  # rad per m, of the horizontal variant's altitude hold
        ("altitude_i", "f8"),  # rad per m s
        ("altitude_d", "f8"),  # rad per m/s
        ("incidence", "f8"),  # * 0 or 1: share of θ − γ fed forward to the pitch command
        ("turn_incidence", "f8"),  # * rad, extra incidence per extra load factor, by the bank
        ("roll_lead", "f8"),  # * s, by how much the coordinated turn's bank is commanded early
        ("lead_filter", "f8"),  # * s, of the derivative that this takes
        ("eta_climb", "f8"),  # * throttle per sin γ_d
        ("rate_filter", "f8"),  # * s, of the filters on σ̇ and γ̇
        ("speed_min", "f8"),  # m/s, the commanded airspeed is clipped to these
        ("speed_max", "f8"),  # m/s
        ("altitude", "f8"),  # m above the origin to hold by pitch; nan: (19) flies the pitch
        # * the feedback of (20) acts inside its arctangent
        ("course_inside", "?"),
        # The (·) of (21) is s_a − u, as printed, which opposes the feed-forward in wind; otherwise
        # it is s_a minus the commanded airspeed, which is equal where there is no wind.
        ("airspeed_error_as_printed", "?"),
        ("dt", "f8"),  # s, control period
    ],
    align=True,
)
# The integrals of (19)-(21) and the filters of one follower; nan: not started.
MEMORY = np.dtype(
    [
        ("gamma", "f8"),  # rad s
        ("course", "f8"),  # rad s
        ("speed", "f8"),  # m
        ("altitude", "f8"),  # m s
        ("chi_dot", "f8"),  # rad/s, filtered
        ("gamma_dot", "f8"),  # rad/s, filtered
        ("turn_bank", "f8"),  # rad, of the coordinated turn
        ("turn_bank_rate", "f8"),  # rad/s, filtered
    ],
    align=True,
)


def initial_memory(n: int) -> Records:
    """Return the memory (n,) of middle loops whose integrals are zero and filters not started."""
    memory = allocate(MEMORY, n)
    for name in ("chi_dot", "gamma_dot", "turn_bank"):
        memory[name] = nan
    return memory


@kernel
def middle_loop(loop: Record, own: Record, memory: Record, out: Record, command: Record) -> None:
    """Turn (u, ω) of one follower into pitch, roll and throttle.

    γ̇_d ≈ e2ᵀω and σ̇_d ≈ e3ᵀω / cos γ.

    Args:
        loop: record of LOOP.
        own: record of MOTION, the follower's estimate.
        memory: record of MEMORY; written.
        out: record of FOLLOWER: speed_command, omega, direction and limiter_flags are read;
            limiter_flags, saturations and what is commanded and desired are written.
        command: record of COMMAND; written.
    """
    y_d, omega, velocity = out.direction, out.omega, own.velocity_ned
    holds_altitude = not isnan(loop.altitude)
    # in the horizontal variant u and ω are motions in the plane, and so is what they act on
    v = (velocity[0], velocity[1], 0.0 if holds_altitude else velocity[2])
    s = norm(v)
    airspeed, phi, dt = own.airspeed, own.euler[0], loop.dt
    unlimited = out.speed_command + airspeed - s
    airspeed_command = min(max(unlimited, loop.speed_min), loop.speed_max)
    chi_dot, gamma_dot = velocity_rates(v, own.acceleration_ned)
    share = dt / (dt + loop.rate_filter)
    chi_dot = _average(memory.chi_dot, chi_dot, share)
    gamma_dot = _average(memory.gamma_dot, gamma_dot, share)
    gamma = gamma_of(v[0], v[1], v[2])
    gamma_d, course_d = gamma_of(y_d[0], y_d[1], y_d[2]), atan2(y_d[1], y_d[0])

    # (19), or altitude hold in the horizontal variant
    gamma_error = gamma - gamma_d
    pitch_by_path = (
        gamma_d
        - loop.gamma_p * gamma_error
        - loop.gamma_i * memory.gamma
        - loop.gamma_d * (gamma_dot - omega[1])
        + loop.incidence * (own.euler[1] - gamma)
        + loop.turn_incidence * (1.0 / cos(phi) - 1.0)
    )
    height_error = -own.position_ned[2] - loop.altitude if holds_altitude else 0.0
    pitch_by_altitude = (
        -loop.altitude_p * height_error
        - loop.altitude_i * memory.altitude
        + loop.altitude_d * velocity[2]
    )

    # (20)
    chi_dot_d = omega[2] / cos(gamma)
    curve = chi_dot_d * s * cos(gamma) / PAPER_GRAVITY
    turn_bank = atan(curve)
    last = memory.turn_bank
    slope = 0.0 if isnan(last) else (turn_bank - last) / dt
    slope_before = memory.turn_bank_rate
    slope = slope_before + dt / (dt + loop.lead_filter) * (slope - slope_before)
    course_error = wrap_pi(atan2(v[1], v[0]) - course_d)
    feedback = (
        loop.course_p * course_error
        + loop.course_i * memory.course
        + loop.course_d * (chi_dot - chi_dot_d)
    )
    # The bank turns the course by g/V tan φ: inside the arctangent the loop's gain is the same at
    # every bank, outside it grows with 1/cos² φ.
    roll = atan(curve - feedback) if loop.course_inside else turn_bank - feedback
    roll += loop.roll_lead * slope

    # (21)
    reference = out.speed_command if loop.airspeed_error_as_printed else airspeed_command
    airspeed_error = airspeed - reference
    throttle = (
        loop.trim_throttle
        + loop.eta_bank * (cos(phi) ** -2 - 1.0)
        + loop.eta_speed * (airspeed_command - loop.trim_airspeed)
        + loop.eta_climb * sin(gamma_d)
        - loop.speed_p * airspeed_error
        - loop.speed_i * memory.speed
    )

    limit = loop.pitch_limit
    path_pitch, gamma_integral = _limit(memory.gamma, gamma_error, dt, pitch_by_path, -limit, limit)
    altitude_pitch, altitude_integral = _limit(
        memory.altitude, height_error, dt, pitch_by_altitude, -limit, limit
    )
    unlimited_pitch = pitch_by_altitude if holds_altitude else pitch_by_path
    command.pitch = altitude_pitch if holds_altitude else path_pitch
    limit = loop.roll_limit
    command.roll, course_integral = _limit(memory.course, course_error, dt, roll, -limit, limit)
    command.throttle, speed_integral = _limit(memory.speed, airspeed_error, dt, throttle, 0.0, 1.0)
    memory.gamma = 0.0 if holds_altitude else gamma_integral
    memory.course, memory.speed, memory.altitude = (
        course_integral,
        speed_integral,
        altitude_integral,
    )
    memory.chi_dot, memory.gamma_dot = chi_dot, gamma_dot
    memory.turn_bank, memory.turn_bank_rate = turn_bank, slope
    out.saturations = (
        (command.pitch != unlimited_pitch) * PITCH
        + (command.roll != roll) * ROLL
        + (command.throttle != throttle) * THROTTLE
    )
    if airspeed_command != unlimited:
        out.limiter_flags |= CLIPPED
    out.airspeed_command = airspeed_command
    out.course_desired, out.flight_path_angle_desired = course_d, gamma_d


@kernel
def _average(last: float, sample: float, share: float) -> float:
    """Return the exponential average, which starts at the first sample."""
    return sample if isnan(last) else last + share * (sample - last)


@kernel
def _limit(
    integral: float, error: float, dt: float, command: Record, low: float, high: float
) -> Values:
    """Limit a command that falls with its error's integral; prevent wind-up."""
    limited = min(max(command, low), high)
    if limited != command and (command > limited) == (error < 0.0):
        return limited, integral
    return limited, integral + dt * error
