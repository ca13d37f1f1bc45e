"""The loop: every aircraft reads a tick before any aircraft writes the next."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TypeAlias

import numpy as np

from testbed.core.call_list import NOW, Call, Step, run_steps, steps_if
from testbed.core.compile import is_interpreted, prepare, registered, registering
from testbed.core.records import (
    Event,
    FaultState,
    FormationState,
    Observer,
    Records,
    Sample,
    VehicleState,
    allocate,
    fields_of,
    write_fields,
)
from testbed.core.samples import make_sample
from testbed.core.saved_state import Replayed, take_changes
from testbed.flight.faults import FaultManager, no_faults
from testbed.flight.formation_stages import FormationStages
from testbed.flight.monitors import GustMonitor, LossMonitor
from testbed.flight.observers import EventQueue, Observers
from testbed.flight.schedule import TickActions
from testbed.flight.stages import (
    FlightRecords,
    Part,
    Stage,
    StageRate,
    UserStage,
    insert_stages,
    make_stages,
)
from testbed.flight.steps import copy_truth, find_losses, has_events
from testbed.flight.tick_loop import ANY_TICKS, LOOK_TICKS, PLACE, TickInputs, TickLoop, pause
from testbed.flight.world import World
from testbed.metrics.document import BOUND_VIOLATED
from testbed.vehicle.fleet import Move

Ended: TypeAlias = Callable[[float, TickActions], bool]


def _is_sensing(stage: Stage) -> bool:
    return stage.part is Part.SENSE and stage.name != PAUSE


PAUSE = "wait for the caller"  # name of the stage at which `Flight.fly_to` returns


def fly(world: World, observers: Sequence[Observer], ended: Ended) -> str:
    """Fly a world to its end; see `Flight.fly`."""
    flight = Flight(world, observers)
    flight.prepare()
    return flight.fly(ended)


class Flight:
    """One run of a world: its stages, and the monitors that turn what they find into events.

    Attributes:
        stages: of a tick, in order; absent parts of the scenario have none.
        ending: the outcome, when the flight has ended.
    """

    UNSAVED = ("_entries",)

    @registering()
    def __init__(
        self,
        world: World,
        observers: Sequence[Observer],
        stages: Sequence[UserStage] = (),
        place: Records | None = None,
    ) -> None:
        """Start before the first tick.

        Args:
            world: that is flown.
            observers: of its samples.
            stages: of the user.
            place: (1,) of PLACE, of `fly_to`; None: a new one.

        Raises:
            InputError: a stage of the user follows none of the flight's.
        """
        self._world = world
        aircraft, followers, links = world.aircraft, world.followers, world.links
        self._truth = fields_of(VehicleState, aircraft["truth"])
        self._estimate = fields_of(VehicleState, aircraft["estimate"])
        self._exact = world.estimators.exact
        n = len(aircraft)
        senders = np.zeros(n, dtype=bool) if world.parts is None else world.parts.radio.senders
        steps, needed = np.zeros(1, dtype=np.intp), np.ones(n, dtype=bool)
        self._inputs = TickInputs(senders, np.full(n, np.nan), steps, needed)
        self._losses = LossMonitor(
            world.names, world.lowest_m, world.proximity, world.faults, fly_on=world.fly_on
        )
        self._gust_monitor = GustMonitor(world.gusts, world.names)
        self._law = np.zeros((n - 1, 0))
        if world.parts is not None:
            self._law = world.parts.control.reports.logged
        self._observers = Observers(observers, n, self._law.shape[1])
        self._sample = make_sample(
            *(aircraft, followers, links, self._law),
            exact=self._exact,
            faults=world.faults is not None,
        )
        self._events = EventQueue(world.initial_events)
        self._formation: FormationStages | None = None
        if world.parts is not None:
            self._formation = FormationStages(
                world,
                world.parts,
                self._truth,
                self._losses,
                self._events,
                self._inputs.planned_s,
            )
        if world.faults is not None:
            self._battery_steps = tuple(self._read_batteries(world.faults))
            self._find_faults = world.faults.bind(aircraft)
        self.ending: str | None = None
        records = FlightRecords(aircraft, followers, links)
        self.stages = insert_stages(tuple(self._make_stages()), stages, records)
        self._loop = self._make_loop(self.stages)
        sense = [each for each in self.stages if each.part is Part.SENSE]
        rest = self.stages[len(sense) :]
        self._place = allocate(PLACE, 1) if place is None else place
        self._place["until"] = -math.inf
        self._observed = tuple(self._observed_steps())
        calls = [each for each in self._observed if isinstance(each, Call)]
        self._observed_calls = calls if len(calls) == len(self._observed) else []
        self._addresses = np.zeros(len(self._observed_calls), dtype=np.uint64)
        call = Call(pause, self._place, self._addresses, NOW)
        stop = Stage(Part.SENSE, StageRate.TICK, PAUSE, call=call)
        self._paused_loop = self._make_loop((*sense, stop, *rest), self._place)
        clock, all_motions = world.clock, False
        if world.parts is not None:
            all_motions = world.parts.radio.needs_all_positions
        self._first_tick = 0
        self._is_begun = world.begin is None  # at its first tick, which else is not 0
        self._last_tick = clock.ticks(world.duration_s)
        self._blocks = Replayed(partial(clock.blocks, all_motions=all_motions))
        self._entries = *world.entries, *registered()

    def _make_loop(self, stages: Sequence[Stage], place: Records | None = None) -> TickLoop:
        return TickLoop(stages, self._inputs, self._world.clock.base_rate_hz, place)

    def _observed_steps(self) -> Iterator[Step]:
        """Yield what writes air data, slots and errors, as stages do at the log rate."""
        for vehicles in self._world.vehicles:
            yield from vehicles.air_steps
        if self._formation is not None:
            yield self._formation.write_slots

    def _make_stages(self) -> Iterator[Stage]:
        yield from self._sensing()
        yield from self._controlling()
        yield from self._actuating()
        yield from self._observing()
        move = Move(self._inputs.steps, self._inputs.needed)
        for each in self._world.vehicles:
            steps = each.move_steps(move)
            name = "move to the next tick"
            yield from make_stages(Part.MOVE, StageRate.TICK, name, steps)

    def _sensing(self) -> Iterator[Stage]:
        """Wind, faults that begin and end, sensor errors and estimates."""
        world, part = self._world, Part.SENSE
        aircraft, vehicles = world.aircraft, world.vehicles
        for each in vehicles:
            yield from make_stages(
                part, StageRate.LOG, "read the air of flight models", each.air_steps
            )
        if world.air is not None:
            yield from make_stages(part, StageRate.AUTOPILOT, "sample the wind", world.air.steps)
            for each in vehicles:
                name = "give the wind to flight models"
                yield from make_stages(part, StageRate.AUTOPILOT, name, each.wind_steps)
        if world.faults is not None:
            name = "begin and end faults"
            steps = *self._battery_steps, (self._find_faults, self._change_faults)
            yield from make_stages(part, StageRate.AUTOPILOT, name, steps)
        if self._exact:
            name = "copy the truth to the estimates"
            yield Stage(part, StageRate.TICK, name, call=Call(copy_truth, aircraft))
        else:
            advance, keep = world.estimators.steps(aircraft)
            name = "advance sensors and estimates"
            yield from make_stages(part, StageRate.AUTOPILOT, name, advance)
            name = "estimate with the present errors"
            yield from make_stages(part, StageRate.BETWEEN, name, keep)
        if self._formation is not None:
            yield from self._formation.companion_stages()

    def _controlling(self) -> Iterator[Stage]:
        """Messages, the formation law with its middle loop, the leader's guidance."""
        formation, world = self._formation, self._world
        if world.array_commands is not None:
            call, name = world.array_commands.take_call(world.aircraft), "take commands"
            yield Stage(Part.CONTROL, StageRate.TICK, name, call=call)
        if formation is not None:
            yield from formation.law_stages()
        if self._world.external_control is not None:
            name = "guide aircraft commanded from outside"
            yield Stage(Part.CONTROL, StageRate.GUIDANCE, name, then=self._guide_external)
        if formation is not None:
            yield from formation.command_stages()

    def _actuating(self) -> Iterator[Stage]:
        """External commands, fly-by-wire A, actuator faults, losses."""
        world, part, rate = self._world, Part.ACTUATE, StageRate.AUTOPILOT
        if self._formation is not None:
            yield from self._formation.late_command_stages()
        if world.external_control is not None:
            yield Stage(part, rate, "take commands from outside", then=self._override_commands)
        if world.array_commands is not None:
            call = world.array_commands.override_call(world.aircraft)
            yield Stage(part, rate, "give commands of the program to autopilots", call=call)
        for vehicles in world.vehicles:
            yield from make_stages(part, rate, "fly by wire", vehicles.autopilot_steps)
        if world.external_processes:
            name = "collect messages of ArduPlanes"
            yield Stage(part, rate, name, then=self._collect_messages)
        if world.faults is not None:
            for vehicles in world.vehicles:
                steps = vehicles.fault_steps(floating=world.faults.has_floating)
                yield from make_stages(part, rate, "apply actuator faults", steps)
        for vehicles in world.vehicles:
            yield from make_stages(part, rate, "give surfaces to models", vehicles.output_steps)
        proximity = world.proximity
        call = Call(
            find_losses,
            *(
                world.aircraft,
                world.lowest_m,
                world.parts is not None and world.parts.scripted_leader,
            ),
            *(proximity.limit_m, proximity.minimum_m, proximity.watching),
        )
        yield Stage(part, rate, "find losses and encounters", call=call, then=self._lose)

    def _observing(self) -> Iterator[Stage]:
        """Errors of the formation, events, samples."""
        world, part, rate = self._world, Part.OBSERVE, StageRate.LOG
        if world.air is not None and world.gusts:
            yield Stage(part, rate, "find gusts that reach aircraft", then=self._find_gusts)
        without_slot = np.zeros(0, dtype=bool)
        if self._formation is not None:
            yield from self._formation.slot_stages()
            without_slot = self._formation.without_slot
        call = world.envelope.bind(world.aircraft, world.followers, without_slot)
        yield Stage(part, rate, "find limits exceeded", call=call, then=self._find_excess)
        yield from self._giving_samples()

    def _giving_samples(self) -> Iterator[Stage]:
        """Samples for the observers: blocks to those that take these."""
        world, part, rate, observers = self._world, Part.OBSERVE, StageRate.LOG, self._observers
        if world.array_commands is not None and world.parts is not None:
            call = world.array_commands.clear_call(world.followers)
            yield Stage(part, rate, "clear what the law reports of commanded followers", call=call)
        external, buffer = world.external_control is not None, observers.buffer
        # where external programs command aircraft, a sample is not just a copy of the records:
        # `_observe` appends it
        if buffer is not None and not external:
            records = world.aircraft, world.followers, world.links
            rate_hz = world.clock.base_rate_hz
            call = buffer.bind(records, self._law, rate_hz, exact=self._exact)
            yield Stage(part, rate, "append a sample", call=call)
        if observers.of_samples or external:
            yield Stage(part, rate, "give events and a sample to observers", then=self._observe)
        else:
            call = Call(has_events, self._events.waiting)
            yield Stage(part, rate, "give events to observers", call=call, then=self._observe)
        if buffer is not None:
            call, name = buffer.full_call(), "take a full block of samples"
            yield Stage(part, rate, name, call=call, then=self._take_block)

    def _take_block(self, now: float) -> None:
        """Hand a block of samples to the observers; end the run where one needs no more."""
        if self._observers.take_block() and self.ending is None:
            self.ending = self.outcome if self.outcome != "completed" else BOUND_VIOLATED

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
        self.compile(compiling, check)
        self.settle()

    def compile(
        self,
        compiling: Callable[[int, int], None] | None = None,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        """Compile the kernels; see `prepare`."""
        prepare(self._entries, compiling, check)
        for each in self.stages:
            if each.call is not None:
                each.call.bind()
        if not is_interpreted():
            self._addresses[:] = [each.address for each in self._observed_calls]
            self._paused_loop.bind()

    def settle(self) -> None:
        """Let the filters settle, or take over an earlier flight, after `compile`."""
        self._world.estimators.warm_up(self._world.aircraft)
        if self._world.begin is not None:
            self._world.begin(self)

    def take_over(self, before: Flight, after: Flight) -> list[str]:
        """Begin as another flight has paused: with all that has changed in it.

        Args:
            before: the other flight as it was when it began.
            after: the same, paused.

        Returns:
            Names of the parts that have changed and have no place here.
        """
        for each in (before, self):
            each._world.formation.radio.match(after._world.formation.radio)
        left = take_changes(before._parts, after._parts, self._parts)
        estimators, own = before._world.estimators, self._world.estimators
        if own.exact != estimators.exact or any("world.estimators" in each for each in left):
            own.warm_up(self._world.aircraft)  # up to the present motion
        self._world.formation.radio.restart_statistics()
        self._first_tick = self._world.clock.ticks(after.time_s)
        self._resume_faults(after.time_s)
        if self._observers.buffer is not None and after._observers.buffer is not None:
            self._observers.buffer.earlier = after._observers.buffer.copy_last()
        return left

    @property
    def _parts(self) -> dict[str, object]:
        """What a flight takes over, by name."""
        return {
            "world": self._world,
            "losses": self._losses,
            "gust_monitor": self._gust_monitor,
            "formation": self._formation,
        }

    def _resume_faults(self, now: float) -> None:
        """Let only the own scenario's faults have an effect, after `take_changes`."""
        if self._world.faults is None:
            self._apply_faults(no_faults(len(self._world.names)))
        else:
            run_steps((*self._battery_steps, self._find_faults), now)
            self._events += self._world.faults.resume(now)
            self._apply_faults(self._world.faults.state)

    def add_event(self, event: Event) -> None:
        """Add an event before the first tick."""
        self._events += [event]

    def fly(self, ended: Ended) -> str:
        """Fly to the end, after `prepare`; observers get a sample at the log rate.

        Args:
            ended: called before each tick with its time, s, and what is due, or before a block of
                ticks if its attribute `each_tick` is false; it may wait, and true ends the run.

        Returns:
            The outcome: "completed", "lost", "envelope_exceeded", "formation_lost",
            "separation_lost" or "interrupted".
        """
        self._advance(self._loop, ended)
        assert self.ending is not None
        return self.ending

    def fly_to(self, until_s: float) -> bool:
        """Fly on to the first tick at or after a time, s, after `prepare`.

        The estimates of that tick are written, its control comes with the next call. A flight that
        ends within a period of the autopilots after it is flown to its end; `ending` is then the
        outcome.

        Returns:
            Whether the flight goes on.
        """
        self.set_pause(until_s)
        return self.fly_on()

    def set_pause(self, until_s: float) -> float:
        """Set the time to which `fly_on` flies, see `fly_to`; return that of the tick, s."""
        pause_s = self._world.clock.pause_s(until_s, self._last_tick)
        self._place["until"] = pause_s
        return pause_s

    def fly_on(self, found: int | None = None) -> bool:
        """Fly on to the time in the place; see `fly_to`.

        Args:
            found: what the call at `address` has returned, if it was made.
        """
        return self._advance(self._paused_loop, None, found)

    @property
    def address(self) -> int:
        """Address of the call that flies up to the pause, or to what needs Python; see `fly_on`."""
        return self._paused_loop.address

    @property
    def time_s(self) -> float:
        """Time of the tick to which `fly_to` has flown, s."""
        return self._paused_loop.time_s

    @property
    def begun_s(self) -> float:
        """Time of the last tick that was begun, s: where a stage has failed, its time."""
        return max(self._loop.begun_s, self._paused_loop.begun_s)

    def _advance(self, loop: TickLoop, ended: Ended | None, found: int | None = None) -> bool:
        """Run blocks of ticks to the next pause, and return true, or to the end of the flight.

        Args:
            loop: of the stages.
            ended: see `fly`; None: nothing ends the flight but itself.
            found: see `TickLoop.run`.
        """
        look = 1 if getattr(ended, "each_tick", True) else LOOK_TICKS
        while True:
            while loop.in_block:
                if ended is not None and ended(loop.time_s, loop.due):
                    self.ending = "interrupted"
                    return False
                loop.limit(ANY_TICKS if ended is None else look)
                while (stage := loop.run(found)) is not None:
                    found = None
                    if stage.name == PAUSE:
                        if is_interpreted() or not self._observed_calls:
                            self.write_observed(loop.time_s)
                        return True
                    if stage.then is not None:
                        stage.then(loop.time_s)
                        if ended is not None and look > 1 and self.ending is None:
                            if ended(loop.time_s, loop.due):
                                self.ending = "interrupted"
                    if self.ending is not None:
                        loop.end()
                found = None
            if loop.done:
                self.ending = self.ending or self.outcome
                self.write_observed(loop.time_s)
                return False
            loop.load(*next(self._blocks), self._last_tick)
            if not self._is_begun:
                self._is_begun = loop.seek(self._first_tick, _is_sensing)

    def sample(self, now: float) -> Sample:
        """Return the state at the tick to which `fly_to` has flown, as views of the records.

        Args:
            now: its time, s.
        """
        return self._sample._replace(tick=self._world.clock.ticks(now), time_s=now)

    def write_observed(self, now: float) -> None:
        """Write air data, slots and errors, as a pause does, at a time, s."""
        run_steps(self._observed, now)

    @property
    def outcome(self) -> str:
        """How a run has ended that came to its end."""
        world, losses = self._world, self._losses.outcome
        if losses == "lost":
            return losses
        exceeded = world.envelope.outcome
        return exceeded if exceeded != "completed" else world.proximity.outcome

    def _read_batteries(self, faults: FaultManager) -> Iterator[Step]:
        """Yield what reads batteries for conditions of faults."""
        if faults.reads_batteries:
            call = faults.battery_call(self._world.aircraft)
            for vehicles in self._world.vehicles:
                yield from steps_if(call, vehicles.air_steps)

    def _change_faults(self, now: float) -> None:
        faults = self._world.faults
        assert faults is not None, "a stage of flights with faults"
        self._events += faults.changes(now)
        self._apply_faults(faults.state)

    def _apply_faults(self, state: FaultState) -> None:
        write_fields(self._world.aircraft["faults"], state)
        if self._formation is not None:
            self._formation.mute(state.transmitter_off | state.frozen | self._losses.lost)

    def _guide_external(self, now: float) -> None:
        world = self._world
        assert world.external_control is not None, "a stage of flights commanded from outside"
        frozen = None if world.faults is None else world.faults.state.frozen
        world.external_control.guide(now, self._estimate, self._losses.lost, frozen)

    def _override_commands(self, now: float) -> None:
        external = self._world.external_control
        assert external is not None, "a stage of flights commanded from outside"
        self._events += external.pop_events()
        external.override_commands(self._world.aircraft)

    def _collect_messages(self, now: float) -> None:
        for process in self._world.external_processes:
            self._events += process.pop_events(now)

    def _find_gusts(self, now: float) -> None:
        air = self._world.air
        assert air is not None, "a stage of flights with gusts"
        self._events += self._gust_monitor.changes(now, air.active_gusts(now))

    def _find_excess(self, now: float) -> None:
        self._events += self._world.envelope.changes(now)

    def _observe(self, now: float) -> None:
        """Hand a sample and the events to the observers; end the run where it is over."""
        world, sample, followers = self._world, self._sample, self._world.followers
        if world.external_control is not None:
            masked = world.external_control.mask_diagnostics(followers)
            if masked is not followers:
                records = world.aircraft, masked, world.links
                formation = fields_of(FormationState, masked, age_s=world.links["age_s"])
                sample = sample._replace(formation=formation, records=records)
        tick, events = world.clock.ticks(now), self._events.take()
        sample = sample._replace(tick=tick, time_s=now, events=events)
        if world.external_control is not None and self._observers.buffer is not None:
            self._observers.buffer.append(sample)
        self._observers.observe(sample)
        if self._losses.terminate:
            self.ending = "lost"
        elif world.envelope.terminate or world.proximity.terminate:
            self.ending = self.outcome

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
        if self._formation is not None:
            self._formation.remove(lost)
