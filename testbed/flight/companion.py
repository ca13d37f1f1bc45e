"""Latencies between an autopilot and the companion computer that runs the formation controller.

A companion has the state that its autopilot had some time ago, and its commands reach the autopilot
some time later ([HBH23] section 7: a Raspberry Pi beside a Pixhawk, joined by USB).
"""

from __future__ import annotations

from math import ceil, floor, isnan

import numpy as np

from testbed.core.call_list import NOW, Call, Steps
from testbed.core.compile import entry
from testbed.core.copies import copy_command, copy_motion
from testbed.core.records import AIRCRAFT, MOTION, Array, Indices, Records, allocate
from testbed.flight.schedule import Clock

_ROUNDING = 1e-6  # of a period, and s


class Companions:
    """The companion computers of n followers, which share two latencies.

    Attributes:
        aircraft: (N,) of AIRCRAFT, of which `estimate` is what the companions have.
        store_states: takes the estimates of all autopilots at one of their ticks.
        receive_states: writes the states that the companions have.
        deliver_commands: writes the commands that the autopilots have.
        sense_steps: at each tick of the control, before messages.
        before_control: at each control step of a group of followers.
        broadcast_aircraft: (N,) of AIRCRAFT, whose `estimate` is broadcast.
    """

    def __init__(
        self,
        aircraft: Records,
        clock: Clock,
        state_latency_s: float,
        command_latency_s: float,
        trims: Array | None = None,
    ) -> None:
        """Start with companions that have received nothing.

        Args:
            aircraft: (N,) of AIRCRAFT of the run.
            clock: of the run.
            state_latency_s: from an autopilot's estimate to its arrival, s.
            command_latency_s: from a control step to the command's arrival, s.
            trims: (N, 3) pitch, roll, rad, and throttle until the first command arrives, of
                autopilots in GUIDED; None: in FBWA they have the first command at once.
        """
        n = len(aircraft)
        self.aircraft = allocate(AIRCRAFT, n)
        rate_hz = clock.base_rate_hz / clock.autopilot
        states = allocate(MOTION, n, ceil(state_latency_s * rate_hz) + 2)
        control_hz = clock.base_rate_hz / clock.control
        commands = np.zeros((n, ceil(command_latency_s * control_hz) + 2, 3))
        times_s, newest = np.full(commands.shape[:2], -np.inf), np.full(n, -1)
        stored, queued = (aircraft, states, rate_hz), (aircraft, commands, times_s, newest)
        received = *stored, state_latency_s, self.aircraft
        self.store_states = Call(_store_states, *stored, NOW)
        self.receive_states = Call(_receive_states, *received, NOW)
        first = np.full((n, 3), np.nan) if trims is None else trims
        self.deliver_commands = Call(_deliver_commands, *queued, command_latency_s, first, NOW)
        self.sense_steps: Steps = ()
        self.before_control: Steps = (self.receive_states,)
        self.broadcast_aircraft = aircraft
        self._queued = queued

    def send_commands(self, rows: Indices) -> Call:
        """Return the call that takes the commands of control steps of followers (m,)."""
        return Call(_send_commands, *self._queued, rows, NOW)


@entry
def _store_states(aircraft: Records, states: Records, rate_hz: float, now: float) -> None:
    """Store the estimates of all aircraft (N,) at a tick of the autopilots in states (N, P)."""
    k = floor(now * rate_hz + _ROUNDING) % states.shape[1]
    for i in range(len(aircraft)):
        copy_motion(aircraft[i].estimate, states[i, k])


@entry
def _receive_states(
    aircraft: Records,
    states: Records,
    rate_hz: float,
    latency_s: float,
    received: Records,
    now: float,
) -> None:
    """Write the newest states that have arrived, as `estimate` of `received` (N,).

    Positions are extrapolated along the velocity from their arrival to `now`, as measurements are
    in [HBH23] sec. 8.3. Before the first arrival the first state is extrapolated backwards.
    """
    k = max(floor((now - latency_s) * rate_hz + _ROUNDING), 0)
    ahead_s = now - latency_s - k / rate_hz
    for i in range(len(aircraft)):
        if latency_s == 0.0:
            copy_motion(aircraft[i].estimate, received[i].estimate)
            continue
        own = received[i].estimate
        copy_motion(states[i, k % states.shape[1]], own)
        if abs(ahead_s) > _ROUNDING:
            for axis in range(3):
                own.position_ned[axis] += ahead_s * own.velocity_ned[axis]


@entry
def _send_commands(
    aircraft: Records, commands: Array, times_s: Array, newest: Indices, rows: Indices, now: float
) -> None:
    """Queue `control` of the followers in these rows (m,) in commands (N, Q, 3)."""
    for row in rows:
        i = row + 1
        control = aircraft[i].control
        newest[i] = (newest[i] + 1) % commands.shape[1]
        k = newest[i]
        times_s[i, k] = now
        commands[i, k, 0], commands[i, k, 1] = control.pitch, control.roll
        commands[i, k, 2] = control.throttle


@entry
def _deliver_commands(
    aircraft: Records,
    commands: Array,
    times_s: Array,
    newest: Indices,
    latency_s: float,
    first: Array,
    now: float,
) -> None:
    """Write `command` of all aircraft (N,): of followers the newest that has arrived.

    Before the first arrival it is that of `first` (N, 3), with which autopilots are in GUIDED, or
    where that is NaN the first one that was sent. The leader's guidance is a part of its autopilot.
    """
    queued = commands.shape[1]
    for i in range(len(aircraft)):
        a = aircraft[i]
        command = a.command
        copy_command(a.control, command)
        a.guided = i > 0 and not isnan(first[i, 0])
        if a.guided:
            command.pitch, command.roll, command.throttle = first[i]
        if i == 0 or newest[i] < 0:
            continue
        k, arrived = newest[i], False
        for back in range(queued):
            j = (newest[i] - back) % queued
            if times_s[i, j] == -np.inf:
                break
            k = j
            if times_s[i, j] + latency_s <= now + _ROUNDING:
                arrived = True
                break
        if a.guided and not arrived:
            continue
        command.pitch, command.roll = commands[i, k, 0], commands[i, k, 1]
        command.throttle = commands[i, k, 2]
