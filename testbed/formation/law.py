"""What a formation law is to the rest of the testbed, and the paper's law in that shape."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from testbed.compiled import twin_of
from testbed.formation import geometry
from testbed.formation.arrays import norm
from testbed.formation.barrier import Barrier
from testbed.formation.control_function import ControlFunction
from testbed.formation.flags import Guard
from testbed.formation.laws import (
    SpeedSet,
    desired_velocity,
    formation_error,
    speed_control,
    turn_control,
)
from testbed.formation.measurement import corrected_positions
from testbed.formation.middle_loop import (
    MiddleLoopGains,
    MiddleLoopMemory,
    middle_loop,
    zero_memory,
)
from testbed.frames import course, flight_path_angle
from testbed.state import Array, FbwaCommand, Flags, Inbox, VehicleState

CLAMPED = int(Guard.SPEED_DESIRED_CLAMPED)
OUTSIDE = int(Guard.OUTSIDE_SPEED_SET)
CLIPPED = int(Guard.SPEED_COMMAND_CLIPPED)


class Diagnosis(NamedTuple):
    """What a law reports of its step, for the log; every array (n,)."""

    speed_desired: Array  # m/s
    speed_command: Array  # commanded airspeed, m/s
    course_desired: Array  # rad
    flight_path_angle_desired: Array  # rad
    guards: Flags
    saturations: Flags
    age_s: Array  # (n, N)


class Law(Protocol):
    """A formation law of n followers; its memory is a value that goes in and comes out."""

    def start(self, own: VehicleState) -> Any:  # noqa: ANN401 - the law's own
        """The memory before the first step; own: the followers' first estimates (n)."""

    def step(
        self,
        now: float,
        own: VehicleState,
        inbox: Inbox,
        memory: Any,  # noqa: ANN401
    ) -> tuple[FbwaCommand, Any, Diagnosis]:
        """One control step at the time `now` (s) from what each agent knows."""


class PaperMemory(NamedTuple):
    """What the paper's law carries from step to step."""

    integrals: MiddleLoopMemory
    leader_acceleration: Array  # (n, 3) m/s², each agent's filtered estimate of q̈_g
    course_rate: Array  # (n,) rad/s, filtered
    climb_rate: Array  # (n,) rad/s, filtered


class PaperLaw(NamedTuple):
    """[HBH23] eqs. (5)-(15), (19)-(21) and (22)-(29) for n followers of one leader."""

    offsets: Array  # υ (n + 1, 3) m, the leader's zero first: forward, right, down in its frame
    gains: Array  # (n, n + 1, 3) β_i for the leader, β_ij for the others, per axis of NED
    k: Array  # (n,) m/s over ρ̄, the largest speed at which an error is closed, (7)
    a: Array  # (n,) 1/s
    b: Array  # (n,) s/m²
    c: Array  # (n,) 1/s
    pole: Array  # (n,) 1/s, the speed model f = −p s, g = p
    control_function: ControlFunction
    barrier: Barrier
    speeds: SpeedSet
    middle: MiddleLoopGains
    dt: float  # control period, s
    from_timestamp: bool  # where neighbours are extrapolated from, sec. 8.3
    # Take the (·) of (21) as s_a − u, as printed, which fights the feed-forward in wind; the
    # default is s_a less the commanded airspeed, equal where there is no wind.
    airspeed_error_as_printed: bool
    acceleration_blend: Array  # (3,) NED, share of a new sample in the average of q̈_g
    rate_blend: Array  # (n,) share of a new sample in the averages of σ̇ and γ̇

    def start(self, own: VehicleState) -> PaperMemory:
        """Integrals at rest, rates as measured."""
        course_rate, climb_rate = geometry.velocity_rates(own.velocity_ned, own.acceleration_ned)
        n = len(self.k)
        return PaperMemory(zero_memory(n), np.zeros((n, 3)), course_rate, climb_rate)

    def step(
        self, now: float, own: VehicleState, inbox: Inbox, memory: PaperMemory
    ) -> tuple[FbwaCommand, PaperMemory, Diagnosis]:
        """One control step of every follower; see `Law`."""
        return STEP(self, now, own, inbox, memory)


def paper_step(
    law: PaperLaw, now: float, own: VehicleState, inbox: Inbox, memory: PaperMemory
) -> tuple[FbwaCommand, PaperMemory, Diagnosis]:
    """One control step of every follower from what it knows.

    An agent that has not heard the leader yet flies wings level at its trim throttle; a neighbour
    not heard yet is left out of the sum (6).
    """
    n = len(law.k)
    silent = np.isnan(inbox.stamp_s)
    deaf = silent[:, 0]
    quiet = np.expand_dims(silent, 2)
    gains = np.where(quiet, 0.0, law.gains)
    own_position = np.expand_dims(own.position_ned, 1)
    own_velocity = np.expand_dims(own.velocity_ned, 1)
    positions = np.where(quiet, own_position, corrected_positions(inbox, now, law.from_timestamp))
    velocities = np.where(quiet, own_velocity, inbox.velocity_ned)

    # The leader's frame, as each agent computes it from what it heard, (22)-(29).
    leader_velocity = np.ascontiguousarray(velocities[:, 0])
    leader_rates = np.where(quiet[:, 0], 0.0, inbox.euler_rates[:, 0])
    frame = geometry.velocity_frame(leader_velocity)
    rate = geometry.frame_rate(
        flight_path_angle(leader_velocity), leader_rates[:, 2], leader_rates[:, 1]
    )
    chi, chi_rate, chi_acceleration = geometry.slots(frame, rate, law.offsets)
    slot, slot_velocity = np.empty((n, 3)), np.empty((n, 3))
    slot_acceleration = np.empty((n, 3))
    for i in range(n):
        slot[i] = chi[i, i + 1]
        slot_velocity[i] = chi_rate[i, i + 1]
        slot_acceleration[i] = chi_acceleration[i, i + 1]
    acceleration = memory.leader_acceleration + law.acceleration_blend * (
        np.where(quiet[:, 0], 0.0, inbox.acceleration_ned[:, 0]) - memory.leader_acceleration
    )

    # The desired velocity, (6)-(12), and the controls (14), (15).
    error = formation_error(own.position_ned, slot, positions, chi, gains)
    error_rate = formation_error(own.velocity_ned, slot_velocity, velocities, chi_rate, gains)
    desired = desired_velocity(
        leader_velocity,
        acceleration,
        slot_velocity,
        slot_acceleration,
        error,
        error_rate,
        law.k,
        law.control_function,
        law.speeds,
    )
    speed = norm(own.velocity_ned)
    u, inside = speed_control(speed, desired, law.a, law.b, law.pole, law.barrier, law.speeds)
    pitching, yawing = turn_control(own.velocity_ned, desired, law.c)

    # The guard on the commanded airspeed, then the middle loop (19)-(21).
    unguarded = u + own.airspeed - speed
    airspeed_command = np.minimum(np.maximum(unguarded, law.speeds.low), law.speeds.high)
    error_against = u if law.airspeed_error_as_printed else airspeed_command
    course_rate, climb_rate = geometry.velocity_rates(own.velocity_ned, own.acceleration_ned)
    course_rate = memory.course_rate + law.rate_blend * (course_rate - memory.course_rate)
    climb_rate = memory.climb_rate + law.rate_blend * (climb_rate - memory.climb_rate)
    climb = flight_path_angle(own.velocity_ned)
    course_desired = course(desired.direction)
    climb_desired = flight_path_angle(desired.direction)
    command, integrals, saturations = middle_loop(
        memory.integrals,
        law.middle,
        law.dt,
        climb,
        climb_rate,
        climb_desired,
        pitching,
        course(own.velocity_ned),
        course_rate,
        course_desired,
        yawing / np.cos(climb),
        speed,
        np.ascontiguousarray(own.euler[:, 0]),
        own.airspeed,
        airspeed_command,
        own.airspeed - error_against,
    )
    guards = (
        desired.clamped * CLAMPED + ~inside * OUTSIDE + (airspeed_command != unguarded) * CLIPPED
    )
    return (
        FbwaCommand(
            np.where(deaf, 0.0, command.pitch),
            np.where(deaf, 0.0, command.roll),
            np.where(deaf, law.middle.trim_throttle, command.throttle),
        ),
        PaperMemory(
            MiddleLoopMemory(
                np.where(deaf, 0.0, integrals.climb),
                np.where(deaf, 0.0, integrals.course),
                np.where(deaf, 0.0, integrals.speed),
            ),
            acceleration,
            course_rate,
            climb_rate,
        ),
        Diagnosis(
            desired.speed,
            airspeed_command,
            course_desired,
            climb_desired,
            guards.astype(np.uint8),
            saturations,
            now - inbox.stamp_s,
        ),
    )


STEP = twin_of(paper_step, "testbed.formation.twin")
