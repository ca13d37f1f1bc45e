"""The paper's law for n followers of one leader: [HBH23] eqs. (5)-(15) and (22)-(29)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.compiled import twin_of
from testbed.formation import geometry
from testbed.formation import leader as leading
from testbed.formation.arrays import norm
from testbed.formation.barrier import Barrier
from testbed.formation.control_function import ControlFunction
from testbed.formation.flags import Guard
from testbed.formation.laws import (
    Desired,
    SpeedSet,
    desired_velocity,
    formation_error,
    speed_control,
    turn_control,
)
from testbed.formation.leader import Memory, unheard
from testbed.formation.measurement import corrected, kept, places, times
from testbed.frames import course, flight_path_angle, velocity_frame
from testbed.state import Array, Inbox, Truths, UnicycleCommand, VehicleState

CLAMPED = int(Guard.SPEED_DESIRED_CLAMPED)
OUTSIDE = int(Guard.OUTSIDE_SPEED_SET)
SILENT = int(Guard.LEADER_SILENT)


@dataclass(frozen=True, eq=False, kw_only=True)
class PaperLaw:
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
    pole: Array  # (n,) 1/s, the speed model f = −p s, g = p
    control_function: ControlFunction  # its fields (n,)
    barrier: Barrier  # its fields (n,)
    speeds: SpeedSet
    # The horizontal variant: the law sees motion in the plane, altitude is the middle loop's.
    horizontal: Truths  # (n,)
    # Shift S and S_d by ground speed less airspeed, so that they bound the airspeed in effect.
    bounds_of_airspeed: bool
    from_timestamp: bool  # where neighbours are extrapolated from, sec. 8.3
    with_acceleration: Truths  # (n,) extrapolate along a parabola
    acceleration_source: NDArray[np.int64]  # (n,) of q̈_g: leader.NOTHING, BROADCAST or TURN
    acceleration_blend: Array  # (n, 3) NED, share of a new message in the average of BROADCAST
    difference_blend: Array  # (n, 2) share of a new difference in the averages of TURN: ṡ_g, γ̇_g
    # Reckon with ω̇_g, by the leader's roll rate; the paper neglects it.
    turn_acceleration: Truths  # (n,)
    # s since the last news arrived, of the leader and of a neighbour, after which they are too old
    silent_after: float
    stale_after: float
    hold: bool  # a neighbour of old news keeps its place in the formation; or is left out of (6)
    # What to fly while the leader is silent: level, at this airspeed and course rate.
    silent_airspeed: Array  # (n,) m/s
    silent_turn: Array  # (n,) rad/s

    def start(self, own: VehicleState) -> Memory:
        """Nothing heard yet."""
        return unheard(*self.gains.shape[:2])

    def step(
        self, now: float, own: VehicleState, inbox: Inbox, memory: Memory
    ) -> tuple[UnicycleCommand, Memory]:
        """One control step of every follower; see `law.Law`."""
        return STEP(self, now, own, inbox, memory)

    @cached_property
    def known_offsets(self) -> Array:
        """υ (n, N, 3) m as each agent knows them."""
        return np.broadcast_to(self.offsets, self.gains.shape).copy()

    @cached_property
    def table(self) -> Any:  # noqa: ANN401 - a structured array
        """What each agent is given, as one array of records for the compiled twin."""
        columns = {
            "row": self.agents,
            **{name: getattr(self, name) for name in _OWN},
            **self.control_function._asdict(),
            **self.barrier._asdict(),
            **self.speeds._asdict(),
        }
        table = np.zeros(len(self.k), dtype=AGENT)
        for name in AGENT.names or ():
            table[name] = columns[name]
        return table


_OWN = (
    "k a b c c_speed pole horizontal with_acceleration turn_acceleration acceleration_source "
    "acceleration_blend difference_blend silent_after stale_after hold silent_airspeed silent_turn"
).split()
_KINDS = {
    "row": "i8",
    "spline": "?",
    "example": "i8",
    "horizontal": "?",
    "with_acceleration": "?",
    "turn_acceleration": "?",
    "acceleration_source": "i8",
    "hold": "?",
}
_SHAPES = {"acceleration_blend": (3,), "difference_blend": (2,)}
AGENT = np.dtype(
    [
        (name, _KINDS.get(name, "f8"), _SHAPES.get(name, ()))
        for name in ("row", *_OWN, *ControlFunction._fields, *Barrier._fields, *SpeedSet._fields)
    ]
)


def paper_step(
    law: PaperLaw, now: float, own: VehicleState, inbox: Inbox, memory: Memory
) -> tuple[UnicycleCommand, Memory]:
    """One control step of every follower from what it knows.

    An agent that does not hear the leader flies level from the course it had when that began, at
    the airspeed and course rate it was given for that. A neighbour not heard is left out of (6),
    or is taken to keep the place in the leader's velocity frame where it was reckoned to be at the
    step at which its last message was new: what an extrapolation adds to that later is its error.
    """
    n = len(law.k)
    level = np.ones((n, 3))
    level[:, 2] = np.where(law.horizontal, 0.0, 1.0)
    limit = np.full(law.gains.shape[1], law.stale_after)
    limit[0] = law.silent_after
    silent = np.isnan(inbox.stamp_s) | (now - inbox.received_s > limit)
    deaf = silent[:, 0]
    quiet = np.expand_dims(silent, 2)
    held = quiet & ~np.isnan(memory.place) & law.hold
    weights = law.gains * np.expand_dims(level, 1)
    gains = np.where(quiet & ~held, 0.0, weights)
    own_velocity = own.velocity_ned * level
    positions, velocities = corrected(inbox, now, law.from_timestamp, law.with_acceleration)
    positions = np.where(quiet, np.expand_dims(own.position_ned, 1), positions)
    velocities = np.where(quiet, np.expand_dims(own_velocity, 1), velocities) * np.expand_dims(
        level, 1
    )

    # The leader's frame, as each agent computes it from what it heard, (22)-(29).
    leader_velocity = np.ascontiguousarray(velocities[:, 0])
    leader_speed = norm(leader_velocity)
    climb = flight_path_angle(leader_velocity)
    euler = np.where(quiet[:, 0], 0.0, inbox.euler[:, 0])
    rates = np.where(quiet[:, 0], 0.0, inbox.euler_rates[:, 0])
    frame = velocity_frame(leader_velocity)
    climb_rate = rates[:, 1] * level[:, 2]
    rate = geometry.frame_rate(climb, rates[:, 2], climb_rate)
    bending = leading.course_acceleration(leader_speed, euler, rates[:, 0])
    turning = geometry.frame_acceleration(climb, rates[:, 2], climb_rate, bending)
    turning = np.where(np.expand_dims(law.turn_acceleration, 1), turning, 0.0)
    chi, chi_rate, chi_acceleration = geometry.slots(frame, rate, turning, law.offsets)
    place, place_time_s = memory.place, memory.place_time_s
    if law.hold:
        said_s = times(inbox, law.from_timestamp)
        new = weights.any(axis=2) & ~silent & ~np.expand_dims(deaf, 1)
        new &= ~(said_s <= place_time_s)
        new[:, 0] = False  # the leader is in no place of its own formation
        place = np.where(np.expand_dims(new, 2), places(frame, positions), place)
        place_time_s = np.where(new, said_s, place_time_s)
        positions, velocities = kept(frame, rate, place, held, positions, velocities)
    each = np.arange(n)
    slot, slot_velocity = chi[each, law.agents], chi_rate[each, law.agents]
    slot_acceleration = chi_acceleration[each, law.agents]
    acceleration, after = _leader_acceleration(law, inbox, deaf, frame, level, memory)

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
    since = np.where(np.isnan(memory.silent_since), now, memory.silent_since)
    begun = np.where(np.isnan(memory.silent_course), course(own_velocity), memory.silent_course)
    desired = _without_leader(
        deaf, begun + law.silent_turn * (now - since), law.silent_turn, desired
    )
    u, inside = speed_control(speed, desired, law.a, law.b, law.pole, law.barrier, speeds)
    u = np.where(deaf, law.silent_airspeed + speed - own.airspeed, u)
    speed_desired = np.where(deaf, u, desired.speed)
    c = law.c + law.c_speed * speed_desired * speed_desired
    pitching, yawing = turn_control(own_velocity, desired, c)
    turn = np.zeros((n, 3))
    turn[:, 1], turn[:, 2] = pitching, yawing
    guards = np.where(deaf, SILENT, desired.clamped * CLAMPED + ~inside * OUTSIDE)
    return (
        UnicycleCommand(
            u,
            turn,
            speed_desired,
            desired.direction,
            guards.astype(np.uint8),
        ),
        after._replace(
            silent_since=np.where(deaf, since, np.nan),
            silent_course=np.where(deaf, begun, np.nan),
            place=place,
            place_time_s=place_time_s,
        ),
    )


def _leader_acceleration(
    law: PaperLaw, inbox: Inbox, deaf: Truths, frame: Array, level: Array, memory: Memory
) -> tuple[Array, Memory]:
    """q̈_g (n, 3) m/s² by each agent's own choice, and the memory for the next step."""
    heard = np.expand_dims(~deaf, 1)
    velocity = np.where(heard, inbox.velocity_ned[:, 0] * level, 1.0)
    time_s = times(inbox, law.from_timestamp)[:, 0]
    speed, climb, speed_rate, climb_rate = leading.differentiate(
        memory, time_s, velocity, law.difference_blend
    )
    euler = np.where(heard, inbox.euler[:, 0], 0.0)
    turn = leading.turn_acceleration(frame, speed, climb, speed_rate, climb_rate, euler)
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
    moved = memory.acceleration + blend * (np.where(heard, sample, 0.0) - memory.acceleration)
    acceleration = np.where(heard, moved, memory.acceleration)
    return acceleration, memory._replace(
        acceleration=acceleration,
        time_s=np.where(deaf, np.nan, time_s),
        speed=np.where(deaf, np.nan, speed),
        climb=np.where(deaf, np.nan, climb),
        speed_rate=np.where(deaf, 0.0, speed_rate),
        climb_rate=np.where(deaf, 0.0, climb_rate),
    )


def _without_leader(deaf: Truths, held: Array, turn: Array, desired: Desired) -> Desired:
    """What is desired, and for the deaf: level flight on a course (n,) rad that turns steadily."""
    north, east, zero = np.cos(held), np.sin(held), np.zeros_like(held)
    rows = np.expand_dims(deaf, 1)
    ahead = np.stack([north, east, zero], axis=1)
    aside = np.stack([-turn * east, turn * north, zero], axis=1)
    return Desired(
        desired.speed,
        desired.speed_rate,
        np.where(rows, ahead, desired.direction),
        np.where(rows, aside, desired.direction_rate),
        desired.clamped,
    )


STEP = twin_of(paper_step, "testbed.formation.paper_twin")
