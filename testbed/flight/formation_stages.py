"""The stages of a flight that fly a formation: messages, law, commands, slots and joins."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from testbed.core.call_list import NOW, Call
from testbed.core.records import Array, BoolArray, VehicleState
from testbed.flight.monitors import JoinMonitor, LinkMonitor, LossMonitor
from testbed.flight.observers import EventQueue
from testbed.flight.separation_monitor import SeparationMonitor
from testbed.flight.stages import Part, Stage, StageRate, make_stages
from testbed.flight.steps import copy_control, write_messages
from testbed.flight.world import FormationParts, World
from testbed.formation.slots import write_formation_state
from testbed.network.outages import OutageEvents


class FormationStages:
    """What a flight does for its followers, with the events of that.

    Attributes:
        write_slots: write slots and errors of the followers.
        without_slot: (n,) followers that are lost, have left the formation, or are commanded from
            outside.
    """

    ADDRESSES = "_events", "_world", "_parts"  # of the flight

    def __init__(
        self,
        world: World,
        parts: FormationParts,
        truth: VehicleState,
        losses: LossMonitor,
        events: EventQueue,
        planned_s: Array,
    ) -> None:
        """Start before the first tick.

        Args:
            world: that is flown.
            parts: its own.
            truth: of the N aircraft.
            losses: of the flight.
            events: of the flight, to which those of the formation are added.
            planned_s: (N,) s, transmission times; NaN: at the tick.
        """
        self._world, self._parts, self._truth = world, parts, truth
        self._losses, self._events = losses, events
        aircraft, followers, built = world.aircraft, world.followers, parts.built_control
        self._planned_s = planned_s
        self._link_monitor = LinkMonitor(
            world.names,
            built.neighbours,
            (followers, world.links),
            parts.radio.statistics,
            (built.config.leader_timeout_s, built.config.neighbour_timeout_s),
            builtin=built.builtin,
            hold=built.hold_stale_neighbours,
        )
        self._join_monitor = JoinMonitor(
            world.names[1:], world.clock.base_rate_hz, aircraft, followers
        )
        filters = built.controllers["separation"]
        self._separation_monitor = None
        if filters["on"].any():
            self._separation_monitor = SeparationMonitor(
                world.names, aircraft, followers, filters["distance"]
            )
        self._outages = OutageEvents(parts.outages)
        self._left = np.zeros(len(followers), dtype=bool)
        array = world.array_commands
        # followers that a program in this process commands
        self._commanded = self._left if array is None else array.commanded[1:]
        self.without_slot = self._left | self._commanded
        self.write_slots = Call(
            write_formation_state, aircraft, followers, parts.control.offsets, parts.altitudes
        )

    def companion_stages(self) -> Iterator[Stage]:
        """Yield what sends states to companion computers."""
        if self._parts.companions is not None:
            call = self._parts.companions.store_states
            name = "send states to the companions"
            yield Stage(Part.SENSE, StageRate.AUTOPILOT, name, call=call)
            name, steps = "receive states by MAVLink", self._parts.companions.sense_steps
            yield from make_stages(Part.SENSE, StageRate.CONTROL, name, steps)

    def law_stages(self) -> Iterator[Stage]:
        """Yield messages, and the law with its middle loop."""
        parts, part, radio = self._parts, Part.CONTROL, self._parts.radio
        companions, aircraft = parts.companions, self._world.aircraft
        known = aircraft if companions is None else companions.broadcast_aircraft
        messages = known, radio.messages, self._planned_s, radio.sent_s
        call = Call(write_messages, *messages, NOW)
        yield Stage(part, StageRate.BROADCAST, "write messages", call=call)
        send, then = radio.send_stage(self._truth)
        yield Stage(part, StageRate.BROADCAST, "send messages", call=send, then=then)
        payloads = radio.payloads.count > 0
        if payloads:
            call, name = radio.keep_payloads_call(), "keep what laws have sent"
            yield Stage(part, StageRate.BROADCAST, name, call=call)
        yield Stage(part, StageRate.CONTROL, "deliver messages", call=radio.deliver_call)
        if payloads:
            call, name = radio.payloads.receive_call(radio.links), "receive what laws have sent"
            yield Stage(part, StageRate.CONTROL, name, call=call)
        for group, members in enumerate(parts.control.groups):
            if (learn := parts.control.membership_call(group)) is not None:
                name, respond = "respond to declared failures", self._membership_step(group)
                yield Stage(part, StageRate.CONTROL, name, call=learn, then=respond, group=group)
            name = "step law and middle loop"
            steps = parts.control.steps(group)
            yield from make_stages(part, StageRate.CONTROL, name, steps, group)
            if (changed := parts.control.changed_call(group)) is not None:
                name, tell = "find events of the law", self._law_step(group)
                yield Stage(part, StageRate.CONTROL, name, call=changed, then=tell, group=group)
            call = self._link_monitor.neighbour_call(members.rows)
            then = self._neighbour_changes
            name = "count message ages, find timeouts"
            yield Stage(part, StageRate.CONTROL, name, call=call, then=then, group=group)

    def command_stages(self) -> Iterator[Stage]:
        """Yield the leader's guidance, and what gives all commands to the vehicles."""
        world, part, leader = self._world, Part.CONTROL, self._parts.leader_controller
        steps = leader.steps(world.aircraft)
        yield from make_stages(part, StageRate.GUIDANCE, "guide the leader", steps)
        for each in world.vehicles:
            steps = each.steering_steps(world.followers, leader.input)
            yield from make_stages(part, StageRate.CONTROL, "steer ideal vehicles", steps)
        yield Stage(part, StageRate.CONTROL, "give commands to autopilots", call=self._command_call)
        call, then = self._link_monitor.leader_call, self._leader_changes
        yield Stage(part, StageRate.CONTROL, "find timeouts of the leader", call=call, then=then)

    def late_command_stages(self) -> Iterator[Stage]:
        """Yield what gives commands to autopilots at their rate, where they change in between."""
        world = self._world
        if self._parts.companions or world.external_control or world.array_commands:
            name = "give commands to autopilots"
            yield Stage(Part.ACTUATE, StageRate.AUTOPILOT, name, call=self._command_call)

    def slot_stages(self) -> Iterator[Stage]:
        """Yield outages, slots and errors, and joins."""
        part, rate, joins = Part.OBSERVE, StageRate.LOG, self._join_monitor
        if self._parts.outages.windows:
            yield Stage(part, rate, "find outages", then=self._find_outages)
        yield Stage(part, rate, "write slots and errors", call=self.write_slots)
        yield Stage(part, rate, "find joins", call=joins.call, then=self._find_joins)
        if (monitor := self._separation_monitor) is not None:
            name = "find what the separation filter does"
            yield Stage(part, rate, name, call=monitor.call, then=self._separation_changes)
        if self._world.external_control is not None:
            name = "find followers commanded from outside"
            yield Stage(part, rate, name, then=self._find_left)

    def mute(self, muted: BoolArray) -> None:
        """Set which aircraft (N,) do not transmit."""
        self._parts.radio.muted[:] = muted

    def remove(self, lost: BoolArray) -> None:
        """Remove lost aircraft (N,): they transmit nothing, and have no slot."""
        self._parts.radio.muted |= lost
        self._update_left()

    def _update_left(self) -> None:
        self._left = self._parts.control.left | self._losses.lost[1:]
        self.without_slot[:] = self._left | self._commanded
        self._link_monitor.set_left(self._left)

    def _membership_step(self, group: int) -> Callable[[float], None]:
        def respond(now: float) -> None:
            if changes := self._parts.control.update_membership(group, now):
                self._events += changes
                self._update_left()

        return respond

    def _law_step(self, group: int) -> Callable[[float], None]:
        def tell(now: float) -> None:
            self._events += self._parts.control.law_events(group, now)

        return tell

    def _neighbour_changes(self, now: float) -> None:
        self._events += self._link_monitor.neighbour_changes(now)

    def _leader_changes(self, now: float) -> None:
        self._events += self._link_monitor.leader_changes(now)

    @property
    def _command_call(self) -> Call:
        """Write the commands of law and guidance that the autopilots have now."""
        companions = self._parts.companions
        if companions is None:
            return Call(copy_control, self._world.aircraft)
        return companions.deliver_commands

    def _find_outages(self, now: float) -> None:
        """Add outages before other events: what is scripted comes before what follows from it."""
        self._events.put_first(self._outages.changes(now))

    def _find_joins(self, now: float) -> None:
        self._events += self._join_monitor.changes(now)

    def _separation_changes(self, now: float) -> None:
        assert self._separation_monitor is not None, "a stage of flights with the filter"
        self._events += self._separation_monitor.changes(now)

    def _find_left(self, now: float) -> None:
        external = self._world.external_control
        assert external is not None, "a stage of flights commanded from outside"
        self.without_slot[:] = external.left_formation(self._left)
