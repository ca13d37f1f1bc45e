"""The only module that imports yaml: from the text of a page to a tree, and back to text.

Plain scalars are read by the rules of YAML 1.2, where `no` is a word and `1e-2` a number; PyYAML's
own rules of YAML 1.1 have it the other way round. Tags, merge keys and repeated keys are errors.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from testbed.scenario.explain import explain
from testbed.scenario.messages import Place, Problem, ScenarioError
from testbed.scenario.tree import Node, Scalar, plain

_MOST_BYTES = 1_000_000
_MOST_NODES = 100_000
_DEEPEST = 40

_WHOLE = re.compile(r"[-+]?[0-9]+")
_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_BARE = re.compile(r"[A-Za-z0-9_./][\w./+-]*")  # text that needs no quotes
_NOT_FINITE = {".inf": "inf", "+.inf": "inf", "-.inf": "-inf", ".nan": "nan"}
_WORDS: dict[str, Scalar] = {"": None, "~": None, "null": None, "true": True, "false": False}

ModelT = TypeVar("ModelT", bound=BaseModel)


class _Reader(yaml.CSafeLoader):
    """PyYAML's C parser with no rules for plain scalars: ours are below."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012 - PyYAML's own protocol


class _Writer(yaml.CSafeDumper):
    """PyYAML's C emitter: no anchors, flat lists on one line, quotes where we need them."""

    def ignore_aliases(self, data: object) -> bool:
        """Write every value out."""
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
    """Return the tree of a file.

    Raises:
        ScenarioError: it cannot be read, is no text, or no page.
    """
    source = _shown(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise stop(Place(source), f"cannot be read: {error.strerror}") from None
    if len(data) > _MOST_BYTES:
        raise stop(Place(source), f"is larger than {_MOST_BYTES:,} bytes: not a page")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise stop(Place(source, line, 1), "is not UTF-8 text (save the file as UTF-8)") from None
    return parse(text, source, path.resolve().parent)


def validated(tree: Node, model: type[ModelT], under: tuple[str, ...] = ()) -> ModelT:
    """Return the tree, which stands under these keys of a page, as a model.

    Raises:
        ScenarioError: with every problem found, each with its place.
    """
    try:
        return model.model_validate(plain(tree))
    except ValidationError as error:
        problems = explain(error, tree, model)
        raise ScenarioError([replace(one, path=under + one.path) for one in problems]) from None


def write(data: object) -> str:
    """Return plain data as YAML; it reads back as the same."""
    text: str = yaml.dump(data, Dumper=_Writer, sort_keys=False, allow_unicode=True, width=100)
    return text


def word(value: object) -> str:
    """Return plain data as YAML on one line; it reads back as the same, numbers to the last bit."""
    if isinstance(value, str) and _BARE.fullmatch(value) and isinstance(_scalar(value), str):
        return value
    if isinstance(value, float) and not math.isfinite(value):
        return f"{value:+}".replace("inf", ".inf").replace("+nan", ".nan")
    return json.dumps(value, ensure_ascii=False)


def _shown(path: Path) -> str:
    """Return the path as short as a reader here can use it."""
    resolved = path.resolve()
    here = Path.cwd().resolve()
    return str(resolved.relative_to(here) if resolved.is_relative_to(here) else resolved)


def parse(text: str, source: str, folder: Path) -> Node:
    """Return the tree of a YAML text.

    Args:
        text: the page.
        source: stands for the file's name in errors.
        folder: what relative paths in it are relative to.

    Raises:
        ScenarioError: it is not YAML, or not of the part of YAML that is read.
    """
    try:
        _refuse_depth(text, source)
        root = yaml.compose(text, Loader=_Reader)
    except yaml.MarkedYAMLError as error:
        place = _place(source, error.problem_mark or error.context_mark)
        raise stop(place, f"is not YAML: {error.problem or error.context}") from None
    except yaml.YAMLError as error:
        raise stop(Place(source), f"is not YAML: {str(error).splitlines()[0]}") from None
    if root is None:
        return Node(None, Place(source, 1, 1), Place(source, 1, 1), folder)
    return _Builder(source, folder).node(root, None, 0)


def _place(source: str, mark: Any) -> Place:  # noqa: ANN401 - one of PyYAML's two classes
    return Place(source, mark.line + 1, mark.column + 1) if mark else Place(source)


def _refuse_depth(text: str, source: str) -> None:
    """Stop before PyYAML composes a text so deep that its C code would overflow the stack."""
    depth = 0
    for event in yaml.parse(text, Loader=_Reader):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > _DEEPEST:
                raise stop(_place(source, event.start_mark), "is too deep")
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1


class _Builder:
    """Turns PyYAML's nodes into ours, counting them: an alias can stand for millions."""

    def __init__(self, source: str, folder: Path) -> None:
        self.source = source
        self.folder = folder
        self.count = 0

    def place(self, node: yaml.Node) -> Place:
        return _place(self.source, node.start_mark)

    def node(self, node: yaml.Node, key: yaml.Node | None, depth: int) -> Node:
        self.count += 1
        place = self.place(node)
        if self.count > _MOST_NODES or depth > _DEEPEST:
            raise stop(place, "the page is too large or too deep")
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
        return Node(value, place, self.place(key) if key else place, self.folder)

    def map(self, node: yaml.Node, depth: int) -> dict[str, Node]:
        children: dict[str, Node] = {}
        for key, child in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise stop(self.place(key), "a key must be a word")
            if key.value == "<<" and not key.style:
                raise stop(self.place(key), "merge keys are not read (write extends instead)")
            if key.value in children:
                first = children[key.value].key
                raise stop(
                    self.place(key),
                    f"the key {key.value!r} is here twice, first in line {first.line} (write it "
                    "once)",
                )
            children[key.value] = self.node(child, key, depth + 1)
        return children

    def refuse_tag(self, node: yaml.Node, expected: str) -> None:
        if node.tag not in (expected, "!"):
            tag = node.tag.replace("tag:yaml.org,2002:", "!!")
            raise stop(self.place(node), f"the tag {tag} is not read (leave it out)")


def _scalar(text: str) -> Scalar:
    """Return what a plain scalar means by the core schema of YAML 1.2."""
    if text.lower() in _WORDS and text in (text.lower(), text.upper(), text.capitalize()):
        return _WORDS[text.lower()]
    if len(text) <= 40:
        if _WHOLE.fullmatch(text):
            return int(text)
        if _NUMBER.fullmatch(text):
            return float(text)
    if text.lower() in _NOT_FINITE:
        return float(_NOT_FINITE[text.lower()])
    return text


def stop(place: Place, text: str, path: tuple[str, ...] = ()) -> ScenarioError:
    """Return the error that says this of a place."""
    return ScenarioError([Problem(place, text, path)])
