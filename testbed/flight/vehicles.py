"""Vehicles of a run: JSBSim aircraft, ideal vehicles, and leaders that follow a script.

Each object reads and writes its rows of the run's AIRCRAFT records in place.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol, TypeAlias

import numpy as np

from testbed.autopilot.fbwa import fly_by_wire_a, settled_autopilots
from testbed.autopilot.parameters import AutopilotTiming, FbwaParams, make_gains
from testbed.core.call_list import Call, Step, Steps, run_steps, steps_if
from testbed.core.compile import entry
from testbed.core.copies import copy_motion
from testbed.core.records import (
    MOTION,
    Array,
    BoolArray,
    Indices,
    Records,
    allocate,
)
from testbed.guidance.recorded_path import SampledTrajectory
from testbed.vehicle.control_surfaces import SERVO, any_floats, apply_actuator_faults, keep_flow
from testbed.vehicle.fleet import FlightModels, Move
from testbed.vehicle.unicycle import advance, is_finite, stop_unicycles, write_motion

LeaderInput: TypeAlias = tuple[Array, Array]  # u (1,) m/s and ω (3,) rad/s of an ideal leader


class Vehicles(Protocol):
    """Some of the aircraft of a run, stepped together."""

    rows: Indices  # (M,) among the N aircraft

    air_steps: Steps  # write `air` of the records; the same at every call of a tick
    wind_steps: Steps  # use `wind` of the records from now on; at the autopilot rate
    autopilot_steps: Steps  # compute `surfaces` from `command`; at the autopilot rate
    output_steps: Steps  # use `surfaces` of the records from now on; at the autopilot rate

    def fault_steps(self, *, floating: bool) -> Steps:
        """Return the steps that apply `faults` to `surfaces`, after those of the autopilots.

        Args:
            floating: surfaces may float.
        """

    def steering_steps(self, followers: Records, leader: LeaderInput) -> Steps:
        """Return the steps that set the inputs of extended unicycles; at the control rate.

        Args:
            followers: (n,) of FOLLOWER.
            leader: u (1,) m/s and ω (3,) rad/s.
        """

    def move_steps(self, move: Move) -> Steps:
        """Return the steps that move them to the next tick."""

    def remove(self, lost: BoolArray) -> None:
        """Stop lost aircraft (N,); they keep their last motion."""

    def step(self, ticks: int, needed: tuple[int, ...] | None) -> None:
        """Advance by ticks of the base rate; write `truth` of the aircraft needed.

        Args:
            ticks: how many.
            needed: rows among the N aircraft; None: all.
        """


class JsbsimVehicles:
    """JSBSim aircraft behind their virtual autopilots."""

    def __init__(
        self, fleet: FlightModels, gains: Records, aircraft: Records, rows: Indices
    ) -> None:
        """Start in trim, with settled autopilots.

        Args:
            fleet: M flight models.
            gains: (M,) of fbwa.GAINS.
            aircraft: (N,) of AIRCRAFT.
            rows: (M,) of the flight models among the aircraft.
        """
        fleet.bind(aircraft, rows)
        self.fleet, self.rows, self._aircraft = fleet, rows, aircraft
        self.autopilots = settled_autopilots(gains, fleet.trimmed)
        self._fly = Call(fly_by_wire_a, rows, *self.autopilots, aircraft)
        self.air_steps: Steps = fleet.air_steps
        self.wind_steps: Steps = (fleet.write_wind,)
        self.autopilot_steps: Steps = (self._fly,)
        self.output_steps: Steps = (fleet.write_surfaces,)
        self._servos = allocate(SERVO, len(rows))

    def retune(self, row: int, params: FbwaParams) -> None:
        """Set the parameters of the autopilot in a row of the fleet; its state stays."""
        gains = self.autopilots.gains
        weight, sitl = gains["pressure_weight"][row], float(gains["sitl_physics_hz"][row])
        timing = AutopilotTiming(sitl_physics_hz=sitl or None)
        gains[row] = make_gains([params], float(gains["dt"][row]), timing)[0]
        gains["pressure_weight"][row] = weight

    def steering_steps(self, followers: Records, leader: LeaderInput) -> Steps:
        """Return nothing: an autopilot takes attitudes."""
        return ()

    def move_steps(self, move: Move) -> Steps:
        """See `Vehicles`."""
        return self.fleet.move_steps(move)

    def autopilot_step(self) -> None:
        """Step the autopilots, and give their surfaces to the flight models."""
        run_steps((*self.autopilot_steps, *self.output_steps), 0.0)

    def fault_steps(self, *, floating: bool) -> Steps:
        """See `Vehicles`."""
        steps = list[Step]()
        if floating:
            floats = Call(any_floats, self.rows, self._aircraft)
            keep = Call(keep_flow, self.rows, self._aircraft, self._servos)
            steps += *steps_if(floats, self.air_steps), keep
        return (*steps, (self._fault_call(), self._drain_batteries))

    def _fault_call(self) -> Call:
        """Return what turns servo outputs in the records into the state of surfaces and motors."""
        trimmed = np.stack(self.fleet.trimmed, axis=1)
        records = self.rows, self._aircraft, self._servos
        return Call(apply_actuator_faults, *records, trimmed, *self.fleet.geometry)

    def _drain_batteries(self, now: float) -> None:
        self.fleet.discharge(self._aircraft["faults"]["charge"][self.rows])

    def remove(self, lost: BoolArray) -> None:
        """See `Vehicles`."""
        self.fleet.remove(lost[self.rows])

    def step(self, ticks: int, needed: tuple[int, ...] | None) -> None:
        """See `Vehicles`."""
        rows = np.arange(len(self._aircraft)) if needed is None else np.array(needed, dtype=np.intp)
        self.fleet.run(ticks, np.flatnonzero(np.isin(self.rows, rows)))


class UnicycleVehicles:
    """Extended unicycles, which follow (u, ω) without an autopilot."""

    def __init__(
        self, unicycles: Records, base_rate_hz: int, aircraft: Records, rows: Indices
    ) -> None:
        """Start, and write the initial motion.

        Args:
            unicycles: (M,) of UNICYCLE.
            base_rate_hz: steps per second.
            aircraft: (N,) of AIRCRAFT.
            rows: (M,) of the unicycles among the aircraft.
        """
        self.rows, self._unicycles, self._aircraft = rows, unicycles, aircraft
        self._first = unicycles.copy()
        self._dt = 1.0 / base_rate_hz
        self.air_steps: Steps = ()
        self.wind_steps: Steps = ()
        self.autopilot_steps: Steps = ()
        self.output_steps: Steps = ()
        air = aircraft["air"]
        for name in ("state_of_charge", "battery_voltage"):
            air[name][rows] = np.nan
        write_motion(unicycles, rows, aircraft)

    def fault_steps(self, *, floating: bool) -> Steps:
        """Return nothing: there are no servos."""
        return ()

    def steering_steps(self, followers: Records, leader: LeaderInput) -> Steps:
        """See `Vehicles`."""
        return (Call(_steer, self._unicycles, self.rows, followers, *leader),)

    def move_steps(self, move: Move) -> Steps:
        """See `Vehicles`."""
        return (Call(_move, self._unicycles, self.rows, self._aircraft, self._dt, move.steps),)

    def remove(self, lost: BoolArray) -> None:
        """See `Vehicles`."""
        stop_unicycles(self._unicycles, self._first, lost[self.rows])
        self._aircraft["stopped"][self.rows] = self._unicycles["stopped"]

    def step(self, ticks: int, needed: tuple[int, ...] | None) -> None:
        """See `Vehicles`."""
        _move(self._unicycles, self.rows, self._aircraft, self._dt, np.array([ticks]))


@entry
def _move(unicycles: Records, rows: Indices, aircraft: Records, dt: float, steps: Indices) -> None:
    """Advance unicycles (M,) by steps of dt, s; write their motion and which have stopped."""
    advance(unicycles, dt, steps[0])
    write_motion(unicycles, rows, aircraft)
    for k in range(len(rows)):
        if not is_finite(unicycles[k]):
            aircraft[rows[k]].stopped = True


@entry
def _steer(
    unicycles: Records, rows: Indices, followers: Records, speed: Array, omega: Array
) -> None:
    """Copy (u, ω) of the followers, and of the leader, to their unicycles."""
    for k in range(len(rows)):
        v = unicycles[k]
        if v.stopped:
            continue
        if rows[k] == 0:
            v.speed_command = speed[0]
            for axis in range(3):
                v.omega[axis] = omega[axis]
        else:
            f = followers[rows[k] - 1]
            v.speed_command = f.speed_command
            for axis in range(3):
                v.omega[axis] = f.omega[axis]


# A tick of a scripted leader.
SCRIPT = np.dtype([("truth", MOTION), ("throttle", "f8")], align=True)


class ScriptedVehicle:
    """A leader whose motion is given: a recorded flight, or a formula."""

    def __init__(self, blocks: Iterator[tuple[SampledTrajectory, Array]], wind_ned: Array) -> None:
        """Start at the first row of the first block.

        Args:
            blocks: motion and equivalent airspeed, one row for each tick of the schedule; none is
                longer than the first.
            wind_ned: (3,) m/s.
        """
        self.rows = np.zeros(1, dtype=np.intp)
        self._blocks, self._wind = blocks, wind_ned
        first = next(blocks)
        self._script = allocate(SCRIPT, len(first[1]))
        self._next = np.zeros(2, dtype=np.int64)  # row of `_script`, and their number
        self._fill(first)
        self.air_steps: Steps = ()
        self.wind_steps: Steps = ()
        self.autopilot_steps: Steps = ()
        self.output_steps: Steps = ()

    def bind(self, aircraft: Records) -> None:
        """Write row 0 of AIRCRAFT from now on."""
        aircraft["wind"]["wind_ned"][0] = self._wind
        for name in ("state_of_charge", "battery_voltage"):
            aircraft["air"][name][0] = np.nan
        self._follow = Call(_follow_script, self._script, self._next, aircraft)
        self._follow(0.0)

    def _fill(self, block: tuple[SampledTrajectory, Array]) -> None:
        """Write a block into the script, to be followed from its first row on."""
        track, equivalent_airspeed = block
        count = len(equivalent_airspeed)
        truth = self._script["truth"][:count]
        for name in (
            *("position_ned", "velocity_ned", "acceleration_ned", "euler", "rates_body"),
            "airspeed",
        ):
            truth[name] = getattr(track, name)
        truth["equivalent_airspeed"] = equivalent_airspeed
        self._script["throttle"][:count] = track.throttle
        self._next[:] = 0, count

    def fault_steps(self, *, floating: bool) -> Steps:
        """Return nothing: the motion is given."""
        return ()

    def steering_steps(self, followers: Records, leader: LeaderInput) -> Steps:
        """Return nothing: the motion is given."""
        return ()

    def remove(self, lost: BoolArray) -> None:
        """Do nothing: the motion is given."""

    def move_steps(self, move: Move) -> Steps:
        """See `Vehicles`."""
        return ((self._follow, self._follow_next_block),)

    def step(self, ticks: int, needed: tuple[int, ...] | None) -> None:
        """Move to the next row of the script."""
        if self._follow(0.0):
            self._follow_next_block(0.0)

    def _follow_next_block(self, now: float) -> None:
        self._fill(next(self._blocks))
        self._follow(0.0)


@entry
def _follow_script(script: Records, next_: Indices, aircraft: Records) -> bool:
    """Write motion and throttle of the leader, from the next row; return whether there is none.

    Args:
        script: (B,) of SCRIPT.
        next_: (2,) number of the row, written, and that of all rows.
        aircraft: (N,) of AIRCRAFT, the leader first.
    """
    k = next_[0]
    if k >= next_[1]:
        return True
    next_[0] = k + 1
    copy_motion(script[k].truth, aircraft[0].truth)
    aircraft[0].surfaces.throttle = script[k].throttle
    return False


@entry
def command_own_motion(aircraft: Records) -> None:
    """Write the leader's attitude and throttle as its command: its motion is given."""
    leader = aircraft[0]
    leader.control.pitch, leader.control.roll = leader.truth.euler[1], leader.truth.euler[0]
    leader.control.throttle = leader.surfaces.throttle
