"""Commands of a program in the same process to the aircraft of a flight, from an array."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from testbed.core.call_list import Call, Steps
from testbed.core.compile import entry
from testbed.core.copies import copy_command
from testbed.core.records import BoolArray, FbwaCommand, Indices, Records
from testbed.flight.vehicles import LeaderInput


class ArrayCommands:
    """Apply commands of an array to aircraft; also the controller of a leader that takes them.

    Args:
        names: of N aircraft, the leader first.
        commands: (N,) of COMMAND.
        trims: by row of the aircraft that take commands, the first commands.

    Attributes:
        commanded: (N,) aircraft that take commands.
        commands: (N,) of COMMAND, for the next ticks; those of the others are not used.
        input: see `LeaderController`.
    """

    def __init__(
        self, names: Sequence[str], commands: Records, trims: Mapping[int, FbwaCommand[float]]
    ) -> None:
        """Start with the first commands."""
        n = len(names)
        self._names = tuple(names)
        self.commanded: BoolArray = np.zeros(n, dtype=bool)
        self.commands = commands
        for row, command in trims.items():
            self.commanded[row] = True
            self.commands[row] = command
        self._held = self.commands.copy()  # of lost aircraft the last one
        self._counts = np.zeros(n, dtype=np.intp)
        self.input: LeaderInput = np.zeros(1), np.zeros(3)

    @property
    def commands_leader(self) -> bool:
        """Whether the leader takes commands: it then serves as the `LeaderController`."""
        return bool(self.commanded[0])

    def take_call(self, aircraft: Records) -> Call:
        """Return the call that takes the commands; at every tick."""
        arrays = self.commanded, self.commands, self._held, self._counts
        return Call(_take, *arrays, aircraft)

    def steps(self, aircraft: Records) -> Steps:
        """Return the step that writes the leader's command; see `LeaderController`."""
        return (Call(_command_leader, self._held, aircraft),)

    def override_call(self, aircraft: Records) -> Call:
        """Return the call that writes `command` of the aircraft; at the autopilot rate."""
        return Call(_override, self.commanded, self._held, aircraft)

    def clear_call(self, followers: Records) -> Call:
        """Return the call that clears what the law reports of followers that it does not fly."""
        return Call(_clear_diagnostics, self.commanded, followers)

    def command_counts(self) -> Mapping[str, Mapping[str, int]]:
        """Count the commands, by aircraft; for the metrics."""
        counts = zip(self._names, self._counts.tolist(), strict=True)
        return {name: {"commands": count} for name, count in counts if count}


@entry
def _take(
    commanded: BoolArray, commands: Records, held: Records, counts: Indices, aircraft: Records
) -> None:
    """Take the commands (N,) of aircraft that are not lost."""
    for i in range(len(aircraft)):
        if commanded[i] and not aircraft[i].lost:
            copy_command(commands[i], held[i])
            counts[i] += 1


@entry
def _command_leader(held: Records, aircraft: Records) -> None:
    """Write the leader's command as that of its controller."""
    copy_command(held[0], aircraft[0].control)


@entry
def _override(commanded: BoolArray, held: Records, aircraft: Records) -> None:
    """Write `command` of the aircraft (N,) that take commands."""
    for i in range(len(aircraft)):
        if commanded[i]:
            copy_command(held[i], aircraft[i].command)
            aircraft[i].guided = False


@entry
def _clear_diagnostics(commanded: BoolArray, followers: Records) -> None:
    """Clear limiter flags and saturations of followers (n,) that the law does not control."""
    for i in range(len(followers)):
        if commanded[i + 1]:
            followers[i].limiter_flags = 0
            followers[i].saturations = 0
