"""Companion computers whose own states and commands pass through MAVLink's fields, in process.

They compute what companions in processes of their own compute in lockstep, without a socket: own
states, and with them broadcasts, have the digits of telemetry; a command is an attitude target that
the autopilot, in GUIDED, takes at its next tick.
"""

from __future__ import annotations

from typing import NamedTuple

from testbed.core.call_list import NOW, Call, Steps
from testbed.core.compile import entry
from testbed.core.geodetic import LocalFrame
from testbed.core.records import AIRCRAFT, Array, Indices, Records, allocate
from testbed.flight.companion import Companions
from testbed.flight.own_state import (
    ATTITUDE_TARGET,
    OWN_STATE,
    AttitudeLimits,
    decode_attitude_target,
    decode_own_state,
    encode_attitude_target,
    encode_own_state,
)
from testbed.flight.schedule import Clock

_LATER_S = 2e-6  # so that a command acts after its control step, at the next tick


class LinkedAutopilots(NamedTuple):
    """What a MAVLink link needs to know of the autopilots of N aircraft, beside their states."""

    frame: LocalFrame  # of the scenario's origin, in degrees
    acceleration: int  # source of the own one: own_state.VELOCITY or IMU
    limits: AttitudeLimits  # (N,) of the angles that they take
    trims: Array  # (N, 3) pitch, roll, rad, and throttle that they fly until the first command


class MavlinkCompanions(Companions):
    """The companion computers of n followers and of the leader, which read and send MAVLink.

    Attributes:
        aircraft: (N,) of AIRCRAFT, of which `estimate` is what the companions have decoded.
    """

    def __init__(
        self,
        aircraft: Records,
        clock: Clock,
        state_latency_s: float,
        command_latency_s: float,
        autopilots: LinkedAutopilots,
    ) -> None:
        """Start with companions that have received nothing; see `Companions`."""
        super().__init__(
            aircraft, clock, state_latency_s, command_latency_s + _LATER_S, autopilots.trims
        )
        n = len(aircraft)
        received, self.aircraft = self.aircraft, allocate(AIRCRAFT, n)
        self.broadcast_aircraft = self.aircraft
        messages, before = allocate(OWN_STATE, n), allocate(OWN_STATE, n)
        numbers = autopilots.frame, autopilots.acceleration
        exchange = Call(_exchange_states, received, messages, before, *numbers, self.aircraft, NOW)
        self.sense_steps: Steps = (self.receive_states, exchange)
        self.before_control: Steps = ()
        self._limits, self._targets = autopilots.limits, allocate(ATTITUDE_TARGET, n)

    def send_commands(self, rows: Indices) -> Call:
        """Return the call that sends the attitude targets of control steps of followers (m,)."""
        return Call(_send_targets, *self._queued, self._targets, self._limits, rows, NOW)


@entry
def _exchange_states(
    autopilots: Records,
    messages: Records,
    before: Records,
    frame: LocalFrame,
    source: int,
    known: Records,
    now: float,
) -> None:
    """Write what companions know of their own aircraft, by way of the messages.

    Args:
        autopilots: (N,) of AIRCRAFT, of which `estimate` is sent.
        messages: (N,) of OWN_STATE; written.
        before: (N,) of OWN_STATE, of the call before; written.
        frame: local frame of the scenario's origin, in degrees.
        source: of the acceleration.
        known: (N,) of AIRCRAFT; written.
        now: s.
    """
    for i in range(len(autopilots)):
        encode_own_state(autopilots[i].estimate, frame, messages[i], now)
        decode_own_state(messages[i], before[i], frame, source, known[i].estimate)


@entry
def _send_targets(
    aircraft: Records,
    commands: Array,
    times_s: Array,
    newest: Indices,
    targets: Records,
    limits: AttitudeLimits,
    rows: Indices,
    now: float,
) -> None:
    """Queue what autopilots take of the attitude targets of followers in these rows (m,)."""
    for row in rows:
        i = row + 1
        encode_attitude_target(aircraft[i].control, targets[i])
        pitch, roll, throttle = decode_attitude_target(targets[i], limits, i)
        newest[i] = (newest[i] + 1) % commands.shape[1]
        k = newest[i]
        times_s[i, k] = now
        commands[i, k, 0], commands[i, k, 1], commands[i, k, 2] = pitch, roll, throttle
