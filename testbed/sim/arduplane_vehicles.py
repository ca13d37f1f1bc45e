"""Aircraft flown by ArduPlane, and aircraft of the same fleet with virtual autopilots."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from testbed.autopilot.json_physics import state_columns
from testbed.autopilot.sitl_process import stop_processes
from testbed.core.records import (
    BoolArray,
    Event,
    Indices,
    Origin,
    Records,
    VehicleState,
    fault_state,
)
from testbed.scenario import Scenario
from testbed.scenario.control_source import ArduPlane
from testbed.sim.vehicles import JsbsimVehicles
from testbed.vehicle.fleet import JsbsimFleet

if TYPE_CHECKING:
    from testbed.autopilot.ardupilot_sitl import SitlVehicle


class ArduPlaneVehicles(JsbsimVehicles):
    """A fleet in which some aircraft are flown by an ArduPlane each, in lockstep.

    At each tick ArduPlane receives the truth, the airspeed that the pitot tube measured in its
    last period and the stick pulses; its servo outputs move the aircraft through that tick. Faults
    act behind the servo outputs.
    """

    def __init__(
        self,
        fleet: JsbsimFleet,
        gains: Records,
        aircraft: Records,
        rows: Indices,
        planes: Mapping[int, SitlVehicle],
        arduplane: Path | None,
    ) -> None:
        """Start in trim, without starting an ArduPlane.

        Args:
            fleet: M flight models.
            gains: (M,) of fbwa.GAINS, also of aircraft whose virtual autopilot is not used.
            aircraft: (N,) of AIRCRAFT.
            rows: (M,) of the flight models among the aircraft.
            planes: the ArduPlanes by row of the fleet.
            arduplane: the binary of the command line.
        """
        super().__init__(fleet, gains, aircraft, rows)
        self._planes, self._arduplane = dict(planes), arduplane
        self._all = tuple(self._planes.values())
        self._messages: list[tuple[SitlVehicle, str, str]] = []
        self._raw = aircraft["surfaces"][rows]  # outputs of the virtual autopilots
        self._pitot = fleet.read().equivalent_airspeed
        self._outputs = {k: self._raw[k].item() for k in planes}

    def check(self) -> None:
        """See `ExternalProcess`."""
        for plane in self._all:
            plane.find(self._arduplane)

    def start(self, check_stop: Callable[[], None]) -> None:
        """Start all processes, then run their startup one by one in the initial state."""
        for plane in self._all:
            plane.start(self._arduplane, check_stop)
        state, air = self.fleet.read(), self.fleet.air()
        columns = state_columns(state, air.wind_ned, state.equivalent_airspeed)
        for row, plane in self._planes.items():
            roll, pitch, _ = state.euler[row].tolist()
            trim = roll, pitch, float(self._raw["throttle"][row])
            text = plane.start_up(columns[row].tolist(), float(air.battery_voltage[row]), trim)
            # of the boot only warnings become events
            warnings = [each for each in plane.pop_messages() if each[0] != "info"]
            self._messages += [(plane, *each) for each in warnings]
            if text:
                self._messages.append((plane, "info", text))

    def pop_events(self, now: float) -> list[Event]:
        """See `ExternalProcess`."""
        messages, self._messages = self._messages, []
        return [Event(now, level, plane.name, text) for plane, level, text in messages]

    def summary(self) -> dict[str, str]:
        """See `ExternalProcess`: the version of each ArduPlane."""
        return {plane.name: plane.client.version or "unknown version" for plane in self._all}

    def close(self) -> None:
        """See `ExternalProcess`."""
        self._stop(self._all)

    def autopilot_step(self) -> None:
        """Step the virtual autopilots, and set the commands of the ArduPlanes."""
        super().autopilot_step()
        for k, plane in self._planes.items():
            command = self._aircraft["command"][self.rows[k]]
            plane.set_command(
                float(command["roll"]), float(command["pitch"]), float(command["throttle"])
            )
            self._messages += [(plane, *each) for each in plane.pop_messages()]
        self._raw = self._aircraft["surfaces"][self.rows]
        self._pitot = self._aircraft["estimate"]["equivalent_airspeed"][self.rows]
        self._write_outputs()

    def apply_faults(self) -> None:
        """See `Vehicles`; faults act behind the servo outputs of each tick."""
        super().apply_faults()
        self._faults = fault_state(self._aircraft["faults"][self.rows])

    def remove(self, lost: BoolArray) -> None:
        """See `Vehicles`; the ArduPlane of a lost aircraft is stopped."""
        super().remove(lost)
        removed = [k for k in self._planes if lost[self.rows[k]]]
        self._stop([self._planes.pop(k) for k in removed])

    def step(self, ticks: int, needed: tuple[int, ...] | None) -> None:
        """Step tick by tick: send states, receive pulses, step the flight models."""
        planes, fleet = self._planes, self.fleet
        which = np.array(list(planes), dtype=np.intp)
        air = fleet.air()
        wind_ned, voltage = air.wind_ned[which], air.battery_voltage[which].tolist()
        pitot = self._pitot[which]
        for _ in range(ticks):
            if planes:
                motion = VehicleState(*(each[which] for each in fleet.read()))
                columns = state_columns(motion, wind_ned, pitot)
                each = zip(planes.values(), columns.tolist(), voltage, strict=True)
                for plane, own, volts in each:
                    plane.send_state(own, volts)
                for k, plane in planes.items():
                    self._outputs[k] = plane.surfaces(plane.receive_pwm())
            self._write_outputs()
            if self._faults is not None:
                self._apply_actuator_faults(self._faults, self._flow)
            fleet.write_surfaces()
            fleet.run(1, fleet.all_rows)

    def _write_outputs(self) -> None:
        """Write the servo outputs of all autopilots, ArduPlane's and virtual, as surfaces."""
        outputs = self._raw.copy()
        for k, output in self._outputs.items():
            outputs[k] = output
        self._aircraft["surfaces"][self.rows] = outputs

    def _stop(self, planes: Sequence[SitlVehicle]) -> None:
        for plane in planes:
            plane.close()
        stop_processes([plane.process for plane in planes if plane.process is not None])


def build_jsbsim_vehicles(
    scenario: Scenario,
    fleet: JsbsimFleet,
    gains: Records,
    aircraft: Records,
    rows: Sequence[int],
    tunes: Sequence[Path],
    arduplane: Path | None,
) -> JsbsimVehicles:
    """Make the vehicles of a scenario's aircraft with flight models.

    Args:
        scenario: as resolved.
        fleet: M flight models.
        gains: (M,) of fbwa.GAINS.
        aircraft: (N,) of AIRCRAFT.
        rows: M rows of the flight models among the aircraft.
        tunes: N parameter files.
        arduplane: the binary of the command line.
    """
    if not any(isinstance(scenario.aircraft[row].autopilot, ArduPlane) for row in rows):
        return JsbsimVehicles(fleet, gains, aircraft, np.array(rows, dtype=np.intp))
    # imported here, as few scenarios need them
    from testbed.autopilot.ardupilot_sitl import SitlConfig, SitlVehicle

    origin = Origin(**scenario.scenario.origin.model_dump())
    yaw = fleet.read().euler[:, 2]
    planes = {}
    for k, row in enumerate(rows):
        autopilot = scenario.aircraft[row].autopilot
        if not isinstance(autopilot, ArduPlane):
            continue
        config = SitlConfig(
            name=scenario.aircraft[row].name,
            instance=row if autopilot.instance is None else autopilot.instance,
            start=autopilot.start,
            binary=autopilot.binary,
            tune=tunes[row],
            timeout_s=autopilot.timeout_s,
            heading_deg=math.degrees(float(yaw[k])) % 360.0,
            elevon_mixing=float(fleet.geometry.mixing[k]),
        )
        planes[k] = SitlVehicle(
            config,
            origin,
            physics_hz=scenario.rates.physics_hz,
            autopilot_hz=scenario.rates.autopilot_hz,
        )
    return ArduPlaneVehicles(
        fleet, gains, aircraft, np.array(rows, dtype=np.intp), planes, arduplane
    )
