"""A pattern written out: the list of aircraft, the offsets and the gains that it stands for."""

from __future__ import annotations

from dataclasses import replace

from testbed.scenario.aircraft import Craft
from testbed.scenario.pattern import Pattern
from testbed.scenario.tree import Node, Plain, merge, planted
from testbed.scenario.yaml_door import validated

FLEET, FORMATION = "fleet", "formation"
# What of the formation is told of followers by name.
_BY_NAME = ("offsets_m", "altitudes_m", "leader_gains", "neighbour_gains", "agents")


def of_pattern(key: str) -> bool:
    """Whether a dotted key is the fleet's or its pattern's, and not that of one aircraft in it."""
    first, *rest = key.strip().split(".")
    return first == FLEET and (not rest or rest[0] in Pattern.model_fields)


def spread(page: Node) -> Node:
    """The page with the list in the place of a pattern; what it says of the formation stays.

    What is written out stands where the pattern does, for whoever says that it is wrong.

    Raises:
        ScenarioError: with every problem of the pattern, each with its place.
    """
    said = _under(page, FLEET)
    if said is None or not isinstance(said.value, dict):
        return page
    fleet = validated(said, Pattern, under=(FLEET,))
    assert isinstance(page.value, dict)
    formation = planted(_formation(fleet), said.place)
    own = _under(page, FORMATION)
    return replace(
        page,
        value=page.value
        | {
            FLEET: replace(said, value=_crafts(fleet, said)),
            FORMATION: merge(formation, own) if own else formation,
        },
    )


def give_way(page: Node, other: Node) -> Node:
    """The page without what it tells by name of the aircraft of a list, if a pattern replaces that.

    Names of the one may be names of the other, which are in other slots.
    """
    old, new, formation = _under(page, FLEET), _under(other, FLEET), _under(page, FORMATION)
    if not (old and new and isinstance(old.value, tuple) and isinstance(new.value, dict)):
        return page
    if not (isinstance(page.value, dict) and formation and isinstance(formation.value, dict)):
        return page
    kept = {key: node for key, node in formation.value.items() if key not in _BY_NAME}
    return replace(page, value=page.value | {FORMATION: replace(formation, value=kept)})


def _under(page: Node, key: str) -> Node | None:
    return page.value.get(key) if isinstance(page.value, dict) else None


def _crafts(fleet: Pattern, said: Node) -> tuple[Node, ...]:
    """The aircraft as a list: what all have, and over it what is one's own."""
    assert isinstance(said.value, dict)
    common = {key: node for key, node in said.value.items() if key in Craft.model_fields}
    agents = _under(said, "agents")
    crafts = []
    for name, (forward, right, down) in zip(fleet.names, fleet.slots, strict=True):
        start: Plain = [forward - fleet.start_behind_m, right, down]
        fresh = {
            key: planted(value, said.place) for key, value in (("name", name), ("start_m", start))
        }
        craft = replace(said, value=common | fresh)
        own = _under(agents, name) if agents else None
        crafts.append(merge(craft, own) if own else craft)
    return tuple(crafts)


def _formation(fleet: Pattern) -> Plain:
    """Offsets, and the gains that are not zero, by name."""
    formation: dict[str, Plain] = {
        "offsets_m": {name: [*slot] for name, slot in zip(fleet.names, fleet.slots, strict=True)}
    }
    if any(fleet.leader_gain):
        formation["leader_gains"] = {name: [*fleet.leader_gain] for name in fleet.names}
    if any(fleet.neighbour_gain):
        formation["neighbour_gains"] = {
            name: {fleet.names[other]: [*fleet.neighbour_gain] for other in heeded}
            for name, heeded in zip(fleet.names, fleet.heeded, strict=True)
            if heeded
        }
    return formation
