"""The paper's law for n followers of one leader: [HBH23] eqs. (5)-(15) and (22)-(29)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reference import formation_geometry as geometry
from reference import formation_leader_filter as leading
from reference.formation_arrays import norm
from reference.formation_laws import (
    Desired,
    SpeedSet,
    desired_velocity,
    formation_error,
    speed_control,
    turn_control,
)
from reference.formation_leader_filter import Memory, no_messages
from reference.formation_message_extrapolation import corrected, kept, places, times
from reference.frames import velocity_frame
from testbed.core.flags import LimiterFlag
from testbed.core.frames import course, flight_path_angle
from testbed.core.records import Array, BoolArray, Messages, UnicycleCommand, VehicleState
from testbed.formation.barrier import SpeedBarrier
from testbed.formation.control_function import ControlFunction

CLAMPED = int(LimiterFlag.SPEED_DESIRED_CLAMPED)
OUTSIDE = int(LimiterFlag.OUTSIDE_SPEED_SET)
TIMED_OUT = int(LimiterFlag.LEADER_TIMEOUT)


@dataclass(frozen=True, eq=False, kw_only=True)
class Hbh23Law:
    """The gains and options of n agents; every array has one row for each, unless it says more."""

    agents: NDArray[np.intp]  # (n,) their rows among the N aircraft; the leader's is 0
    # υ (N, 3) m, the leader's zero first: forward, right, down in its frame; or (n, N, 3), as each
    # agent knows them
    offsets: Array
    gains: Array  # (n, N, 3) β_i for the leader, β_ij for the others, per axis of NED
    k: Array  # (n,) m/s over ρ̄, the largest speed at which an error is closed, (7)
    a: Array  # (n,) 1/s
    b: Array  # (n,) s/m²
    c: Array  # (n,) 1/s, the constant part of c_i(t)
    c_speed: Array  # (n,) s/m², the part that grows with s_d²
    speed_pole: Array  # (n,) 1/s, the speed model f = −p s, g = p
    control_function: ControlFunction  # its fields (n,)
    barrier: SpeedBarrier  # its fields (n,)
    speeds: SpeedSet
    # The horizontal variant: the law sees motion in the plane, altitude is the middle loop's.
    horizontal: BoolArray  # (n,)
    # Shift S and S_d by ground speed less airspeed, so that they bound the airspeed in effect.
    bounds_of_airspeed: bool
    from_timestamp: bool  # where neighbours are extrapolated from, sec. 8.3
    with_acceleration: BoolArray  # (n,) extrapolate along a parabola
    acceleration_source: NDArray[np.int64]  # (n,) of q̈_g: leader.NOTHING, BROADCAST or TURN
    acceleration_blend: Array  # (n, 3) NED, share of a new message in the average of BROADCAST
    difference_blend: Array  # (n, 2) share of a new difference in the averages of TURN: ṡ_g, γ̇_g
    # (n,) of ω̇_g: leader.NOTHING as in the paper, ROLL_RATE or DIFFERENCE
    angular_acceleration_source: NDArray[np.int64]
    turn_rate_blend: Array  # (n,) share of a new difference in the average of ω̇_g
    # s since the last message, after which the leader or a neighbour has timed out
    leader_timeout_s: float
    neighbour_timeout_s: float
    # a timed-out neighbour keeps its relative position, instead of being left out of (6)
    hold_stale_neighbours: bool
    # During a leader timeout: level flight at this airspeed and course rate.
    lost_leader_airspeed: Array  # (n,) m/s
    lost_leader_turn_rate: Array  # (n,) rad/s

    def start(self, own: VehicleState) -> Memory:
        """Return the memory before the first message."""
        return no_messages(*self.gains.shape[:2])

    def step(
        self, now: float, own: VehicleState, inbox: Messages, memory: Memory
    ) -> tuple[UnicycleCommand, Memory]:
        """One control step of every follower; see `law.Law`."""
        return hbh23_step(self, now, own, inbox, memory)


def hbh23_step(
    law: Hbh23Law, now: float, own: VehicleState, inbox: Messages, memory: Memory
) -> tuple[UnicycleCommand, Memory]:
    """Step all followers.

    A follower whose leader has timed out flies level from its course at the timeout, at a set
    airspeed and course rate. A neighbour that has timed out is left out of (6), or keeps its
    position in the leader's velocity frame: the one extrapolated when its last message was new.
    """
    n = len(law.k)
    level = np.ones((n, 3))
    level[:, 2] = np.where(law.horizontal, 0.0, 1.0)
    limit = np.full(law.gains.shape[1], law.neighbour_timeout_s)
    limit[0] = law.leader_timeout_s
    timed_out = np.isnan(inbox.stamp_s) | (now - inbox.received_s > limit)
    no_leader = timed_out[:, 0]
    columns = np.expand_dims(timed_out, 2)
    held = columns & ~np.isnan(memory.held_position) & law.hold_stale_neighbours
    weights = law.gains * np.expand_dims(level, 1)
    gains = np.where(columns & ~held, 0.0, weights)
    own_velocity = own.velocity_ned * level
    positions, velocities = corrected(inbox, now, law.from_timestamp, law.with_acceleration)
    positions = np.where(columns, np.expand_dims(own.position_ned, 1), positions)
    velocities = np.where(columns, np.expand_dims(own_velocity, 1), velocities) * np.expand_dims(
        level, 1
    )

    # The leader's frame of each agent, from the leader's newest message, (22)-(29).
    leader_velocity = np.ascontiguousarray(velocities[:, 0])
    leader_speed = norm(leader_velocity)
    gamma = flight_path_angle(leader_velocity)
    euler = np.where(columns[:, 0], 0.0, inbox.euler[:, 0])
    rates = np.where(columns[:, 0], 0.0, inbox.euler_rates[:, 0])
    frame = velocity_frame(leader_velocity)
    gamma_dot = rates[:, 1] * level[:, 2]
    rate = geometry.frame_rate(gamma, rates[:, 2], gamma_dot)
    bending = leading.course_acceleration(leader_speed, euler, rates[:, 0])
    turning = geometry.frame_acceleration(gamma, rates[:, 2], gamma_dot, bending)
    said_s = times(inbox, law.from_timestamp)
    omega, omega_dot = leading.differentiate_rate(memory, said_s[:, 0], rate, law.turn_rate_blend)
    source = np.expand_dims(law.angular_acceleration_source, 1)
    differenced = source == leading.DIFFERENCE
    turning = np.select([source == leading.ROLL_RATE, differenced], [turning, omega_dot], 0.0)
    chi, chi_rate, chi_acceleration = geometry.slots(frame, rate, turning, law.offsets)
    place, held_time_s = memory.held_position, memory.held_time_s
    if law.hold_stale_neighbours:
        new = weights.any(axis=2) & ~timed_out & ~np.expand_dims(no_leader, 1)
        new &= ~(said_s <= held_time_s)
        new[:, 0] = False  # the leader is in no place of its own formation
        place = np.where(np.expand_dims(new, 2), places(frame, positions), place)
        held_time_s = np.where(new, said_s, held_time_s)
        positions, velocities = kept(frame, rate, place, held, positions, velocities)
    each = np.arange(n)
    slot, slot_velocity = chi[each, law.agents], chi_rate[each, law.agents]
    slot_acceleration = chi_acceleration[each, law.agents]
    acceleration, after = _leader_acceleration(law, inbox, no_leader, frame, level, memory)

    # The desired velocity, (6)-(12), and the controls (14), (15).
    error = formation_error(own.position_ned, slot, positions, chi, gains)
    error_rate = formation_error(own_velocity, slot_velocity, velocities, chi_rate, gains)
    speed = norm(own_velocity)
    lag = (speed - own.airspeed) if law.bounds_of_airspeed else np.zeros(n)
    speeds = SpeedSet(*(bound + lag for bound in law.speeds))
    desired = desired_velocity(
        leader_velocity,
        acceleration * level,
        slot_velocity,
        slot_acceleration,
        error,
        error_rate,
        law.k,
        law.control_function,
        speeds,
    )
    since = np.where(np.isnan(memory.timeout_since), now, memory.timeout_since)
    begun = np.where(np.isnan(memory.timeout_course), course(own_velocity), memory.timeout_course)
    desired = _without_leader(
        no_leader,
        begun + law.lost_leader_turn_rate * (now - since),
        law.lost_leader_turn_rate,
        desired,
    )
    u, inside = speed_control(speed, desired, law.a, law.b, law.speed_pole, law.barrier, speeds)
    u = np.where(no_leader, law.lost_leader_airspeed + speed - own.airspeed, u)
    speed_desired = np.where(no_leader, u, desired.speed)
    c = law.c + law.c_speed * speed_desired * speed_desired
    pitching, yawing = turn_control(own_velocity, desired, c)
    turn = np.zeros((n, 3))
    turn[:, 1], turn[:, 2] = pitching, yawing
    limiter_flags = np.where(no_leader, TIMED_OUT, desired.clamped * CLAMPED + ~inside * OUTSIDE)
    return (
        UnicycleCommand(
            u,
            turn,
            speed_desired,
            desired.direction,
            limiter_flags.astype(np.uint8),
        ),
        after._replace(
            timeout_since=np.where(no_leader, since, np.nan),
            timeout_course=np.where(no_leader, begun, np.nan),
            held_position=place,
            held_time_s=held_time_s,
            omega=np.where(differenced & ~columns[:, 0], omega, memory.omega),
            omega_dot=np.where(
                columns[:, 0], 0.0, np.where(differenced, omega_dot, memory.omega_dot)
            ),
        ),
    )


def _leader_acceleration(
    law: Hbh23Law, inbox: Messages, no_leader: BoolArray, frame: Array, level: Array, memory: Memory
) -> tuple[Array, Memory]:
    """q̈_g (n, 3) m/s² by each agent's own choice, and the memory for the next step."""
    received = np.expand_dims(~no_leader, 1)
    velocity = np.where(received, inbox.velocity_ned[:, 0] * level, 1.0)
    time_s = times(inbox, law.from_timestamp)[:, 0]
    speed, gamma, speed_rate, gamma_dot = leading.differentiate(
        memory, time_s, velocity, law.difference_blend
    )
    euler = np.where(received, inbox.euler[:, 0], 0.0)
    turn = leading.turn_acceleration(frame, speed, gamma, speed_rate, gamma_dot, euler)
    source = np.expand_dims(law.acceleration_source, 1)
    sample = np.select(
        [source == leading.BROADCAST, source == leading.TURN],
        [inbox.acceleration_ned[:, 0], turn],
        0.0,
    )
    # an average takes every message once; what is differentiated is averaged already
    new = np.expand_dims(~(time_s <= memory.time_s), 1)
    blend = np.where(new, law.acceleration_blend, 0.0)
    blend = np.where(source == leading.TURN, 1.0, blend)
    moved = memory.acceleration + blend * (np.where(received, sample, 0.0) - memory.acceleration)
    acceleration = np.where(received, moved, memory.acceleration)
    return acceleration, memory._replace(
        acceleration=acceleration,
        time_s=np.where(no_leader, np.nan, time_s),
        speed=np.where(no_leader, np.nan, speed),
        gamma=np.where(no_leader, np.nan, gamma),
        speed_rate=np.where(no_leader, 0.0, speed_rate),
        gamma_dot=np.where(no_leader, 0.0, gamma_dot),
    )


def _without_leader(no_leader: BoolArray, held: Array, turn: Array, desired: Desired) -> Desired:
    """Replace the desired velocity in a leader timeout: level, on a turning course (n,) rad."""
    north, east, zero = np.cos(held), np.sin(held), np.zeros_like(held)
    rows = np.expand_dims(no_leader, 1)
    ahead = np.stack([north, east, zero], axis=1)
    aside = np.stack([-turn * east, turn * north, zero], axis=1)
    return Desired(
        desired.speed,
        desired.speed_rate,
        np.where(rows, ahead, desired.direction),
        np.where(rows, aside, desired.direction_rate),
        desired.clamped,
    )
