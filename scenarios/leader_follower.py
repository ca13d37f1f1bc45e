"""A textbook leader-follower law: each follower steers itself into its slot beside the leader.

Nobody hears anybody but the leader. The slot moves with the leader and turns with its course. Along
the path the error sets the speed, across it the course (the vector field of R. W. Beard and T. W.
McLain, Small Unmanned Aircraft, Princeton 2012, chapter 10), and height sets the pitch. It commands
the sticks of fly-by-wire A directly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from testbed.law import FbwaCommand, Inbox, Team, VehicleState

GRAVITY = 9.81


class Memory(NamedTuple):
    """Integrals of the speed and the climb error."""

    speed: np.ndarray  # (n,) m
    climb: np.ndarray  # (n,) m


class LeaderFollower:
    """See the module. Gains: closing (1/s), course field (1/m), and the loops behind them."""

    def __init__(
        self,
        team: Team,
        *,
        closing: float = 0.3,
        approach_deg: float = 60.0,
        field_per_m: float = 0.03,
        course: float = 2.5,
        climb: float = 0.02,
        speed: float = 0.12,
        speed_integral: float = 0.02,
    ) -> None:
        """Keep what the page says."""
        self.team = team
        self.closing, self.field, self.course = closing, field_per_m, course
        self.approach = np.radians(approach_deg)
        self.climb, self.speed, self.speed_integral = climb, speed, speed_integral

    def start(self, own: VehicleState) -> Memory:
        """Integrals at rest."""
        return Memory(np.zeros(len(own.airspeed)), np.zeros(len(own.airspeed)))

    def step(
        self, now: float, own: VehicleState, inbox: Inbox, memory: Memory
    ) -> tuple[FbwaCommand, Memory]:
        """One control step of every follower."""
        team = self.team
        age = now - inbox.received_s[:, 0]
        deaf = ~(age <= team.silent_after)  # nothing heard yet, or nothing for too long
        age = np.where(deaf, 0.0, age)[:, np.newaxis]
        velocity = np.where(deaf[:, np.newaxis], own.velocity_ned, inbox.velocity_ned[:, 0])
        leader = inbox.position_ned[:, 0] + age * velocity
        turn = np.where(deaf, 0.0, inbox.euler_rates[:, 0, 2])

        # the slot and how it moves, in the leader's course frame
        level = np.hypot(velocity[:, 0], velocity[:, 1])
        ahead = velocity[:, :2] / level[:, np.newaxis]
        right = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
        forward, aside, down = team.offsets[team.agents].T
        gap = leader - own.position_ned
        along = (gap[:, :2] * ahead).sum(axis=1) + forward
        across = (gap[:, :2] * right).sum(axis=1) + aside
        below = gap[:, 2] + down
        slot_speed = level - turn * aside
        slot_course = np.arctan2(velocity[:, 1], velocity[:, 0]) + turn * forward / slot_speed

        # along: speed by throttle; across: course by roll; down: climb by pitch
        wanted = np.clip(slot_speed + self.closing * along, team.speed_low, team.speed_high)
        flown = np.hypot(own.velocity_ned[:, 0], own.velocity_ned[:, 1])
        slow = np.where(deaf, 0.0, wanted - flown)
        bearing = slot_course + self.approach * (2.0 / np.pi) * np.arctan(self.field * across)
        off = bearing - np.arctan2(own.velocity_ned[:, 1], own.velocity_ned[:, 0])
        off = (off + np.pi) % (2.0 * np.pi) - np.pi
        climbing = -velocity[:, 2] / level
        high = np.where(deaf, 0.0, below)
        throttle = team.trim_throttle + self.speed * slow + self.speed_integral * memory.speed
        return FbwaCommand(
            pitch=np.where(
                deaf, 0.0, climbing - self.climb * high - 0.05 * self.climb * memory.climb
            ),
            roll=np.where(deaf, 0.0, np.arctan(turn * flown / GRAVITY) + self.course * off),
            throttle=throttle,
        ), Memory(
            np.clip(memory.speed + team.dt * slow, -10.0, 10.0),
            np.clip(memory.climb + team.dt * high, -100.0, 100.0),
        )
