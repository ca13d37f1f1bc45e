"""Validate a tree as a pydantic model; explain its errors with places."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from testbed.core.numbers import SMALLEST, parse_number
from testbed.scenario.problems import FilePosition, Problem, ScenarioError, did_you_mean
from testbed.scenario.yaml_io import Node, plain, walk

_TYPES = {
    "float_type": "a number",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "string_type": "text",
    "tuple_type": "a list",
    "mapping_type": "a map of keys and values",
    "model_type": "a map of keys and values",
    "model_attributes_type": "a map of keys and values",
    "dict_type": "a map of keys and values",
}
_MAP_KEYS = {"$ref", "properties", "discriminator"}  # in the JSON schema of a map
_BOUNDS = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
}
_PERCENT = re.compile(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*%\s*", re.ASCII)
_MAX_SHOWN = 60  # characters of a value
# Keys of the header that a file inherits and that may not fit its own duration.
_INHERITED = (("scenario", "windows"), ("scenario", "published"))


ModelT = TypeVar("ModelT", bound=BaseModel)


def validate(tree: Node, model: type[ModelT], under: tuple[str, ...] = ()) -> ModelT:
    """Validate a tree as a pydantic model.

    Args:
        tree: of a file or a part of one.
        model: class of the result.
        under: keys of that part, for errors.

    Raises:
        ScenarioError: with every problem found, each with its place.
    """
    try:
        return model.model_validate(plain(tree))
    except ValidationError as error:
        problems = explain(error, tree, model)
        raise ScenarioError([replace(one, path=under + one.path) for one in problems]) from None


def explain(error: ValidationError, tree: Node, model: type[BaseModel]) -> list[Problem]:
    """Return the problems behind an error of pydantic, in the order of the text."""
    schema = _schema(model)
    problems: list[Problem] = []
    for detail in error.errors(include_url=False):
        if detail["type"] == "cross":
            problems += [_problem(tree, loc, text) for loc, text in detail["ctx"]["problems"]]
        elif not (detail["type"] == "too_short" and _has_enough(detail, tree)):
            problems.append(_one(detail, tree, schema))
    unique: dict[tuple[str, ...], Problem] = {}
    for problem in problems:  # a short list is one problem, not one per missing element
        unique.setdefault(problem.path, problem)
    return sorted(unique.values(), key=lambda p: _reading_order(p.place))


@functools.cache
def _schema(model: type[BaseModel]) -> dict[str, Any]:
    """Return the JSON schema of a model, cached: a study may validate thousands of scenarios."""
    return model.model_json_schema(by_alias=True)


def _reading_order(place: FilePosition | None) -> tuple[str, int, int]:
    return (place.source, place.line, place.column) if place else ("", 0, 0)


def _has_enough(detail: Mapping[str, Any], tree: Node) -> bool:
    """Return whether a list is "too short" only because some of its elements are wrong."""
    node, _, _ = walk(tree, detail["loc"])
    return isinstance(node.value, tuple | dict) and len(node.value) >= detail["ctx"]["min_length"]


def _problem(tree: Node, loc: tuple[str | int, ...], text: str) -> Problem:
    node, path, left = walk(tree, loc)
    place = node.key if left else node.place
    hint, other_place = _inherited(tree, path, place)
    return Problem(other_place or place, text + hint, path + left[:1])


def _inherited(
    tree: Node, path: tuple[str, ...], place: FilePosition
) -> tuple[str, FilePosition | None]:
    """Return remedy and place for a key of the header that is inherited.

    A window or a published number that does not fit is reported where `duration_s` or the windows
    are set, not where the inherited value is.
    """
    duration, _, _ = walk(tree, ("scenario", "duration_s"))
    by_option = duration.place.source.startswith("--set")
    if path[:2] == ("scenario", "windows") and by_option:
        remedy = f"; write --set {'.'.join(path)}=null, or --duration, which also ends windows"
        return remedy, None
    if path[:2] not in _INHERITED or place.source == tree.place.source:
        return "", None
    key, under = (path[2], "windows") if path[1] == "windows" else ("published", "scenario")
    here = duration.place if duration.place.source == tree.place.source else tree.place
    return f"; it is inherited from {place}: write {key}: null under {under} to remove it", here


def _one(detail: Mapping[str, Any], tree: Node, schema: dict[str, Any]) -> Problem:
    kind, loc, context = detail["type"], detail["loc"], detail.get("ctx", {})
    node, path, left = walk(tree, loc)
    place = node.place
    if kind == "missing" and not left:
        parent, path, _ = walk(tree, loc[:-1])
        if not isinstance(parent.value, tuple):  # a key with the name of a kind
            remedy = _write(f"{loc[-1]}: ...", _about(schema, tree, path[:-1]))
            return Problem(parent.key, f"is not a key of this section{remedy}", path)
        # of a fixed-length list
        return Problem(parent.place, _length(parent, path, tree, schema), path)
    if kind == "missing":
        path += left[:1]
        place = node.key
        text = f"is missing{_write(f'{path[-1]}: ...', _about(schema, tree, path))}"
    elif kind == "extra_forbidden":
        place = node.key
        known = list(_at(schema, tree, path[:-1]).get("properties", {}))
        hint = did_you_mean(path[-1], known)
        text = f"is not a key of this section{hint} (write one of {', '.join(known)})"
    elif kind in ("union_tag_not_found", "union_tag_invalid"):
        tag = context["discriminator"].strip("'")
        path += (tag,) if isinstance(node.value, dict) else ()
        # a word can stand for the map of its kind
        value = node.value.get(tag) if isinstance(node.value, dict) else node
        text = "is missing" if value is None else f"is {_shown(value)}"
        place = value.place if value else node.key
        tags = context.get("expected_tags", "").replace("'", "") or ", ".join(
            _tags(_at(schema, tree, path[: len(path) - isinstance(node.value, dict)], follow=False))
        )
        near = did_you_mean(str(value.value), tags.split(", ")) if value else ""
        text = f"{text}{near} (write one of {tags})"
    elif kind in _TYPES:
        about = _about(schema, tree, path)
        advice = _advice(node, kind, about) or _write(_TYPES[kind], about)
        shown = _shown(node)
        if kind == "int_type" and isinstance(node.value, float) and node.value.is_integer():
            shown = node.text or repr(node.value)
            advice = _write(f"{node.value:.0f}, a whole number", about)
        # of a whole file, which may be no scenario at all, nothing is quoted
        text = f"is {shown if path else _kind(node)}{advice}"
    elif kind in _BOUNDS:
        limit, word = _BOUNDS[kind]
        bound, number = context[limit], node.value
        if bound == SMALLEST and isinstance(number, int | float) and number <= 0:
            word, bound = "above", 0
        remedy = f"write a number {word} {bound:g}"
        if word == "at most" and context[limit] == 1 and isinstance(number, int | float):
            remedy += f"; {number:g} % is {number / 100:g}" if 5 <= number <= 100 else ""
        if reason := _at(schema, tree, path).get("reason"):
            remedy += f": {reason}"
        text = f"is {_shown(node)} ({remedy})"
    elif kind == "literal_error":
        expected = context["expected"].replace("'", "")
        near = did_you_mean(str(node.value), expected.replace(" or ", ", ").split(", "))
        text = f"is {_shown(node)}{near} (write {expected})"
    elif kind in ("too_short", "too_long"):
        text = _length(node, path, tree, schema)
    elif kind == "string_pattern_mismatch":
        text = "is not a name" if "[key]" in loc else f"is {_shown(node)}"
        text = f"{text} (write letters, digits, '-', '_' and '.', no spaces)"
    elif kind == "string_unicode":
        text = f"is {_shown(node)}, not UTF-8 text"
    elif kind == "finite_number":
        text = f"is {_shown(node)} (write a finite number)"
    else:
        text = detail["msg"]
    if "[key]" in loc:
        place = node.key
    return Problem(place, text, path)


def _length(node: Node, path: tuple[str, ...], tree: Node, schema: dict[str, Any]) -> str:
    here = _at(schema, tree, path)
    count = len(node.value) if isinstance(node.value, tuple | dict) else 0
    low = here.get("minItems", here.get("minProperties"))
    high = here.get("maxItems", here.get("maxProperties"))
    if low is None and high is None:
        return f"has {count} elements"
    wanted = f"at least {low}" if count < (low or 0) or high is None else f"at most {high}"
    if low == high:
        wanted = str(high)
    return f"has {count} elements{_write(wanted, _about(schema, tree, path))}"


def _advice(node: Node, kind: str, about: str) -> str:
    """Return the remedy for YAML 1.1 booleans, quoted numbers, percentages and map or number."""
    number_or_map = " or a map" in about
    if isinstance(node.value, str) and (percent := _PERCENT.fullmatch(node.value)):
        if number_or_map or "0 to 1" in about:
            return f" (write {float(percent[1]) / 100:g})"
    if number_or_map:
        what = about.partition(": ")[2] or about
        return f" (write {what.rstrip('.')})"
    if not isinstance(node.value, str):
        return ""
    word = node.value.strip()
    if kind == "bool_type" and word.lower() in ("yes", "on", "y"):
        return " (write true)"
    if kind == "bool_type" and word.lower() in ("no", "off", "n"):
        return " (write false)"
    if kind in ("float_type", "int_type"):
        bare = word.replace("_", "").replace(" ", "")
        if parse_number(bare) is None:
            return ""
        return f" (write {bare}, without quotes, spaces or underscores)"
    return ""


def _kind(node: Node) -> str:
    """Name the kind of a value, without the value."""
    kinds = (("a map", dict), ("a list", tuple), ("text", str), ("true or false", bool))
    if node.value is None:
        return "empty"
    return next((name for name, kind in kinds if isinstance(node.value, kind)), "a number")


def _shown(node: Node) -> str:
    if isinstance(node.value, dict | tuple) or node.value is None:
        return _kind(node)
    if isinstance(node.value, bool):
        return str(node.value).lower()
    if isinstance(node.value, float):
        return f"{node.value:.12g}"
    return shown_value(node.value)


def shown_value(value: object) -> str:
    """Return a value as an error shows it, shortened."""
    if isinstance(value, str):
        return repr(value if len(value) <= _MAX_SHOWN else f"{value[: _MAX_SHOWN - 3]}...")
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # a number of thousands of digits
        text = f"a {type(value).__name__}"
    return text if len(text) <= _MAX_SHOWN else f"{text[: _MAX_SHOWN - 3]}..."


def _write(what: str, description: str) -> str:
    return f" (write {what}; {description.rstrip('.')})" if description else f" (write {what})"


def _about(schema: dict[str, Any], tree: Node, path: tuple[str, ...]) -> str:
    """Return the description, with the unit, of the field at or above a path."""
    for end in range(len(path), 0, -1):
        here = _at(schema, tree, path[:end], follow=False)
        text = here.get("description") or _at(schema, tree, path[:end]).get("description")
        if text:
            return str(text)
    return ""


def _at(
    schema: dict[str, Any], tree: Node, path: tuple[str, ...], *, follow: bool = True
) -> dict[str, Any]:
    """Return the JSON schema at a path of the file, or {}."""
    here = schema
    node: Node | None = tree
    for part in path:
        here = _follow(schema, here, node)
        value = node.value if node else None
        if isinstance(value, tuple):
            items = here.get("items") or {}
            here = items or (here.get("prefixItems") or [{}])[0]
            node = value[int(part)] if int(part) < len(value) else None
        else:
            named = here.get("patternProperties") or {"": here.get("additionalProperties")}
            rest = next(iter(named.values()))
            here = here.get("properties", {}).get(part) or (rest if isinstance(rest, dict) else {})
            node = value.get(part) if isinstance(value, dict) else None
    return _follow(schema, here, node) if follow else here


def _follow(schema: dict[str, Any], here: dict[str, Any], node: Node | None) -> dict[str, Any]:
    """Resolve references, and unions by the tag in the value."""
    value = node.value if node else None
    while True:
        if "$ref" in here:
            here = schema["$defs"][here["$ref"].rsplit("/", 1)[1]]
        elif "discriminator" in here:
            rule = here["discriminator"]
            named = value.get(rule["propertyName"]) if isinstance(value, dict) else None
            tag_value = named.value if named else None
            tag = _default_tag(schema, rule) if tag_value is None else str(tag_value)
            if tag not in rule["mapping"]:
                return {"properties": dict.fromkeys(rule["mapping"], {})}
            here = {"$ref": rule["mapping"][tag]}
        elif "anyOf" in here and "properties" not in here:
            maps = [choice for choice in here["anyOf"] if _MAP_KEYS & choice.keys()]
            lists = [choice for choice in here["anyOf"] if choice.get("type") == "array"]
            if isinstance(value, tuple) and len(lists) == 1:
                here = lists[0]
            elif maps:
                here = maps[0]
            else:
                return here
        else:
            return here


def _tags(here: dict[str, Any]) -> list[str]:
    """Return the tags of a union, or of the union among some choices."""
    for choice in (here, *here.get("anyOf", ())):
        if "discriminator" in choice:
            return list(choice["discriminator"]["mapping"])
    return []


def _default_tag(schema: dict[str, Any], rule: Mapping[str, Any]) -> str:
    """Return the tag of a union that is a default, or ""."""
    for tag, reference in rule["mapping"].items():
        choice = _follow(schema, {"$ref": reference}, None)
        if "default" in choice["properties"][rule["propertyName"]]:
            return str(tag)
    return ""
