"""The loop: every aircraft reads a tick before any aircraft writes the next."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

import numpy as np

from testbed.core.call_list import NOW, Call, run_steps
from testbed.core.compile import prepare, registered, registering
from testbed.core.records import (
    AirData,
    FormationState,
    Observer,
    Sample,
    VehicleState,
    fields_of,
    write_fields,
)
from testbed.core.samples import make_sample
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
from testbed.flight.steps import copy_truth, find_losses, has_events, is_reached
from testbed.flight.tick_loop import LOOK_TICKS, TickInputs, TickLoop
from testbed.flight.world import World
from testbed.vehicle.fleet import Move

Ended: TypeAlias = Callable[[float, TickActions], bool]


class NeverEnded:
    """Let a flight go on to its end; see `Flight.fly`."""

    each_tick = False

    def __call__(self, now: float, due: TickActions) -> bool:
        """Return false."""
        return False


PAUSE = "wait for the caller"  # name of the stage at which `Flight.ticks` yields


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

    @registering()
    def __init__(
        self, world: World, observers: Sequence[Observer], stages: Sequence[UserStage] = ()
    ) -> None:
        """Start before the first tick.

        Args:
            world: that is flown.
            observers: of its samples.
            stages: of the user.

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
        self._observers = Observers(observers, n)
        self._sample = make_sample(
            aircraft, followers, links, exact=self._exact, faults=world.faults is not None
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
        self.ending: str | None = None
        records = FlightRecords(aircraft, followers, links)
        self.stages = insert_stages(tuple(self._make_stages()), stages, records)
        self._loop = self._make_loop(self.stages)
        sense = [each for each in self.stages if each.part is Part.SENSE]
        rest = self.stages[len(sense) :]
        self._until_s = np.full(1, -np.inf)
        pause = Stage(Part.SENSE, StageRate.TICK, PAUSE, call=Call(is_reached, self._until_s, NOW))
        self._paused_loop = self._make_loop((*sense, pause, *rest))
        control = (each for each in rest if each.part is Part.CONTROL)
        self._steering = self._make_loop((*sense, *control))
        self._entries = *world.entries, *registered()

    def _make_loop(self, stages: Sequence[Stage]) -> TickLoop:
        return TickLoop(stages, self._inputs, self._world.clock.base_rate_hz)

    def _make_stages(self) -> Iterator[Stage]:
        """Yield the stages of a tick."""
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
            yield Stage(part, StageRate.AUTOPILOT, name, then=self._change_faults)
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
                yield from make_stages(part, rate, "apply actuator faults", vehicles.fault_steps)
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
            call = buffer.bind(records, world.clock.base_rate_hz, exact=self._exact)
            yield Stage(part, rate, "append a sample", call=call)
        if observers.of_samples or external:
            yield Stage(part, rate, "give events and a sample to observers", then=self._observe)
        else:
            call = Call(has_events, self._events.waiting)
            yield Stage(part, rate, "give events to observers", call=call, then=self._observe)
        if buffer is not None:
            call, name = buffer.full_call(), "take a full block of samples"
            yield Stage(part, rate, name, call=call, then=observers.take_block)

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
        prepare(self._entries, compiling, check)
        for each in self.stages:
            if each.call is not None:
                each.call.bind()
        self._world.estimators.warm_up(self._world.aircraft)

    def fly(self, ended: Ended) -> str:
        """Fly to the end, after `prepare`; observers get a sample at the log rate.

        Args:
            ended: called before each tick with its time, s, and what is due, or before a block of
                ticks if its attribute `each_tick` is false; it may wait, and true ends the run.

        Returns:
            The outcome: "completed", "lost", "envelope_exceeded", "formation_lost",
            "separation_lost" or "interrupted".
        """
        for _ in self._run(self._loop, ended):
            pass
        assert self.ending is not None
        return self.ending

    def ticks(self, ended: Ended) -> Iterator[float]:
        """Fly tick by tick, after `prepare`; `ending` is the outcome when the iterator has ended.

        Args:
            ended: see `fly`.

        Yields:
            The time of a tick, s, when its estimates are written, before its control; of each, or
            of the first at or after that of `pause_at`.
        """
        return self._run(self._paused_loop, ended)

    @property
    def last_s(self) -> float:
        """Time of the last tick of a flight that has ended in `ticks`, s."""
        return self._paused_loop.time_s

    def pause_at(self, until_s: float) -> None:
        """Let `ticks` yield nothing before a time, s; infinite: nothing up to the end."""
        self._until_s[0] = until_s

    def _run(self, loop: TickLoop, ended: Ended) -> Iterator[float]:
        """Run blocks of ticks to the end of the flight; yield the time of each pause, s."""
        world, look = self._world, 1 if getattr(ended, "each_tick", True) else LOOK_TICKS
        last = world.clock.ticks(world.duration_s)
        all_motions = world.parts is not None and world.parts.radio.needs_all_positions
        for rows, period in world.clock.blocks(all_motions=all_motions):
            loop.load(rows, period, last)
            while loop.in_block:
                if ended(loop.time_s, loop.due):
                    self.ending = "interrupted"
                    return
                loop.limit(look)
                while (stage := loop.run()) is not None:
                    if stage.name == PAUSE:
                        yield loop.time_s
                    elif stage.then is not None:
                        stage.then(loop.time_s)
                        if look > 1 and self.ending is None and ended(loop.time_s, loop.due):
                            self.ending = "interrupted"
                    loop.resume(ending=self.ending is not None)
            if loop.done:
                break
        self.ending = self.ending or self.outcome

    def steer(self, now: float, due: TickActions) -> None:
        """Sense and control at a time, s, without stepping autopilots: for measurements."""
        tick = self._world.clock.ticks(now)
        self._steering.load([(tick, due, 0, ())], 0, tick)
        self._steering.limit(1)
        while (stage := self._steering.run()) is not None:
            if stage.then is not None:
                stage.then(now)
            self._steering.resume()

    def sample(self, now: float) -> Sample:
        """Return the state at a tick that `ticks` has yielded, as views of the records.

        Args:
            now: its time, s.
        """
        self._read_air()
        if self._formation is not None:
            self._formation.write_slots(now)
        return self._sample._replace(tick=self._world.clock.ticks(now), time_s=now)

    @property
    def outcome(self) -> str:
        """How a run has ended that came to its end."""
        world, losses = self._world, self._losses.outcome
        if losses == "lost":
            return losses
        exceeded = world.envelope.outcome
        return exceeded if exceeded != "completed" else world.proximity.outcome

    def _change_faults(self, now: float) -> None:
        faults, lost = self._world.faults, self._losses.lost
        assert faults is not None, "a stage of flights with faults"
        self._events += faults.changes(now, self._truth, self._read_air, lost)
        write_fields(self._world.aircraft["faults"], faults.state)
        if self._formation is not None:
            self._formation.mute(faults.state.transmitter_off | faults.state.frozen | lost)

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

    def _read_air(self) -> AirData:
        """Read the flight models; the wind is that of the records, sampled at this tick."""
        for vehicles in self._world.vehicles:
            run_steps(vehicles.air_steps, 0.0)
        return self._sample.air
