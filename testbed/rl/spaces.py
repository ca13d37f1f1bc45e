"""Observations and actions of a follower: their components, bounds and units.

Both are normalised: an observation is its value divided by its bound, limited to -1..1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from testbed.core.records import Array, Sample
from testbed.core.velocity_frame import velocity_frame

Vector = NDArray[np.float32]


class Component(NamedTuple):
    """One component of an observation."""

    name: str
    unit: str
    bound: float  # of its absolute value


def _axes(name: str, unit: str, bound: float) -> tuple[Component, ...]:
    return tuple(Component(f"{name}_{axis}", unit, bound) for axis in ("forward", "right", "down"))


# Vectors are resolved in the follower's own course frame: forward along its course, right, down.
OWN = (
    *_axes("slot", "m", 50.0),  # slot − own position
    *_axes("relative_velocity", "m/s", 20.0),  # leader − own
    *_axes("leader_acceleration", "m/s²", 10.0),
    Component("roll", "rad", 1.6),
    Component("pitch", "rad", 0.8),
    Component("airspeed", "m/s", 15.0),  # true airspeed − that at the start
    Component("roll_rate", "rad/s", 3.0),
    Component("pitch_rate", "rad/s", 3.0),
    Component("yaw_rate", "rad/s", 3.0),
    Component("message_age", "s", 2.0),  # of the leader's newest message; 2: none yet
    Component("last_pitch_action", "1", 1.0),
    Component("last_roll_action", "1", 1.0),
    Component("last_throttle_action", "1", 1.0),
)
# The nearest other follower by its newest message, minus the own position; the bound without one.
NEAREST = _axes("nearest", "m", 50.0)
ACTIONS = ("pitch", "roll", "throttle")


def observation_space(components: tuple[Component, ...]) -> Box:
    """Return the space of an observation with these components."""
    return Box(-1.0, 1.0, (len(components),), np.float32)


def action_space() -> Box:
    """Return the space of an action: pitch, roll and throttle, see `CommandRange`."""
    return Box(-1.0, 1.0, (len(ACTIONS),), np.float32)


class CommandRange(NamedTuple):
    """Commands of a follower for the actions -1, 0 and 1; linear between them.

    Each has pitch and roll (rad) and throttle (0..1).
    """

    lowest: Array  # (3,)
    trim: Array  # (3,) level flight at the airspeed of the start
    highest: Array  # (3,)

    def command(self, action: Vector) -> tuple[float, float, float]:
        """Return pitch, roll and throttle of an action (3,), limited to -1..1."""
        part = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
        span = np.where(part < 0.0, self.trim - self.lowest, self.highest - self.trim)
        pitch, roll, throttle = (self.trim + part * span).tolist()
        return pitch, roll, throttle


class Slot(NamedTuple):
    """The slot of a follower."""

    offsets: Array  # (N, 3) m, forward, right, down in the leader's velocity frame, by slot
    altitude: float  # m above the origin, of the horizontal variant of the law; NaN: none


def observe(
    sample: Sample, row: int, slot: Slot, airspeed: float, action: Vector, *, nearest: bool
) -> Vector:
    """Compute the observation of a follower from its own estimate and the messages it received.

    Args:
        sample: the present state.
        row: of the follower among the N aircraft.
        slot: of the follower.
        airspeed: at the start, m/s.
        action: (3,) the last one.
        nearest: add the components `NEAREST`.

    Returns:
        (k,) of `OWN`, then of `NEAREST`; a value that is not finite is 0.
    """
    assert sample.records is not None
    links = sample.records[2][row - 1]
    own = sample.estimate
    position, velocity = own.position_ned[row], own.velocity_ned[row]
    course_frame = velocity_frame(velocity[None] * (1.0, 1.0, 0.0))[0]
    age = sample.time_s - links["stamp_s"]  # (N,) NaN: no message
    received_ned = links["position_ned"] + age[:, None] * links["velocity_ned"]  # (N, 3)
    leader_velocity = links["velocity_ned"][0]
    where = _slot_ned(sample, row, slot, received_ned[0], leader_velocity)
    values = [
        (where - position) @ course_frame,
        (leader_velocity - velocity) @ course_frame,
        links["acceleration_ned"][0] @ course_frame,
        own.euler[row, :2],
        (own.airspeed[row] - airspeed,),
        own.rates_body[row],
        (age[0],),
        action,
    ]
    if np.isnan(age[0]):
        values[0] = values[1] = values[2] = np.zeros(3)
        values[6] = (_BOUNDS[_AGE],)
    if nearest:
        values.append(_nearest(received_ned, row, position) @ course_frame)
    flat = np.concatenate(values)
    limited = np.clip(flat / _BOUNDS[: len(flat)], -1.0, 1.0)
    observation: Vector = np.nan_to_num(limited).astype(np.float32)
    return observation


_BOUNDS = np.array([each.bound for each in (*OWN, *NEAREST)])
_AGE = [each.name for each in OWN].index("message_age")


def _slot_ned(sample: Sample, row: int, slot: Slot, leader: Array, velocity: Array) -> Array:
    """Return the position of the slot (3,), m, behind a leader at a position with a velocity."""
    holds_altitude = not np.isnan(slot.altitude)
    level = velocity * (1.0, 1.0, 0.0) if holds_altitude else velocity
    offset = slot.offsets[sample.formation.slot_index[row - 1]]
    where: Array = leader + velocity_frame(level[None])[0] @ offset
    if holds_altitude:
        where[2] = -slot.altitude
    return where


def _nearest(received_ned: Array, row: int, position: Array) -> Array:
    """Return the nearest other follower, relative to a position (3,), m; the bound: none."""
    relative = np.delete(received_ned, (0, row), axis=0) - position
    distance = np.linalg.norm(relative, axis=1)
    if not np.isfinite(distance).any():
        return np.full(3, NEAREST[0].bound)
    found: Array = relative[np.nanargmin(distance)]
    return found
