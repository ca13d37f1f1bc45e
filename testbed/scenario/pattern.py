"""A fleet that is a pattern: who flies in which slot, and who heeds whom."""

import math
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from testbed.scenario.aircraft import Craft
from testbed.scenario.fields import Gain, Metres, Name, Whole, refuse
from testbed.scenario.messages import did_you_mean

Kind = Literal["vee", "line-abreast", "column", "echelon-left", "echelon-right", "grid"]
Slot = tuple[float, float, float]
Finding = tuple[tuple[str | int, ...], str]
# What of the spacing a pattern has no use for: its place, the word for it, and who has it.
_IDLE = {"line-abreast": (0, "behind", "vee"), "column": (1, "beside", "echelon-right")}
_SPACING_M = {"line-abreast": (0.0, 10.0, 0.0), "column": (10.0, 0.0, 0.0)}


class Pattern(Craft):
    """A fleet of like aircraft in a pattern, which is read as the list that it stands for."""

    name: Name = Field("uav", description="What the names begin with: uav1, uav2 and so on.")
    pattern: Kind = Field(
        description="vee: ranks behind the leader, right and left in turn; line-abreast: the same "
        "beside it; column; echelon-left, echelon-right; or grid: rows, as square as it goes."
    )
    count: Annotated[Whole, Field(ge=1, le=255)] = Field(
        description="How many followers there are, a number."
    )
    spacing_m: tuple[Metres, Metres, Metres] | None = Field(
        None,
        description="From each to the next [behind, beside, below], m; by default 10 behind and "
        "10 beside where the pattern has that.",
    )
    start_behind_m: Metres = Field(
        20.0, description="All start this far behind their slots, m; a negative number is ahead."
    )
    neighbours: Annotated[Whole, Field(ge=0)] = Field(
        2, description="How many others each heeds, those with the nearest slots; a number."
    )
    among: Literal["all", "ahead"] = Field(
        "all", description="Of whom: of all; or of those ahead, which have lower numbers."
    )
    leader_gain: Gain = Field((1.0, 1.0, 1.0), description="formation.leader_gains of everyone.")
    neighbour_gain: Gain = Field(
        (1.0, 1.0, 1.0), description="formation.neighbour_gains for whom it heeds."
    )
    agents: Mapping[Name, Mapping[Name, Any]] = Field(
        {}, description="By follower, what of an aircraft's keys is different for it."
    )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the followers, in order."""
        return tuple(f"{self.name}{number}" for number in range(1, self.count + 1))

    @cached_property
    def slots(self) -> tuple[Slot, ...]:
        """Slots [forward, right, down] of the leader, m, in the order of the names."""
        behind, beside, below = self.spacing_m or _SPACING_M.get(self.pattern, (10.0, 10.0, 0.0))
        steps = (_steps(self.pattern, index, self.count) for index in range(self.count))
        return tuple(
            (0.0 - back * behind, aside * beside, down * below) for back, aside, down in steps
        )

    @property
    def heeded(self) -> tuple[tuple[int, ...], ...]:
        """Whom each heeds, the nearest first, and of two that are as near the first in order."""
        everyone = range(self.count)
        ahead = self.among == "ahead"
        return tuple(
            tuple(self._by_distance(index, range(index) if ahead else everyone)[: self.neighbours])
            for index in everyone
        )

    def _by_distance(self, index: int, others: range) -> list[int]:
        slots = self.slots

        def distance(other: int) -> float:
            return round(
                math.dist(slots[index], slots[other]), 6
            )  # rounding alone is no difference

        return sorted((other for other in others if other != index), key=distance)

    @model_validator(mode="after")
    def _check(self) -> Self:
        refuse((*_spaced(self), *_strangers(self)))
        return self


def _steps(pattern: Kind, index: int, count: int) -> tuple[float, float, float]:
    """Steps [behind, beside, below] from the leader to one of `count` followers, from 0."""
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
        row, place = divmod(index, width)
        abreast = min(width, count - row * width)
        return row + 1, place - (abreast - 1) / 2, row + 1
    return rank, rank if pattern == "echelon-right" else -rank, rank


def _spaced(fleet: Pattern) -> Iterator[Finding]:
    """Whether the spacing is of the pattern, and leaves everyone a place of its own."""
    at = ("spacing_m",)
    if fleet.spacing_m is not None and fleet.pattern in _IDLE:
        place, word, other = _IDLE[fleet.pattern]
        if fleet.spacing_m[place]:
            text = f"has {fleet.spacing_m[place]:g} m {word}, where a {fleet.pattern} has nobody"
            yield (*at, place), f"{text} (write 0, or pattern: {other})"
            return
    taken: dict[tuple[float, ...], str] = {(0.0, 0.0, 0.0): "the leader"}
    for name, slot in zip(fleet.names, fleet.slots, strict=True):
        near = tuple(round(each, 1) + 0.0 for each in slot)
        if near in taken:
            text = f"puts {name} where {taken[near]} is (write [behind, beside, below] in m)"
            yield at, text
            return
        taken[near] = name


def _strangers(fleet: Pattern) -> Iterator[Finding]:
    """Whether those that are different are there."""
    for name in fleet.agents:
        if name not in fleet.names:
            hint = did_you_mean(name, fleet.names)
            everyone = f"{fleet.names[0]} to {fleet.names[-1]}"
            yield ("agents", name), f"no follower has this name{hint} (the fleet has {everyone})"
