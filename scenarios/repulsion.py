"""The paper's law with repulsion between aircraft that come close.

[HBH23] reduces errors without regard to other aircraft. Here the position that a follower gives to
the law is moved towards each aircraft within a radius, so that the law steers away from it. While
there is none, commands equal the paper's to the bit, with the gains of the scenario.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from testbed.law import FormationConfig, Inbox, UnicycleCommand, VehicleState


class Repulsion:
    """Law that moves a position by `gain` (r − d), d: distance below r = `radius_m`."""

    def __init__(
        self, config: FormationConfig, *, radius_m: float = 12.0, gain: float = 4.0
    ) -> None:
        """Wrap the paper's law."""
        assert config.hbh23 is not None
        self.config, self.hbh23 = config, config.hbh23
        self.radius, self.gain = radius_m, gain

    def start(self, own: VehicleState) -> Any:  # noqa: ANN401 - the paper's law's own
        """Return the memory of the paper's law; repulsion has none."""
        return self.hbh23.start(own)

    def step(
        self,
        now: float,
        own: VehicleState,
        inbox: Inbox,
        memory: Any,  # noqa: ANN401
    ) -> tuple[UnicycleCommand, Any]:
        """Step the paper's law with moved positions."""
        age = now - inbox.received_s
        received = age <= self.config.neighbour_timeout_s  # False without a message
        received[np.arange(len(received)), self.config.agents] = False  # not from itself
        others = inbox.position_ned + age[:, :, np.newaxis] * inbox.velocity_ned
        away = own.position_ned[:, np.newaxis] - others  # (n, N, 3) m
        distance = np.linalg.norm(away, axis=2)
        near = received & (distance > 0.0) & (distance < self.radius)
        push = np.zeros_like(away)
        push[near] = (self.gain * (self.radius / distance[near] - 1.0))[:, np.newaxis] * away[near]
        moved = own._replace(position_ned=own.position_ned - push.sum(axis=1))
        return self.hbh23.step(now, moved, inbox, memory)
