"""The paper's law with repulsion between aircraft that come close.

[HBH23] closes errors and does not ask who is in the way. Here every follower moves the position
that it reports to the law towards each aircraft that is nearer than a radius, so that the law flies
it away from there. While nobody is, the law is the paper's to the bit, with the gains of the page.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from testbed.law import Inbox, Team, UnicycleCommand, VehicleState


class Repulsion:
    """Gives way by `gain` metres for each metre that another aircraft is within `radius_m`."""

    def __init__(self, team: Team, *, radius_m: float = 12.0, gain: float = 4.0) -> None:
        """Wrap the paper's law."""
        assert team.paper is not None
        self.team, self.paper = team, team.paper
        self.radius, self.gain = radius_m, gain

    def start(self, own: VehicleState) -> Any:  # noqa: ANN401 - the paper's law's own
        """What the paper's law remembers; repulsion remembers nothing."""
        return self.paper.start(own)

    def step(
        self,
        now: float,
        own: VehicleState,
        inbox: Inbox,
        memory: Any,  # noqa: ANN401
    ) -> tuple[UnicycleCommand, Any]:
        """One step of the paper's law from the moved positions."""
        age = now - inbox.received_s
        heard = age <= self.team.stale_after  # not so where nothing was heard yet
        heard[np.arange(len(heard)), self.team.agents] = False  # nobody is in its own way
        others = inbox.position_ned + age[:, :, np.newaxis] * inbox.velocity_ned
        away = own.position_ned[:, np.newaxis] - others  # (n, N, 3) m
        distance = np.linalg.norm(away, axis=2)
        near = heard & (distance > 0.0) & (distance < self.radius)
        push = np.zeros_like(away)
        push[near] = (self.gain * (self.radius / distance[near] - 1.0))[:, np.newaxis] * away[near]
        moved = own._replace(position_ned=own.position_ned - push.sum(axis=1))
        return self.paper.step(now, moved, inbox, memory)
