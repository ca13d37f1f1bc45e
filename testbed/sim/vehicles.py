"""Vehicles of a run: JSBSim aircraft, ideal vehicles, and leaders that follow a script.

Each object reads and writes its rows of the run's AIRCRAFT records in place.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Protocol

import numpy as np

from testbed.autopilot.fbwa import fly_by_wire_a, settled_autopilots
from testbed.autopilot.parameters import AutopilotTiming, FbwaParams, make_gains
from testbed.core.compile import Kernel, entry
from testbed.core.records import (
    ActuatorCommand,
    Array,
    BoolArray,
    FaultState,
    Indices,
    Records,
    fault_state,
    fields_of,
)
from testbed.guidance.recorded_path import SampledTrajectory
from testbed.vehicle.control_surfaces import Servos, apply_actuator_faults, initial_servos
from testbed.vehicle.fleet import JsbsimFleet, write_fields_at
from testbed.vehicle.unicycle import advance, are_finite, stop_unicycles, write_motion


class Vehicles(Protocol):
    """Some of the aircraft of a run, stepped together."""

    rows: Indices  # (M,) among the N aircraft

    def read_air(self) -> None:
        """Write `air` of the records; the same at every call of a tick."""

    def set_wind(self) -> None:
        """Use `wind` of the records from now on; at the autopilot rate."""

    def set_unicycle(self, followers: Records, speed: float, omega: Array) -> None:
        """Set the inputs of extended unicycles; at the control rate.

        Args:
            followers: (n,) of FOLLOWER.
            speed: u of the leader, m/s.
            omega: ω of the leader (3,), rad/s.
        """

    def autopilot_step(self) -> None:
        """Compute `surfaces` of the records from `command`; at the autopilot rate."""

    def apply_faults(self) -> None:
        """Apply `faults` to `surfaces`; after `autopilot_step`, in runs with faults."""

    def remove(self, lost: BoolArray) -> None:
        """Stop lost aircraft (N,); they keep their last motion."""

    def step(self, ticks: int, needed: tuple[int, ...] | None) -> None:
        """Advance by ticks of the base rate; write `truth` of the aircraft needed.

        Args:
            ticks: how many.
            needed: rows among the N aircraft; None: all.
        """

    def kernels(self, followers: Records) -> list[Kernel]:
        """Return the compiled calls of these vehicles, for `core.compile.prepare`."""


class JsbsimVehicles:
    """JSBSim aircraft behind their virtual autopilots."""

    def __init__(
        self, fleet: JsbsimFleet, gains: Records, aircraft: Records, rows: Indices
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
        self._fly = partial(fly_by_wire_a, rows, *self.autopilots, aircraft)
        self.read_air, self.set_wind = fleet.read_air, fleet.write_wind
        self._servos: Servos | None = None
        self._faults: FaultState | None = None
        self._zero_flow = self._flow = np.zeros((len(rows), 2))
        self._changed = True  # surfaces were written since the last step
        self._needed: dict[tuple[int, ...], Indices] = {}  # flight models by the rows needed

    def retune(self, row: int, params: FbwaParams) -> None:
        """Set the parameters of the autopilot in a row of the fleet; its state stays."""
        gains = self.autopilots.gains
        weight, sitl = gains["pressure_weight"][row], float(gains["sitl_physics_hz"][row])
        timing = AutopilotTiming(sitl_physics_hz=sitl or None)
        gains[row] = make_gains([params], float(gains["dt"][row]), timing)[0]
        gains["pressure_weight"][row] = weight

    def set_unicycle(self, followers: Records, speed: float, omega: Array) -> None:
        """Ignore the inputs: an autopilot takes attitudes."""

    def kernels(self, followers: Records) -> list[Kernel]:
        """See `Vehicles`."""
        return [self._fly, *self.fleet.kernels()]

    def autopilot_step(self) -> None:
        """See `Vehicles`."""
        self._fly()
        self._changed = True

    def apply_faults(self) -> None:
        """See `Vehicles`."""
        fleet, rows = self.fleet, self.rows
        faults = fault_state(self._aircraft["faults"][rows])
        self._flow = self._zero_flow
        if faults.floating.any():
            air = fleet.air()
            self._flow = np.stack((air.alpha, air.beta), axis=1)
        self._apply_actuator_faults(faults, self._flow)
        fleet.discharge(faults.charge)

    def _apply_actuator_faults(self, faults: FaultState, flow: Array) -> None:
        """Turn servo outputs in the records into the state of surfaces and motors."""
        fleet = self.fleet
        surfaces = fields_of(ActuatorCommand, self._aircraft["surfaces"])
        before = self._servos or initial_servos(fleet.trimmed, fleet.geometry)
        outputs = ActuatorCommand(*(each[self.rows] for each in surfaces))
        actuators, self._servos = apply_actuator_faults(
            outputs, before, faults, flow, fleet.geometry
        )
        write_fields_at(self._aircraft, self.rows, "surfaces", actuators)

    def remove(self, lost: BoolArray) -> None:
        """See `Vehicles`."""
        self.fleet.remove(lost[self.rows])

    def step(self, ticks: int, needed: tuple[int, ...] | None) -> None:
        """See `Vehicles`."""
        if self._changed:
            self.fleet.write_surfaces()
            self._changed = False
        self.fleet.run(ticks, self.fleet.all_rows if needed is None else self._fleet_rows(needed))

    def _fleet_rows(self, needed: tuple[int, ...]) -> Indices:
        """Return the rows of the fleet that are among these of the aircraft."""
        if needed not in self._needed:
            self._needed[needed] = np.flatnonzero(np.isin(self.rows, needed))
        return self._needed[needed]


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
        self._first, self._dt = unicycles.copy(), 1.0 / base_rate_hz
        self._write = partial(write_motion, unicycles, rows, aircraft)
        self._steer = partial(_steer, unicycles, rows)
        air = aircraft["air"]
        for name in ("state_of_charge", "battery_voltage"):
            air[name][rows] = np.nan
        self._write()

    def read_air(self) -> None:
        """Do nothing: a unicycle flies along its nose and has no propeller or battery."""

    def set_wind(self) -> None:
        """See `Vehicles`: the motion is written with the wind of the records."""

    def set_unicycle(self, followers: Records, speed: float, omega: Array) -> None:
        """See `Vehicles`."""
        self._steer(followers, speed, omega)

    def kernels(self, followers: Records) -> list[Kernel]:
        """See `Vehicles`."""
        omega = np.zeros(3)
        return [
            partial(self._steer, followers, 0.0, omega),
            partial(advance, self._unicycles, self._dt, 1),
            self._write,
        ]

    def autopilot_step(self) -> None:
        """Do nothing: there is no autopilot."""

    def apply_faults(self) -> None:
        """Do nothing: a unicycle has no parts that fail."""

    def remove(self, lost: BoolArray) -> None:
        """See `Vehicles`."""
        stop_unicycles(self._unicycles, self._first, lost[self.rows])
        self._aircraft["stopped"][self.rows] = self._unicycles["stopped"]

    def step(self, ticks: int, needed: tuple[int, ...] | None) -> None:
        """See `Vehicles`."""
        advance(self._unicycles, self._dt, ticks)
        self._write()
        self._aircraft["stopped"][self.rows] |= ~are_finite(self._unicycles)


@entry
def _steer(
    unicycles: Records, rows: Indices, followers: Records, speed: float, omega: Array
) -> None:
    """Copy (u, ω) of the followers, and of the leader, to their unicycles."""
    for k in range(len(rows)):
        v = unicycles[k]
        if v.stopped:
            continue
        if rows[k] == 0:
            v.speed_command = speed
            for axis in range(3):
                v.omega[axis] = omega[axis]
        else:
            f = followers[rows[k] - 1]
            v.speed_command = f.speed_command
            for axis in range(3):
                v.omega[axis] = f.omega[axis]


class ScriptedVehicle:
    """A leader whose motion is given: a recorded flight, or a formula."""

    def __init__(self, blocks: Iterator[tuple[SampledTrajectory, Array]], wind_ned: Array) -> None:
        """Start at the first row of the first block.

        Args:
            blocks: motion and equivalent airspeed, one row for each tick of the schedule.
            wind_ned: (3,) m/s.
        """
        self.rows = np.zeros(1, dtype=np.intp)
        self._blocks, self._row, self._wind = blocks, 0, wind_ned
        self._track, self._equivalent_airspeed = next(blocks)

    def bind(self, aircraft: Records) -> None:
        """Write row 0 of AIRCRAFT from now on."""
        self._aircraft = aircraft
        aircraft["wind"]["wind_ned"][0] = self._wind
        for name in ("state_of_charge", "battery_voltage"):
            aircraft["air"][name][0] = np.nan
        self._write()

    def _write(self) -> None:
        """Write motion and throttle; the command is the motion itself."""
        track, row, truth = self._track, self._row, self._aircraft["truth"]
        for name in (
            *("position_ned", "velocity_ned", "acceleration_ned", "euler", "rates_body"),
            "airspeed",
        ):
            truth[name][0] = getattr(track, name)[row]
        truth["equivalent_airspeed"][0] = self._equivalent_airspeed[row]
        self._aircraft["surfaces"]["throttle"][0] = track.throttle[row]

    def command(self) -> tuple[float, float, float]:
        """Return the present pitch, roll and throttle."""
        roll, pitch, _ = self._track.euler[self._row].tolist()
        return pitch, roll, float(self._track.throttle[self._row])

    def read_air(self) -> None:
        """Do nothing: a script has neither flow angles nor a propeller."""

    def set_wind(self) -> None:
        """Do nothing: the motion is given."""

    def set_unicycle(self, followers: Records, speed: float, omega: Array) -> None:
        """Ignore the inputs."""

    def kernels(self, followers: Records) -> list[Kernel]:
        """See `Vehicles`: a script needs none."""
        return []

    def autopilot_step(self) -> None:
        """Do nothing: there is no autopilot."""

    def apply_faults(self) -> None:
        """Do nothing: the motion is given."""

    def remove(self, lost: BoolArray) -> None:
        """Do nothing: the motion is given."""

    def step(self, ticks: int, needed: tuple[int, ...] | None) -> None:
        """Move to the next row of the track."""
        self._row += 1
        if self._row == len(self._track.position_ned):
            self._row = 0
            self._track, self._equivalent_airspeed = next(self._blocks)
        self._write()
