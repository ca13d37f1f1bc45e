"""Follow on the leader's arc in wind, and make room for an aircraft that has failed.

The slot turns with the leader: its velocity is that of the leader and of the leader's turn rate
times the offset. The desired velocity is limited through the air, by the own estimate of the wind.
A follower whose neighbour declares a failure climbs by `room_m`, out of its way.
"""

import numpy as np

import testbed
from testbed.law import FollowerConfig, Inbox, OwnState, UnicycleCommand, command_from_velocity

DOWN = np.array([0.0, 0.0, 1.0])


@testbed.kernel
def length(v: np.ndarray) -> float:
    """Return the length of a vector (3,)."""
    return np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)


@testbed.kernel(
    memory=[("air_speed_mps", float), ("avoids", int)],
    log=["air_speed_mps"],
    events={"avoids": ["flies in its slot", "climbs to make room"]},
)
def arc_follower(
    now: float,
    own: OwnState,
    inbox: Inbox,
    memory: np.record,
    config: FollowerConfig,
    closing: float = 0.3,
    room_m: float = 10.0,
) -> UnicycleCommand:
    """Fly with the slot's velocity and a velocity towards it."""
    age = now - inbox.received_s[0]
    if not age <= config.leader_timeout_s:  # also where age is NaN
        return command_from_velocity(config, own, own.velocity_ned)
    memory.avoids = 0
    for j in range(1, len(inbox.failed)):
        if inbox.failed[j] and j != config.agents:
            memory.avoids = 1
    velocity = inbox.velocity_ned[0]
    turn = inbox.turn_rate[0]
    forward = velocity / length(velocity)
    right = np.cross(DOWN, forward)
    right /= length(right)
    slot = config.offsets[config.agents]
    offset = slot[0] * forward + slot[1] * right + slot[2] * np.cross(forward, right)
    if memory.avoids:
        offset = offset - room_m * DOWN
    error = inbox.position_ned[0] + age * velocity + offset - own.position_ned
    error /= max(1.0, length(error) / 10.0)
    desired = velocity + turn * np.cross(DOWN, offset) + closing * error
    through_air = desired - own.wind_ned
    memory.air_speed_mps = length(through_air)
    allowed = min(max(memory.air_speed_mps, config.airspeed_min), config.airspeed_max)
    desired = own.wind_ned + through_air * (allowed / memory.air_speed_mps)
    along = turn * np.cross(DOWN, offset)
    acceleration = inbox.acceleration_ned[0] + turn * np.cross(DOWN, along)
    return command_from_velocity(config, own, desired, acceleration)
