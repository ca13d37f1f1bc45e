"""Laws that use nothing, part, or all of what they are given; the tests copy this file."""

import numpy as np

import testbed
from testbed.law import FbwaCommand, UnicycleCommand, command_from_velocity


class Sticks:
    """Fly-by-wire commands, of nothing in the configuration."""

    def __init__(self, config, **options):
        self.config = config

    def start(self, own):
        return None

    def step(self, now, own, inbox, memory):
        still = np.zeros(len(own.airspeed))
        return FbwaCommand(still + 0.03, still, still + 0.3), None


class Speeds(Sticks):
    """Inputs of the unicycle, of nothing in the configuration."""

    def step(self, now, own, inbox, memory):
        speed = np.linalg.norm(own.velocity_ned, axis=1)
        direction = own.velocity_ned / speed[:, np.newaxis]
        return UnicycleCommand(speed, np.zeros_like(direction), speed, direction, 0), None


class Velocity(Sticks):
    def step(self, now, own, inbox, memory):
        return command_from_velocity(self.config, own, own.velocity_ned), None


class Paper(Sticks):
    def start(self, own):
        return self.config.hbh23.start(own)

    def step(self, now, own, inbox, memory):
        return self.config.hbh23.step(now, own, inbox, memory)


@testbed.kernel
def sticks(now, own, inbox, memory, config):
    return FbwaCommand(0.03, 0.0, 0.3)


@testbed.kernel
def follow(now, own, inbox, memory, config):
    """Fly towards the leader, by its extrapolated position."""
    age = now - inbox.received_s[0]
    if not age <= config.leader_timeout_s:
        return FbwaCommand(0.03, 0.0, 0.3)
    ahead = inbox.position_ned[0] + age * inbox.velocity_ned[0] - own.position_ned
    course = np.arctan2(ahead[1], ahead[0])
    error = course - np.arctan2(own.velocity_ned[1], own.velocity_ned[0])
    return FbwaCommand(0.03, np.arctan(np.sin(error)), 0.3)


class Follow(Sticks):
    """The same as a class."""

    def step(self, now, own, inbox, memory):
        age = now - inbox.received_s[:, 0]
        late = ~(age <= self.config.leader_timeout_s)
        age = np.where(late, 0.0, age)[:, np.newaxis]
        ahead = inbox.position_ned[:, 0] + age * inbox.velocity_ned[:, 0] - own.position_ned
        course = np.arctan2(ahead[:, 1], ahead[:, 0])
        error = course - np.arctan2(own.velocity_ned[:, 1], own.velocity_ned[:, 0])
        roll = np.where(late, 0.0, np.arctan(np.sin(error)))
        return FbwaCommand(np.full(len(roll), 0.03), roll, np.full(len(roll), 0.3)), None
