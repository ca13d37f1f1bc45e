"""The loop: every aircraft reads a tick before any aircraft writes the next."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from testbed.core.compile import Kernel, prepare
from testbed.core.records import (
    MESSAGE,
    AirData,
    BoolArray,
    Event,
    FormationState,
    Observer,
    Sample,
    VehicleState,
    allocate,
    fields_of,
    write_fields,
)
from testbed.core.samples import copy_sample, make_sample
from testbed.formation.slots import write_formation_state
from testbed.network.outages import OutageEvents
from testbed.sim.build import World
from testbed.sim.leader_control import NO_INPUT
from testbed.sim.monitors import GustMonitor, JoinMonitor, LinkMonitor, LossMonitor
from testbed.sim.schedule import TickActions
from testbed.sim.stages import (
    copy_control,
    copy_truth,
    find_losses,
    write_messages,
)


def fly(
    world: World, observers: Sequence[Observer], ended: Callable[[float, TickActions], bool]
) -> str:
    """Fly a world to its end; see `Flight.fly`."""
    flight = Flight(world, observers)
    flight.prepare()
    return flight.fly(ended)


class Flight:
    """One run of a world: its stages, and the monitors that turn what they find into events."""

    def __init__(self, world: World, observers: Sequence[Observer]) -> None:
        """Start before the first tick."""
        self._world = world
        aircraft, followers, links = world.aircraft, world.followers, world.links
        self._control, self._radio = world.control, world.radio
        self._truth = fields_of(VehicleState, aircraft["truth"])
        self._estimate = fields_of(VehicleState, aircraft["estimate"])
        self._exact = world.estimators.exact
        self._copy_truth = partial(copy_truth, aircraft)
        self._copy_control = partial(copy_control, aircraft)
        self._messages, self._tick_s = allocate(MESSAGE, len(aircraft)), np.empty(len(aircraft))
        self._write_messages = partial(write_messages, aircraft, self._messages)
        proximity = world.proximity
        self._find_losses = partial(
            find_losses,
            aircraft,
            world.scripted_leader,
            proximity.limit_m,
            proximity.minimum_m,
        )
        built = world.built_control
        self._link_monitor = LinkMonitor(
            world.names,
            built.neighbours,
            (followers, links),
            world.radio.statistics,
            (built.config.leader_timeout_s, built.config.neighbour_timeout_s),
            builtin=built.builtin,
            hold=built.hold_stale_neighbours,
        )
        self._losses = LossMonitor(world.names, world.proximity, world.faults, fly_on=world.fly_on)
        self._gust_monitor = GustMonitor(world.gusts, world.names)
        self._join_monitor = JoinMonitor(
            world.names[1:], world.clock.base_rate_hz, aircraft, followers
        )
        self._outages = OutageEvents(world.outages)
        self._observers = Observers(observers)
        self._sample = make_sample(
            aircraft, followers, links, exact=self._exact, faults=world.faults is not None
        )
        self._events: list[Event] = list(world.initial_events)
        self._left = self._control.left
        self._transmitter_off: BoolArray | None = None
        self._leader_input = NO_INPUT
        self.ending: str | None = None  # the outcome, when the flight has ended

    def prepare(
        self,
        compiling: Callable[[int, int], None] | None = None,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        """Compile the kernels, and let the filters settle; once, before the flight.

        Args:
            compiling: see `core.compile.prepare`.
            check: the same.
        """
        prepare(self.kernels(), compiling, check)
        self._world.estimators.warm_up(self._world.aircraft)

    def fly(self, ended: Callable[[float, TickActions], bool]) -> str:
        """Fly to the end, after `prepare`; observers get a sample at the log rate.

        Args:
            ended: called before each tick with its time, s, and what is due; it may wait, and
                true ends the run.

        Returns:
            The outcome: "completed", "lost", "envelope_exceeded", "formation_lost",
            "separation_lost" or "interrupted".
        """
        for _ in self.ticks(ended):
            pass
        assert self.ending is not None
        return self.ending

    def ticks(self, ended: Callable[[float, TickActions], bool]) -> Iterator[float]:
        """Fly tick by tick, after `prepare`; `ending` is the outcome when the iterator has ended.

        Args:
            ended: see `fly`.

        Yields:
            The time of a tick, s, when its estimates are written, before its control.
        """
        world = self._world
        last = world.clock.ticks(world.duration_s)
        for tick, due, ticks, needed in world.clock.schedule(
            world.duration_s, all_motions=world.radio.needs_all_positions
        ):
            now = world.clock.time_s(tick)
            if ended(now, due):
                self.ending = "interrupted"
                return
            self.sense(now, due)
            yield now
            self.control(now, due)
            self.actuate(now, due)
            if due.log:
                self.ending = self.observe(tick, now)
                if self.ending:
                    return
            if tick + ticks > last:
                break
            for vehicles in world.vehicles:
                vehicles.step(ticks, needed)
        self.ending = self.outcome

    def sample(self, now: float) -> Sample:
        """Return the state at a tick that `ticks` has yielded, as views of the records.

        Args:
            now: its time, s.
        """
        world = self._world
        self._read_air()
        write_formation_state(
            world.aircraft, world.followers, self._control.offsets, world.altitudes
        )
        return self._sample._replace(tick=world.clock.ticks(now), time_s=now)

    def kernels(self) -> list[Kernel]:
        """Return the compiled calls of the run, for `core.compile.prepare`."""
        world = self._world
        calls: list[Kernel] = [
            partial(self._write_messages, 0.0, self._tick_s),
            self._find_losses,
            self._copy_control,
            partial(
                write_formation_state,
                world.aircraft,
                world.followers,
                world.control.offsets,
                world.altitudes,
            ),
            *world.radio.kernels(),
            *world.control.kernels(),
            *world.leader_controller.kernels(world.aircraft),
        ]
        for vehicles in world.vehicles:
            calls += vehicles.kernels(world.followers)
        calls += [self._copy_truth] if self._exact else world.estimators.kernels()
        calls += [*self._link_monitor.kernels(), *self._join_monitor.kernels()]
        calls += world.envelope.kernels(world.aircraft, world.followers)
        if world.air is not None:
            calls += world.air.kernels()
        return calls

    @property
    def outcome(self) -> str:
        """How a run has ended that came to its end."""
        world, losses = self._world, self._losses.outcome
        if losses == "lost":
            return losses
        exceeded = world.envelope.outcome
        return exceeded if exceeded != "completed" else world.proximity.outcome

    def sense(self, now: float, due: TickActions) -> None:
        """Stage 1: wind, faults that begin, sensor errors and estimates."""
        world, aircraft = self._world, self._world.aircraft
        if due.log:
            self._read_air()
        if due.autopilot and world.air is not None:
            world.air.sample_wind(now)
            for vehicles in world.vehicles:
                vehicles.set_wind()
        faults = world.faults
        if due.autopilot and faults is not None:
            self._events += faults.changes(now, self._truth, self._read_air, self._losses.lost)
            write_fields(aircraft["faults"], faults.state)
            self._transmitter_off = (
                faults.state.transmitter_off | faults.state.frozen | self._losses.lost
            )
        if self._exact:
            self._copy_truth()
        else:
            world.estimators.estimate(aircraft, advance=due.autopilot)
        if due.autopilot and world.companions is not None:
            world.companions.store_states(now)

    def control(self, now: float, due: TickActions) -> None:
        """Stage 2: messages, the formation law with its middle loop, the leader's guidance."""
        world, aircraft, radio = self._world, self._world.aircraft, self._radio
        if due.broadcast is not None:
            self._tick_s.fill(now)
            sent_s = self._tick_s if due.sent_s is None else due.sent_s
            self._write_messages(now, sent_s)
            radio.send(sent_s, self._messages, self._truth, due.broadcast, self._transmitter_off)
        if not (due.control or due.guidance):
            return
        radio.deliver(now)
        for number in due.control:
            if changes := self._control.update_membership(number, now):
                self._events += changes
                self._update_left()
            rows = self._control.step(number, now)
            self._events += self._link_monitor.neighbour_changes(now, rows)
        if due.guidance:
            external = world.external_control
            if external is not None:
                frozen = None if world.faults is None else world.faults.state.frozen
                external.guide(now, self._estimate, self._losses.lost, frozen)
            self._leader_input = world.leader_controller.step(aircraft)
        for vehicles in world.vehicles:
            vehicles.set_unicycle(world.followers, *self._leader_input)
        self.write_commands(now)
        self._events += self._link_monitor.leader_changes(now)

    def actuate(self, now: float, due: TickActions) -> None:
        """Stage 3: external commands, fly-by-wire A, actuator faults, losses."""
        if not due.autopilot:
            return
        world, aircraft = self._world, self._world.aircraft
        if world.companions is not None or world.external_control is not None:
            self.write_commands(now)
        if world.external_control is not None:
            self._events += world.external_control.pop_events()
            world.external_control.override_commands(aircraft)
        for vehicles in world.vehicles:
            vehicles.autopilot_step()
        for process in world.external_processes:
            self._events += process.pop_events(now)
        if world.faults is not None:
            for vehicles in world.vehicles:
                vehicles.apply_faults()
        if self._find_losses() or world.proximity.watching:
            self._lose(now)

    def write_commands(self, now: float) -> None:
        """Write the commands of law and guidance that the autopilots have at the time `now`, s."""
        if self._world.companions is None:
            self._copy_control()
        else:
            self._world.companions.deliver_commands(now)

    def observe(self, tick: int, now: float) -> str | None:
        """Hand a sample and the events to the observers; return the outcome if the run ends."""
        world, losses = self._world, self._losses
        aircraft, followers = world.aircraft, world.followers
        if world.air is not None:
            reached = world.air.active_gusts(now)
            if reached is not None:
                self._events += self._gust_monitor.changes(now, reached)
        # what is scripted comes before what follows from it
        events = [*self._outages.changes(now), *self._events]
        write_formation_state(aircraft, followers, self._control.offsets, world.altitudes)
        sample, external, left = self._sample, world.external_control, self._left
        if external is not None:
            left = external.left_formation(left)
            masked = external.mask_diagnostics(followers)
            if masked is not followers:
                records = aircraft, masked, world.links
                formation = fields_of(FormationState, masked, age_s=world.links["age_s"])
                sample = sample._replace(formation=formation, records=records)
        events += self._join_monitor.changes(tick)
        events += world.envelope.changes(now, aircraft, followers, left)
        self._observers.observe(sample._replace(tick=tick, time_s=now, events=tuple(events)))
        self._events = []
        if losses.terminate:
            return "lost"
        if world.envelope.terminate or world.proximity.terminate:
            return self.outcome
        return None

    def _lose(self, now: float) -> None:
        """Remove the aircraft that are lost from now on."""
        world, aircraft = self._world, self._world.aircraft
        events = self._losses.changes(now, self._truth.position_ned, np.array(aircraft["down"]))
        if not events:
            return
        self._events += events
        lost = self._losses.lost
        aircraft["lost"] = lost
        for vehicles in world.vehicles:
            vehicles.remove(lost)
        if world.air is not None:
            world.air.remove(lost)
        self._transmitter_off = (
            lost if self._transmitter_off is None else self._transmitter_off | lost
        )
        self._update_left()

    def _update_left(self) -> None:
        self._left = self._control.left | self._losses.lost[1:]
        self._link_monitor.set_left(self._left)

    def _read_air(self) -> AirData:
        """Read the flight models; the wind is that of the records, sampled at this tick."""
        for vehicles in self._world.vehicles:
            vehicles.read_air()
        return self._sample.air


class Observers:
    """The observers of a run.

    A sample of the loop has views of the run's records, which the next ticks change. An observer
    that copies what it needs at once has an attribute `zero_copy` that is true; all others share
    one copy.
    """

    def __init__(self, observers: Sequence[Observer]) -> None:
        """Sort observers by whether they need a copy."""
        self._direct = [each for each in observers if getattr(each, "zero_copy", False)]
        self._others = [each for each in observers if each not in self._direct]

    def observe(self, sample: Sample) -> None:
        """Pass a sample to all observers."""
        for each in self._direct:
            each.observe(sample)
        if self._others:
            copied = copy_sample(sample)
            for each in self._others:
                each.observe(copied)
