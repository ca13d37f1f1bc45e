"""Damping and margins of the followers in steady flight, from the linearised formation.

The flight is that of `steady_flight`, with compiled flight models. What it predicts is compared
with flights in docs/margins.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.core.records import Array
from testbed.flight.world import World
from testbed.plan.world import build
from testbed.scenario import Scenario
from testbed.trials.delay_margin import DelayMargin, delay_margins
from testbed.trials.held_flight import COMMANDS, HeldFlight
from testbed.trials.linear_formation import (
    CommandMargins,
    Mode,
    join,
)
from testbed.trials.period_map import PeriodMaps, linearise_periods
from testbed.trials.steady_flight import (
    LONGEST_SETTLE_S,
    LOOK_S,
    SETTLE_S,
    STEADY_DEG,
    MarginsError,
    check_measurable,
    check_roll_limits,
    steady_scenario,
)

BANK_TOLERANCE_DEG = 0.5  # between the bank that is asked for and the highest one flown
RECENTRE_S = 2.0
# then an unstable flight is linearised, before it leaves its steady state
UNSTABLE_STEADY_DEG = 0.02
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
    """

    bank_deg: float
    followers: tuple[PredictedMargins, ...]
    problem: str
    message_delays: tuple[DelayMargin, ...] = ()


def predict_margins(scenario: Scenario, bank_deg: float, climb_mps: float = 0.0) -> Prediction:
    """Linearise the followers of a scenario in steady flight, in one direction of turn.

    Args:
        scenario: whose formation, network and controller they have.
        bank_deg: the highest of a follower; clockwise if positive; 0: straight.
        climb_mps: of the leader, m/s.

    Raises:
        MarginsError: the scenario cannot be flown so, see `check_measurable`, or not linearised.
        InputError: an aircraft has no compiled flight model.
    """
    flight, problem = fly_steadily(scenario, bank_deg, climb_mps)
    if problem:
        return Prediction(bank_deg, (), problem)
    maps = linearise(flight)
    formation = join(maps)
    banks = np.degrees(flight.world.aircraft["truth"]["euler"][1:, 0])
    followers = []
    for i, name in enumerate(formation.names):
        modes = tuple(formation.of(i).modes())
        least = next((mode for mode in modes if mode.frequency_hz > 0.0), None)
        commands = dict(zip(COMMANDS, formation.margins(i), strict=True))
        followers.append(PredictedMargins(name, float(banks[i]), least, commands, modes))
    # late messages lead to another circle than the one that is linearised
    delays = () if bank_deg else tuple(delay_margins(maps))
    return Prediction(bank_deg, tuple(followers), "", delays)


def worse_prediction(turns: Sequence[Prediction]) -> Prediction:
    """Return the worse numbers of each follower in both directions, and its higher bank."""
    problems = dict.fromkeys(each.problem for each in turns if each.problem)
    if problems:
        return Prediction(abs(turns[0].bank_deg), (), "; ".join(problems))
    followers = tuple(
        _worse_of(pair) for pair in zip(*(each.followers for each in turns), strict=True)
    )
    return Prediction(abs(turns[0].bank_deg), followers, "", turns[0].message_delays)


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
    """Linearise a steady flight over the periods after which it repeats."""
    clock = flight.world.clock
    airspeed = round(AIRSPEED_S * clock.base_rate_hz)
    ticks = math.lcm(clock.period, airspeed)
    return linearise_periods(flight, ticks // clock.control)


def fly_steadily(
    scenario: Scenario, bank_deg: float, climb_mps: float = 0.0
) -> tuple[HeldFlight, str]:
    """Fly until the highest bank of a follower is the one asked for.

    Args:
        scenario: whose formation, network and controller they have.
        bank_deg: the highest of a follower; clockwise if positive; 0: straight.
        climb_mps: of the leader, m/s.

    Raises:
        MarginsError: see `predict_margins`.

    Returns:
        The flight, and what is not steady in it; "": it is.
    """
    check_measurable(scenario)
    flight, problem = _settle(scenario, bank_deg, climb_mps)
    banks = np.degrees(flight.world.aircraft["truth"]["euler"][1:, 0])
    excess = float(np.abs(banks).max() - abs(bank_deg))
    if bank_deg and abs(excess) > BANK_TOLERANCE_DEG and math.isfinite(excess):
        corrected = math.copysign(max(abs(bank_deg) - excess, 1.0), bank_deg)
        flight, problem = _settle(scenario, corrected, climb_mps)
    return flight, problem


def _check_linearisable(world: World) -> None:
    """Check that the state of the followers is known, and the same at each control step.

    Raises:
        MarginsError: it is not; with what to write.
    """
    clock, formation = world.clock, world.formation
    phases = {*clock.control_phases, *clock.broadcast_phases}
    if not formation.built_control.builtin:
        problem = "a law of your own has a state that is not known"
    elif formation.companions is not None:
        problem = "companion computers hold commands back"
    elif phases != {0} or clock.broadcast != clock.control:
        problem = "messages are not sent at each control step"
    elif world.is_random:
        problem = "the network is random"
    else:
        return
    raise MarginsError(
        f"{problem}, so the formation cannot be linearised (margins: write --method flown)"
    )


def _settle(scenario: Scenario, bank_deg: float, climb_mps: float) -> tuple[HeldFlight, str]:
    world = build(steady_scenario(scenario, bank_deg, "compiled", climb_mps))
    _check_linearisable(world)
    check_roll_limits(world, abs(bank_deg))
    flight = HeldFlight(world)
    return flight, settle(flight)


def settle(flight: HeldFlight) -> str:
    """Fly until the banks are steady, also where that flight is unstable.

    Returns:
        Why they are not; "": they are.
    """
    moved_deg = np.array([math.inf])
    while flight.time_s < LONGEST_SETTLE_S and not moved_deg.max() < STEADY_DEG:
        flight.fly_to(flight.time_s + SETTLE_S - LOOK_S)
        moved_deg, _ = _look(flight, LOOK_S)
    if not moved_deg.max() < STEADY_DEG:
        moved_deg = _settle_unstable(flight)
    # also one that has been lost on the way, and moves no more
    gone = flight.world.aircraft["down"][1:] | flight.world.aircraft["stopped"][1:]
    if gone.any():
        return f"not steady: {flight.world.names[1 + int(gone.argmax())]} has been lost"
    if moved_deg.max() < STEADY_DEG:
        return ""
    worst = int(np.nan_to_num(moved_deg, nan=np.inf).argmax())
    name = flight.world.names[1 + worst]
    return f"not steady: the bank of {name} still changes by {moved_deg[worst]:.1f}°"


def _settle_unstable(flight: HeldFlight) -> Array:
    """Fly on to a steady flight that is unstable; return how much banks (n,) move, degrees.

    Deviations of the commands from their mean over the time before are halved: the steady flight
    is the same, and the loops have half their gain.
    """
    inputs, moved_deg = flight.inputs, np.array([math.inf])
    _, mean = _look(flight, RECENTRE_S)
    for _ in range(round(LONGEST_SETTLE_S / RECENTRE_S)):
        inputs.gain[:] = 0.5
        inputs.begin(mean)
        moved_deg, mean = _look(flight, RECENTRE_S)
        if moved_deg.max() < UNSTABLE_STEADY_DEG:
            break
    inputs.end()
    return moved_deg


def _look(flight: HeldFlight, duration_s: float) -> tuple[Array, Array]:
    """Fly on; return how much banks move (n,), degrees, and the mean commands (n, 3)."""
    banks, commands = [], []
    for _ in range(round(duration_s / flight.dt)):
        flight.fly_to(flight.time_s + flight.dt)
        banks.append(flight.world.aircraft["truth"]["euler"][1:, 0].copy())
        commands.append(flight.inputs.computed.copy())
    moved_deg: Array = np.degrees(np.ptp(np.array(banks), axis=0))
    return moved_deg, np.mean(commands, axis=0)
