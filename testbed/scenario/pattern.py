"""Fleets that are a pattern: slots, neighbours, and their expansion to a list of followers."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from testbed.scenario.aircraft import AircraftSection
from testbed.scenario.fields import Finding, Gain, Metres, Name, Whole, raise_findings
from testbed.scenario.problems import did_you_mean
from testbed.scenario.validate import validate
from testbed.scenario.yaml_io import Node, Plain, merge, plant

FLEET, FORMATION = "fleet", "formation"
# keys of the formation that name followers
_BY_FOLLOWER = ("offsets_m", "altitudes_m", "leader_gains", "neighbour_gains", "agents")

Kind = Literal["vee", "line-abreast", "column", "echelon-left", "echelon-right", "grid"]
Slot = tuple[float, float, float]
# Unused element of the spacing: its index, its name, and a pattern that uses it.
_UNUSED = {"line-abreast": (0, "behind", "vee"), "column": (1, "beside", "echelon-right")}
_SPACING_M = {"line-abreast": (0.0, 10.0, 0.0), "column": (10.0, 0.0, 0.0)}


class Pattern(AircraftSection):
    """Fleet of like aircraft in a pattern; it is read as the list that it stands for."""

    name: Name = Field("uav", description="Prefix of the names: uav1, uav2 and so on.")
    pattern: Kind = Field(
        description="vee: ranks behind the leader, right and left in turn; line-abreast: the same "
        "beside it; column; echelon-left, echelon-right; grid: rows, as square as possible."
    )
    count: Annotated[Whole, Field(ge=1, le=255)] = Field(description="Number of followers.")
    spacing_m: tuple[Metres, Metres, Metres] | None = Field(
        None,
        description="Distance from slot to slot [behind, beside, below], m; by default 10 behind "
        "and 10 beside, where the pattern has it.",
    )
    start_behind_m: Metres = Field(
        20.0, description="Distance of all starts behind the slots, m; negative is ahead."
    )
    neighbours: Annotated[Whole, Field(ge=0, le=255)] = Field(
        2, description="Number of neighbours of each follower: those with the nearest slots."
    )
    neighbours_from: Literal["all", "ahead"] = Field(
        "all", description="Candidates: all, or ahead: followers with lower numbers."
    )
    leader_gain: Gain = Field(
        (1.0, 1.0, 1.0), description="formation.leader_gains of every follower."
    )
    neighbour_gain: Gain = Field(
        (1.0, 1.0, 1.0), description="formation.neighbour_gains for each neighbour."
    )
    agents: Mapping[Name, Mapping[Name, Any]] = Field(
        {}, description="By follower, keys of an aircraft that differ."
    )

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the followers, in order."""
        return tuple(f"{self.name}{number}" for number in range(1, self.count + 1))

    @cached_property
    def slots(self) -> tuple[Slot, ...]:
        """Return the slots [forward, right, down] of the leader, m, in order."""
        behind, beside, below = self.spacing_m or _SPACING_M.get(self.pattern, (10.0, 10.0, 0.0))
        steps = (_steps(self.pattern, index, self.count) for index in range(self.count))
        return tuple(
            (0.0 - back * behind, aside * beside, down * below) for back, aside, down in steps
        )

    @property
    def neighbour_indices(self) -> tuple[tuple[int, ...], ...]:
        """Return the neighbours of each follower, nearest first, ties in fleet order."""
        ahead = self.neighbours_from == "ahead"
        return tuple(
            tuple(self._by_distance(index, range(index if ahead else self.count)))[
                : self.neighbours
            ]
            for index in range(self.count)
        )

    def _by_distance(self, index: int, others: range) -> list[int]:
        slots = self.slots

        def distance(other: int) -> float:
            return round(math.dist(slots[index], slots[other]), 6)  # ties despite rounding

        return sorted((other for other in others if other != index), key=distance)

    @model_validator(mode="after")
    def _check(self) -> Self:
        raise_findings((*_check_spacing(self), *_check_agents(self)))
        return self


def _steps(pattern: Kind, index: int, count: int) -> tuple[float, float, float]:
    """Return steps [behind, beside, below] from the leader to follower `index` of `count`."""
    rank, pair = index + 1, index // 2 + 1
    side = pair if index % 2 == 0 else -pair
    if pattern == "vee":
        return pair, side, pair
    if pattern == "line-abreast":
        return 0, side, pair
    if pattern == "column":
        return rank, 0, rank
    if pattern == "grid":
        width = math.ceil(math.sqrt(count))
        row, column = divmod(index, width)
        abreast = min(width, count - row * width)
        return row + 1, column - (abreast - 1) / 2, row + 1
    return rank, rank if pattern == "echelon-right" else -rank, rank


def _check_spacing(fleet: Pattern) -> Iterator[Finding]:
    """Check that the pattern uses the spacing, and that all slots are apart."""
    at = ("spacing_m",)
    if fleet.spacing_m is not None and fleet.pattern in _UNUSED:
        index, word, other = _UNUSED[fleet.pattern]
        if fleet.spacing_m[index]:
            text = f"has {fleet.spacing_m[index]:g} m {word}, which a {fleet.pattern} does not use"
            yield (*at, index), f"{text} (write 0, or pattern: {other})"
            return
    taken: dict[tuple[float, ...], str] = {(0.0, 0.0, 0.0): "the leader"}
    for name, slot in zip(fleet.names, fleet.slots, strict=True):
        near = tuple(round(each, 1) + 0.0 for each in slot)
        if near in taken:
            text = f"puts {name} where {taken[near]} is (write [behind, beside, below] in m)"
            yield at, text
            return
        taken[near] = name


def _check_agents(fleet: Pattern) -> Iterator[Finding]:
    for name in fleet.agents:
        if name not in fleet.names:
            hint = did_you_mean(name, fleet.names)
            names = f"{fleet.names[0]} to {fleet.names[-1]}"
            yield ("agents", name), f"no follower has this name{hint} (the fleet has {names})"


def is_pattern_key(keys: tuple[str, ...]) -> bool:
    """Return whether keys lead to the fleet or its pattern, not one aircraft."""
    first, *rest = keys
    return first == FLEET and (not rest or rest[0] in Pattern.model_fields)


def expand_pattern(scenario: Node) -> Node:
    """Replace a pattern by the list of followers, with their offsets and gains.

    Keys of the file's own `formation` take precedence. Generated values have the place of the
    pattern, for errors.

    Raises:
        ScenarioError: with every problem of the pattern, each with its place.
    """
    pattern = _child(scenario, FLEET)
    if pattern is None or not isinstance(pattern.value, dict):
        return scenario
    fleet = validate(pattern, Pattern, under=(FLEET,))
    assert isinstance(scenario.value, dict)
    formation = plant(_formation(fleet), pattern.place)
    own = _child(scenario, FORMATION)
    return replace(
        scenario,
        value=scenario.value
        | {
            FLEET: replace(pattern, value=_followers(fleet, pattern)),
            FORMATION: merge(formation, own) if own else formation,
        },
    )


def drop_follower_keys(base: Node, top: Node) -> Node:
    """Return `base` without keys by follower, if `top` replaces them by a pattern.

    The same names may be in other slots.
    """
    old, new, formation = _child(base, FLEET), _child(top, FLEET), _child(base, FORMATION)
    if not (old and new and isinstance(old.value, tuple) and isinstance(new.value, dict)):
        return base
    if not (isinstance(base.value, dict) and formation and isinstance(formation.value, dict)):
        return base
    rest = {key: node for key, node in formation.value.items() if key not in _BY_FOLLOWER}
    return replace(base, value=base.value | {FORMATION: replace(formation, value=rest)})


def _child(node: Node, key: str) -> Node | None:
    return node.value.get(key) if isinstance(node.value, dict) else None


def _followers(fleet: Pattern, pattern: Node) -> tuple[Node, ...]:
    """Return the list of followers: common keys, and over them those of each."""
    assert isinstance(pattern.value, dict)
    common = {
        key: node for key, node in pattern.value.items() if key in AircraftSection.model_fields
    }
    agents = _child(pattern, "agents")
    followers = []
    for name, (forward, right, down) in zip(fleet.names, fleet.slots, strict=True):
        start: Plain = [forward - fleet.start_behind_m, right, down]
        generated = {
            key: plant(value, pattern.place) for key, value in (("name", name), ("start_m", start))
        }
        follower = replace(pattern, value=common | generated)
        own = _child(agents, name) if agents else None
        followers.append(merge(follower, own) if own else follower)
    return tuple(followers)


def _formation(fleet: Pattern) -> Plain:
    """Return offsets, and gains that are not zero, by name."""
    formation: dict[str, Plain] = {
        "offsets_m": {name: [*slot] for name, slot in zip(fleet.names, fleet.slots, strict=True)}
    }
    if any(fleet.leader_gain):
        formation["leader_gains"] = {name: [*fleet.leader_gain] for name in fleet.names}
    if any(fleet.neighbour_gain):
        formation["neighbour_gains"] = {
            name: {fleet.names[other]: [*fleet.neighbour_gain] for other in neighbours}
            for name, neighbours in zip(fleet.names, fleet.neighbour_indices, strict=True)
            if neighbours
        }
    return formation
