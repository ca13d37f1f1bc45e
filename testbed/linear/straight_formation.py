"""The followers of a scenario linearised in straight flight, with their graph.

A formation of many followers that are alike needs no map of each. In straight flight the map of one
depends on the graph by a few numbers: its own state by the sum of its gains, since it enters the
law (6) as minus that sum times its own slot error; a message of a neighbour by β_ij; and the
leader's message by

    1,  υ_i,  β_i,  Σ_j β_ij (υ_i − υ_j)

of which the first two are the slot's velocity and acceleration, the last two the error ξ_i. So the
maps of eight different followers give those of all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from testbed.core.records import Array
from testbed.linear.held_flight import COMMANDS, HeldFlight
from testbed.linear.linear_formation import AXES, average, received
from testbed.linear.linear_system import LinearSystem
from testbed.linear.period_map import PeriodMaps
from testbed.linear.predicted_margins import fly_linearisable, linearise
from testbed.linear.predicted_response import StraightFormation
from testbed.linear.steady_flight import MarginsError, check_measurable, steady_scenario
from testbed.scenario import Scenario
from testbed.scenario.control import BUILT_IN

# The integral of the course moves steady slot errors by centimetres for minutes.
SETTLED_S = 150.0
MOST_LINEARISED = 12  # followers that are linearised one by one
SLOW_HZ = 1e-5  # of a displacement that is constant for a follower
NO_SHARE = 1e-3  # smaller shares are none
# of the eight: slot, m, gain of the leader, gain of the first for those that have one
_EXAMPLES: tuple[tuple[tuple[float, float, float], float, float], ...] = (
    ((-20.0, 0.0, 0.0), 1.0, 0.0),
    ((-60.0, 0.0, 0.0), 1.0, 0.0),
    ((-20.0, 40.0, 0.0), 1.0, 0.0),
    ((-20.0, 0.0, -30.0), 1.0, 0.0),
    ((-40.0, -20.0, 20.0), 2.0, 0.0),
    ((-60.0, 40.0, 20.0), 1.0, 1.0),
    ((-80.0, -40.0, 20.0), 1.0, 1.0),
    ((-60.0, 20.0, -40.0), 1.0, 1.0),
)


def linearise_straight(scenario: Scenario) -> StraightFormation:
    """Linearise the followers of a scenario behind a virtual leader in straight, level flight.

    Args:
        scenario: whose formation, network and controller they have.

    Raises:
        MarginsError: the scenario cannot be flown so, or not linearised.
        InputError: an aircraft has no compiled flight model.
    """
    check_measurable(scenario)
    # how a user's law uses slots and gains is not known
    if len(scenario.fleet) <= MOST_LINEARISED or scenario.controller.law != BUILT_IN:
        return _each_of(scenario)
    _check_alike(scenario)
    return _alike(scenario)


def _fly_straight(scenario: Scenario) -> HeldFlight:
    flight, problem = fly_linearisable(scenario, 0.0)
    if problem:
        raise MarginsError(problem)
    flight.fly_to(max(flight.time_s, SETTLED_S))
    return flight


def _each_of(scenario: Scenario) -> StraightFormation:
    """Linearise the followers one by one."""
    flight = _fly_straight(scenario)
    maps = linearise(flight)
    formation = flight.world.formation
    found = StraightFormation(
        dt=maps.dt,
        speed=maps.speed,
        names=tuple(flight.world.names[1:]),
        maps=_messages_of(maps),
        age_s=maps.age_s,
        gains=np.array(formation.built_control.neighbours["gain"]),
        offsets=np.array(formation.control.offsets),
        level=~np.isnan(formation.altitudes),
        alike=False,
    )
    if formation.built_control.builtin:
        return found
    return replace(found, gains=shares(found, maps))


def shares(formation: StraightFormation, maps: PeriodMaps) -> Array:
    """Return the shares (n, N, 3) of aircraft in the motion of each follower, as of its gains.

    If follower j alone is displaced by a constant, a follower with the law of [HBH23] is displaced
    by the share β_ij / B of that. For another law the share is that of the linearised follower. The
    rest to 1 is the leader's share, because a displacement of all aircraft displaces it equally.

    Args:
        formation: linearised; its gains are not read.
        maps: of its followers' control periods.
    """
    found = np.zeros((len(maps.followers), len(maps.followers) + 1, len(AXES)))
    for i, each in enumerate(maps.followers):
        for j in each.b_message:
            for axis in range(len(AXES)) if j else ():
                share = float(formation.hop(i, j, axis, np.array([SLOW_HZ])).real.item())
                found[i, j, axis] = share if abs(share) > NO_SHARE else 0.0
    rest = 1.0 - found.sum(axis=1)
    found[:, 0] = np.where(np.abs(rest) > NO_SHARE, rest, 0.0)
    return found


def _messages_of(maps: PeriodMaps) -> tuple[LinearSystem, ...]:
    """Return the followers from the messages that they use and the wind to their own messages."""
    followers = []
    for i, each in enumerate(maps.followers):
        whole = average(maps, i)
        commands = {f"{each.name}.{command}" for command in COMMANDS}
        inputs = [name for name in whole.inputs if name not in commands]
        followers.append(whole.select(inputs, f"{each.name}.message"))
    return tuple(followers)


def _check_alike(scenario: Scenario) -> None:
    """Check that the followers of a large formation differ by slots and gains only.

    Raises:
        MarginsError: they differ otherwise.
    """
    why = f"more than {MOST_LINEARISED} followers are linearised as alike"
    # without what steady flight leaves out, such as sensors
    fleet = steady_scenario(scenario, 0.0, "compiled").fleet
    first = _without_place(fleet[0])
    for k, each in enumerate(fleet):
        if _without_place(each) != first:
            raise MarginsError(
                f"fleet.{k}: {each.name} differs from {fleet[0].name}, but {why} (write the same "
                "keys)"
            )
    formation, network = scenario.formation, scenario.network
    if not scenario.rates.synchronous:
        raise MarginsError(
            f"rates.synchronous: followers differ by their phases, but {why} (write true)"
        )
    for key, section in (
        ("formation.agents", formation.agents),
        ("formation.altitudes_m", formation.altitudes_m),
        ("network.links", network.links),
        ("network.broadcast", network.broadcast),
        ("network.clocks", network.clocks),
    ):
        if section:
            raise MarginsError(f"{key}: followers differ by it, but {why} (leave it out)")
    for name in (each.name for each in scenario.fleet):
        all_gains = [formation.leader_gains.get(name, (0.0,) * 3)]
        all_gains += formation.neighbour_gains.get(name, {}).values()
        for gain in all_gains:
            if len({*gain}) > 1:
                raise MarginsError(
                    f"formation: a gain of {name} differs between the axes, but {why} (write one "
                    "number)"
                )


def _without_place(follower: Any) -> dict[str, Any]:  # noqa: ANN401 - a section
    data: dict[str, Any] = follower.model_dump(mode="json", by_alias=True)
    return {key: value for key, value in data.items() if key not in ("name", "start_m")}


def _example(scenario: Scenario) -> Scenario:
    """Return a formation of the eight different followers."""
    data = scenario.model_dump(mode="json", by_alias=True)
    names = [each.name for each in scenario.fleet][: len(_EXAMPLES)]
    data["fleet"] = data["fleet"][: len(_EXAMPLES)]
    for section in ("expect", "limits"):
        data.pop(section)
    data["formation"] |= {
        "offsets_m": {name: list(each[0]) for name, each in zip(names, _EXAMPLES, strict=True)},
        "leader_gains": {name: each[1] for name, each in zip(names, _EXAMPLES, strict=True)},
        "neighbour_gains": {
            name: {names[0]: each[2]}
            for name, each in zip(names, _EXAMPLES, strict=True)
            if each[2]
        },
    }
    data["scenario"] |= {"windows": {}, "published": None}
    return Scenario.model_validate(data)


def _alike(scenario: Scenario) -> StraightFormation:
    """Compose the maps of all followers from those of eight."""
    maps = linearise(_fly_straight(_example(scenario)))
    parts = _Parts(maps)
    names = [each.name for each in scenario.fleet]
    n = len(names)
    offsets = np.zeros((n + 1, 3))
    gains = np.zeros((n, n + 1, 3))
    formation = scenario.formation
    for i, name in enumerate(names):
        offsets[i + 1] = formation.offsets_m[name]
        gains[i, 0] = formation.leader_gains.get(name, 0.0)
        for other, gain in formation.neighbour_gains.get(name, {}).items():
            gains[i, names.index(other) + 1] = gain
    neighbour_age = float(maps.age_s[-1, 1])
    age_s = np.where(gains[..., 0] > 0.0, neighbour_age, np.nan)
    age_s[:, 0] = maps.age_s[0, 0]
    return StraightFormation(
        dt=maps.dt,
        speed=maps.speed,
        names=tuple(names),
        maps=tuple(parts.compose(names, i, offsets, gains[i, :, 0]) for i in range(n)),
        age_s=age_s,
        gains=gains,
        offsets=offsets,
        level=np.zeros(n, dtype=bool),
        alike=True,
    )


class _Parts:
    """The parts of the map of a follower that its gains and its slot multiply."""

    def __init__(self, maps: PeriodMaps) -> None:
        """Find the parts from the eight different followers."""
        followers = self._followers = _messages_of(maps)
        if len({_states_of(each) for each in followers}) > 1:
            raise MarginsError("followers that are alike have different states")
        sums = np.array([leader + first for _, leader, first in _EXAMPLES])
        self._a = _solve(
            np.stack((np.ones_like(sums), sums), axis=-1), np.stack([each.a for each in followers])
        )
        slots = np.array([slot for slot, _, _ in _EXAMPLES])
        numbers = []
        for slot, leader, first in _EXAMPLES:
            apart = leader * np.array(slot) + first * (np.array(slot) - slots[0])
            numbers.append(_numbers(np.array(slot), leader, apart))
        self._leader = _solve(
            np.array(numbers), np.stack([each.select("leader").b for each in followers])
        )
        prefix = received(maps.followers[-1].name, maps.followers[0].name)
        neighbour = followers[-1].select(prefix)
        self._neighbour = neighbour.b
        self._message = [name.removeprefix(prefix) for name in neighbour.inputs]

    def compose(self, names: Sequence[str], i: int, offsets: Array, gains: Array) -> LinearSystem:
        """Return the map of a follower.

        Args:
            names: of all followers.
            i: 0..n-1.
            offsets: (N, 3) m.
            gains: (N,) of this follower for the aircraft.
        """
        own = offsets[i + 1]
        numbers = _numbers(own, gains[0], gains @ (own - offsets))
        senders = [j for j in np.flatnonzero(gains).tolist() if j]
        like = self._followers[0].select(["wind", "leader"])
        wind = like.select("wind").b
        into = [gains[j] * self._neighbour for j in senders]
        b = np.hstack([wind, np.tensordot(numbers, self._leader, 1), *into])
        name = names[i]
        from_others = [received(name, names[j - 1]) for j in senders]
        return replace(
            like,
            a=self._a[0] + gains.sum() * self._a[1],
            b=b,
            d=np.zeros((len(like.outputs), b.shape[1])),
            states=tuple(f"{name}.{state}" for state in _states_of(like)),
            inputs=(
                *like.inputs,
                *(f"{one}{rest}" for one in from_others for rest in self._message),
            ),
            outputs=tuple(f"{name}.{output.partition('.')[2]}" for output in like.outputs),
        )


def _states_of(follower: LinearSystem) -> tuple[str, ...]:
    """Return the names of a follower's states without its own."""
    return tuple(name.partition(".")[2] for name in follower.states)


def _numbers(slot: Array, leader: float, apart: Array) -> Array:
    """Return the numbers (8,) that multiply the parts of the leader's message."""
    return np.array([1.0, *slot, leader, *apart])


def _solve(numbers: Array, maps: Array) -> Array:
    """Return the parts (P, ...) of which `numbers` (8, P) make the maps (8, ...)."""
    flat, *_ = np.linalg.lstsq(numbers, maps.reshape(len(maps), -1), rcond=None)
    parts: Array = np.asarray(flat, dtype=float).reshape(numbers.shape[1], *maps.shape[1:])
    return parts
