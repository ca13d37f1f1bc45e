"""Aircraft flown by ArduPlane, and aircraft of the same fleet with virtual autopilots."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from testbed.ardupilot.json_physics import MOTION_NUMBERS, pack_motion
from testbed.ardupilot.sitl_process import stop_processes
from testbed.core.call_list import Call, Steps
from testbed.core.compile import bind_entry
from testbed.core.records import (
    BoolArray,
    Event,
    FbwaCommand,
    Indices,
    Records,
    join_names,
)
from testbed.flight.vehicles import JsbsimVehicles
from testbed.vehicle.fleet import FlightModels, Move

if TYPE_CHECKING:
    from testbed.ardupilot.ardupilot_sitl import SitlVehicle


class ArduPlaneVehicles(JsbsimVehicles):
    """A fleet in which some aircraft are flown by an ArduPlane each, in lockstep.

    At each tick ArduPlane receives the truth, the airspeed that the pitot tube measured in its
    last period and the stick pulses; its servo outputs move the aircraft through that tick. Faults
    act behind the servo outputs.
    """

    def __init__(
        self,
        fleet: FlightModels,
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
        self.autopilot_steps, self.output_steps = (self._step_autopilots,), ()
        self._planes, self._arduplane = dict(planes), arduplane
        self._all = tuple(self._planes.values())
        self._messages: list[tuple[SitlVehicle, str, str]] = []
        self._raw = aircraft["surfaces"][rows]  # outputs of the virtual autopilots
        self._pitot = fleet.read().equivalent_airspeed
        self._outputs = {k: self._raw[k].item() for k in planes}
        self._motion = np.empty((len(rows), MOTION_NUMBERS))  # of `pack_motion`
        packed = rows, aircraft, self._motion
        self._pack_motion = bind_entry(pack_motion, *packed, like=(fleet.all_rows,))
        self._sent = False  # the state of this tick, to the ArduPlanes
        self._one = {k: np.array([k]) for k in planes}
        self._virtual = np.setdiff1d(fleet.all_rows, list(planes))
        self._apply_faults: Call | None = None  # None: the scenario has none

    def check(self) -> None:
        """Check that the program exists, before anything is started or written.

        Raises:
            InputError: it does not.
        """
        for plane in self._all:
            plane.find(self._arduplane)

    def start(
        self, check_stop: Callable[[], None], announce: Callable[[str], None] = lambda text: None
    ) -> None:
        """Start all processes, then run their startup one by one in the initial state.

        Args:
            check_stop: called repeatedly in every wait for a process, also in flight; raises
                `RunStopped` when the run is to end.
            announce: receives messages to the user: ports, and a warning about open ones.

        Raises:
            InputError: one cannot be started.
            RunStopped: the run is to end.
        """
        for plane in self._all:
            plane.start(self._arduplane, check_stop)
        for line in self._describe_ports():
            announce(line)
        state, air = self.fleet.read(), self.fleet.air()
        self._pack_motion(self.fleet.all_rows)
        for row, plane in self._planes.items():
            roll, pitch, _ = state.euler[row].tolist()
            trim = FbwaCommand(pitch, roll, float(self._raw["throttle"][row]))
            pitot, voltage = state.equivalent_airspeed[row], air.battery_voltage[row]
            inputs = air.wind_ned[row].tolist(), float(pitot), float(voltage)
            text = plane.start_up(self._motion[row].tolist(), inputs, trim)
            # of the boot only warnings become events
            warnings = [each for each in plane.pop_messages() if each[0] != "info"]
            self._messages += [(plane, *each) for each in warnings]
            if text:
                self._messages.append((plane, "info", text))

    def _describe_ports(self) -> Iterator[str]:
        """Describe the ports of all ArduPlanes, with one warning for those on every address."""
        # imported here, as few scenarios need them
        from testbed.ardupilot.ardupilot_sitl import HOST, open_ports, ports

        for plane in self._all:
            physics, mavlink = ports(plane.instance)
            yield (
                f"ArduPlane: {plane.name} by instance {plane.instance}, {physics}/udp and "
                f"{mavlink}/tcp of {HOST}"
            )
        started = [plane for plane in self._all if plane.process is not None]
        if started:
            rc, tcp = open_ports(0)
            of = str(started[0].instance) if len(started) == 1 else "its instance"
            numbers = join_names([str(each) for each in tcp])
            yield (
                f"warning: ArduPlane itself listens on {rc}/udp and {numbers}/tcp, plus ten times "
                f"{of}, of every address of this machine: any program that reaches it can command "
                f"{join_names([plane.name for plane in started])}"
            )

    def pop_events(self, now: float) -> list[Event]:
        """Return messages and state changes of the ArduPlanes since the last call."""
        messages, self._messages = self._messages, []
        return [Event(now, level, plane.name, text) for plane, level, text in messages]

    def summary(self) -> dict[str, str]:
        """Return the version of each ArduPlane, by name of the aircraft."""
        return {plane.name: plane.client.version or "unknown version" for plane in self._all}

    def close(self) -> None:
        """Stop what was started, however far that came; called once, however the run ends."""
        self._stop(self._all)

    def _step_autopilots(self, now: float) -> None:
        """Send command and state to the ArduPlanes, and step the virtual autopilots.

        The ArduPlanes then compute during the rest of the tick, the sample and the log.
        """
        self._pitot = self._aircraft["estimate"]["equivalent_airspeed"][self.rows]
        self._send_states(self._aircraft["command"][self.rows])
        self._fly(now)
        for plane in self._planes.values():
            self._messages += [(plane, *each) for each in plane.pop_messages()]
        self._raw = self._aircraft["surfaces"][self.rows]
        self._write_outputs()

    def fault_steps(self, *, floating: bool) -> Steps:
        """See `Vehicles`; faults act behind the servo outputs of each tick, too."""
        self._apply_faults = self._fault_call()
        return super().fault_steps(floating=floating)

    def remove(self, lost: BoolArray) -> None:
        """See `Vehicles`; the ArduPlane of a lost aircraft is stopped."""
        super().remove(lost)
        removed = [k for k in self._planes if lost[self.rows[k]]]
        self._stop([self._planes.pop(k) for k in removed])

    def move_steps(self, move: Move) -> Steps:
        """See `Vehicles`."""
        return (lambda now: self.step(int(move.steps[0]), None),)

    def step(self, ticks: int, needed: tuple[int, ...] | None) -> None:
        """Step each flight model as soon as its ArduPlane has computed the tick.

        Flight models do not depend on one another within a call. While one is stepped, the
        ArduPlanes of the others compute.
        """
        fleet, outputs = self.fleet, self._outputs
        planes = tuple(self._planes.items())
        if not self._sent:
            self._send_states(None)
        self._sent = False
        fleet.write_surfaces(0.0)
        fleet.run_some(self._virtual, ticks)
        for left in reversed(range(ticks)):
            for k, plane in planes:
                outputs[k] = plane.surfaces(plane.receive_pwm())
                if self._apply_faults is None:
                    self._aircraft["surfaces"][self.rows[k]] = outputs[k]
                    self._step_one(k, plane, left)
            if self._apply_faults is not None:
                self._write_outputs()
                self._apply_faults(0.0)
                for k, plane in planes:
                    self._step_one(k, plane, left)

    def _step_one(self, k: int, plane: SitlVehicle, left: int) -> None:
        """Step a flight model by a tick, and send its state if ticks are left."""
        self.fleet.write_surfaces(0.0)
        self.fleet.run_some(self._one[k], 1)
        if left:
            self._send_state(k, plane)

    def _send_states(self, commands: Records | None) -> None:
        """Send the current state to all ArduPlanes, once before a step.

        Args:
            commands: (M,) of COMMAND; None: those sent before.
        """
        self.fleet.read_air()
        winds = self._aircraft["wind"]["wind_ned"][self.rows].tolist()
        voltage = self._aircraft["air"]["battery_voltage"][self.rows].tolist()
        pitot = self._pitot.tolist()
        for k, plane in self._planes.items():
            if commands is not None:
                plane.set_command(FbwaCommand._make(commands[k].item()))
            plane.set_inputs(winds[k], pitot[k], voltage[k])
            self._send_state(k, plane)
        self._sent = True

    def _send_state(self, k: int, plane: SitlVehicle) -> None:
        self._pack_motion(self._one[k])
        plane.send_state(self._motion[k].tolist())

    def _write_outputs(self) -> None:
        """Write the servo outputs of all autopilots, ArduPlane's and virtual, as surfaces."""
        outputs = self._raw.copy()
        for k, output in self._outputs.items():
            outputs[k] = output
        self._aircraft["surfaces"][self.rows] = outputs

    def _stop(self, planes: Sequence[SitlVehicle]) -> None:
        stop_processes([plane.process for plane in planes if plane.process is not None])
        for plane in planes:  # last: other runs take no instance whose physics port is bound
            plane.close()
