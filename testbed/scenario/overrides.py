"""Settings from the command line and from studies: `key.path=value`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from testbed.scenario.problems import Place, Problem, ScenarioError, did_you_mean
from testbed.scenario.tree import Node, expand_preset, null_removes
from testbed.scenario.yaml_io import parse

_LINKS = ("network", "links")  # its maps, by sender and by receiver, have a key '*' for the rest


@dataclass(frozen=True, slots=True)
class Setting:
    """One change of a scenario.

    Args:
        text: as written, `key.path=value`.
        keys: of the path.
        value: every node of it has the setting as its place.
    """

    text: str
    keys: tuple[str, ...]
    value: Node

    @property
    def source(self) -> str:
        """Return what stands for the name of a file in errors."""
        return f"--set {self.text}"

    @property
    def tree(self) -> Node:
        """Return the value under its keys, as a scenario with nothing else."""
        node = self.value
        for key in reversed(self.keys):
            node = replace(node, value={key: node})
        return node


def parse_setting(text: str) -> Setting:
    """Read `key.path=value`, the value in YAML.

    Raises:
        ScenarioError: the text is not of that form.
    """
    key, equals, value = text.partition("=")
    keys = tuple(key.strip().split("."))
    source = f"--set {text}"
    if not text.isprintable() and any("\ud800" <= each <= "\udfff" for each in text):
        raise _error(source, (), "is not UTF-8 text (write it in UTF-8)")
    if not equals or not all(keys):
        raise _error(source, (), "is not key.path=value (write for example rates.log_hz=50)")
    try:
        node = parse(value, source, Path.cwd())
    except ScenarioError as error:
        raise _error(source, keys, error.problems[0].text) from None
    return Setting(text, keys, _placed(node, Place(source)))


def override(tree: Node, setting: Setting) -> Node:
    """Return the scenario with one value changed.

    In a list a key is an index from 0 or the `name` of an element, and `*` is every element of a
    list or map; below network.links it is every link. A key that the file leaves out is added.
    Null removes a key. A key inside sensors that are the name of a preset changes that preset.

    Raises:
        ScenarioError: the keys lead nowhere.
    """
    return _set(tree, setting.keys, (), setting)


def _placed(node: Node, place: Place) -> Node:
    """Give every node of a value one place: a setting has no lines."""
    value = node.value
    if isinstance(value, dict):
        value = {name: _placed(child, place) for name, child in value.items()}
    elif isinstance(value, tuple):
        value = tuple(_placed(child, place) for child in value)
    return Node(value, place, place, node.folder)


def _set(node: Node, keys: tuple[str, ...], done: tuple[str, ...], setting: Setting) -> Node:
    if not keys:
        return setting.value
    key, rest = keys[0], keys[1:]
    parent = done[-1] if done else ""
    node = expand_preset(node, parent)
    if isinstance(node.value, tuple):
        children = list(node.value)
        for index in _indices(node.value, key, done, setting):
            children[index] = _set(children[index], rest, (*done, str(index)), setting)
        return replace(node, value=tuple(children))
    if isinstance(node.value, dict) or node.value is None:
        named = dict(node.value or {})
        new = setting.value
        for name in _names(named, key, done, setting):
            child = named.get(name, Node(None, new.place, new.place, new.folder))
            if not rest and new.value is None and null_removes(named, name, parent):
                del named[name]
            else:
                named[name] = _set(child, rest, (*done, name), setting)
        return replace(node, value=named)
    raise _error(setting.source, done, f"is {node.value!r}, which has no {key!r} inside")


def _names(
    named: dict[str, Node], key: str, done: tuple[str, ...], setting: Setting
) -> tuple[str, ...]:
    if key != "*":
        return (key,)
    if done[:2] == _LINKS and len(done) < len(_LINKS) + 2:
        return tuple(dict.fromkeys((*named, "*")))
    if not named:
        raise _error(setting.source, done, "is empty: * stands for nothing")
    return tuple(named)


def _indices(
    items: tuple[Node, ...], key: str, done: tuple[str, ...], setting: Setting
) -> tuple[int, ...]:
    if key == "*":
        return tuple(range(len(items)))
    if key.isdecimal() and int(key) < len(items):
        return (int(key),)
    names = [
        item.value["name"].value if isinstance(item.value, dict) and "name" in item.value else None
        for item in items
    ]
    if key in names:
        return (names.index(key),)
    known = [name for name in names if isinstance(name, str)]
    indices = f"0 to {len(items) - 1}" if items else "nothing: it is empty"
    raise _error(
        setting.source,
        done,
        f"has no element {key!r}{did_you_mean(key, known)} (it has "
        f"{', '.join([indices, *known])}; * is all of them)",
    )


def _error(source: str, path: tuple[str, ...], text: str) -> ScenarioError:
    return ScenarioError([Problem(Place(source), text, path)])
