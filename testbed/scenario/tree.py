"""Tree of a YAML file: values with their places, and the merge of two trees."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from testbed.scenario.problems import Place

Scalar = str | int | float | bool | None
Plain = Scalar | list["Plain"] | dict[str, "Plain"]


@dataclass(frozen=True, slots=True)
class Node:
    """A value and its place. Maps and lists hold nodes."""

    value: Scalar | tuple[Node, ...] | dict[str, Node]
    place: Place  # of the value
    key: Place  # of the key that names it; in a list, of the value
    folder: Path  # base of relative paths in the value


# Maps that differ in one of these keys do not merge.
_KIND_KEYS = ("kind", "example")
# Kind of a map without the key `kind`, by the key that holds the map.
_DEFAULT_KINDS = {"loss": "bernoulli"}
# A map under this key may change a preset: null in it is a value, and a name stands for the preset.
_WITH_PRESET = "sensors"
_PRESET = "preset"
# Keys of `scenario` that a file with another name does not inherit.
_BY_NAME = ("question", "expectation", "published")


def merge(base: Node, top: Node, name: str = "") -> Node:
    """Return `base` changed by `top`: maps merge deeply, lists and scalars are replaced.

    `name` is the key of both. A map of another `kind` (or `example`) replaces the old one. Null
    removes a key, so that its default holds.
    """
    if not (isinstance(base.value, dict) and isinstance(top.value, dict)):
        return top
    for kind in _KIND_KEYS:
        old, new = base.value.get(kind), top.value.get(kind)
        old_kind = old.value if old else _DEFAULT_KINDS.get(name)
        if old_kind and new and old_kind != new.value:
            return top
    merged = dict(base.value)
    for key, node in top.value.items():
        if node.value is None and null_removes(merged, key, name):
            del merged[key]
        else:
            merged[key] = merge(merged[key], node, key) if key in merged else node
    return replace(top, value=merged)


def inherit(base: Node, top: Node) -> Node:
    """Merge a file with the one it extends; a renamed scenario does not inherit its question.

    Nor the expectation and the published numbers.
    """
    old_header, new_header = _header(base), _header(top)
    old, new = old_header.get("name"), new_header.get("name")
    if new is None or (old is not None and old.value == new.value):
        return merge(base, top)
    # a key that the top file removes by null stays for the merge
    dropped = {k for k in _BY_NAME if k not in new_header or new_header[k].value is not None}
    rest = {key: node for key, node in old_header.items() if key not in dropped}
    assert isinstance(base.value, dict)
    below = {**base.value, "scenario": replace(base.value["scenario"], value=rest)}
    return merge(replace(base, value=below), top)


def _header(tree: Node) -> dict[str, Node]:
    """Return the map under `scenario`, or an empty one."""
    header = tree.value.get("scenario") if isinstance(tree.value, dict) else None
    return header.value if header and isinstance(header.value, dict) else {}


def null_removes(named: Mapping[str, Node], key: str, name: str) -> bool:
    """Return whether null removes a key from the map under `name`, or is its new value."""
    return key in named and not (name == _WITH_PRESET and _PRESET in named and key != _PRESET)


def expand_preset(node: Node, name: str) -> Node:
    """Return the value under `name` as a map, if it is the name of a preset."""
    if name != _WITH_PRESET or not isinstance(node.value, str):
        return node
    return replace(node, value={_PRESET: node})


def plant(value: Plain, place: Place) -> Node:
    """Return plain values as a tree whose nodes all have one place."""
    nodes: Scalar | tuple[Node, ...] | dict[str, Node]
    if isinstance(value, dict):
        nodes = {name: plant(child, place) for name, child in value.items()}
    elif isinstance(value, list):
        nodes = tuple(plant(child, place) for child in value)
    else:
        nodes = value
    return Node(nodes, place, place, Path())


def plain(node: Node) -> Plain:
    """Return the value without places: dicts, lists and scalars."""
    if isinstance(node.value, dict):
        return {name: plain(child) for name, child in node.value.items()}
    if isinstance(node.value, tuple):
        return [plain(child) for child in node.value]
    return node.value


def walk(node: Node, loc: tuple[str | int, ...]) -> tuple[Node, tuple[str, ...], tuple[str, ...]]:
    """Follow a location of pydantic through the tree; tags of unions in it are skipped.

    Returns:
        the deepest node that exists, the path to it, and the rest of the location: empty, or
        beginning with the key that is missing.
    """
    path: list[str] = []
    for index, part in enumerate(loc):
        name = str(part)
        if isinstance(node.value, dict):
            if name in node.value:
                node = node.value[name]
                path.append(name)
                continue
            if any(kind in node.value and node.value[kind].value == part for kind in _KIND_KEYS):
                continue
            if path and _DEFAULT_KINDS.get(path[-1]) == part:
                continue
            return node, tuple(path), tuple(str(rest) for rest in loc[index:])
        if isinstance(node.value, tuple) and isinstance(part, int) and part < len(node.value):
            node = node.value[part]
            path.append(name)
            continue
        break
    return node, tuple(path), ()
