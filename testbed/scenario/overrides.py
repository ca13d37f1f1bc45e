"""Changes to a page from the command line: `--set key.path=value`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from testbed.scenario.messages import Place, Problem, ScenarioError, did_you_mean
from testbed.scenario.tree import Node, spelt_out, takes_away

Parse = Callable[[str, str, Path], Node]
_LINKS = ("network", "links")  # whose maps, by sender and by receiver, have a key '*' for the rest


def override(tree: Node, text: str, parse: Parse) -> Node:
    """Return the page with one value changed.

    The key is a dotted path; in a list it counts from 0 or gives an element's `name`, and `*`
    stands for every element of a list or map; of network.links also for the page's own '*', so
    that it is every link. A key that is not on the page is added, so that defaults can be changed;
    whether the schema knows it is seen when the page is checked. A value of null takes a key away.
    A key inside sensors that are a name changes that preset.

    Args:
        tree: the page.
        text: `key.path=value`, the value in YAML.
        parse: reads YAML: text, name of the source and folder to a tree.

    Raises:
        ScenarioError: the text is not of that form, or the key leads nowhere.
    """
    source = f"--set {text}"
    key, equals, value = text.partition("=")
    parts = tuple(key.strip().split("."))
    if not equals or not all(parts):
        raise _stop(source, (), "is not key.path=value (write for example rates.log_hz=50)")
    try:
        node = parse(value, source, Path.cwd())
    except ScenarioError as error:
        raise _stop(source, parts, error.problems[0].text) from None
    return _set(tree, parts, (), _nowhere(node, Place(source)), source)


def _nowhere(node: Node, place: Place) -> Node:
    """Give every part of a value the option itself as its place: it has no line."""
    value = node.value
    if isinstance(value, dict):
        value = {name: _nowhere(child, place) for name, child in value.items()}
    elif isinstance(value, tuple):
        value = tuple(_nowhere(child, place) for child in value)
    return Node(value, place, place, node.folder)


def _set(node: Node, parts: tuple[str, ...], done: tuple[str, ...], new: Node, source: str) -> Node:
    if not parts:
        return new
    part, rest = parts[0], parts[1:]
    under = done[-1] if done else ""
    node = spelt_out(node, under)
    if isinstance(node.value, tuple):
        children = list(node.value)
        for index in _indices(node.value, part, done, source):
            at = (*done, str(index))
            children[index] = _set(children[index], rest, at, new, source)
        return replace(node, value=tuple(children))
    if isinstance(node.value, dict) or node.value is None:
        named = dict(node.value or {})
        for name in _keys(named, part, done, source):
            child = named.get(name, Node(None, new.place, new.place, new.folder))
            if not rest and new.value is None and takes_away(named, name, under):
                del named[name]
            else:
                named[name] = _set(child, rest, (*done, name), new, source)
        return replace(node, value=named)
    raise _stop(source, done, f"is {node.value!r}, which has no {part!r} inside")


def _keys(named: dict[str, Node], part: str, done: tuple[str, ...], source: str) -> tuple[str, ...]:
    if part != "*":
        return (part,)
    if done[:2] == _LINKS and len(done) < len(_LINKS) + 2:
        return tuple(dict.fromkeys((*named, "*")))
    if not named:
        raise _stop(source, done, "is empty: * has nothing to stand for")
    return tuple(named)


def _indices(
    items: tuple[Node, ...], part: str, done: tuple[str, ...], source: str
) -> tuple[int, ...]:
    if part == "*":
        return tuple(range(len(items)))
    if part.isdecimal() and int(part) < len(items):
        return (int(part),)
    names = [
        item.value["name"].value if isinstance(item.value, dict) and "name" in item.value else None
        for item in items
    ]
    if part in names:
        return (names.index(part),)
    known = [name for name in names if isinstance(name, str)]
    wanted = f"0 to {len(items) - 1}" if items else "nothing: it is empty"
    raise _stop(
        source,
        done,
        f"has no element {part!r}{did_you_mean(part, known)} (it has "
        f"{', '.join([wanted, *known])}; * is all of them)",
    )


def _stop(source: str, path: tuple[str, ...], text: str) -> ScenarioError:
    return ScenarioError([Problem(Place(source), text, path)])
