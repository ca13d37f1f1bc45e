"""The only module that imports pyarrow: runs as tables, for Parquet, CSV and pandas; and studies.

A table has one row for each frame and aircraft, in order of time and then of the run's names.
What is about each aircraft is a column for every aircraft, named before the unit:
`formation_age_leader_s`. Where there is no number a cell is null: empty in CSV.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
import pyarrow as arrow
from pyarrow import csv, parquet

from testbed.record.flight import QUANTITIES, Flight, Numbers, Quantity

if TYPE_CHECKING:
    import pandas

_ROWS = 65_536  # in memory at once, and in a row group of Parquet


def columns(quantity: Quantity, names: tuple[str, ...]) -> tuple[str, ...]:
    """The names of a quantity's columns in a run of these aircraft."""
    if not quantity.about_each:
        return (quantity.name,)
    stem, _, unit = quantity.name.rpartition("_")
    return tuple(f"{stem}_{name}_{unit}" for name in names)


def schema(flight: Flight) -> Any:  # noqa: ANN401 - pyarrow has no types
    """The columns with their units, and with the table what tells this run from others."""
    fields = [
        arrow.field("time_s", arrow.float64(), metadata={"unit": "s"}),
        arrow.field("aircraft", arrow.dictionary(arrow.int32(), arrow.string())),
    ]
    for each in QUANTITIES.values():
        kind = arrow.uint32() if each.whole else arrow.float64()
        if each.source == "lost":
            kind = arrow.bool_()
        unit = {"unit": each.unit} if each.unit else None
        fields += [arrow.field(name, kind, metadata=unit) for name in columns(each, flight.names)]
    return arrow.schema(fields, metadata=flight.facts())


def tables(flight: Flight) -> Iterator[Any]:
    """The rows in parts that fit into memory; at least one part, which may be empty."""
    kind, names = schema(flight), flight.names
    step = max(1, _ROWS // len(names))
    for start in range(0, max(1, flight.time_s.size), step):
        rows = slice(start, start + step)
        time_s = flight.time_s[rows]
        who = np.tile(np.arange(len(names), dtype=np.int32), time_s.size)
        cells = [
            arrow.array(np.repeat(time_s, len(names))),
            arrow.DictionaryArray.from_arrays(who, arrow.array(names, arrow.string())),
        ]
        for each in QUANTITIES.values():
            values = flight.of(each, rows)
            absent = who == 0 if each.followers_only else np.zeros(who.size, dtype=bool)
            for other in range(len(names) if each.about_each else 1):
                of_one = values[..., other] if each.about_each else values
                cells.append(_cells(of_one.reshape(-1), absent, kind.field(len(cells)).type))
        yield arrow.Table.from_arrays(cells, schema=kind)


def _cells(values: Numbers, absent: Numbers, kind: Any) -> Any:  # noqa: ANN401
    """A column: null where there is nobody to have a number, or no number."""
    missing = absent | np.isnan(values) if values.dtype.kind == "f" else absent
    if kind == arrow.uint32():
        values = np.where(missing, 0, values).astype(np.uint32)
    return arrow.array(values, kind, mask=missing)


def write_parquet(flight: Flight, file: IO[bytes]) -> None:
    """Write a run as Parquet: units with the columns, page, metrics and events with the file."""
    with parquet.ParquetWriter(file, schema(flight), compression="zstd") as writer:
        for table in tables(flight):
            writer.write_table(table)


def write_csv(flight: Flight, file: IO[bytes]) -> None:
    """Write a run as CSV: a row of names, then numbers that read back to the same bits."""
    file.write((",".join(schema(flight).names) + "\n").encode())
    # names need no quotes: neither fields nor aircraft may have a comma in theirs
    style = csv.WriteOptions(include_header=False, quoting_style="none")
    for table in tables(flight):
        names = table["aircraft"].cast(arrow.string())
        csv.write_csv(table.set_column(1, "aircraft", names), file, style)


def to_pandas(flight: Flight) -> pandas.DataFrame:
    """A table indexed by time_s and aircraft."""
    whole = arrow.concat_tables(tables(flight)).replace_schema_metadata()
    frame: pandas.DataFrame = whole.to_pandas()
    return frame.set_index(["time_s", "aircraft"])


KINDS: Mapping[str, Any] = {
    "int64": arrow.int64(),
    "double": arrow.float64(),
    "string": arrow.string(),
    "bool": arrow.bool_(),
}


def write_columns(
    file: IO[bytes],
    fields: Mapping[str, str],
    groups: Iterable[Sequence[Sequence[Any]]],
    facts: Mapping[str, str],
) -> None:
    """Write any table as Parquet, a group of rows at a time.

    Args:
        file: where to.
        fields: the kind of each column, one of `KINDS`, by its name.
        groups: of each group of rows its columns; None is no value.
        facts: texts to be kept with the table.
    """
    kind = arrow.schema(
        [arrow.field(name, KINDS[each]) for name, each in fields.items()],
        metadata=dict(facts),
    )
    with parquet.ParquetWriter(file, kind, compression="zstd") as writer:
        for group in groups:
            cells = [arrow.array(c, each.type) for c, each in zip(group, kind, strict=True)]
            writer.write_table(arrow.Table.from_arrays(cells, schema=kind))


def read_columns(
    path: Path, names: Iterable[str] | None = None
) -> tuple[dict[str, Numbers], dict[str, str]]:
    """Read a table and its facts.

    Args:
        path: the file.
        names: columns to read, of those that there are; all, if None.

    Returns:
        The columns (rows,) by name, a missing double as nan and a missing text as None; and the
        texts that are kept with the table.

    Raises:
        ValueError: it is not a Parquet file.
        OSError: it cannot be read.
    """
    try:
        with parquet.ParquetFile(path) as file:
            kind = file.schema_arrow
            wanted = kind.names if names is None else [n for n in kind.names if n in set(names)]
            table = file.read(columns=wanted)
    except arrow.ArrowInvalid as error:
        raise ValueError(f"is not a Parquet file: {error}") from None
    facts = {key.decode(): text.decode() for key, text in (kind.metadata or {}).items()}
    columns = {name: table[name].to_numpy(zero_copy_only=False) for name in wanted}
    return columns, facts


def column_names(path: Path) -> tuple[str, ...]:
    """The columns of a Parquet file.

    Raises:
        ValueError: it is not a Parquet file.
        OSError: it cannot be read.
    """
    try:
        return tuple(parquet.read_schema(path).names)
    except arrow.ArrowInvalid as error:
        raise ValueError(f"is not a Parquet file: {error}") from None
