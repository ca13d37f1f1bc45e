"""Commands from external programs to the aircraft of a run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from testbed.core.call_list import Steps
from testbed.core.records import BoolArray, Event, FbwaCommand, Records, VehicleState
from testbed.flight.vehicles import LeaderInput
from testbed.mavlink.vehicle_control import VehicleControl


class CommandSession(Protocol):
    """Commands of an external program to one aircraft.

    Attributes:
        name: of the aircraft.
        lost: it crashed or broke.
        frozen: its autopilot is frozen.
        lockstep: the run waits for its commands.
        companion: the formation's law commands it, from a companion computer that the run started.
    """

    name: str
    lost: bool
    frozen: bool
    lockstep: bool
    companion: bool

    @property
    def command_counts(self) -> Mapping[str, int]:
        """Executed requests by kind."""

    @property
    def waiting(self) -> bool:
        """Whether lockstep waits for a command."""

    @property
    def timeout_s(self) -> float:
        """How long lockstep waits for a command, s of wall-clock time."""

    @property
    def command(self) -> FbwaCommand[float] | None:
        """The current command; None: the scenario's own controller commands this follower."""

    @property
    def guided(self) -> bool:
        """Whether the current command is an attitude target in GUIDED."""

    def guide(self, now: float, estimate: VehicleState) -> None:
        """Step the guidance at a time, s, from the estimates of N aircraft."""

    def expect_command(self, now: float) -> None:
        """Wait, in lockstep, for a command in reply to the sample of this time, s."""

    def pop_events(self) -> list[Event]:
        """Return the events since the last call."""


class ExternalControl:
    """Apply external commands to the aircraft; also the controller of a commandable leader.

    Args:
        vehicles: of N aircraft, leader first.
        sessions: of those that take commands, with their rows.

    Attributes:
        vehicles: the same.
        input: see `LeaderController`.
    """

    def __init__(
        self, vehicles: Sequence[VehicleControl], sessions: Sequence[tuple[int, CommandSession]]
    ) -> None:
        """Start with every aircraft under the scenario's own control."""
        self.vehicles, self._sessions = tuple(vehicles), sessions
        self._lockstep = [session for _, session in self._sessions if session.lockstep]
        self._events: list[Event] = []
        self.input: LeaderInput = np.zeros(1), np.zeros(3)

    @property
    def commands_leader(self) -> bool:
        """Whether the leader has a session, which then serves as its `LeaderController`."""
        return bool(self._sessions) and self._sessions[0][0] == 0

    @property
    def waiting(self) -> list[str]:
        """Names of the aircraft that lockstep waits for a command of."""
        return [session.name for session in self._lockstep if session.waiting]

    @property
    def timeout_s(self) -> float:
        """How long lockstep waits, s of wall-clock time."""
        return min((session.timeout_s for session in self._lockstep), default=math.inf)

    def guide(
        self, now: float, estimate: VehicleState, lost: BoolArray, frozen: BoolArray | None
    ) -> None:
        """Step the guidance of all sessions; each control period of the leader, before control.

        Args:
            now: s
            estimate: of N aircraft.
            lost: (N,) aircraft that crashed or broke.
            frozen: (N,) aircraft whose autopilot is frozen; None: none.
        """
        for row, session in self._sessions:
            session.lost = bool(lost[row])
            session.frozen = frozen is not None and bool(frozen[row])
            if not session.lost:
                session.guide(now, estimate)

    def steps(self, aircraft: Records) -> Steps:
        """Return the step that writes the leader's command; see `LeaderController`."""
        _, leader = self._sessions[0]

        def write(now: float) -> None:
            command = leader.command
            assert command is not None  # only a follower's session may leave it to the law
            aircraft["control"][0] = command

        return (write,)

    def override_commands(self, aircraft: Records) -> None:
        """Write `command` and `guided` of the aircraft that their sessions control."""
        commands, guided = aircraft["command"], aircraft["guided"]
        for row, session in self._sessions:
            if (command := session.command) is not None:
                commands[row], guided[row] = command, session.guided

    def mask_diagnostics(self, followers: Records) -> Records:
        """Clear the limiter flags and saturations of followers that the law does not control.

        Args:
            followers: (n,) of FOLLOWER.

        Returns:
            The same, or a copy where any is cleared.
        """
        rows = self._commanded_followers()
        if not rows:
            return followers
        masked = followers.copy()
        masked["limiter_flags"][rows] = masked["saturations"][rows] = 0
        return masked

    def left_formation(self, left: BoolArray) -> BoolArray:
        """Mark followers that the law does not control as having left the formation, (n,)."""
        rows = self._commanded_followers()
        if not rows:
            return left
        out = left.copy()
        out[rows] = True
        return out

    def _commanded_followers(self) -> list[int]:
        """Rows, among n followers, of those that a session controls."""
        return [
            row - 1
            for row, each in self._sessions
            if row and each.command is not None and not (each.companion and each.guided)
        ]

    def command_counts(self) -> Mapping[str, Mapping[str, int]]:
        """Count the executed external requests, by aircraft and kind; for the metrics."""
        return {
            session.name: dict(session.command_counts)
            for _, session in self._sessions
            if session.command_counts
        }

    def pop_events(self) -> list[Event]:
        """Return the events since the last call."""
        events = [
            *self._events,
            *(event for _, session in self._sessions for event in session.pop_events()),
        ]
        self._events = []
        return events

    def add_events(self, events: Sequence[Event]) -> None:
        """Add events to those that `pop_events` returns next."""
        self._events += events

    def expect_commands(self, now: float) -> None:
        """Wait, in lockstep, for a command in reply to the sample of this time, s."""
        for session in self._lockstep:
            session.expect_command(now)
