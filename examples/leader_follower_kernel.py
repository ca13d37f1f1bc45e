"""A leader-follower law with integrals as a kernel, whose memory `testbed margins` linearises.

Each follower steers to its slot beside the leader by fly-by-wire A: the error along the leader's
course sets the speed, the error across it the course, and the height error the pitch. It is the law
of scenarios/leader_follower.py for one follower.
"""

from typing import Any

import numpy as np

import testbed
from testbed.law import FbwaCommand, Inbox, VehicleState, ground_speed_bounds

GRAVITY = 9.81


@testbed.kernel(memory=[("speed_m", float), ("height_ms", float)])
def leader_follower(
    now: float,
    own: VehicleState,
    inbox: Inbox,
    memory: Any,  # noqa: ANN401 - a record of the fields above
    config: Any,  # noqa: ANN401 - that of one follower
    closing: float = 0.3,
    approach_deg: float = 60.0,
    field_per_m: float = 0.03,
    course: float = 2.5,
    climb: float = 0.02,
    speed: float = 0.12,
    speed_integral: float = 0.02,
) -> FbwaCommand[float]:
    """Return the commands of one follower."""
    age = now - inbox.received_s[0]
    if not age <= config.leader_timeout_s:  # also where age is NaN: no message yet
        return FbwaCommand(0.0, 0.0, config.trim_throttle + speed_integral * memory.speed_m)
    velocity = inbox.velocity_ned[0]
    level = np.hypot(velocity[0], velocity[1])
    north, east = velocity[0] / level, velocity[1] / level
    turn = inbox.euler_rates[0, 2]
    slot = config.offsets[config.agents]
    offset = inbox.position_ned[0] + age * velocity - own.position_ned
    along = offset[0] * north + offset[1] * east + slot[0]
    across = offset[1] * north - offset[0] * east + slot[1]
    below = offset[2] + slot[2]
    slot_speed = level - turn * slot[1]
    slot_course = np.arctan2(velocity[1], velocity[0]) + turn * slot[0] / slot_speed

    low, high = ground_speed_bounds(config, own)
    ground = np.hypot(own.velocity_ned[0], own.velocity_ned[1])
    speed_error = min(max(slot_speed + closing * along, low), high) - ground
    field = np.radians(approach_deg) * np.arctan(field_per_m * across) / (0.5 * np.pi)
    course_error = slot_course + field - np.arctan2(own.velocity_ned[1], own.velocity_ned[0])
    course_error = (course_error + np.pi) % (2.0 * np.pi) - np.pi
    command = FbwaCommand(
        pitch=-velocity[2] / level - climb * below - 0.05 * climb * memory.height_ms,
        roll=np.arctan(turn * ground / GRAVITY) + course * course_error,
        throttle=config.trim_throttle + speed * speed_error + speed_integral * memory.speed_m,
    )
    memory.speed_m = min(max(memory.speed_m + config.dt * speed_error, -10.0), 10.0)
    memory.height_ms = min(max(memory.height_ms + config.dt * below, -100.0), 100.0)
    return command
