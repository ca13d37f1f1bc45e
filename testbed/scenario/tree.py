"""A page as it was written: values that know their place, merged without losing it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from testbed.scenario.messages import Place

Scalar = str | int | float | bool | None
Plain = Scalar | list["Plain"] | dict[str, "Plain"]


@dataclass(frozen=True, slots=True)
class Node:
    """A value and where it stands. Maps and lists hold nodes."""

    value: Scalar | tuple[Node, ...] | dict[str, Node]
    place: Place  # of the value
    key: Place  # of the key that names it; of the value itself in a list
    folder: Path  # what a relative path in it is relative to


# A map whose key of this name differs is another kind of thing: nothing of the old one is kept.
_KINDS = ("kind", "example")
# By key, what kind a map is that says none.
_UNSAID = {"loss": "bernoulli"}
# A map under this key may say which set of values it changes: null in it is then a value, as is a
# name in its place all of the set.
_CHANGED = "sensors"
_SET = "like"
# What a page says of the experiment of its name.
_OF_ITS_NAME = ("question", "expectation", "published")


def merge(base: Node, top: Node, name: str = "") -> Node:
    """Return `base` changed by `top`: maps merge deeply, everything else is replaced.

    `name` is the key they are under. Two maps of different `kind` (or `example`) do not merge: the
    new one replaces the old. A key whose new value is null is taken away, which leaves its
    default, if it has one.
    """
    if not (isinstance(base.value, dict) and isinstance(top.value, dict)):
        return top
    for kind in _KINDS:
        old, new = base.value.get(kind), top.value.get(kind)
        was = old.value if old else _UNSAID.get(name)
        if was and new and was != new.value:
            return top
    merged = dict(base.value)
    for key, node in top.value.items():
        if node.value is None and takes_away(merged, key, name):
            del merged[key]
        else:
            merged[key] = merge(merged[key], node, key) if key in merged else node
    return replace(top, value=merged)


def inherit(base: Node, top: Node) -> Node:
    """Return a page merged with the one it extends, less what is true of that one's name alone.

    Question, expectation and published numbers of an experiment are none of another's.
    """
    header, own = (_header(page) for page in (base, top))
    old, new = header.get("name"), own.get("name")
    if new is None or (old is not None and old.value == new.value):
        return merge(base, top)
    # what the page takes away by null stays until then
    gone = {key for key in _OF_ITS_NAME if key not in own or own[key].value is not None}
    kept = {key: node for key, node in header.items() if key not in gone}
    assert isinstance(base.value, dict)
    below = {**base.value, "scenario": replace(base.value["scenario"], value=kept)}
    return merge(replace(base, value=below), top)


def _header(page: Node) -> dict[str, Node]:
    """Return what is under `scenario`, if that is a map."""
    header = page.value.get("scenario") if isinstance(page.value, dict) else None
    return header.value if header and isinstance(header.value, dict) else {}


def takes_away(named: Mapping[str, Node], key: str, name: str) -> bool:
    """Tell whether null takes a key out of the map under `name`, or is the value it then has."""
    return key in named and not (name == _CHANGED and _SET in named and key != _SET)


def spelt_out(node: Node, name: str) -> Node:
    """Return what is under `name` as a map, if it is the name of a set of values."""
    if name != _CHANGED or not isinstance(node.value, str):
        return node
    return replace(node, value={_SET: node})


def planted(value: Plain, place: Place) -> Node:
    """Return bare values as a tree that stands at one place."""
    grown: Scalar | tuple[Node, ...] | dict[str, Node]
    if isinstance(value, dict):
        grown = {name: planted(child, place) for name, child in value.items()}
    elif isinstance(value, list):
        grown = tuple(planted(child, place) for child in value)
    else:
        grown = value
    return Node(grown, place, place, Path())


def plain(node: Node) -> Plain:
    """Return the bare value: dicts, lists and scalars."""
    if isinstance(node.value, dict):
        return {name: plain(child) for name, child in node.value.items()}
    if isinstance(node.value, tuple):
        return [plain(child) for child in node.value]
    return node.value


def walk(node: Node, loc: tuple[str | int, ...]) -> tuple[Node, tuple[str, ...], tuple[str, ...]]:
    """Follow a pydantic location through the page.

    Returns:
        The deepest node that exists, the path to it, and what of the location is left: nothing,
        or the key that is missing. Tags of unions, which pydantic puts into a location, are
        skipped.
    """
    path: list[str] = []
    for index, part in enumerate(loc):
        name = str(part)
        if isinstance(node.value, dict):
            if name in node.value:
                node = node.value[name]
                path.append(name)
                continue
            if any(kind in node.value and node.value[kind].value == part for kind in _KINDS):
                continue
            if path and _UNSAID.get(path[-1]) == part:
                continue
            return node, tuple(path), tuple(str(rest) for rest in loc[index:])
        if isinstance(node.value, tuple) and isinstance(part, int) and part < len(node.value):
            node = node.value[part]
            path.append(name)
            continue
        break
    return node, tuple(path), ()
