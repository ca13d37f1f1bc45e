"""The paper's law with integral action on the position error.

[HBH23] has none: a steady disturbance leaves a steady error. Here every follower integrates its
error in the leader's frame, in which the error of a steady turn is constant, and moves the position
that it gives to the law by the integral. All else is the paper's law with the scenario's gains.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from testbed.law import FormationConfig, Inbox, UnicycleCommand, VehicleState


class Memory(NamedTuple):
    """Memory of the paper's law, and the shift of each follower's position."""

    paper: Any
    moved: np.ndarray  # (n, 3) m, forward, right, down in the leader's velocity frame


class IntegralAction:
    """Law that integrates errors at `rate_per_s`, up to `limit_m` per component."""

    def __init__(
        self, config: FormationConfig, *, rate_per_s: float = 0.1, limit_m: float = 3.0
    ) -> None:
        """Wrap the paper's law."""
        assert config.hbh23 is not None
        self.config, self.hbh23 = config, config.hbh23
        self.rate, self.limit = rate_per_s, limit_m

    def start(self, own: VehicleState) -> Memory:
        """Return the memory of the paper's law and shifts of zero."""
        return Memory(self.hbh23.start(own), np.zeros((len(own.airspeed), 3)))

    def step(
        self, now: float, own: VehicleState, inbox: Inbox, memory: Memory
    ) -> tuple[UnicycleCommand, Memory]:
        """Step the paper's law with moved positions."""
        received = now - inbox.received_s[:, 0] <= self.config.leader_timeout_s
        velocity = np.where(received[:, np.newaxis], inbox.velocity_ned[:, 0], own.velocity_ned)
        axes = leader_axes(velocity)
        age = (now - inbox.received_s[:, 0])[:, np.newaxis]
        offset = inbox.position_ned[:, 0] + age * velocity - own.position_ned
        error = (axes @ offset[:, :, np.newaxis])[:, :, 0] + self.config.offsets[self.config.agents]
        increment = np.where(received[:, np.newaxis], self.rate * self.config.dt * error, 0.0)
        moved = np.clip(memory.moved + increment, -self.limit, self.limit)
        shift = (moved[:, np.newaxis] @ axes)[:, 0]
        command, paper = self.hbh23.step(
            now, own._replace(position_ned=own.position_ned - shift), inbox, memory.paper
        )
        return command, Memory(paper, moved)


def leader_axes(velocity: np.ndarray) -> np.ndarray:
    """Return the axes forward, right, down of the velocity frames as rows (n, 3, 3), NED."""
    forward = velocity / np.linalg.norm(velocity, axis=1, keepdims=True)
    right = np.cross([[0.0, 0.0, 1.0]], forward)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return np.stack([forward, right, np.cross(forward, right)], axis=1)
