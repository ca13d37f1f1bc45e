"""Compiled guidance of one aircraft, on records.

Flight plan, gains and memory are records; the memory is written in place. The equations are those
of `mission_follower`.
"""

from __future__ import annotations

from dataclasses import astuple, fields

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.frames import gamma_of
from testbed.core.records import Record, Records, Values, allocate
from testbed.guidance.altitude_airspeed_hold import HoldGains, HoldMemory
from testbed.guidance.flight_plan import FlightPlan, Mission
from testbed.guidance.mission_follower import LeaderMemory, step, unicycle_step

FLIGHT_PARAMS = tuple(each.name for each in fields(Mission) if each.name != "legs")
GAINS = tuple(each.name for each in fields(HoldGains))
# One segment of a flight plan; see `flight_plan.Segment`.
SEGMENT = np.dtype(
    [
        ("circle", "?"),
        ("start", "f8", (3,)),
        ("end", "f8", (3,)),
        ("turn", "f8"),
        ("radius", "f8"),
        ("clockwise", "?"),
        ("turns", "f8"),
        ("continues", "?"),
    ]
)
# Progress in the plan; see `mission_follower.LeaderMemory`.
MEMORY = np.dtype(
    [
        ("segment", "i8"),
        ("altitude_from", "f8"),
        ("captured", "?"),
        ("turned", "f8"),
        ("bearing", "f8"),
        ("hold", [(name, "f8") for name in HoldMemory._fields]),
    ]
)
# The guidance of one aircraft besides the segments: parameters, gains and memory.
GUIDANCE_STATE = np.dtype(
    [
        ("flight_params", [(name, "f8") for name in FLIGHT_PARAMS]),
        ("repeat_from", "i8"),
        ("gains", [(name, "f8") for name in GAINS]),
        ("dt", "f8"),
        ("memory", MEMORY),
    ]
)


def segment_records(plan: FlightPlan) -> Records:
    """Pack the segments of a plan into records (K,) of SEGMENT."""
    segments = allocate(SEGMENT, len(plan.segments))
    segments[:] = list(plan.segments)
    return segments


def begin_flight(plan: FlightPlan, memory: LeaderMemory, *, dt: float, gains: HoldGains) -> Records:
    """Return the guidance of one aircraft, (1,) of GUIDANCE_STATE, stepped every `dt` s."""
    own = allocate(GUIDANCE_STATE, 1)
    own["repeat_from"], own["dt"] = plan.repeat_from, dt
    own["gains"] = astuple(gains)
    own["memory"] = memory
    set_flight_params(own, plan.mission)
    return own


def set_flight_params(own: Records, mission: Mission) -> None:
    """Set airspeed, limits and L1 parameters to those of a mission.

    Its legs are not read.
    """
    own["flight_params"] = tuple(getattr(mission, name) for name in FLIGHT_PARAMS)


def memory_of(own: Records) -> LeaderMemory:
    """Return the memory in a record (1,) of GUIDANCE_STATE."""
    memory = LeaderMemory(*own["memory"][0].item())
    return memory._replace(hold=HoldMemory(*memory.hold))


@entry
def guide(row: int, aircraft: Records, segments: Record, state: Record) -> None:
    """Guide the aircraft in a row along its plan: write its fly-by-wire-A command.

    Args:
        row: of the aircraft.
        aircraft: (N,) of AIRCRAFT; `control` of the row is written.
        segments: (K,) of SEGMENT.
        state: (1,) of GUIDANCE_STATE; its memory is written.
    """
    own, o = aircraft[row].estimate, state[0]
    pitch, roll, throttle, memory = step(
        _memory_of(o.memory),
        own.position_ned,
        own.velocity_ned,
        own.euler[0],
        own.airspeed,
        FlightPlan(o.flight_params, segments, o.repeat_from),
        o.dt,
        o.gains,
    )
    _write_memory(o.memory, memory)
    command = aircraft[row].control
    command.pitch, command.roll, command.throttle = pitch, roll, throttle


@entry
def guide_unicycle(row: int, aircraft: Records, segments: Record, state: Record) -> Values:
    """Guide the ideal vehicle in a row; return u (m/s) and ω (rad/s).

    See `guide`. For the log, the command is its flight-path angle, its bank and zero throttle.
    """
    own, o = aircraft[row].estimate, state[0]
    plan = FlightPlan(o.flight_params, segments, o.repeat_from)
    speed, omega, memory = unicycle_step(
        _memory_of(o.memory), own.position_ned, own.velocity_ned, plan, o.dt, o.gains
    )
    _write_memory(o.memory, memory)
    north, east, down = own.velocity_ned
    command = aircraft[row].control
    command.pitch = gamma_of(north, east, down)
    command.roll, command.throttle = own.euler[0], 0.0
    return speed, omega


@kernel
def _memory_of(m: Record) -> LeaderMemory:
    h = m.hold
    held = HoldMemory(h.altitude, h.climb, h.pitch, h.throttle)
    return LeaderMemory(m.segment, m.altitude_from, m.captured, m.turned, m.bearing, held)


@kernel
def _write_memory(m: Record, memory: Record) -> None:
    m.segment, m.altitude_from, m.captured = memory.segment, memory.altitude_from, memory.captured
    m.turned, m.bearing = memory.turned, memory.bearing
    h, held = m.hold, memory.hold
    h.altitude, h.climb, h.pitch, h.throttle = held.altitude, held.climb, held.pitch, held.throttle
