"""Steady slot errors of a scenario's followers with late and lost messages, predicted and flown.

The flight is that of `steady_flight`, behind a virtual leader in still air. The part of the network
is the difference from the same flight without it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from testbed.core.flags import Saturation
from testbed.core.records import Array
from testbed.core.velocity_frame import velocity_frame
from testbed.flight.loop import Flight
from testbed.flight.world import World
from testbed.formation.slots import write_formation_state
from testbed.linear.delay_offset import (
    MAX_LOSS,
    MessageAges,
    SteadyMotion,
    ages_of_messages,
    steady_offsets,
)
from testbed.linear.steady_flight import (
    MarginsError,
    build_compiled,
    check_measurable,
    check_roll_limits,
    steady_scenario,
)
from testbed.network.links import resolve_links
from testbed.scenario import Scenario
from testbed.scenario.arguments import with_changes
from testbed.scenario.control import BUILT_IN
from testbed.scenario.network import Bernoulli, Link, Network

Origin = Literal["receipt", "timestamp"]  # of the extrapolation
SETTLE_S = 900.0  # the integral of the course takes p/i, some 170 s
LOOK_S, RANDOM_LOOK_S = 5.0, 600.0  # that are averaged; the second with losses
SAMPLE_S = 0.2  # the airspeed filters repeat after 0.2 s
STEADY_M = 0.5  # largest change of an error in LOOK_S
_PLAIN = ("delay_s", "loss")  # keys of a link that the prediction has
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class SteadyErrors:
    """Mean slot errors of n followers in steady flight.

    Attributes:
        error_m: (n, 3) forward, right and down of the leader's course.
        problem: why they have no meaning; "": they have.
        note: commands that reach a limit, which the prediction has not; "": none.
    """

    error_m: Array
    problem: str = ""
    note: str = ""


def is_known_law(scenario: Scenario) -> bool:
    """Return whether errors can be predicted: a user's law has an equilibrium of its own."""
    return scenario.controller.law == BUILT_IN


def origins(scenario: Scenario) -> tuple[Origin | None, ...]:
    """Return the origins of the extrapolation to compare; None: a user's law extrapolates."""
    if not is_known_law(scenario) and scenario.controller.extrapolate_from is None:
        return (None,)
    return get_args(Origin)


def with_network(scenario: Scenario, delay_s: float, origin: Origin | None) -> Scenario:
    """Return a scenario with another delay of the messages and another origin of extrapolation."""
    return with_changes(
        scenario,
        network=with_changes(scenario.network, delay_s=delay_s),
        controller=with_changes(scenario.controller, extrapolate_from=origin),
    )


def without_network(scenario: Scenario) -> Scenario:
    """Return a scenario whose messages all arrive at once."""
    return with_changes(scenario, network=Network())


def predict_errors(scenario: Scenario, bank_deg: float) -> SteadyErrors:
    """Predict the errors of a scenario's followers from its law, graph and network.

    Args:
        scenario: as resolved.
        bank_deg: of a coordinated turn of the outermost slot, clockwise if positive; 0: straight.

    Raises:
        MarginsError: the scenario has a part that the prediction has not; with its key.
    """
    world = _build(scenario, bank_deg, 1.0)  # which is not flown
    check_predictable(scenario, world, turning=bool(bank_deg))
    errors = solve_errors(scenario, world, _motion(world))
    return SteadyErrors(errors, "" if np.isfinite(errors).all() else "no steady flight is found")


def _build(scenario: Scenario, bank_deg: float, duration_s: float) -> World:
    check_measurable(scenario)
    steady = steady_scenario(scenario, bank_deg, scenario.scenario.engine)
    header = with_changes(steady.scenario, duration_s=duration_s)
    world = build_compiled(with_changes(steady, scenario=header))
    check_roll_limits(world, abs(bank_deg))
    return world


def fly_errors(scenario: Scenario, bank_deg: float) -> SteadyErrors:
    """Measure the errors of a scenario's followers in a steady flight.

    Args:
        scenario: as resolved.
        bank_deg: see `predict_errors`.

    Raises:
        MarginsError: the scenario cannot be flown so, or the bank is too near a limit.
    """
    world = _build(scenario, bank_deg, SETTLE_S + RANDOM_LOOK_S + 2.0 * LOOK_S)
    slots = world.formation.control.offsets, world.formation.altitudes
    flight = Flight(world, [])
    flight.prepare()
    flight.fly_to(-math.inf)
    seconds = RANDOM_LOOK_S if world.is_random else LOOK_S
    rows, limits = [], []
    for k in range(round(seconds / SAMPLE_S)):
        flight.fly_to(SETTLE_S + k * SAMPLE_S)
        write_formation_state(world.aircraft, world.followers, *slots)
        forward, right, _ = velocity_frame(world.aircraft["truth"]["velocity_ned"][:1])[0].T
        level = np.array([forward[0], forward[1], 0.0]) / math.hypot(forward[0], forward[1])
        axes = np.stack((level, right, (0.0, 0.0, 1.0)))
        rows.append(world.followers["error_ned"] @ axes.T)
        limits.append(world.followers["saturations"].copy())
    errors = np.array(rows)
    moved = np.ptp(errors, axis=0).max(axis=1)
    unsteady = ~np.isfinite(moved) if world.is_random else ~(moved < STEADY_M)
    problem = ""
    if unsteady.any():
        worst = int(np.nan_to_num(moved, nan=np.inf).argmax())
        problem = f"not steady: the error of {world.names[1 + worst]} still changes"
    return SteadyErrors(
        errors.mean(axis=0), problem, _describe_limits(np.array(limits, dtype=np.int64), world)
    )


def _describe_limits(saturations: NDArray[np.int64], world: World) -> str:
    """Name the commands that were at a limit, of samples (K, n), with their share of the time."""
    found = []
    for limit in Saturation:
        shares = (saturations & int(limit) > 0).mean(axis=0)
        for name, share in zip(world.names[1:], shares.tolist(), strict=True):
            if share > 0.0:
                command = str(limit.name).lower()
                found.append(f"{command} command of {name} in {100.0 * share:.1f} %")
    return f"at a limit: {', '.join(found)} of the time" if found else ""


def _motion(world: World) -> SteadyMotion:
    """Return the motion of the leader of a world, which is virtual."""
    leader = world.aircraft["truth"][0]
    velocity, acceleration = leader["velocity_ned"], leader["acceleration_ned"]
    level = float(velocity[0] ** 2 + velocity[1] ** 2)
    across = float(velocity[0] * acceleration[1] - velocity[1] * acceleration[0])
    return SteadyMotion(float(np.linalg.norm(velocity)), across / level, -float(velocity[2]))


def solve_errors(scenario: Scenario, world: World, motion: SteadyMotion) -> Array:
    """Return the steady errors (n, 3) of a scenario's followers behind a leader in some motion.

    Args:
        scenario: see `check_predictable`.
        world: of it, or of one with the same fleet, formation, controller and rates.
        motion: of the leader.
    """
    control = world.formation.built_control
    law = control.controllers["law"]
    ages = message_ages(scenario, world)
    return steady_offsets(motion, law, control.config.gains, control.config.offsets, ages)


def message_ages(scenario: Scenario, world: World) -> MessageAges:
    """Return the ages of a scenario's messages at the control steps of its followers.

    Args:
        scenario: with delay and independent loss on its links.
        world: of its flight, whose clock counts.
    """
    links = resolve_links(world.names, scenario.network)
    delay, loss = np.zeros((2, len(world.names) - 1, len(world.names)))
    for i, j, link in links.pairs():
        delay[i, j] = link.delay_s or 0.0
        loss[i, j] = _loss(link)
    clock = world.clock
    steps = math.lcm(clock.control, clock.broadcast) // clock.control
    sent = np.array([each or 0 for each in clock.broadcast_phases])
    first = np.array(clock.control_phases)[:, np.newaxis] - sent
    after = first[..., np.newaxis] + clock.control * np.arange(steps)
    return ages_of_messages(
        delay,
        loss,
        after / clock.base_rate_hz,
        clock.broadcast / clock.base_rate_hz,
        from_timestamp=scenario.controller.extrapolate_from == "timestamp",
    )


def check_predictable(scenario: Scenario, world: World, *, turning: bool) -> None:
    """Check that the prediction has all parts of a scenario.

    Raises:
        MarginsError: it has not; with the key.
    """
    links = resolve_links(world.names, scenario.network)
    control = world.formation.built_control
    gains = control.config.gains
    others = [name for link in links.distinct for name in _other_keys(link)]
    network = scenario.network
    problem, remedy = "", "write --method flown"
    if not control.builtin:
        problem = "controller.law: the equilibrium of a law of your own is found by flights"
    elif world.formation.companions is not None:
        problem = "controller.companion: own states are late, too"
    elif others:
        problem = f"network.{others[0]}: only delay_s and independent loss are predicted"
    elif network.tdma or network.broadcast or network.clocks:
        key = next(each for each in ("tdma", "broadcast", "clocks") if getattr(network, each))
        problem = f"network.{key}: only delay_s and independent loss are predicted"
    elif (most := max((_loss(link) for link in links.distinct), default=0.0)) > MAX_LOSS:
        lost = "no message arrives" if most == 1.0 else "hardly a message arrives"
        problem = f"network.loss: is {most:.10g}, so {lost}"
        remedy = f"write at most {MAX_LOSS:g}, or --method flown"
    elif turning and np.any(np.abs(gains[..., 0] - gains[..., 1]) > _ROUNDING):
        problem = "formation: gains that differ north and east have no steady flight in a turn"
        remedy = "write equal ones, or --bank 0"
    if problem:
        raise MarginsError(f"{problem} ({remedy})")


def _loss(link: Link) -> float:
    """Return the probability of independent losses on a link."""
    return link.loss.probability if isinstance(link.loss, Bernoulli) else 0.0


def _other_keys(link: Link) -> list[str]:
    """Return the keys of a link that the prediction has not."""
    found = [
        name
        for name in Link.model_fields
        if name not in (*_PLAIN, "arithmetic") and getattr(link, name) not in (None, (), 0)
    ]
    loss = link.loss
    if loss is not None and not (isinstance(loss, Bernoulli) and not loss.correlation):
        found.append("loss")
    return found
