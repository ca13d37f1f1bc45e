"""Formation laws of users that several modules of tests fly: one text is compiled once."""

# the error of the slot behind a low-pass filter of 0.8 s
FILTERED = """
import numpy as np
import testbed
from testbed.law import command_from_velocity

DOWN = np.array([0.0, 0.0, 1.0])

@testbed.kernel
def length(v):
    return np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)

@testbed.kernel(memory=[("pull_ned", float, 3), ("steps", int)])
def filtered(now, own, inbox, memory, config, closing=0.6):
    age = now - inbox.received_s[0]
    if not age <= config.leader_timeout_s:
        return command_from_velocity(config, own, own.velocity_ned)
    memory.steps += 1
    velocity = inbox.velocity_ned[0]
    forward = velocity / length(velocity)
    right = np.cross(DOWN, forward)
    right /= length(right)
    slot = config.offsets[config.agents]
    offset = slot[0] * forward + slot[1] * right + slot[2] * np.cross(forward, right)
    turn = np.cross(DOWN * inbox.euler_rates[0, 2], offset)
    error = inbox.position_ned[0] + age * velocity + offset - own.position_ned
    for k in range(3):
        memory.pull_ned[k] = 0.95 * memory.pull_ned[k] + 0.05 * closing * error[k]
    desired = velocity + turn + memory.pull_ned
    return command_from_velocity(config, own, desired, inbox.acceleration_ned[0])
"""
