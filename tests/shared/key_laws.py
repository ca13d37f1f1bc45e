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
