"""References of a section: the texts in it that name files, folders, code or other scenarios.

The type of a field that names such a thing contains a mark, `RefersTo`. There is no list of keys:
what needs the references of a scenario walks through it with `references`.
"""

import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Annotated, Any, Literal, NamedTuple, get_args

from pydantic import BaseModel, Field

from testbed.scenario.fields import KeyPath

ReferenceKind = Literal["aircraft", "tune", "scenario", "data", "gains", "code"]
BUILT_IN = "hbh23"  # the law of the paper, which is no file


@dataclass(frozen=True, slots=True)
class RefersTo:
    """Mark of a type whose texts name something outside of the scenario."""

    kind: ReferenceKind


AircraftReference = Annotated[str, Field(min_length=1), RefersTo("aircraft")]
"""A name in aircraft/, or the path of a folder."""
TuneReference = Annotated[str, Field(min_length=1), RefersTo("tune")]
"""`<tune>.param` of the aircraft in the same section, or the path of a file."""
ScenarioReference = Annotated[str, Field(min_length=1), RefersTo("scenario")]
"""A name of a scenario, or the path of its file."""
DataReference = Annotated[str, Field(min_length=1), RefersTo("data")]
"""A name in scenarios/data, or the path of a CSV file."""
GainsReference = Annotated[str, Field(min_length=1), RefersTo("gains")]
"""The path of a file like middle_loop.yaml."""
CODE = RefersTo("code")
"""Mark of `module:name`, or of the name of a law of the library."""


class Reference(NamedTuple):
    """A text of a section that names something.

    Args:
        loc: its keys, as a file has them.
        kind: of what it names.
        name: the text.
        aircraft: of a tune: the aircraft that it is for; else empty.
    """

    loc: KeyPath
    kind: ReferenceKind
    name: str
    aircraft: str = ""


def references(section: BaseModel) -> Iterator[Reference]:
    """Yield all references in a section and those below it, in the order of their fields."""
    yield from _of_section(section, ())


def kinds_of_keys(model: type[BaseModel]) -> dict[str, ReferenceKind]:
    """Return the kind of reference of every key that may have one, in a section or below it.

    Keys of one name have the same kind.
    """
    found: dict[str, ReferenceKind] = {}
    for each in sections_of(model):
        for field in _fields(each):
            if field.kind is not None:
                found[field.key] = field.kind
    return found


def sections_of(model: type[BaseModel]) -> list[type[BaseModel]]:
    """Return a section and all those that may be in it, at any depth."""
    found = {model: None}
    queue = [model]
    while queue:
        for field in queue.pop().model_fields.values():
            new = [part for part in _parts_of(field) if isinstance(part, type)]
            queue += [part for part in new if part not in found]
            found |= dict.fromkeys(new)
    return list(found)


class _ReferenceField(NamedTuple):
    """A field that has references, or sections that may have some."""

    name: str
    key: str  # in a file
    kind: ReferenceKind | None  # of the texts of the field itself


def _of_section(section: BaseModel, loc: KeyPath) -> Iterator[Reference]:
    for field in _fields(type(section)):
        value = getattr(section, field.name)
        yield from _of_value(section, value, (*loc, field.key), field.kind)


def _of_value(
    section: BaseModel,
    value: Any,  # noqa: ANN401 - of any field
    loc: KeyPath,
    kind: ReferenceKind | None,
) -> Iterator[Reference]:
    if isinstance(value, BaseModel):
        yield from _of_section(value, loc)
    elif isinstance(value, Mapping):
        for key, each in value.items():
            yield from _of_value(section, each, (*loc, key), kind)
    elif isinstance(value, list | tuple):
        for index, each in enumerate(value):
            yield from _of_value(section, each, (*loc, index), kind)
    elif isinstance(value, str) and kind is not None and (kind != "code" or value != BUILT_IN):
        aircraft = section.aircraft if kind == "tune" else ""  # type: ignore[attr-defined]
        yield Reference(loc, kind, value, aircraft)


@functools.cache
def _fields(model: type[BaseModel]) -> tuple[_ReferenceField, ...]:
    """Return the fields of a section that can have references; most have none."""
    found = []
    for name, field in model.model_fields.items():
        parts = list(_parts_of(field))
        kind = next((part.kind for part in parts if isinstance(part, RefersTo)), None)
        below = any(isinstance(part, type) and _fields(part) for part in parts)
        if kind is not None or below:
            found.append(_ReferenceField(name, field.alias or name, kind))
    return tuple(found)


def _parts_of(field: Any) -> Iterator[RefersTo | type[BaseModel]]:  # noqa: ANN401 - FieldInfo
    """Yield the marks and the sections in the type of a field."""
    yield from chain.from_iterable(map(_parts, (field.annotation, *field.metadata)))


def _parts(annotation: Any) -> Iterator[RefersTo | type[BaseModel]]:  # noqa: ANN401 - a type
    if isinstance(annotation, RefersTo) or (
        isinstance(annotation, type) and issubclass(annotation, BaseModel)
    ):
        yield annotation
    else:
        yield from chain.from_iterable(map(_parts, get_args(annotation)))
