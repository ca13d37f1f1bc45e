"""The leader's q̈_g and ω̇_g as a follower estimates them, [HBH23] sections 8 and 10."""

from __future__ import annotations

from math import cos, tan

import numpy as np

from testbed.core.compile import kernel
from testbed.core.frames import PAPER_GRAVITY, gamma_of, norm
from testbed.core.records import Record, Values, Vector
from testbed.core.velocity_frame import to_ned

# Source of q̈_g: zero, the broadcast, or bank and differences of the velocity.
NOTHING, BROADCAST, TURN = 0, 1, 2
# Source of ω̇_g: NOTHING, the leader's roll rate, or differences of ω_g.
ROLL_RATE, DIFFERENCE = 1, 2

# A follower's state for its leader between two control steps.
MEMORY = np.dtype(
    [
        ("acceleration", "f8", 3),  # m/s², averaged estimate of q̈_g
        ("time_s", "f8"),  # of the newest message used: its stamp or its receipt; nan: none
        ("speed", "f8"),  # m/s, in that message
        ("gamma", "f8"),  # rad, in that message
        ("speed_rate", "f8"),  # m/s², averaged
        ("gamma_dot", "f8"),  # rad/s, averaged
        ("omega", "f8", 3),  # ω_g, rad/s, in that message
        ("omega_dot", "f8", 3),  # rad/s², averaged
        ("timeout_since", "f8"),  # s, since when the leader has timed out; nan: it has not
        ("timeout_course", "f8"),  # rad, own course at that time
    ],
    align=True,
)


@kernel
def difference_angular_velocity(
    law: Record, memory: Record, time_s: float, omega: Vector
) -> Values:
    """Return ω̇_g, rad/s², as averaged differences of ω_g, sec. 8.2.

    Args:
        law: record of LAW.
        memory: record of MEMORY; omega and omega_dot are written, the time is left.
        time_s: of the leader's newest message.
        omega: ω_g, rad/s, in its velocity frame, (26).
    """
    since = time_s - memory.time_s
    known = since <= 0.0  # an average takes every message once; false for the first: nan
    before, average = memory.omega, memory.omega_dot
    for axis in range(3):
        if since > 0.0:
            slope = (omega[axis] - before[axis]) / since
            average[axis] += law.turn_rate_blend * (slope - average[axis])
        if not known:
            before[axis] = omega[axis]
    return average[0], average[1], average[2]


@kernel
def estimate_leader_acceleration(
    law: Record, link: Record, memory: Record, time_s: float, frame: Vector
) -> None:
    """Update the estimate of q̈_g from the leader's newest message.

    TURN is a coordinated turn, sec. 10: s_g Ṙ_g e1 + ṡ_g R_g e1, σ̇_g ≈ g tan φ_g / (s_g cos θ_g).

    Args:
        law: record of LAW.
        link: record of LINK, the leader's message.
        memory: record of MEMORY; written.
        time_s: of the message.
        frame: cos σ_g, sin σ_g, cos γ_g, sin γ_g.
    """
    velocity = link.velocity_ned
    v = (velocity[0], velocity[1], 0.0 if law.horizontal else velocity[2])
    speed = norm(v)
    gamma = gamma_of(v[0], v[1], v[2])
    speed_rate, gamma_dot = memory.speed_rate, memory.gamma_dot
    since = time_s - memory.time_s
    if since > 0.0:
        slope = (speed - memory.speed) / since
        speed_rate += law.difference_blend[0] * (slope - speed_rate)
        slope = (gamma - memory.gamma) / since
        gamma_dot += law.difference_blend[1] * (slope - gamma_dot)
    known = time_s <= memory.time_s  # an average takes every message once
    memory.time_s, memory.speed, memory.gamma = time_s, speed, gamma
    memory.speed_rate, memory.gamma_dot = speed_rate, gamma_dot
    if law.acceleration_source == TURN:
        euler = link.euler
        chi_dot = PAPER_GRAVITY * tan(euler[0]) / (speed * cos(euler[1]))
        along, across = speed_rate, speed * chi_dot * cos(gamma)
        a, b, c = to_ned(frame, along, across, -speed * gamma_dot)
        memory.acceleration[0], memory.acceleration[1], memory.acceleration[2] = a, b, c
        return
    for axis in range(3):
        sample = 0.0
        if law.acceleration_source == BROADCAST:
            sample = link.acceleration_ned[axis]
        blend = 0.0 if known else law.acceleration_blend[axis]
        memory.acceleration[axis] += blend * (sample - memory.acceleration[axis])
