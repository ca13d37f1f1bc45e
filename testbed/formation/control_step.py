"""A control step of one follower: law, middle loop, and ages of the messages used.

`control_step` needs no simulation around it: the records of one follower, its estimate and the
newest messages it has received.
"""

from __future__ import annotations

from math import nan
from typing import NamedTuple

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.frames import norm
from testbed.core.reads import Deferred
from testbed.core.records import (
    FOLLOWER,
    LINK,
    MOTION,
    Array,
    Inbox,
    Messages,
    OwnState,
    Record,
    Records,
    UnicycleCommand,
    VehicleState,
    allocate,
    fields_of,
)
from testbed.formation import leader_filter, middle_loop
from testbed.formation.hbh23 import (
    LAW,
    NEIGHBOUR,
    OUTSIDE,
    hbh23,
    reach_velocity,
    write_inputs,
)
from testbed.formation.message_extrapolation import message_ages
from testbed.formation.middle_loop import CLIPPED, LOOP
from testbed.formation.middle_loop import middle_loop as run_middle_loop
from testbed.formation.separation_filter import SEPARATION, limit_closing

# The gains and the memory of one follower's control.
CONTROLLER = np.dtype(
    [
        ("law", LAW),
        ("leader", leader_filter.MEMORY),
        ("loop", LOOP),
        ("integrals", middle_loop.MEMORY),
        ("unicycle", "?"),  # an ideal vehicle, which flies (u, ω) without middle loop
        ("separation", SEPARATION),
    ],
    align=True,
)


def initial_controllers(
    law: Records, loop: Records, unicycle: list[bool], separation: Records | None = None
) -> Records:
    """Return the controllers (n,) of LAW (n,) and LOOP (n,), with nothing received yet.

    Args:
        law: (n,) of LAW.
        loop: (n,) of LOOP.
        unicycle: which followers are ideal vehicles.
        separation: (n,) of SEPARATION; None: without the filter.
    """
    controllers = allocate(CONTROLLER, len(law))
    controllers["law"], controllers["loop"], controllers["unicycle"] = law, loop, unicycle
    reset_leader_memory(controllers["leader"])
    if separation is not None:
        controllers["separation"] = separation
    controllers["integrals"] = middle_loop.initial_memory(len(law))
    return controllers


def reset_leader_memory(memory: Records) -> None:
    """Set memories (n,) of the leader to those before the first message."""
    for name in leader_filter.MEMORY.names or ():
        averages = ("acceleration", "speed_rate", "gamma_dot", "omega_dot")
        memory[name] = 0.0 if name in averages else nan


def make_neighbours(
    offsets: np.ndarray, gains: np.ndarray, leader_timeout_s: float, neighbour_timeout_s: float
) -> Records:
    """Make the gains and states of n followers for N aircraft, before the first message.

    Args:
        offsets: υ (N, 3) m.
        gains: β (n, N, 3).
        leader_timeout_s: after which the leader's message is not used.
        neighbour_timeout_s: after which a neighbour's message is not used.
    """
    neighbours = allocate(NEIGHBOUR, *gains.shape[:2])
    neighbours["offset"] = offsets
    set_gains(neighbours, gains)
    neighbours["timeout_s"] = neighbour_timeout_s
    neighbours["timeout_s"][:, 0] = leader_timeout_s
    neighbours["held_position"] = neighbours["held_time_s"] = nan
    return neighbours


def set_gains(neighbours: Records, gains: np.ndarray) -> None:
    """Set β (n, N, 3).

    Used are the messages with a gain, and always the leader's.
    """
    neighbours["gain"] = gains
    neighbours["used"] = gains.any(axis=2)
    neighbours["used"][:, 0] = True


@kernel
def control_step(
    controller: Record,
    now: float,
    own: Record,
    inbox: Record,
    neighbours: Record,
    out: Record,
    command: Record,
) -> None:
    """Compute one follower's (u, ω) and fly-by-wire-A command from its messages.

    Args:
        controller: record of CONTROLLER; its memories are written.
        now: s.
        own: record of MOTION, the follower's estimate.
        inbox: (N,) of LINK; `age_s` is written.
        neighbours: (N,) of NEIGHBOUR; held positions are written.
        out: record of FOLLOWER; written.
        command: record of COMMAND; written.
    """
    hbh23(controller.law, now, own, inbox, neighbours, controller.leader, out)
    finish_step(controller, now, own, inbox, neighbours, True, out, command)


@kernel
def finish_step(
    controller: Record,
    now: float,
    own: Record,
    inbox: Record,
    neighbours: Record,
    needs_leader: bool,
    out: Record,
    command: Record,
) -> None:
    """Filter a law's (u, ω), run the middle loop behind it, and write message ages."""
    if controller.separation.on:
        limit_closing(controller.separation, controller.law, now, own, inbox, neighbours, out)
    run_middle_loop(controller.loop, own, controller.integrals, out, command)
    if controller.unicycle:
        _without_middle_loop(own, out, controller.law.speed_model.own)
    message_ages(now, neighbours, needs_leader, inbox)


@kernel
def _without_middle_loop(own: Record, out: Record, own_speed_model: bool) -> None:
    """Correct the outputs of a follower with an ideal vehicle, which has no middle loop.

    Outside the speed set, where (14) divides by a slope of h near zero, the limit on the commanded
    airspeed applies to it as well.
    """
    v = own.velocity_ned
    speed = norm(v)
    if own_speed_model:  # u is no speed
        out.limiter_flags &= 0xFF ^ CLIPPED
        out.airspeed_command = nan
        out.saturations = 0
        return
    if out.limiter_flags & OUTSIDE:
        out.speed_command = out.airspeed_command - own.airspeed + speed
    else:
        out.limiter_flags &= 0xFF ^ CLIPPED
    out.airspeed_command = out.speed_command + own.airspeed - speed
    out.saturations = 0


class Hbh23Memory(NamedTuple):
    """State of n followers between two steps of the law."""

    leader: Records  # (n,) of leader_filter.MEMORY
    held_position: np.ndarray  # (n, N, 3) m, see NEIGHBOUR
    held_time_s: np.ndarray  # (n, N)


class Hbh23Law:
    """The law of [HBH23] for n followers, for own laws that extend it.

    Args:
        law: (n,) of LAW.
        neighbours: (n, N) of NEIGHBOUR.
        step_reads: the keys that its steps use.
        velocity_reads: the keys that `command_from_velocity` uses.
    """

    def __init__(
        self,
        law: Records,
        neighbours: Records,
        step_reads: tuple[Deferred, ...] = (),
        velocity_reads: tuple[Deferred, ...] = (),
    ) -> None:
        self.law, self.neighbours = law, neighbours
        self.step_reads, self.velocity_reads = step_reads, velocity_reads

    def start(self, own: VehicleState | OwnState) -> Hbh23Memory:
        """Return the memory before the first message."""
        memory = allocate(leader_filter.MEMORY, len(self.law))
        reset_leader_memory(memory)
        return Hbh23Memory(memory, *_held(self.neighbours))

    def step(
        self, now: float, own: VehicleState | OwnState, inbox: Messages | Inbox, memory: Hbh23Memory
    ) -> tuple[UnicycleCommand, Hbh23Memory]:
        """Step all n followers; see `law.Law`."""
        for each in self.step_reads:
            each.use()
        n, aircraft = self.neighbours.shape
        estimate, links = allocate(MOTION, n), allocate(LINK, n, aircraft)
        out, leader, neighbours = (
            allocate(FOLLOWER, n),
            memory.leader.copy(),
            self.neighbours.copy(),
        )
        neighbours["held_position"], neighbours["held_time_s"] = memory[1:]
        _write_own(estimate, own)
        for name in Messages._fields:
            links[name] = getattr(inbox, name)
        _step_laws(now, self.law, estimate, links, neighbours, leader, out)
        return unicycle_command(out), Hbh23Memory(leader, *_held(neighbours))

    def command_from_velocity(
        self, own: VehicleState | OwnState, velocity_ned: Array, acceleration_ned: Array
    ) -> UnicycleCommand:
        """Compute the inputs of the extended unicycle that reach desired velocities.

        Args:
            own: the followers' estimates (n).
            velocity_ned: p_d (n, 3) m/s, over the ground.
            acceleration_ned: ṗ_d (n, 3) m/s².
        """
        for each in self.velocity_reads:
            each.use()
        estimate, out = allocate(MOTION, len(self.law)), allocate(FOLLOWER, len(self.law))
        _write_own(estimate, own)
        _reach_velocities(self.law, estimate, velocity_ned, acceleration_ned, out)
        return unicycle_command(out)


def _write_own(estimate: Records, own: VehicleState | OwnState) -> None:
    for name in VehicleState._fields:
        estimate[name] = getattr(own, name)


def _held(neighbours: Records) -> tuple[np.ndarray, np.ndarray]:
    return neighbours["held_position"].copy(), neighbours["held_time_s"].copy()


@entry
def _step_laws(
    now: float,
    law: Record,
    estimate: Record,
    links: Records,
    neighbours: Record,
    memory: Record,
    out: Record,
) -> None:
    for i in range(len(law)):
        hbh23(law[i], now, estimate[i], links[i], neighbours[i], memory[i], out[i])


@entry
def _reach_velocities(
    law: Records, estimate: Records, velocity_ned: Array, acceleration_ned: Array, out: Records
) -> None:
    for i in range(len(law)):
        own = estimate[i]
        inputs = reach_velocity(
            law[i], own.velocity_ned, own.airspeed, velocity_ned[i], acceleration_ned[i]
        )
        write_inputs(inputs, out[i])


def unicycle_command(followers: Records) -> UnicycleCommand:
    """View the inputs of the extended unicycle in FOLLOWER (n,)."""
    return fields_of(UnicycleCommand, followers, speed=followers["speed_command"])
