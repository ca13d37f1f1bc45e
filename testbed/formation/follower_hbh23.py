"""The built-in law for one follower, in laws of users under `@testbed.kernel`."""

from __future__ import annotations

from math import nan
from typing import Any, NamedTuple

import numpy as np
from numba.core import types
from numba.extending import overload_method

from testbed.core.compile import kept_kernel, kernel
from testbed.core.field_docs import document_fields
from testbed.core.records import (
    FOLLOWER,
    LINK,
    MOTION,
    Array,
    Inbox,
    OwnState,
    Record,
    Records,
    UnicycleCommand,
    allocate,
)
from testbed.formation import leader_filter
from testbed.formation.hbh23 import NEIGHBOUR, hbh23

# What the law keeps from one step to the next, as a field of a kernel's memory; zero before the
# first step.
HBH23_MEMORY = np.dtype(
    [
        ("leader", leader_filter.MEMORY),
        ("started", "i8"),  # 0: before the first step
    ],
    align=True,
)


@document_fields
class FollowerHbh23(NamedTuple):
    """The built-in law of one follower, with the scenario's gains."""

    gains: Records  # (1,) of LAW
    offsets: Array  # (N, 3) υ, m
    weights: Array  # (N, 3) β_i in row 0, β_ij behind it, per axis of NED

    def step(self, now: float, own: OwnState, inbox: Inbox, memory: Record) -> UnicycleCommand:
        """Step the law; its equations are those of `hbh23.hbh23`.

        Args:
            now: s.
            own: the follower's estimate, as the kernel receives it.
            inbox: messages, as the kernel receives them.
            memory: a field of the kernel's memory that is declared with `HBH23_MEMORY`; written.
        """
        n = len(self.offsets)
        scratch = allocate(MOTION, 1), allocate(LINK, n), allocate(NEIGHBOUR, n)
        return _step(self, now, own, inbox, memory, *scratch, allocate(FOLLOWER, 1))


@kernel
def _step(
    config: FollowerHbh23,
    now: float,
    own: OwnState,
    inbox: Inbox,
    memory: Record,
    estimates: Records,
    links: Records,
    neighbours: Records,
    outs: Records,
) -> UnicycleCommand:
    """Step the law with records that are written; see `FollowerHbh23.step`."""
    estimate, out, law = estimates[0], outs[0], config.gains[0]
    if memory.started == 0:
        _reset(memory.leader)
        memory.started = 1
    estimate.airspeed, estimate.equivalent_airspeed = own.airspeed, own.equivalent_airspeed
    for axis in range(3):
        estimate.position_ned[axis] = own.position_ned[axis]
        estimate.velocity_ned[axis] = own.velocity_ned[axis]
        estimate.acceleration_ned[axis] = own.acceleration_ned[axis]
        estimate.euler[axis] = own.euler[axis]
        estimate.rates_body[axis] = own.rates_body[axis]
    for m in range(len(links)):
        link, other = links[m], neighbours[m]
        link.stamp_s, link.received_s = inbox.stamp_s[m], inbox.received_s[m]
        other.excluded = False
        other.held_time_s = nan
        other.timeout_s = law.leader_timeout_s if m == 0 else law.neighbour_timeout_s
        other.used = m == 0
        for axis in range(3):
            link.position_ned[axis] = inbox.position_ned[m, axis]
            link.velocity_ned[axis] = inbox.velocity_ned[m, axis]
            link.acceleration_ned[axis] = inbox.acceleration_ned[m, axis]
            link.euler[axis] = inbox.euler[m, axis]
            link.euler_rates[axis] = inbox.euler_rates[m, axis]
            other.offset[axis] = config.offsets[m, axis]
            other.gain[axis] = config.weights[m, axis]
            other.held_position[axis] = nan
            other.used = other.used or config.weights[m, axis] != 0.0
    hbh23(law, now, estimate, links, neighbours, memory.leader, out)
    omega: Any = out.omega[0], out.omega[1], out.omega[2]
    direction: Any = out.direction[0], out.direction[1], out.direction[2]
    flags = out.limiter_flags
    return UnicycleCommand(out.speed_command, omega, out.speed_desired, direction, flags)


@kernel
def _reset(leader: Record) -> None:
    """Set a memory of the leader to that before the first message; the averages are zero."""
    leader.time_s = leader.speed = leader.gamma = nan
    leader.timeout_since = leader.timeout_course = nan
    for axis in range(3):
        leader.omega[axis] = nan


@kept_kernel
def _step_in_kernels(
    config: FollowerHbh23, now: float, own: OwnState, inbox: Inbox, memory: Record
) -> UnicycleCommand:
    n = len(config.offsets)
    estimates, links = np.empty(1, MOTION), np.empty(n, LINK)
    neighbours, outs = np.empty(n, NEIGHBOUR), np.empty(1, FOLLOWER)
    return _step(config, now, own, inbox, memory, estimates, links, neighbours, outs)


def _step_of(config: Any, now: Any, own: Any, inbox: Any, memory: Any) -> Any:  # noqa: ANN401, ARG001
    """Return what kernels compile in place of `FollowerHbh23.step`; None: of another tuple."""
    if getattr(config, "instance_class", None) is not FollowerHbh23:
        return None
    return lambda config, now, own, inbox, memory: _step_in_kernels(config, now, own, inbox, memory)


overload_method(types.BaseNamedTuple, "step")(
    lambda config, now, own, inbox, memory: _step_of(config, now, own, inbox, memory)
)
