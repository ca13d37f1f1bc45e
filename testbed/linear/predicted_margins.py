"""Damping and margins of the followers in steady flight, from the linearised formation.

The flight is that of `steady_flight`, with compiled flight models. What it predicts is compared
with flights in docs/margins.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.compiled.compiled_fleet import CompiledFleet
from testbed.core.compile import is_interpreted
from testbed.core.records import join_names
from testbed.flight.world import World
from testbed.formation.compiled_law import CompiledLaw
from testbed.linear.delay_margin import DelayMargin, delay_margins
from testbed.linear.follower_state import held_fields, problem_of_memory
from testbed.linear.held_flight import COMMANDS, HeldFlight
from testbed.linear.linear_formation import command_margins, join
from testbed.linear.linear_system import Mode
from testbed.linear.loop_margins import CommandMargins
from testbed.linear.period_map import PeriodMaps, linearise_control, linearise_periods
from testbed.linear.steady_flight import MarginsError, banks_deg, fly_steadily
from testbed.scenario import Scenario
from testbed.scenario.arguments import with_changes
from testbed.scenario.network import Link

AIRSPEED_S = 0.1  # period of the autopilots' airspeed filters


@dataclass(frozen=True, slots=True)
class PredictedMargins:
    """Modes and margins of one follower.

    Attributes:
        name: of the follower.
        bank_deg: as flown.
        least_damped: of the modes that oscillate; None: nothing does.
        commands: margins by the name of the command: pitch, roll, throttle.
        modes: of it and the followers that influence each other with it, the least damped first.
    """

    name: str
    bank_deg: float
    least_damped: Mode | None
    commands: dict[str, CommandMargins]
    modes: tuple[Mode, ...]


@dataclass(frozen=True, slots=True)
class Prediction:
    """The followers at one bank.

    Attributes:
        bank_deg: asked for, of the follower that banks most; clockwise if positive.
        followers: empty where there is a problem.
        problem: why there are no numbers; "": there are.
        message_delays: margins of the followers that receive from each other, in straight flight.
        note: memory of a user's law that is held; "": none.
    """

    bank_deg: float
    followers: tuple[PredictedMargins, ...]
    problem: str
    message_delays: tuple[DelayMargin, ...] = ()
    note: str = ""


def predict_margins(scenario: Scenario, bank_deg: float, climb_mps: float = 0.0) -> Prediction:
    """Linearise the followers of a scenario in steady flight, in one direction of turn.

    Args:
        scenario: whose formation, network and controller they have.
        bank_deg: the highest of a follower; clockwise if positive; 0: straight.
        climb_mps: of the leader, m/s.

    Raises:
        MarginsError: the scenario cannot be flown so, see `check_measurable`, or not linearised.
    """
    flight, problem = fly_linearisable(scenario, bank_deg, climb_mps)
    if problem:
        return Prediction(bank_deg, (), problem)
    maps = linearise(flight)
    formation = join(maps)
    followers = []
    for name, bank in zip(flight.world.names[1:], banks_deg(flight).tolist(), strict=True):
        own = formation.coupled_with(name)  # others cannot destabilise it
        modes = tuple(own.modes())
        least = next((mode for mode in modes if mode.frequency_hz > 0.0), None)
        commands = command_margins(own, name)
        followers.append(PredictedMargins(name, bank, least, commands, modes))
    # late messages lead to another circle than the one that is linearised
    delays: Sequence[DelayMargin] = ()
    if not bank_deg:
        builtin = flight.world.formation.built_control.builtin
        later = None if builtin else _LaterMessages(scenario, climb_mps, maps)
        delays = delay_margins(maps, later)
    return Prediction(bank_deg, tuple(followers), "", tuple(delays), _describe_held(flight.world))


def _describe_held(world: World) -> str:
    """Name the memory of a user's law that is no state."""
    groups = world.formation.built_control.groups
    names = dict.fromkeys(name for each in groups for name in held_fields(each.law))
    if not names:
        return ""
    return f"held, as whole numbers and flags have no derivatives: memory {join_names(list(names))}"


class _LaterMessages:
    """Maps of a formation with later messages, for a law of a user's.

    The formation is flown until it is steady with each delay, and its control is linearised there.
    """

    def __init__(self, scenario: Scenario, climb_mps: float, maps: PeriodMaps) -> None:
        self._scenario, self._climb_mps, self._maps = scenario, climb_mps, maps
        self._known: dict[int, PeriodMaps | None] = {0: maps}

    def __call__(self, periods: int) -> PeriodMaps | None:
        """Return the maps with messages these control periods later; None: it is not steady."""
        if periods not in self._known:
            self._known[periods] = self._linearise(periods * self._maps.dt)
        return self._known[periods]

    def _linearise(self, delay_s: float) -> PeriodMaps | None:
        late = with_later_messages(self._scenario, delay_s)
        flight, problem = fly_linearisable(late, 0.0, self._climb_mps)
        if problem:
            return None
        maps = linearise_control(flight, self._maps)
        return replace(maps, age_s=np.array(flight.world.links["age_s"]))


def with_later_messages(scenario: Scenario, delay_s: float) -> Scenario:
    """Return a scenario whose messages all arrive later."""
    network = scenario.network
    links = {
        sender: {receiver: _later(link, delay_s) for receiver, link in receivers.items()}
        for sender, receivers in network.links.items()
    }
    whole = (network.delay_s or 0.0) + delay_s
    return with_changes(scenario, network=with_changes(network, delay_s=whole, links=links))


def _later(link: Link, delay_s: float) -> Link:
    """Return a link with a larger delay; one without its own has that of all links."""
    return link if link.delay_s is None else with_changes(link, delay_s=link.delay_s + delay_s)


def worse_prediction(turns: Sequence[Prediction]) -> Prediction:
    """Return the worse numbers of each follower in both directions, and its higher bank."""
    problems = dict.fromkeys(each.problem for each in turns if each.problem)
    if problems:
        return Prediction(abs(turns[0].bank_deg), (), "; ".join(problems))
    followers = tuple(
        _worse_of(pair) for pair in zip(*(each.followers for each in turns), strict=True)
    )
    first = turns[0]
    return Prediction(abs(first.bank_deg), followers, "", first.message_delays, first.note)


def _worse_of(pair: Sequence[PredictedMargins]) -> PredictedMargins:
    modes = [each.least_damped for each in pair if each.least_damped is not None]
    every = [mode for each in pair for mode in each.modes]
    commands = {}
    for name in COMMANDS:
        gains, least, latencies, phases, distances = zip(
            *(each.commands[name] for each in pair), strict=True
        )
        commands[name] = CommandMargins(
            min(gains), max(least), min(latencies), min(phases), min(distances)
        )
    return PredictedMargins(
        pair[0].name,
        max((each.bank_deg for each in pair), key=abs),
        min(modes, key=lambda mode: mode.damping, default=None),
        commands,
        tuple(sorted(every, key=lambda mode: mode.damping)),
    )


def linearise(flight: HeldFlight) -> PeriodMaps:
    """Linearise a steady flight, which is linearisable, over the periods after which it repeats.

    Raises:
        MarginsError: the memory of a user's law does not repeat with it.
    """
    clock = flight.world.clock
    airspeed = round(AIRSPEED_S * clock.base_rate_hz)
    ticks = math.lcm(clock.period, airspeed)
    return linearise_periods(flight, ticks // clock.control)


def linearise_checked(flight: HeldFlight) -> PeriodMaps:
    """Linearise any steady flight; see `linearise`.

    Raises:
        MarginsError: it cannot be linearised.
    """
    _check_linearisable(flight.world)
    return linearise(flight)


class NotLinearisable(MarginsError):
    """A scenario whose followers cannot be linearised.

    Attributes:
        problem: why.
        remedy: what to write in the scenario.
    """

    def __init__(self, problem: str, remedy: str) -> None:
        """See the class."""
        super().__init__(problem, remedy)
        self.problem, self.remedy = problem, remedy

    def __str__(self) -> str:
        """Return the message."""
        return f"{self.problem}, so the formation cannot be linearised ({self.remedy})"


def fly_linearisable(
    scenario: Scenario, bank_deg: float, climb_mps: float = 0.0
) -> tuple[HeldFlight, str]:
    """Fly a formation that can be linearised until it is steady; see `fly_steadily`.

    Raises:
        MarginsError: see `predict_margins`.
    """
    # with "compiled" the loader's own error has a remedy that is of no use here
    engine = "compiled" if is_interpreted() else "auto"
    return fly_steadily(scenario, bank_deg, climb_mps, engine, _check_linearisable)


def _check_linearisable(world: World) -> None:
    """Check that the state of the followers is known, and the same at each control step.

    Raises:
        NotLinearisable: it is not; with what to write.
    """
    clock, formation = world.clock, world.formation
    laws = [each.law for each in formation.built_control.groups]
    memory = [found for found in map(problem_of_memory, laws) if found[0]]
    if world.fleet is not None and not isinstance(world.fleet, CompiledFleet):
        problem, remedy = world.fleet.engine_reason, "write another aircraft, such as rascal110"
    elif not all(each is None or isinstance(each, CompiledLaw) for each in laws):
        problem = "a law that is a Python class has a memory that is not known"
        remedy = (
            "write it as a function under @testbed.kernel that steps one follower, with its memory "
            "declared, as in docs/own-law.md"
        )
    elif memory:
        problem, remedy = memory[0]
    elif formation.built_control.outputs.sent:
        problem = "the law reads numbers that the laws of others send"
        remedy = "margins: write --method flown"
    elif formation.companions is not None:
        problem, remedy = (
            "companion computers hold commands back",
            "write controller.companion: {state_latency_s: 0, command_latency_s: 0, link: direct}",
        )
    elif clock.broadcast != clock.control or clock.transmit_schedules:
        problem = "messages are not sent at each control step"
        remedy = "write rates.broadcast_hz as control_hz, and no network.tdma or network.broadcast"
    elif formation.radio.is_random:
        problem = "the network is random"
        remedy = "write a network without chance: delay_s alone"
    else:
        return
    raise NotLinearisable(problem, remedy)
