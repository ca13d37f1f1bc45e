"""The paper's law with integral action on the position error, as a kernel that wraps it.

It is `IntegralAction` of scenarios/integral_action.py without Python in the tick:
`config.hbh23.step` steps the built-in law, from a position that is moved by the integral of the
error in the leader's velocity frame. The log has that integral, and an event where a component
reaches its limit.
"""

import numpy as np

import testbed
from testbed.law import HBH23_MEMORY, FollowerConfig, Inbox, OwnState, UnicycleCommand

DOWN = np.array([0.0, 0.0, 1.0])


@testbed.kernel
def length(v: np.ndarray) -> float:
    """Return the length of a vector (3,)."""
    return np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)


@testbed.kernel(
    memory=[("hbh23", HBH23_MEMORY), ("moved_m", float, 3), ("limited", int)],
    log=["moved_m"],
    events={"limited": ["the integral is within its limit", "the integral is at its limit"]},
)
def integral_action(
    now: float,
    own: OwnState,
    inbox: Inbox,
    memory: np.record,
    config: FollowerConfig,
    rate_per_s: float = 0.1,
    limit_m: float = 3.0,
) -> UnicycleCommand:
    """Step the paper's law from a position that is moved by the integral of the error."""
    age = now - inbox.received_s[0]
    received = age <= config.leader_timeout_s  # false where age is NaN
    velocity = inbox.velocity_ned[0] if received else own.velocity_ned
    forward = velocity / length(velocity)
    right = np.cross(DOWN, forward)
    right /= length(right)
    down = np.cross(forward, right)
    if received:
        offset = inbox.position_ned[0] + age * velocity - own.position_ned
        slot = config.offsets[config.agents]
        memory.limited = 0
        for k, axis in enumerate((forward, right, down)):
            error = np.sum(axis * offset) + slot[k]
            moved = memory.moved_m[k] + rate_per_s * config.dt * error
            memory.moved_m[k] = min(max(moved, -limit_m), limit_m)
            if memory.moved_m[k] != moved:
                memory.limited = 1
    moved = memory.moved_m
    shift = moved[0] * forward + moved[1] * right + moved[2] * down
    shifted = OwnState(
        own.position_ned - shift,
        own.velocity_ned,
        own.acceleration_ned,
        own.euler,
        own.rates_body,
        own.airspeed,
        own.equivalent_airspeed,
        own.wind_ned,
    )
    return config.hbh23.step(now, shifted, inbox, memory.hbh23)
