"""Write the reference of the scenario file from its JSON schema."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any

from testbed.scenario import json_schema

Schema = Mapping[str, Any]
HEADING = ("| key | type | default | unit | what it is |", "|---|---|---|---|---|")
# Units of keys for which the schema has none, by suffix of the key.
SUFFIXES = {
    "m": "m",
    "s": "s",
    "deg": "deg",
    "mps": "m/s",
    "mps2": "m/s²",
    "mps3": "m/s³",
    "radps": "rad/s",
    "radps2": "rad/s²",
    "dps": "deg/s",
    "pa": "Pa",
    "ppm": "ppm",
    "percent": "%",
}


def markdown() -> str:
    """Return a section for each top-level key, with one for each map in it."""
    schema = json_schema()
    places = paths(schema)
    text = ["## At the top of a scenario\n", table("", schema)]
    seen: set[str] = set()
    for key, part in schema["properties"].items():
        held = [name for name in reached(part, schema["$defs"]) if name not in seen]
        seen.update(held)
        if held:
            text.append(f"## {key}\n")
        for index, name in enumerate(held):
            definition = schema["$defs"][name]
            if index or name not in references(part):
                text.append(f"### {title(name, definition)} {{#{anchor(name)}}}\n")
            else:  # the top-level map itself, whose name is the heading
                text.append(f'<a id="{anchor(name)}"></a>\n')
            text.append(f"{definition.get('description', '')}\n")
            text.append("Written at " + ", ".join(f"`{place}`" for place in places[name]) + ".\n")
            if "properties" not in definition:  # a value with several forms
                text.append(f"Takes {cell(takes(definition))}.\n")
            text += [table(name, each) for each in maps(definition)]
    return "\n".join(text)


def title(name: str, definition: Schema) -> str:
    """Return the heading of a map: its kind, where there are several, or its name in words."""
    kind = definition.get("properties", {}).get("kind", {}).get("const")
    return f"kind: {kind}" if kind else words(name).capitalize()


def words(name: str) -> str:
    """Return the name of a map in words."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()


def anchor(name: str) -> str:
    """Return the anchor of the section of a map."""
    return words(name).replace(" ", "-")


def table(name: str, definition: Schema) -> str:
    """Return a table of the keys of one map."""
    rows = []
    for key, part in definition["properties"].items():
        mark = f"{anchor(name)}.{key}" if name else key
        cells = (takes(part), default(part), unit(key, part), part.get("description", ""))
        rows.append(f"| `{key}`{{#{mark}}} | " + " | ".join(map(cell, cells)) + " |")
    return "\n".join((*HEADING, *rows, ""))


def maps(definition: Schema) -> list[Schema]:
    """Return the definition if it has keys, or its alternatives that have."""
    forms = (definition, *definition.get("anyOf", ()), *definition.get("oneOf", ()))
    return [form for form in forms if "properties" in form]


def references(part: Any) -> Iterator[str]:  # noqa: ANN401 - nested plain data
    """Yield every map that a part of the schema names, not those inside them."""
    if isinstance(part, Mapping):
        if "$ref" in part:
            yield part["$ref"].rpartition("/")[2]
        for key, value in part.items():
            if key not in ("default", "discriminator"):
                yield from references(value)
    elif isinstance(part, list):
        for value in part:
            yield from references(value)


def reached(part: Any, definitions: Schema) -> list[str]:  # noqa: ANN401
    """Return every map that may occur below a key, in reading order."""
    found: list[str] = []

    def visit(below: Any) -> None:  # noqa: ANN401
        for name in references(below):
            if name not in found:
                found.append(name)
                visit(definitions[name])

    visit(part)
    return found


def paths(schema: Schema) -> Mapping[str, list[str]]:
    """Return where in a scenario each map may occur; `*` is any list element or any name."""
    found: dict[str, list[str]] = defaultdict(list)

    def visit(definition: Schema, path: tuple[str, ...]) -> None:
        for name, steps in placed(definition, path):
            place = ".".join(steps)
            if place not in found[name]:
                found[name].append(place)
                visit(schema["$defs"][name], steps)

    visit(schema, ())
    return found


def placed(part: Schema, path: tuple[str, ...]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the maps that a key takes, each with its path."""
    if "$ref" in part:
        yield part["$ref"].rpartition("/")[2], path
    for key in ("anyOf", "oneOf", "allOf"):
        for each in part.get(key, ()):
            yield from placed(each, path)
    for key, each in part.get("properties", {}).items():
        yield from placed(each, (*path, key))
    for each in (part.get("items"), named(part)):
        if isinstance(each, Mapping):
            yield from placed(each, (*path, "*"))


def named(part: Schema) -> Any:  # noqa: ANN401
    """Return the schema of the values of a map from names, if there is one."""
    held = part.get("additionalProperties")
    return held or next(iter(part.get("patternProperties", {}).values()), None)


def takes(part: Schema) -> str:
    """Return the allowed values in words."""
    if "$ref" in part:
        name = part["$ref"].rpartition("/")[2]
        return f"[{words(name)}](#{anchor(name)})"
    if "const" in part:
        return f"`{written(part['const'])}`"
    if "enum" in part:
        return ", ".join(f"`{written(value)}`" for value in part["enum"])
    for key in ("anyOf", "oneOf"):
        if key in part:
            return " or ".join(dict.fromkeys(map(takes, part[key])))
    return KINDS.get(part.get("type", ""), lambda _: "anything")(part)


def number(part: Schema) -> str:
    """Return a number type with its bounds."""
    kind = "whole number" if part["type"] == "integer" else "number"
    low, high = part.get("minimum"), part.get("maximum")
    above, below = part.get("exclusiveMinimum"), part.get("exclusiveMaximum")
    below = "2⁶³" if below == 2**63 else below
    bounds = [
        *([f"≥ {low}"] if low is not None else [f"> {above}"] if above is not None else []),
        *([f"≤ {high}"] if high is not None else [f"< {below}"] if below is not None else []),
    ]
    return " ".join((kind, ", ".join(bounds))).strip()


def array(part: Schema) -> str:
    """Return a list type, with the number of elements if it is fixed."""
    if "prefixItems" in part:
        kinds = list(dict.fromkeys(map(takes, part["prefixItems"])))
        return f"{len(part['prefixItems'])} × {' or '.join(kinds)}"
    low, high = part.get("minItems"), part.get("maxItems")
    inner = takes(part.get("items", {}))
    return f"{low} × {inner}" if low is not None and low == high else f"list of {inner}"


def mapping(part: Schema) -> str:
    """Return the type of a map from names."""
    inner = named(part)
    return f"by name: {takes(inner)}" if isinstance(inner, Mapping) else "map"


KINDS = {
    "number": number,
    "integer": number,
    "array": array,
    "object": mapping,
    "string": lambda part: "text",
    "boolean": lambda part: "`true`, `false`",
    "null": lambda part: "`null`",
}


def default(part: Schema) -> str:
    """Return the default; the keys of a map have their own defaults."""
    if "default" not in part:
        return ""
    value = part["default"]
    return "see&nbsp;there" if isinstance(value, Mapping) and value else f"`{written(value)}`"


def written(value: Any) -> str:  # noqa: ANN401
    """Return a value as it is written in a scenario."""
    return value if value and isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def unit(key: str, part: Any) -> str:  # noqa: ANN401
    """Return the unit of a number, or of the numbers in a list."""
    return stated_unit(part) or (SUFFIXES.get(key.rpartition("_")[2], "") if "_" in key else "")


def stated_unit(part: Any) -> str:  # noqa: ANN401
    """Return the unit that the schema states, or an empty text."""
    if isinstance(part, list):
        return next(filter(None, map(stated_unit, part)), "")
    if not isinstance(part, Mapping):
        return ""
    inner = (*(part.get(key) for key in ("anyOf", "oneOf", "items", "prefixItems")), named(part))
    return part.get("unit") or next(filter(None, map(stated_unit, inner)), "")


def cell(text: str) -> str:
    """Return text escaped for a table cell."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")
