"""Write the reference of modules, classes and functions from their docstrings.

The source is read, not imported. A page asks for a name by a line `::: testbed.Simulation`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import griffe
from comments import Comments

ROOT = Path(__file__).parents[1]
WIDTH = 90  # of a signature on one line
TITLES = {
    "parameters": "Arguments",
    "attributes": "Attributes",
    "returns": "Returns",
    "yields": "Yields",
    "raises": "Raises",
}


@cache
def package(name: str) -> griffe.Object:
    """Return a package of the repository with all that is in it."""
    loaded = griffe.load(
        name,
        search_paths=[ROOT],
        allow_inspection=False,
        extensions=griffe.load_extensions(Comments),
    )
    assert isinstance(loaded, griffe.Object)
    return loaded


def markdown(path: str) -> str:
    """Return the section of a name, under a third-level heading, or the sections of a module.

    Args:
        path: of a module, class or function, with dots.

    Raises:
        KeyError: there is no such name.
    """
    first, _, rest = path.partition(".")
    found = package(first)[rest] if rest else package(first)
    found = found.final_target if found.is_alias else found
    if found.is_module:
        head = f'<a id="{path}"></a>Module `{path}`.\n'
        return "\n".join((head, *text_of(found), *members(found, path, 3)))
    return "\n".join(section(found, path, 3))


def section(found: griffe.Object, path: str, level: int) -> Iterator[str]:
    """Yield heading, signature, docstring and public members."""
    owner = found.parent if level > 3 else None
    name = f"{owner.name}.{found.name}" if owner is not None and owner.is_class else found.name
    yield f"{'#' * level} `{name}` {{#{path}}}\n"
    yield f"```python\n{signature(found)}\n```\n"
    yield from text_of(found)
    if found.is_class:
        yield from members(found, path, level + 1)


def members(found: griffe.Object, path: str, level: int) -> Iterator[str]:
    """Yield the sections of public members that have a docstring, in the order of the source."""
    for name, member in found.members.items():
        if not (name.startswith("_") or member.is_alias or member.is_module):
            assert isinstance(member, griffe.Object)
            if member.has_docstring:
                yield from section(member, f"{path}.{name}", level)


def signature(found: griffe.Object) -> str:
    """Return how a function is called, a class made, or an attribute declared."""
    if isinstance(found, griffe.Attribute):
        return found.name + (f": {found.annotation}" if found.annotation else "")
    parameters = found.parameters if isinstance(found, griffe.Function | griffe.Class) else ()
    returned = found.annotation if isinstance(found, griffe.Function) else None
    end = f") -> {returned}" if returned else ")"
    written = list(arguments(parameters))
    line = f"{found.name}({', '.join(written)}{end}"
    if len(line) <= WIDTH:
        return line
    return "\n".join((f"{found.name}(", *(f"    {each}," for each in written), end))


def arguments(parameters: Iterable[griffe.Parameter]) -> Iterator[str]:
    """Yield the parameters of a signature, without `self`, with the marks / and *."""
    kinds = griffe.ParameterKind
    before = None
    named_only = False
    for each in parameters:
        if each.name in ("self", "cls"):
            continue
        if before is kinds.positional_only and each.kind is not before:
            yield "/"
        if each.kind is kinds.keyword_only and not named_only:
            yield "*"
        named_only |= each.kind in (kinds.keyword_only, kinds.var_positional)
        stars = {kinds.var_positional: "*", kinds.var_keyword: "**"}.get(each.kind, "")
        text = stars + each.name + (f": {each.annotation}" if each.annotation else "")
        if each.default is not None and not stars:
            text += f" = {each.default}" if each.annotation else f"={each.default}"
        yield text
        before = each.kind
    if before is kinds.positional_only:
        yield "/"


def text_of(found: griffe.Object) -> Iterator[str]:
    """Yield the docstring, its lists of arguments, results and errors as lists of Markdown."""
    if found.docstring is None:
        return
    for part in found.docstring.parse(
        "google", returns_multiple_items=False, returns_named_value=False
    ):
        kind = part.kind.value
        if kind == "text":
            yield f"{part.value}\n"
        else:
            yield f"**{TITLES[kind]}**\n"
            yield from (item(each) for each in part.value)
            yield ""


def item(each: Any) -> str:  # noqa: ANN401 - one class of griffe for each kind of section
    """Return a list item: name, type and default as code, then the description."""
    name, kind, value = (getattr(each, key, None) for key in ("name", "annotation", "value"))
    default = f", default `{value}`" if value else ""
    head = f"`{name}`" if name else f"`{kind}`"
    if name and kind:
        head += f" (`{kind}`{default})"
    description = " ".join(each.description.split())
    return f"- {head}: {escaped(description)}"


def escaped(text: str) -> str:
    """Return text in which `<` outside code begins no HTML."""
    parts = text.split("`")
    return "`".join(p if i % 2 else p.replace("<", "&lt;") for i, p in enumerate(parts))
