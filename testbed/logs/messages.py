"""Topics of a log and their fields, of which writer, reader, exports and schemas are made.

A topic has columns: the fields of records of a `Sample` that are annotated with `Logged`, in their
order there. A log also has Foxglove's own messages: `/tf`, `/tf_static`, `/<aircraft>/fix` and
`/events`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntFlag
from functools import cache
from typing import Any, get_origin, get_type_hints

from testbed.core.flags import flag_names
from testbed.core.identifiers import identifiers
from testbed.core.records import AXES, Sample, logged_fields

LOG_SCHEMA = 6  # raised when a topic or field is renamed, removed, required or of another meaning

DOUBLE, FIXED32, BOOL = "double", "fixed32", "bool"  # protobuf types
_TYPES = {"f8": DOUBLE, "u1": FIXED32, "u4": FIXED32, "?": BOOL}


@dataclass(frozen=True, slots=True)
class Column:
    """One array of a sample, aircraft or followers on its leading axis, as message fields."""

    source: str  # path from Sample: "truth.position_ned"
    names: tuple[str, ...]  # one field for each component
    dtype: str  # of a component in a sample
    per_aircraft: bool  # one field, a message with a value by the name of each aircraft
    default_source: str | None = None  # the column whose values hold where nothing was written
    bits: type[IntFlag] | None = None  # what its bits are; None: it is a number

    @property
    def type(self) -> str:
        """Protobuf type of a field."""
        return _TYPES[self.dtype]


@dataclass(frozen=True, slots=True, eq=False)  # hashed by identity, at every chunk
class Topic:
    """Messages `/<aircraft>/<name>`: one for each aircraft, or follower, and sample."""

    name: str
    followers_only: bool
    columns: tuple[Column, ...]

    @property
    def message_type(self) -> str:
        """Full protobuf name: testbed.EstimatedError."""
        return "testbed." + self.name.title().replace("_", "")

    @property
    def fields(self) -> tuple[tuple[str, Column], ...]:
        """Field names with their columns, in the order of the field numbers from 1 on."""
        return tuple((name, column) for column in self.columns for name in column.names)


def aircraft_fields(names: Sequence[str]) -> dict[str, int]:
    """Number the fields of a message with a value for each aircraft.

    The numbers are those whose tags have the same length: 2 bytes up to 2032 aircraft.
    """
    first = 16 if len(names) <= 2032 else 2048
    return {name: first + k for k, name in enumerate(identifiers(names))}


# The record of each field of `Sample`.
RECORDS: Mapping[str, Any] = {
    name: get_origin(hint) or hint for name, hint in get_type_hints(Sample).items()
}


_logged_fields = cache(logged_fields)  # reading annotations takes a while


def _column(source: str, default_source: str | None = None) -> Column:
    """Make the column of a field that is annotated with `Logged`; its path is from `Sample`."""
    record, _, field = source.rpartition(".")
    dtype, logged = _logged_fields(RECORDS[record] if record else Sample)[field]
    more = logged.per_aircraft, default_source, logged.bits
    return Column(source, logged.names, dtype, *more)


def _columns(record: str) -> tuple[Column, ...]:
    return tuple(_column(f"{record}.{field}") for field in _logged_fields(RECORDS[record]))


STATE = Topic(
    "state",
    followers_only=False,
    columns=(*_columns("truth"), *_columns("air"), *_columns("surfaces"), _column("lost")),
)
# Written only in chunks in which an estimate differs from the true state.
ESTIMATE = Topic(
    "estimate",
    followers_only=False,
    columns=tuple(
        replace(column, default_source=column.source.replace("estimate", "truth"))
        for column in _columns("estimate")
    ),
)
COMMAND = Topic("command", followers_only=False, columns=_columns("command"))
# The formation error computed from the estimates. Written only in chunks in which it differs from
# the true error.
ESTIMATED_ERROR = Topic(
    "estimated_error",
    followers_only=True,
    columns=(_column("formation.estimated_error_ned", "formation.error_ned"),),
)
FORMATION = Topic(
    "formation",
    followers_only=True,
    columns=tuple(
        column
        for column in _columns("formation")
        if column.names != ESTIMATED_ERROR.columns[0].names
    ),
)
# Message counts since the start on the links to a follower, by sender. Written from the chunk with
# the first lost message on.
NETWORK = Topic("network", followers_only=True, columns=_columns("links"))
TOPICS = (STATE, ESTIMATE, COMMAND, FORMATION, ESTIMATED_ERROR, NETWORK)


@cache
def topics_of(law_numbers: tuple[str, ...]) -> tuple[Topic, ...]:
    """Return the topics of a log, with `law` where a user's law logs numbers of these names."""
    if not law_numbers:
        return TOPICS
    numbers = Column("law", law_numbers, "f8", per_aircraft=False)
    return *TOPICS, Topic("law", followers_only=True, columns=(numbers,))


# The last word of a name is its unit; other names are dimensionless.
UNITS: Mapping[str, str] = {
    "m": "m",
    "mps": "m/s",
    "mps2": "m/s²",
    "rad": "rad",
    "radps": "rad/s",
    "rps": "1/s",
    "s": "s",
    "v": "V",
}


@dataclass(frozen=True, slots=True)
class Quantity:
    """A field of the log: a number per sample and aircraft, or pair."""

    name: str  # topic and field of the log: formation_error_north_m
    topic: Topic
    field: str  # error_north_m
    unit: str  # "" if dimensionless
    source: str  # path from a sample, or a log with K samples
    component: int | None  # of the array's last axis; None: all of it
    followers_only: bool  # the leader has no value
    per_aircraft: bool  # a value about every aircraft, (K, N, N)
    integer: bool  # a count, an index or a set of bits
    bits: type[IntFlag] | None  # what its bits are; None: it is a number

    @property
    def flag_attributes(self) -> dict[str, str]:
        """Masks and names of its bits, as the CF conventions have them; empty: it is a number."""
        if self.bits is None:
            return {}
        masks = " ".join(str(int(flag)) for flag in self.bits)
        return {"flag_masks": masks, "flag_meanings": " ".join(flag_names(self.bits))}

    def of(self, array: Any) -> Any:  # noqa: ANN401 - an array of any type
        """Return the values in the array of the source."""
        return array if self.component is None else array[..., self.component]

    def columns(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Name the table columns: one, or one for each aircraft, before the unit."""
        if not self.per_aircraft:
            return (self.name,)
        stem, _, unit = self.name.rpartition("_")
        return tuple(f"{stem}_{name}_{unit}" for name in names)


def _unit(field: str) -> str:
    """Return the unit of a field; an index or an axis behind it names the number of a vector."""
    words = field.split("_")
    last = words[-2] if len(words) > 1 and (words[-1].isdigit() or words[-1] in AXES) else words[-1]
    return UNITS.get(last, "")


def _quantities(topic: Topic) -> Iterator[Quantity]:
    for column in topic.columns:
        for i, field in enumerate(column.names):
            prefixed = field.startswith(f"{topic.name}_")
            yield Quantity(
                name=field if prefixed else f"{topic.name}_{field}",
                topic=topic,
                field=field,
                unit=_unit(field),
                source=column.source,
                component=i if len(column.names) > 1 else None,
                followers_only=topic.followers_only,
                per_aircraft=column.per_aircraft,
                integer=column.type == FIXED32,
                bits=column.bits,
            )


@cache
def quantities_of(law_numbers: tuple[str, ...]) -> Mapping[str, Quantity]:
    """Return the quantities of a log by name; see `topics_of`."""
    topics = topics_of(law_numbers)
    return {each.name: each for topic in topics for each in _quantities(topic)}


QUANTITIES = quantities_of(())  # of each log
