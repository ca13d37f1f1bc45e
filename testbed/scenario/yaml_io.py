"""Trees of YAML files, with the place of each value: read, merge and write them.

The only module that imports yaml. Plain scalars follow YAML 1.2, in which `no` is text and `1e-2` a
number; in PyYAML's YAML 1.1 it is the other way round. Tags, merge keys and repeated keys are
errors.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from testbed.core.input_files import ReadError, read_bounded
from testbed.core.numbers import parse_number, parse_whole
from testbed.scenario.problems import FilePosition, Problem, ScenarioError

_MAX_NODES = 100_000
_MAX_DEPTH = 40
_MAX_NUMBER = 40  # characters

_BARE = re.compile(r"[A-Za-z0-9_./][\w./+-]*")  # text that needs no quotes
_NOT_FINITE = {".inf": "inf", "+.inf": "inf", "-.inf": "-inf", ".nan": "nan"}
_WORDS: dict[str, Scalar] = {"": None, "~": None, "null": None, "true": True, "false": False}


class _Reader(yaml.CSafeLoader):
    """PyYAML's C parser without rules for plain scalars; `_scalar` has them."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012 - PyYAML's own protocol


class _Writer(yaml.CSafeDumper):
    """PyYAML's C emitter: no anchors, flat lists on one line, quotes by YAML 1.2."""

    def ignore_aliases(self, data: object) -> bool:
        """Write repeated values in full."""
        return True

    def _list(self, data: list[Any]) -> yaml.Node:
        flow = not any(isinstance(item, list | dict) for item in data)
        return self.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=flow)

    def _text(self, data: str) -> yaml.Node:
        style = None if isinstance(_scalar(data), str) else '"'
        return self.represent_scalar("tag:yaml.org,2002:str", data, style=style)


_Writer.add_representer(list, _Writer._list)
_Writer.add_representer(str, _Writer._text)


def read(path: Path) -> Node:
    """Read the tree of a file.

    Raises:
        ScenarioError: it cannot be read, is not UTF-8, or not YAML.
    """
    return parse(*read_source(path))


def read_source(path: Path) -> tuple[str, str, Path]:
    """Return the arguments of `parse` for a file.

    Raises:
        ScenarioError: it cannot be read, or is not UTF-8.
    """
    source = _short(path)
    try:
        data = read_bounded(path)
    except ReadError as error:
        raise error_at(FilePosition(source), error.reason) from None
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise error_at(
            FilePosition(source, line, 1), "is not UTF-8 text (save the file as UTF-8)"
        ) from None
    return text, source, path.resolve().parent


def write(data: object) -> str:
    """Return plain data as YAML text that reads back as the same."""
    text: str = yaml.dump(data, Dumper=_Writer, sort_keys=False, allow_unicode=True, width=100)
    return text


def to_inline(value: object) -> str:
    """Return plain data as YAML on one line, exact to the last bit."""
    if isinstance(value, str) and _BARE.fullmatch(value) and isinstance(_scalar(value), str):
        return value
    if isinstance(value, float) and not math.isfinite(value):
        return f"{value:+}".replace("inf", ".inf").replace("+nan", ".nan")
    return json.dumps(value, ensure_ascii=False)


def _short(path: Path) -> str:
    """Return the path relative to the working directory, if it is below."""
    resolved = path.resolve()
    here = Path.cwd().resolve()
    return str(resolved.relative_to(here) if resolved.is_relative_to(here) else resolved)


def parse(text: str, source: str, folder: Path) -> Node:
    """Read the tree of a YAML text.

    Args:
        text: of the file.
        source: name of the file in errors.
        folder: base of relative paths in it.

    Raises:
        ScenarioError: it is not YAML, or has tags, merge keys or repeated keys.
    """
    try:
        _refuse_depth(text, source)
        root = yaml.compose(text, Loader=_Reader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = f"is not YAML: {error.problem or error.context}"
        if mark is not None and _begins_with_tab(text, mark.line):
            problem = "begins with a tab (indent with spaces; YAML allows no tabs there)"
        raise error_at(_place_of(source, mark), problem) from None
    except yaml.reader.ReaderError as error:
        before = text.encode()[: error.position].decode(errors="ignore")
        place = FilePosition(source, before.count("\n") + 1, len(before) - before.rfind("\n"))
        raise error_at(place, f"is not YAML: {str(error).splitlines()[0]}") from None
    if root is None:
        return Node(None, FilePosition(source, 1, 1), FilePosition(source, 1, 1), folder)
    return _Builder(source, folder).node(root, None, 0)


def _begins_with_tab(text: str, line: int) -> bool:
    """Return whether the indent of a line, counted from 0, has a tab."""
    lines = text.splitlines()
    indent = (
        lines[line][: len(lines[line]) - len(lines[line].lstrip())] if line < len(lines) else ""
    )
    return "\t" in indent


def _place_of(source: str, mark: Any) -> FilePosition:  # noqa: ANN401 - one of PyYAML's two classes
    return FilePosition(source, mark.line + 1, mark.column + 1) if mark else FilePosition(source)


def _refuse_depth(text: str, source: str) -> None:
    """Refuse a text so deep that PyYAML's C code would overflow the stack."""
    depth = 0
    for event in yaml.parse(text, Loader=_Reader):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > _MAX_DEPTH:
                raise error_at(
                    _place_of(source, event.start_mark),
                    f"is nested deeper than {_MAX_DEPTH} levels (write a flatter file)",
                )
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1


class _Builder:
    """Converts nodes of PyYAML, and counts them: an alias can stand for millions."""

    def __init__(self, source: str, folder: Path) -> None:
        self.source = source
        self.folder = folder
        self.count = 0

    def place(self, node: yaml.Node) -> FilePosition:
        return _place_of(self.source, node.start_mark)

    def node(self, node: yaml.Node, key: yaml.Node | None, depth: int) -> Node:
        self.count += 1
        place = self.place(node)
        if self.count > _MAX_NODES or depth > _MAX_DEPTH:
            raise error_at(place, "is too large or too deep (write a smaller file)")
        value: Scalar | tuple[Node, ...] | dict[str, Node]
        if isinstance(node, yaml.ScalarNode):
            self.refuse_tag(node, "tag:yaml.org,2002:str")
            value = _scalar(node.value) if not node.style else node.value
        elif isinstance(node, yaml.SequenceNode):
            self.refuse_tag(node, "tag:yaml.org,2002:seq")
            value = tuple(self.node(child, None, depth + 1) for child in node.value)
        else:
            self.refuse_tag(node, "tag:yaml.org,2002:map")
            value = self.map(node, depth)
        text = node.value if isinstance(node, yaml.ScalarNode) else ""
        return Node(value, place, self.place(key) if key else place, self.folder, text)

    def map(self, node: yaml.Node, depth: int) -> dict[str, Node]:
        children: dict[str, Node] = {}
        for key, child in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise error_at(self.place(key), "a key must be a word")
            if key.value == "<<" and not key.style:
                raise error_at(self.place(key), "merge keys are not read (write extends instead)")
            if key.value in children:
                first = children[key.value].key
                raise error_at(
                    self.place(key),
                    f"the key {key.value!r} is repeated, first in line {first.line} (write it "
                    "once)",
                )
            children[key.value] = self.node(child, key, depth + 1)
        return children

    def refuse_tag(self, node: yaml.Node, expected: str) -> None:
        if node.tag not in (expected, "!"):
            tag = node.tag.replace("tag:yaml.org,2002:", "!!")
            raise error_at(self.place(node), f"the tag {tag} is not read (leave it out)")


def _scalar(text: str) -> Scalar:
    """Return the value of a plain scalar by the core schema of YAML 1.2."""
    if text.lower() in _WORDS and text in (text.lower(), text.upper(), text.capitalize()):
        return _WORDS[text.lower()]
    if len(text) <= _MAX_NUMBER:
        if (whole := parse_whole(text)) is not None:
            return whole
        if (number := parse_number(text)) is not None:
            return number
    if text.lower() in _NOT_FINITE:
        return float(_NOT_FINITE[text.lower()])
    return text


def error_at(place: FilePosition, text: str, path: tuple[str, ...] = ()) -> ScenarioError:
    """Return an error with one problem."""
    return ScenarioError([Problem(place, text, path)])


Scalar = str | int | float | bool | None
Plain = Scalar | list["Plain"] | dict[str, "Plain"]


@dataclass(frozen=True, slots=True)
class Node:
    """A value and its place. Maps and lists hold nodes."""

    value: Scalar | tuple[Node, ...] | dict[str, Node]
    place: FilePosition  # of the value
    key: FilePosition  # of the key that names it; in a list, of the value
    folder: Path  # base of relative paths in the value
    text: str = field(default="", compare=False)  # of a scalar, as the file has it


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
    """Merge a file with the one it extends.

    A renamed scenario does not inherit the question, the expectation and the published numbers.
    """
    old_header, new_header = header_of(base), header_of(top)
    old, new = old_header.get("name"), new_header.get("name")
    if new is None or (old is not None and old.value == new.value):
        return merge(base, top)
    # a key that the top file removes by null stays for the merge
    dropped = {k for k in _BY_NAME if k not in new_header or new_header[k].value is not None}
    rest = {key: node for key, node in old_header.items() if key not in dropped}
    assert isinstance(base.value, dict)
    below = {**base.value, "scenario": replace(base.value["scenario"], value=rest)}
    return merge(replace(base, value=below), top)


def header_of(tree: Node) -> dict[str, Node]:
    """Return the map under `scenario`, or an empty one."""
    header = tree.value.get("scenario") if isinstance(tree.value, dict) else None
    return header.value if header and isinstance(header.value, dict) else {}


def null_removes(named: Mapping[str, Node], key: str, name: str) -> bool:
    """Return whether null removes a key of the map under `name`."""
    return key in named and not (name == _WITH_PRESET and _PRESET in named and key != _PRESET)


def expand_preset(node: Node, name: str) -> Node:
    """Return the value under `name` as a map, if it names a preset."""
    if name != _WITH_PRESET or not isinstance(node.value, str):
        return node
    return replace(node, value={_PRESET: node})


def plant(value: Plain, place: FilePosition) -> Node:
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
