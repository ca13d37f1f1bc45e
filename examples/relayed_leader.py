"""Followers that tell each other where the leader is.

Each follower sends, with its own messages, the newest motion of the leader that it knows, and when
that was measured. It flies by the newest that it has: from the leader itself, or from another
follower. So one that does not hear the leader follows it nevertheless.
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
    memory=[
        ("position_ned", float, 3),  # m, of the leader
        ("velocity_ned", float, 3),  # m/s
        ("acceleration_ned", float, 3),  # m/s²
        ("measured_s", float),  # s, when that was measured; 0: nothing is known
        ("age_s", float),  # s, since then
        ("source", int),
    ],
    send=["position_ned", "velocity_ned", "acceleration_ned", "measured_s"],
    log=["age_s"],
    events={"source": ["knows no leader", "hears the leader", "is told where the leader is"]},
)
def relayed_leader(
    now: float,
    own: OwnState,
    inbox: Inbox,
    memory: np.record,
    config: FollowerConfig,
    closing: float = 0.3,
) -> UnicycleCommand:
    """Fly with the newest motion of the leader that is known, and a velocity towards the slot."""
    if inbox.stamp_s[0] > memory.measured_s:  # false where it is NaN
        memory.position_ned[:] = inbox.position_ned[0]
        memory.velocity_ned[:] = inbox.velocity_ned[0]
        memory.acceleration_ned[:] = inbox.acceleration_ned[0]
        memory.measured_s, memory.source = inbox.stamp_s[0], 1
    for j in range(1, len(inbox.stamp_s)):
        told = inbox.payload[j]
        if told[9] > memory.measured_s:
            memory.position_ned[:] = told[0:3]
            memory.velocity_ned[:] = told[3:6]
            memory.acceleration_ned[:] = told[6:9]
            memory.measured_s, memory.source = told[9], 2
    memory.age_s = now - memory.measured_s
    if memory.measured_s == 0.0 or memory.age_s > config.leader_timeout_s:
        memory.source = 0
        return command_from_velocity(config, own, own.velocity_ned)
    velocity = memory.velocity_ned
    forward = velocity / length(velocity)
    right = np.cross(DOWN, forward)
    right /= length(right)
    slot = config.offsets[config.agents]
    offset = slot[0] * forward + slot[1] * right + slot[2] * np.cross(forward, right)
    error = memory.position_ned + memory.age_s * velocity + offset - own.position_ned
    error /= max(1.0, length(error) / 10.0)
    return command_from_velocity(config, own, velocity + closing * error, memory.acceleration_ned)
