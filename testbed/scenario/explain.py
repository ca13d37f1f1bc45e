"""Pydantic's errors in the words of the page: where it is, what is wrong, what to write instead."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ValidationError

from testbed.scenario.messages import Place, Problem, did_you_mean
from testbed.scenario.tree import Node, Plain, plain, walk

_NOT_TYPED = {
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
_MAPS = {"$ref", "properties", "discriminator"}  # of a schema, one of these in a map's
_BOUNDS = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
}
# What a page that extends another may have from it, and may be wrong of its own flight.
_OF_HEADER = (("scenario", "portions"), ("scenario", "published"))


def explain(error: ValidationError, tree: Node, model: type[BaseModel]) -> list[Problem]:
    """Return what is wrong with the page, in the order of its text."""
    schema = _schema(model)
    problems: list[Problem] = []
    for detail in error.errors(include_url=False):
        if detail["type"] == "cross":
            problems += [_problem(tree, loc, text) for loc, text in detail["ctx"]["problems"]]
        elif not (detail["type"] == "too_short" and _has_enough(detail, tree)):
            problems.append(_one(detail, tree, schema))
    unique: dict[tuple[str, ...], Problem] = {}
    for problem in problems:  # a list that is too short is said once, not per missing element
        unique.setdefault(problem.path, problem)
    return sorted(unique.values(), key=lambda p: _reading_order(p.place))


@functools.cache
def _schema(model: type[BaseModel]) -> dict[str, Any]:
    """The schema of a page, which takes a while to make; many pages may be wrong in one study."""
    return model.model_json_schema(by_alias=True)


def _reading_order(place: Place | None) -> tuple[str, int, int]:
    return (place.source, place.line, place.column) if place else ("", 0, 0)


def _has_enough(detail: Mapping[str, Any], tree: Node) -> bool:
    """Tell whether a list is "too short" only because its elements are wrong, as is said there."""
    node, _, _ = walk(tree, detail["loc"])
    return isinstance(node.value, tuple | dict) and len(node.value) >= detail["ctx"]["min_length"]


def _problem(tree: Node, loc: tuple[str | int, ...], text: str) -> Problem:
    node, path, left = walk(tree, loc)
    place = node.key if left else node.place
    hint, there = _inherited(tree, path, place)
    return Problem(there or place, text + hint, path + left[:1])


def _inherited(tree: Node, path: tuple[str, ...], place: Place) -> tuple[str, Place | None]:
    """Return how to be rid of what another page or a longer run left in the header, and where.

    A portion, or a published number of one, is wrong where `duration_s` or the portions are, not
    where it was written.
    """
    asked, _, _ = walk(tree, ("scenario", "duration_s"))
    by_option = asked.place.source.startswith("--set")
    if path[:2] == ("scenario", "portions") and by_option:
        out = f"; to leave it out write --set {'.'.join(path)}=null; --duration ends portions, too"
        return out, None
    if path[:2] not in _OF_HEADER or place.source == tree.place.source:
        return "", None
    key, under = (path[2], "portions") if path[1] == "portions" else ("published", "scenario")
    there = asked.place if asked.place.source == tree.place.source else tree.place
    return f"; it is inherited from {place}: write {key}: null under {under} to leave it out", there


def _one(detail: Mapping[str, Any], tree: Node, schema: dict[str, Any]) -> Problem:
    kind, loc, context = detail["type"], detail["loc"], detail.get("ctx", {})
    node, path, left = walk(tree, loc)
    place = node.place
    if kind == "missing" and not left:  # of a fixed-length list
        parent, path, _ = walk(tree, loc[:-1])
        return Problem(parent.place, _length(parent, path, tree, schema), path)
    known = _known_keys(schema, tree, path[:-1] if kind == "extra_forbidden" else path)
    if kind == "missing":
        path += left[:1]
        place = node.key
        text = f"is missing{_write(f'{path[-1]}: ...', _about(schema, tree, path))}"
    elif kind == "extra_forbidden":
        place = node.key
        hint = did_you_mean(path[-1], known)
        text = f"is not a key of this part{hint} (write one of {', '.join(known)})"
    elif kind in ("union_tag_not_found", "union_tag_invalid"):
        tag = context["discriminator"].strip("'")
        path += (tag,) if isinstance(node.value, dict) else ()
        # a word may stand for the map of its kind
        value = node.value.get(tag) if isinstance(node.value, dict) else node
        said = "is missing" if value is None else f"is {_shown(value)}"
        place = value.place if value else node.key
        tags = context.get("expected_tags", "").replace("'", "") or ", ".join(
            _tags(_at(schema, tree, path[: len(path) - isinstance(node.value, dict)], follow=False))
        )
        near = did_you_mean(str(value.value), tags.split(", ")) if value else ""
        text = f"{said}{near} (write one of {tags})"
    elif kind in _NOT_TYPED:
        advice = _advice(node, kind) or _write(_NOT_TYPED[kind], _about(schema, tree, path))
        text = f"is {_shown(node)}{advice}"
    elif kind in _BOUNDS:
        limit, word = _BOUNDS[kind]
        text = f"is {_shown(node)} (write a number {word} {context[limit]:g})"
    elif kind == "literal_error":
        expected = context["expected"].replace("'", "")
        near = did_you_mean(str(node.value), expected.replace(" or ", ", ").split(", "))
        text = f"is {_shown(node)}{near} (write {expected})"
    elif kind in ("too_short", "too_long"):
        text = _length(node, path, tree, schema)
    elif kind == "string_pattern_mismatch":
        said = "is no name" if "[key]" in loc else f"is {_shown(node)}"
        text = f"{said} (write letters, digits, '-', '_' and '.', no blanks)"
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
    least, most = here.get("minItems"), here.get("maxItems")
    wanted = f"at least {least}" if most is None else str(most)
    return f"has {count} elements{_write(wanted, _about(schema, tree, path))}"


def _advice(node: Node, kind: str) -> str:
    """Explain what looks right and is not: YAML 1.1 habits and quotes."""
    if not isinstance(node.value, str):
        return ""
    word = node.value.strip()
    if kind == "bool_type" and word.lower() in ("yes", "on", "y"):
        return " (write true)"
    if kind == "bool_type" and word.lower() in ("no", "off", "n"):
        return " (write false)"
    if kind in ("float_type", "int_type"):
        bare = word.replace("_", "").replace(" ", "")
        try:
            float(bare)
        except ValueError:
            return ""
        return f" (write {bare}, without quotes, blanks or underscores)"
    return ""


def _shown(node: Node) -> str:
    if isinstance(node.value, dict):
        return "a map"
    if isinstance(node.value, tuple):
        return "a list"
    if node.value is None:
        return "empty"
    if isinstance(node.value, bool):
        return str(node.value).lower()
    if isinstance(node.value, str):
        text = node.value
        return repr(text if len(text) <= 60 else text[:57] + "...")
    return f"{node.value:.12g}" if isinstance(node.value, float) else str(node.value)


def _write(what: str, description: str) -> str:
    return f" (write {what}; {description.rstrip('.')})" if description else f" (write {what})"


def _about(schema: dict[str, Any], tree: Node, path: tuple[str, ...]) -> str:
    """Return the description of the field at or above a path, which says its unit."""
    for end in range(len(path), 0, -1):
        here = _at(schema, tree, path[:end], follow=False)
        text = here.get("description") or _at(schema, tree, path[:end]).get("description")
        if text:
            return str(text)
    return ""


def _known_keys(schema: dict[str, Any], tree: Node, path: tuple[str, ...]) -> list[str]:
    return list(_at(schema, tree, path).get("properties", {}))


def _at(
    schema: dict[str, Any], tree: Node, path: tuple[str, ...], *, follow: bool = True
) -> dict[str, Any]:
    """Return the JSON schema of the part of the page at a path, or {} where it has none."""
    here = schema
    page: Plain = plain(tree)
    for part in path:
        here = _follow(schema, here, page)
        if isinstance(page, list):
            items = here.get("items") or {}
            here = items or (here.get("prefixItems") or [{}])[0]
            page = page[int(part)] if int(part) < len(page) else None
        else:
            named = here.get("patternProperties") or {"": here.get("additionalProperties")}
            rest = next(iter(named.values()))
            here = here.get("properties", {}).get(part) or (rest if isinstance(rest, dict) else {})
            page = page.get(part) if isinstance(page, dict) else None
    return _follow(schema, here, page) if follow else here


def _follow(schema: dict[str, Any], here: dict[str, Any], page: Plain) -> dict[str, Any]:
    """Resolve references and unions, the latter by the page's own tag."""
    while True:
        if "$ref" in here:
            here = schema["$defs"][here["$ref"].rsplit("/", 1)[1]]
        elif "discriminator" in here:
            rule = here["discriminator"]
            tag = page.get(rule["propertyName"]) if isinstance(page, dict) else None
            tag = _unsaid(schema, rule) if tag is None else str(tag)
            if tag not in rule["mapping"]:
                return {"properties": dict.fromkeys(rule["mapping"], {})}
            here = {"$ref": rule["mapping"][tag]}
        elif "anyOf" in here and "properties" not in here:
            maps = [choice for choice in here["anyOf"] if _MAPS & choice.keys()]
            lists = [choice for choice in here["anyOf"] if choice.get("type") == "array"]
            if isinstance(page, list) and len(lists) == 1:
                here = lists[0]
            elif maps:
                here = maps[0]
            else:
                return here
        else:
            return here


def _tags(here: dict[str, Any]) -> list[str]:
    """Return the tags of a union, or of that among some choices."""
    for choice in (here, *here.get("anyOf", ())):
        if "discriminator" in choice:
            return list(choice["discriminator"]["mapping"])
    return []


def _unsaid(schema: dict[str, Any], rule: Mapping[str, Any]) -> str:
    """Return the tag of a union's map that says none: one that is a default, or nothing."""
    for tag, reference in rule["mapping"].items():
        choice = _follow(schema, {"$ref": reference}, None)
        if "default" in choice["properties"][rule["propertyName"]]:
            return str(tag)
    return ""
