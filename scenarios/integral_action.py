"""The paper's law with integral action on the position error.

[HBH23] has none: what pushes steadily leaves a steady error. Here every follower integrates its
error in the leader's frame, where a steady turn is at rest, and moves the position that it reports
to the law by the integral, so that the law flies the rest of the error away. Everything else is the
paper's, with the gains of the page.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from testbed.law import Inbox, Team, UnicycleCommand, VehicleState


class Memory(NamedTuple):
    """What the paper's law remembers, and how far each follower's position is moved."""

    paper: Any
    moved: np.ndarray  # (n, 3) m, forward, right, down in the leader's velocity frame


class IntegralAction:
    """Takes errors up at `rate_per_s`, and no more than `limit_m` of each component."""

    def __init__(self, team: Team, *, rate_per_s: float = 0.1, limit_m: float = 3.0) -> None:
        """Wrap the paper's law."""
        assert team.paper is not None
        self.team, self.paper = team, team.paper
        self.rate, self.limit = rate_per_s, limit_m

    def start(self, own: VehicleState) -> Memory:
        """Nothing taken up yet."""
        return Memory(self.paper.start(own), np.zeros((len(own.airspeed), 3)))

    def step(
        self, now: float, own: VehicleState, inbox: Inbox, memory: Memory
    ) -> tuple[UnicycleCommand, Memory]:
        """One step of the paper's law from the moved positions."""
        heard = now - inbox.received_s[:, 0] <= self.team.silent_after
        velocity = np.where(heard[:, np.newaxis], inbox.velocity_ned[:, 0], own.velocity_ned)
        axes = leader_axes(velocity)
        age = (now - inbox.received_s[:, 0])[:, np.newaxis]
        gap = inbox.position_ned[:, 0] + age * velocity - own.position_ned
        error = (axes @ gap[:, :, np.newaxis])[:, :, 0] + self.team.offsets[self.team.agents]
        taken = np.where(heard[:, np.newaxis], self.rate * self.team.dt * error, 0.0)
        moved = np.clip(memory.moved + taken, -self.limit, self.limit)
        shift = (moved[:, np.newaxis] @ axes)[:, 0]
        told, paper = self.paper.step(
            now, own._replace(position_ned=own.position_ned - shift), inbox, memory.paper
        )
        return told, Memory(paper, moved)


def leader_axes(velocity: np.ndarray) -> np.ndarray:
    """Forward, right and down of the velocity frames (n, 3, 3): the rows, in NED."""
    forward = velocity / np.linalg.norm(velocity, axis=1, keepdims=True)
    right = np.cross([[0.0, 0.0, 1.0]], forward)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return np.stack([forward, right, np.cross(forward, right)], axis=1)
