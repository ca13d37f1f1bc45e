"""A formation in steady flight, from whose present any number of flights go on.

Stages of the flight can hold and change the messages that followers use, and change, delay and add
to their commands.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from testbed.compiled.compiled_fleet import CompiledFleet
from testbed.core.call_list import Step, run_steps
from testbed.core.frames import course
from testbed.core.records import LINK, Array, Records, allocate
from testbed.core.saved_state import SavedState
from testbed.flight.control import ControlGroup
from testbed.flight.loop import Flight
from testbed.flight.schedule import Clock
from testbed.flight.stages import FlightRecords, UserStage
from testbed.flight.steps import copy_truth
from testbed.flight.vehicles import JsbsimVehicles
from testbed.flight.world import World
from testbed.formation.compiled_law import CompiledLaw
from testbed.formation.slots import write_formation_state

MESSAGE = ("position_ned", "velocity_ned", "acceleration_ned")  # of a follower's message, 3 each
LEADER_MESSAGE = (*MESSAGE, "euler", "euler_rates")
COMMANDS = ("pitch", "roll", "throttle")
KICK_S = 0.2
GIVE_COMMANDS = "give commands to autopilots"


class InputChanges:
    """Changes of the followers' messages and commands.

    A command stays in the records of the aircraft from one control step to the next, while the
    autopilots read it in each of their periods. So what is written there in a period is always
    computed from the command as the control, or its companion, has given it, never from what is
    there. The same holds for messages, which stay in the links until newer ones arrive.

    Attributes:
        held: (n, N) of LINK, the messages that are used; None: those that arrive.
        messages: (n, N, 15) added to the fields of LEADER_MESSAGE of the held ones, or of those
            that arrive, NED.
        swing: what is added besides, (n, N, 15) of the times (n, N) at which the content of the
            messages was measured, s; None: nothing.
        added: (n, 3) added to the commands in each period of the autopilots.
        gain: (n, 3) factor of the commands' deviations from the steady ones.
        latency_s: (n, 3) of the commands, additional.
        computed: (n, 3) commands that the autopilots were given last, before all this.
        keeps_next: whether the messages of the next control step are copied to `delivered`.
        delivered: (n, N) of LINK.
    """

    CONSTANT = True  # no state of the flight

    def __init__(self, n: int, clock: Clock, *, each_period: bool = False) -> None:
        """Start without changes.

        Args:
            n: followers.
            clock: of the flight.
            each_period: commands are given in each period of the autopilots, as by companions, not
                at control steps only.
        """
        self.held: Records | None = None
        self.swing: Callable[[Array], Array] | None = None
        self.keeps_next, self.delivered = False, allocate(LINK, n, n + 1)
        self._arrived = allocate(LINK, n, n + 1)
        self._arrived["number"] = -1  # none yet
        self.messages = np.zeros((n, n + 1, 3 * len(LEADER_MESSAGE)))
        self._clock, self._each_period = clock, each_period
        self._rate_hz = clock.base_rate_hz / clock.autopilot
        self._control_ticks = {each % clock.control for each in (0, *clock.control_phases)}
        self.added = np.zeros((n, 3))
        self.computed = np.zeros((n, 3))
        self.gain, self.latency_s = np.ones((n, 3)), np.zeros((n, 3))
        self._steady: Array | None = None
        self._line = np.zeros((1, n, 3))
        self._late = np.zeros((n, 3))
        self._places = np.indices((n, 3))  # in the line

    def begin(self, steady: Array | None = None) -> None:
        """Begin a flight with this gain and latency.

        Args:
            steady: (n, 3) commands whose deviations they change; None: the present ones.
        """
        self._steady = self.computed.copy() if steady is None else steady
        self._late = self.latency_s * self._rate_hz
        self._line = np.repeat(self._steady[np.newaxis], int(self._late.max()) + 2, axis=0)

    def end(self) -> None:
        """Take all changes away."""
        self.held, self.swing, self._steady = None, None, None
        self.messages[:] = self.added[:] = self.latency_s[:] = 0.0
        self.gain[:] = 1.0

    def stages(self) -> tuple[UserStage, ...]:
        """Return the stages of the flight that make the changes."""
        return (
            UserStage("hold messages", "deliver messages", self._hold),
            UserStage("change commands", GIVE_COMMANDS, self._change_given),
            UserStage("change commands", "copy the truth to the estimates", self._change_held),
        )

    def _hold(self, now: float, records: FlightRecords) -> None:
        if self.keeps_next:
            self.delivered, self.keeps_next = records.links.copy(), False
        self.write_messages(records.links)

    def write_messages(self, links: Records) -> None:
        """Write the messages that followers use into links (n, N)."""
        if self.held is None and self.swing is None and not self.messages.any():
            return
        added = self.messages
        if self.swing is not None:
            added = added + self.swing(links["measured_s"])
        base = self._as_arrived(links) if self.held is None else self.held
        for k, name in enumerate(LEADER_MESSAGE):
            links[name] = base[name] + added[:, :, 3 * k : 3 * k + 3]

    def _as_arrived(self, links: Records) -> Records:
        """Return the messages as they were when they arrived, before any change.

        A message stays in the links until a newer one arrives, also where it is delivered to other
        followers in between.
        """
        new = links["number"] != self._arrived["number"]
        self._arrived[new] = links[new]
        return self._arrived

    def read_computed(self, aircraft: Records) -> None:
        """Read the commands that control has computed from aircraft (N,)."""
        self._read(aircraft["control"])

    def _read(self, commands: Records) -> None:
        for k, name in enumerate(COMMANDS):
            self.computed[:, k] = commands[name][1:]

    def _change_given(self, now: float, records: FlightRecords) -> None:
        """Read the commands that are given in this tick, and change them if autopilots read."""
        self._read(records.aircraft["command"])
        tick = self._clock.ticks(now)
        if tick % self._clock.autopilot == 0:
            self._write(records)

    def _change_held(self, now: float, records: FlightRecords) -> None:
        """Change the commands of a period of the autopilots in which none are given."""
        tick, clock = self._clock.ticks(now), self._clock
        given = self._each_period or tick == 0 or tick % clock.control in self._control_ticks
        if tick % clock.autopilot == 0 and not given:
            self._write(records)

    def _write(self, records: FlightRecords) -> None:
        """Write the commands of a period of the autopilots."""
        commands = self.computed
        if self._steady is not None:
            commands = self._steady + self.gain * (self._delayed() - self._steady)
        commands = commands + self.added
        own = records.aircraft[1:]
        for k, name in enumerate(COMMANDS):
            own["command"][name] = commands[:, k]

    def _delayed(self) -> Array:
        line = self._line
        line[1:] = line[:-1].copy()
        line[0] = self.computed
        whole, (rows, columns) = self._late.astype(int), self._places
        sooner, later = line[whole, rows, columns], line[whole + 1, rows, columns]
        delayed: Array = sooner + (self._late - whole) * (later - sooner)
        return delayed


class HeldFlight:
    """A flight of a world of `steady_scenario`.

    Attributes:
        inputs: changes of messages and commands.
        dt: s, control period.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        [self.vehicles] = [each for each in world.vehicles if isinstance(each, JsbsimVehicles)]
        held = world.formation.companions is not None
        self.inputs = InputChanges(len(world.followers), world.clock, each_period=held)
        self._flight = Flight(world, [], self.inputs.stages())
        self._flight.prepare()
        self._flight.fly_to(-math.inf)
        control = world.formation.control
        self._own_control = [
            step for group in range(len(control.groups)) for step in control.steps(group)
        ]
        self._control = self._own_control
        self.dt = world.clock.control / world.clock.base_rate_hz

    @property
    def fleet(self) -> CompiledFleet:
        """The flight models, of a flight whose models are compiled."""
        assert isinstance(self.world.fleet, CompiledFleet), "of a compiled `steady_scenario`"
        return self.world.fleet

    @property
    def time_s(self) -> float:
        """Time of the tick before whose control the flight waits, s."""
        return self._flight.time_s

    def fly_to(self, until_s: float) -> None:
        """Fly on to a tick."""
        self._flight.fly_to(until_s)

    def fly_on_with_messages(self, until_s: float) -> Records:
        """Fly on to a tick; return the messages (n, N) of LINK of the first control step."""
        self.inputs.keeps_next = True
        self.fly_to(until_s)
        return self.inputs.delivered

    def save(self) -> SavedState:
        """Save the present, without the changes of inputs."""
        return SavedState(flight=self._flight)

    def write_motion(self) -> None:
        """Write the motion of the flight models into the records, as at the end of a tick."""
        self.fleet.write_motion()
        copy_truth(self.world.aircraft)

    def use_laws(self, groups: Sequence[ControlGroup] | None) -> None:
        """Choose the compiled laws that `step_control` steps, with the memory of the flight's own.

        Args:
            groups: with laws of the same memory as those of the flight; None: its own.
        """
        self._control = self._own_control
        if groups is None:
            return
        control = self.world.formation.control
        steps: list[Step] = []
        for own, other in zip(control.groups, groups, strict=True):
            assert isinstance(own.law, CompiledLaw) and isinstance(other.law, CompiledLaw)
            known, used = own.law.memory, other.law.memory
            if known is not None and used is not None:
                steps.append(partial(_copy_memory, known, used))
            steps += control.compiled_law_steps(other, other.law)
            if known is not None and used is not None:
                steps.append(partial(_copy_memory, used, known))
        self._control = steps

    def step_control(self) -> None:
        """Step law and middle loop with the messages held, and nothing else."""
        inputs, links = self.inputs, self.world.links
        if inputs.held is not None:
            links[:] = inputs.held  # their stamps, too
        inputs.write_messages(links)
        run_steps(self._control, self.time_s)
        inputs.read_computed(self.world.aircraft)

    def write_errors(self) -> None:
        """Write slots and errors of the present motion."""
        world = self.world
        slots = world.formation.control.offsets, world.formation.altitudes
        write_formation_state(world.aircraft, world.followers, *slots)

    def displace(self, distance_m: float) -> None:
        """Move all followers to the right of their courses and down, each by this distance."""
        truth, fleet = self.world.aircraft["truth"][1:], self.world.fleet
        assert fleet is not None, "a flight of flight models"
        right = course(truth["velocity_ned"]) + 0.5 * math.pi
        shift = np.stack((np.cos(right), np.sin(right), np.ones(len(truth))), axis=-1)
        fleet.displace(distance_m * shift)
        copy_truth(self.world.aircraft)

    def respond(self, present: SavedState, periods: int, kick: Array | None = None) -> Array:
        """Fly on from a saved present with this gain and latency; see `record`."""
        present.restore()
        return self.record(periods, kick)

    def record(self, periods: int, kick: Array | None = None) -> Array:
        """Fly on with this gain and latency, and a kick of the commands.

        Args:
            periods: K of control.
            kick: (n, 3) added to the commands for KICK_S.

        Returns:
            (K, n, 5): roll and pitch, rad, and slot errors north, east and down, m; NaN after a
            follower has been lost.
        """
        inputs, world = self.inputs, self.world
        inputs.read_computed(world.aircraft)  # not those of the flight before
        inputs.begin()
        rows = np.empty((periods, len(world.followers), 5))
        begin = round(self.time_s / self.dt)
        for k in range(periods):
            if world.aircraft["stopped"][1:].any() or world.aircraft["down"][1:].any():
                rows[k:] = math.nan
                break
            self.write_errors()
            rows[k, :, :2] = world.aircraft["truth"]["euler"][1:, :2]
            rows[k, :, 2:] = world.followers["error_ned"]
            inputs.added[:] = kick if kick is not None and k * self.dt < KICK_S - 1e-9 else 0.0
            self.fly_to((begin + k + 1) * self.dt)
        return rows


def _copy_memory(source: Records, target: Records, now: float) -> None:
    target[:] = source
